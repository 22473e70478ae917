"""A scene as a self-contained web page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import modalshell as ms
from modalshell.core.typing import Array, Progress, unheard
from modalshell.core.units import in_percent
from modalshell.export import compress
from modalshell.export.near_origin import centred
from modalshell.files.provenance import repository_file
from modalshell.models.base.model import NO_POTENTIAL
from modalshell.models.factory import MODE_COUNT
from modalshell.models.reduced_rotation_strain import ReducedWarp, trained_on_loads
from modalshell.modes import model_basis
from modalshell.motion.colouring import Colouring
from modalshell.page import Page, farthest, live_model, recorded, shell_page
from modalshell.page.modal_page import live_tip
from modalshell.page.report import sentence
from modalshell.render.bodies import seen_contacts
from modalshell.run.run_scene import run_in_memory
from modalshell.scene import ShellScene
from modalshell.scene.parts import build_damping
from modalshell.scene.read import located
from modalshell.scene.tables import MotionTable

_RANK, _SAMPLES, _MIXTURES = 8, 32, 8
"""Shapes and triangles of reduced RSW on a page, and copies of each answer in its training."""
_MOST_NUMBERS = 700_000
"""Numbers of modes, rotations and shapes up to which a page has reduced RSW: about 2 MB."""
_NEAR = 0.05
"""Error in training up to which a page has reduced RSW."""
_HONEST = 0.25
"""Error against the scene's own answer up to which a live model is offered."""
_ERROR = 5e-4
"""Largest error of a recorded vertex on a page, as a share of the shell's size."""
_MOST_VERTICES = 5000
"""Vertices up to which a page has a record and live models."""


def scene_page(scene: ms.Scene, on_step: Progress = unheard) -> Page:
    """The page of a scene: its flock, or its shell.

    A motion by LMA, MWTS or reduced RSW under loads that do not change is computed live on the page. Where the live
    models would leave out something of the scene (supports that move, constraints, loads that change, another model, a
    static answer, a colour), the scene is run and the page plays what the run gave. The live models can be chosen
    where they are near it, or where it is said what they leave out; the page says how far they are off. SceneError if a
    table is refused. OptionError if there are more birds, modes or shapes of a motion than a browser takes.
    """
    own: Page | None = scene.own_page()
    if own is not None:
        return own
    made = _ShellPage(scene.require_shell(), on_step)
    with scene.unit_system.said():
        return made.page()


