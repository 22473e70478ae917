"""Viewer session, independent of graphics: a scene in motion whose gravity and model can change."""

from __future__ import annotations

import math

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import checked_count, checked_number, checked_vectors
from modalshell.core.errors import LoadError, ModalShellError, OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.integrators.state import CREASES, HEAT
from modalshell.models import Model
from modalshell.models.base.modal import ModalModel, as_modal
from modalshell.models.factory import MODE_COUNT, FirstModes
from modalshell.motion import Motion
from modalshell.motion.recorder import take_steps
from modalshell.scene import Scene
from modalshell.scene.models import model_tables
from modalshell.scene.tables import MotionTable
from modalshell.viewer.live_bar import LiveBar

FRAME_SECONDS = 1.0 / 30.0
"""Time from one picture to the next [s]."""

_WORK_LIMIT = 2.0 * FRAME_SECONDS
"""Wall time [s] per frame after which no further step is begun."""
_LONGEST_PAUSE = 0.25
"""Longer gaps [s] between frames, from building a model or a sleeping machine, are not caught up."""
_MODE_LIMIT = 64
"""Modes that the slider reaches, where the scene has no more."""
_STEP, _DAMPING = 1.0 / 30.0, (0.5, 0.001)
"""Step [s] and damping, of mass [1/s] and stiffness [s], of a scene without a motion."""

_WORTH_IT = 0.02
"""Share by which a round must lessen the squared misfit for another to be worth it."""
_ROOM, _INSET = 0.5, 5e-3
"""What planes show about the shell, and depth below their surfaces at which colliders are drawn, over its size."""
_FAR = 1e6
"""Shell sizes from the rest shape at which a motion counts as diverged though its numbers are still finite."""


def gravity_limit(gravity: Array, units: UnitSystem = SI) -> float:
    """Size of gravity's components [m/s^2] that a viewer makes room for, where the scene's is ``gravity`` (3,)."""
    return 2.0 * max(units.earth, float(np.abs(gravity).max()))


def _still_motion(units: UnitSystem) -> MotionTable:
    """The motion of a scene without one, in its units."""
    mass, stiffness = _DAMPING
    second = units.seconds
    return MotionTable(duration=math.inf, dt=_STEP / second, damping=(mass * second, stiffness / second))


class ViewSession:
    """A scene in motion, to be played, paused, pulled at by gravity and given to another model.

    SceneError where the scene is refused.

    Parameters
    ----------
    scene : Scene
        What to show. One without a motion moves with steps of 1/30 s and light damping.

    Attributes
    ----------
    shell : Shell
        The scene's shell.
    name : str
        Name of the model, a key of :func:`modalshell.models.registry.models`.
    modes : int
        Modes that a modal model has or would have.
    mode_limit : int
        The largest number allowed.
    units : UnitSystem
        Of the scene's numbers.
    gravity : ndarray, shape (3,)
        Acceleration on every vertex [m/s^2].
    gravity_limit : float
        Size up to which front ends offer each of its components [m/s^2].
    rest_positions, faces, held
        Vertex positions (n, 3) at rest [m], triangles (T, 3), and which vertices (n,) are held.
    positions : ndarray, shape (n, 3)
        The last finite vertex positions [m], in the world.
    diverged : bool
        Whether the motion is not finite any more; then only a reset or another model continues it.
    playing : bool
        Whether :meth:`advance` moves on.
    late : bool
        Whether the last frame left simulated time undone.
    note : str
        Warning about the motion; empty if there is none.
    refusal : str
        Why the last choice of a model was refused; empty if it was not.
    frame_milliseconds : float
        Work of the last frame, without drawing.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene.require_shell()
        self.shell = scene.build_shell()
        self.rest_positions, self.faces = self.shell.rest_positions, self.shell.mesh.faces
        self.held = self.shell.clamped
        self._built = self.scene.build(self.shell)
        self.units = scene.unit_system
        self._table = scene.motion or _still_motion(self.units)
        self._size = self.shell.size
        self.name = scene.model.spec.key
        self.modes = int(scene.model.options.get("modes", MODE_COUNT))
        self.mode_limit = min(max(_MODE_LIMIT, self.modes), self.shell.unknowns.count)
        self.gravity = np.array(self._built.gravity or (0.0, 0.0, 0.0), dtype=np.float64)
        self.gravity_limit = gravity_limit(self.gravity, self.units)
        model = self._built.model
        modal = as_modal(model)
        self._first_modes = FirstModes(None if modal is None else modal.basis)
        self._models: dict[str, tuple[int, Model]] = {self.name: (self.modes, model)}
        self.playing, self.frame_milliseconds, self._owed, self.refusal = False, 0.0, 0.0, ""
        self._begin(self._new_motion(model, None))

    @property
    def model(self) -> Model:
        """The model that moves."""
        return self._motion.model

    def bodies(self) -> list[tuple[Array, NDArray[np.integer]]]:
        """Vertices [m] and triangles of the colliders, where they are now."""
        contacts = [contact for contact in self._built.contacts if contact.has_surface]
        if not contacts:
            return []
        rest, size = self.shell.rest_positions, self.shell.size
        low, high = rest.min(axis=0) - size * _ROOM, rest.max(axis=0) + size * _ROOM
        corners = np.stack(np.meshgrid(*np.stack([low, high]).T), axis=-1).reshape(-1, 3)
        moved = [contact.surfaces(corners, np.array([self.time]), _INSET * size) for contact in contacts]
        return [(x[0], faces) for x, faces in moved]

    @property
    def time(self) -> float:
        """Simulated time since the rest shape [s]."""
        return self._motion.time

    def play(self) -> None:
        """Let time run, unless the motion has diverged."""
        self.playing = not self.diverged

    def pause(self) -> None:
        """Hold time."""
        self.playing = False

    def toggle(self) -> None:
        """Play if paused, otherwise pause."""
        self.refusal = ""
        self.playing = not (self.playing or self.diverged)

    def reset(self) -> None:
        """Go back to the rest shape at time 0 and pause, with the model and gravity as they are."""
        self.refusal = ""
        self._begin(self._new_motion(self._cached_model(self.name, self.modes), None))

    def set_gravity(self, gravity: ArrayLike) -> None:
        """Change the acceleration (3,) [m/s^2] on every vertex; the motion continues from its present state."""
        vector = checked_vectors("gravity", gravity, (3,), LoadError)
        self._motion.load = self.shell.loading(vector, self._built.force, self._built.loads).dead
        self.gravity = vector

    def choose(self, name: str, modes: int) -> bool:
        """Take a model that the user names, or note why it is refused; whether it is another than the present one."""
        if (name, modes) == (self.name, self.modes):
            return False
        self.refusal = ""
        try:
            self.set_model(name, modes)
        except ModalShellError as error:
            self.refusal = self.units.restated(str(error))
        return True

    def set_model(self, name: str, modes: int | None = None) -> None:
        """Continue with another model or number of modes, in the present shape as nearly as the model can take it.

        With the same modal model the motion continues as well; any other model starts from rest in that shape, with the
        folds that creases have kept. OptionError for a model or number of modes that does not exist, or a model that
        cannot take the scene's steps. The session then is as it was. SolverError if the modes cannot be computed.
        """
        if name not in model_tables():
            raise OptionError(f"there is no model {name!r}; choose from {', '.join(model_tables())}")
        count = self.modes if modes is None else checked_count("modes", modes)
        if count > self.mode_limit:
            raise OptionError(f"modes must be at most {self.mode_limit} in the viewer (got {count})")
        motion = self._new_motion(self._cached_model(name, count), self._motion)
        self.name, self.modes = name, count
        playing = self.playing
        self._begin(motion)
        self.playing = playing and not self.diverged

    def advance(self, seconds: float, *, limit: float = math.inf) -> None:
        """Move on by ``seconds`` of simulated time, if playing.

        Parameters
        ----------
        seconds : float
            Simulated time [s]; a remainder below one step is kept for the next call.
        limit : float
            Wall time [s] after which no further step is begun; the time left is dropped, so that a model too slow for
            the present moves slowly instead of falling behind for ever.
        """
        if not self.playing:
            return
        watch = Stopwatch()
        self._owed += checked_number("seconds", seconds, at_least=0.0, unit="s") / self.units.seconds
        self.late = False
        motion = self._motion
        end = motion.count + int(self._owed / motion.setup.dt + 1e-6)  # thirty frames of 1/30 s shall be thirty steps
        try:
            for _ in take_steps(motion, end):
                self._owed -= motion.setup.dt
                if self._bar is not None:
                    self._bar.see(motion)
                self.late = motion.count < end and watch() > limit
                if self.late:
                    self._owed = 0.0
                    break
        except ModalShellError as error:
            self.playing, self.note = False, self.units.restated(str(error))
        if not motion.finite:
            self._stop_diverged()
        self._look()
        if self.playing:
            self.note = self._faults()
        self.frame_milliseconds = 1e3 * watch()

    def keep_pace(self, passed: float) -> None:
        """Move on by the wall time [s] that has ``passed`` since the last frame, in real time where the model can."""
        self.advance(passed if passed < _LONGEST_PAUSE else FRAME_SECONDS, limit=_WORK_LIMIT)

    def status(self) -> str:
        """One line: model, modes, time, work per frame, and a warning if there is one."""
        modes = f", {self.modes} modes" if "modes" in model_tables()[self.name].__struct_fields__ else ""
        state = "playing" if self.playing else "paused"
        work = f"{self.frame_milliseconds:.2g} ms a frame"
        bar = "" if self._bar is None else self._bar.text
        parts = [f"{self.model.name}{modes}", f"t = {self.time:.2f} {self.units.time}", bar, work, state]
        if self.playing and self.late:
            parts.append("slower than real time")
        return "; ".join(filter(None, [*parts, self.note, self.refusal]))

    def _begin(self, motion: Motion) -> None:
        """Restore a motion."""
        self._motion = motion
        self._bar = LiveBar(motion) if self.scene.bar else None
        self._owed = 0.0
        self.late, self.playing, self.diverged, self.note = False, False, False, ""
        self.positions = self.shell.rest_positions
        self._look()
        if not self.diverged:
            self.note = self._faults()

    def _stop_diverged(self) -> None:
        self.playing, self.diverged = False, True
        self.note = f"{Outcome.DIVERGED} at t = {self.time:.3g} {self.units.time}: reset, or take another model"

    def _look(self) -> None:
        """Take the positions, unless they are no shape any more."""
        if self.diverged:
            return
        positions = self._motion.positions()
        if not np.abs(positions - self.shell.rest_positions).max() < _FAR * self._size:
            self._stop_diverged()
            return
        self.positions = positions.copy()  # a model may lend its one buffer

    def _faults(self) -> str:
        """Warning about a motion that is still running."""
        unconverged = self._motion.unconverged
        fault = self._motion.fault()
        missed = f"{unconverged} steps did not converge" if unconverged else ""
        return ", ".join(filter(None, [fault, missed]))

    def _cached_model(self, name: str, modes: int) -> Model:
        """The model on the scene's options if it is the scene's own, else on its defaults; the last of each is kept."""
        known = self._models.get(name)
        kind = model_tables()[name]
        counted = "modes" in kind.__struct_fields__
        if known is not None and (known[0] == modes or not counted):
            return known[1]
        table = self.scene.model if self.scene.model.spec.key == name else kind()
        if counted:
            table = msgspec.structs.replace(table, modes=modes)
        model = table.build(self.scene.model_factory(self.shell, self._first_modes))
        self._models[name] = (modes, model)
        return model

    def _new_motion(self, model: Model, before: Motion | None) -> Motion:
        """A motion of ``model`` from rest at time 0, or from the shape and time of the one ``before``."""
        path, motion = self._built.path, self._built.motion_of(model, self.gravity, self._table)
        if before is not None:
            motion.count = before.count
            motion.place(self.positions)
            if CREASES in motion.state.memory and CREASES in before.state.memory and not self.diverged:
                folds = before.model.crease_angles(before.state.memory[CREASES])
                motion.state.memory[CREASES] = motion.model.own_crease_angles(folds)
                motion.state.memory[HEAT] = before.state.memory[HEAT].copy()
            if (modal := as_modal(model)) is not None:
                own = self.positions if path is None else path.at(before.time).to_shell(self.positions)
                state = hand_over(None if self.diverged else before, own, modal)
                motion.state.coordinates, motion.state.rates = state
        return motion


def hand_over(before: Motion | None, positions: Array, model: ModalModel) -> tuple[Array, Array]:
    """Coordinates (m,) and rates (m,) with which ``model`` continues.

    Parameters
    ----------
    before : Motion or None
        The motion so far, unless it has diverged. If its model is the same but for the number of modes, so is what
        follows.
    positions : ndarray, shape (n, 3)
        The shape [m] that any other model is brought as near to as it can, at rest, in the shell's frame.
    model : ModalModel
        The model that continues.
    """
    last = None if before is None else as_modal(before.model)
    if before is not None and last is not None and type(last) is type(model):
        mass = np.repeat(model.shell.mass, 3)
        transfer = model.basis.modes.T @ (mass[:, None] * last.basis.modes)
        return transfer @ before.state.coordinates, transfer @ before.state.rates
    coordinates = nearest_coordinates(model, positions)
    return coordinates, np.zeros_like(coordinates)


def nearest_coordinates(model: ModalModel, positions: Array) -> Array:
    """Coordinates (m,) whose shape is nearest to ``positions`` (n, 3) in the norm of the mass.

    The projection of a large bend on the modes alone, when warped, is another bend.
    """
    from scipy.optimize import least_squares  # not before a model changes: its import takes long

    weight = np.sqrt(np.repeat(model.shell.mass, 3))
    wanted = positions - model.shell.rest_positions

    def misfit(coordinates: Array) -> Array:
        return weight * (model.raw_displacement(coordinates) - wanted).ravel()

    return least_squares(misfit, model.coordinates_of(positions), method="lm", ftol=_WORTH_IT).x