class _ShellPage:
    """The page of a scene of one shell, while it is made."""

    def __init__(self, scene: ShellScene, on_step: Progress) -> None:
        self.scene, self.on_step = scene, on_step
        self.shell = scene.build_shell()
        path, self.force, loads, constraints = scene.build_loading(self.shell)
        self.free_of_time = path is None and not constraints and not scene.contacts
        self.left_out = ["the supports rest"] if path is not None else []
        self.left_out += ["nothing is held along a path"] if constraints else []
        self.left_out += ["nothing is touched"] if scene.contacts else []
        if loads:
            self.left_out += ["loads that change stay as they are at rest, at their largest"]
            loading = self.shell.loading(force=self.force, loads=loads)
            self.force = loading.dead + loading.largest_force()
        motion = scene.motion
        self.left_out += ["modes are not damped one by one"] if motion is not None and motion.modal_damping else []
        self.left_out += ["steps are taken whole"] if motion is not None and motion.tolerance is not None else []
        self.gravity = scene.gravity or (0.0, 0.0, 0.0)
        self.modes: ms.Basis | ms.OptionError
        try:
            self.modes = ms.solve_modes(self.shell, scene.model.options.get("modes", MODE_COUNT))
        except ms.OptionError as error:  # creases, stresses at rest: the scene's own model may know them
            self.modes = error

    @property
    def basis(self) -> ms.Basis:
        """What the live models move in."""
        if isinstance(self.modes, ms.OptionError):
            raise self.modes
        return self.modes

    def _solve(self, shell: ms.Shell, count: int) -> ms.Basis:
        """Modes of the scene's own model, which are often those that the live models move in."""
        known = self.modes
        return known if isinstance(known, ms.Basis) and known.count == count else model_basis(shell, count)

    @property
    def is_live(self) -> bool:
        """Whether the live models leave out nothing."""
        scene, same = self.scene, self.scene.model.spec.builder in (ms.LinearModal, ms.ModalWarping, trained_on_loads)
        return same and scene.motion is not None and scene.output.color is None and not self.left_out and not scene.bar

    def page(self) -> Page:
        """The live page, or one that begins with the record of a run."""
        scene, mesh = self.scene, self.shell.mesh
        gravity, units = list(self.gravity), scene.unit_system
        if self.is_live:
            return shell_page(
                mesh.vertices, mesh.faces, title=scene.name, tip=live_tip(self.basis), live=self._live(),
                gravity=gravity, units=units, notes=["Computed live on this page."],
            )  # fmt: skip
        run = run_in_memory(scene, self.on_step, self.shell, self._solve)
        motion = compress(centred(run)[0], _ERROR)
        shapes = motion.displacements()
        what = "motion" if scene.motion is not None else "equilibrium"
        name = scene.model.spec.name
        record = recorded(
            motion.times,
            shapes,
            motion.amplitudes,
            label=f"The scene's {what}, {name}",
            tones=None if scene.output.color is None else Colouring.of(run, scene.output.color),
            bars=run.bars,
        )
        notes = [f"Shown is the scene's own {what}, computed by {name} ({run.outcome})."]
        if run.message not in ("", NO_POTENTIAL):
            notes.append(sentence(run.message))
        notes += [f"Error bar: {units.restated(str(run.bars))}."] if run.bars is not None else []
        seen = seen_contacts(run.positions, run.faces, run.times, scene.build_contacts())
        live, said = self._offered(run)
        return shell_page(
            mesh.vertices, mesh.faces, title=scene.name, tip=farthest(shapes, motion.amplitudes),
            live=live, record=record, gravity=gravity, units=units, notes=notes + said,
            bodies=[contact.body(corners, motion.times, inset) for contact, corners, inset in seen],
        )  # fmt: skip

    def _live(self) -> dict[str, Any]:
        """What the page needs to step the live models."""
        motion = self.scene.motion
        units = self.scene.unit_system
        strength = float(np.linalg.norm(self.gravity)) or units.earth
        reduced = _reduced(self.basis, np.array(self.gravity), strength, self.force)
        options: dict[str, Any] = {"force": self.force, "reduced": reduced, "units": units}
        if motion is not None:
            options |= {"damping": self._damping(motion), "dt": motion.dt}
        return live_model(self.basis, **options)

    def _damping(self, motion: MotionTable) -> tuple[float, float]:
        """Rayleigh factors of mass [1/s] and stiffness [s]."""
        with located(self.scene.file, "motion", motion):
            damping = build_damping(motion)
        return damping.mass_factor, damping.stiffness_factor

    def _offered(self, run: ms.Trajectory) -> tuple[dict[str, Any] | None, list[str]]:
        """The live models offered with a record, None where they are too far from it, and what is said about them."""
        if len(self.shell.mass) > _MOST_VERTICES:
            return None, ["No live model is offered: the page would be too large with both."]
        if isinstance(self.modes, ms.OptionError):
            return None, ["No live model is offered: they move in vibration modes, which the shell has not here."]
        off = self._error(run) if self.free_of_time else None
        far = "has no answer here" if off is None else f"is {in_percent(off)} off this answer"
        without = f"; live, {' and '.join(self.left_out)}" if self.left_out else ""
        if self.free_of_time and (off is None or off > _HONEST):
            return None, [f"No live model is offered: MWTS, which a page can compute, {far}{without}."]
        said = (
            f"Live models can be chosen below. MWTS {far}" if self.free_of_time else "Live models can be chosen below"
        )
        return self._live(), [f"{said}{without}."]

    def _error(self, run: ms.Trajectory) -> float | None:
        """Error of MWTS, as the page computes it, against the run, over all its frames; None where it has no answer."""
        model, pull, motion = ms.ModalWarping(self.basis), tuple(self.gravity), self.scene.motion
        if motion is None:
            answer = model.equilibrium(gravity=pull, force=self.force)
            return _difference(answer.positions[None], run.positions, self.shell) if answer.converged else None
        moved = ms.simulate(
            model, duration=motion.duration, dt=motion.dt, gravity=pull, force=self.force,
            damping=self._damping(motion), store_every=motion.store_every,
        )  # fmt: skip
        if len(moved.times) != len(run.times):
            return None
        return _difference(moved.positions, run.positions, self.shell)


def _difference(seen: NDArray[np.floating], expected: NDArray[np.floating], shell: ms.Shell) -> float | None:
    """Relative error in displacement over all frames, in the norm of the mass; None where nothing moves."""
    missed = sum(float((shell.mass @ ((a - b) ** 2)).sum()) for a, b in zip(seen, expected, strict=True))
    moved = sum(float((shell.mass @ ((b - shell.rest_positions) ** 2)).sum()) for b in expected)
    return float(np.sqrt(missed / moved)) if moved > 0.0 else None


def _reduced(basis: ms.Basis, gravity: Array, strength: float, force: Array | None) -> ReducedWarp | None:
    """Reduced RSW for a page, trained on the scene's load and a gravity of some strength in every direction.

    None where it is large.
    """
    size = 3 * len(basis.shell.rest_positions) * (2 * basis.count + _RANK)
    if basis.rigid_modes or size > _MOST_NUMBERS:
        return None
    pulls = [sign * strength * axis for axis in np.eye(3) for sign in (1.0, -1.0)] + [gravity]
    dead = np.zeros_like(basis.shell.rest_positions) if force is None else force
    loads = [factor * (basis.shell.gravity_force(pull) + dead) for pull in pulls for factor in (0.5, 1.0)]
    full = ms.RotationStrain(basis)
    trained = ms.ReducedRotationStrain.trained(
        full, loads=np.array(loads), mixtures=_MIXTURES, aside=0.1, rank=_RANK, samples=_SAMPLES
    )
    return trained.on_page() if trained.training_error < _NEAR else None


def write_pages(folder: Path, on_step: Progress = unheard) -> list[Path]:
    """Write the page of every bundled scene into ``folder``; return the files."""
    scenes = sorted(repository_file("studies/scenes/v_beam.toml").parent.glob("*.toml"))
    written = []
    for index, file in enumerate(scenes):
        written.append(scene_page(ms.load_scene(file)).save(folder / f"{file.stem}.html"))
        on_step(index + 1, len(scenes))
    return written
