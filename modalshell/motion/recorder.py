"""Step loop: advances a motion, checks it at the stored frames, and determines its outcome."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome, gravest
from modalshell.core.timings import Stopwatch
from modalshell.core.touched import TOUCHED, TouchedFrame
from modalshell.core.typing import Array, Progress, unheard
from modalshell.integrators.full import Composite, FullIntegrator, ImplicitRule
from modalshell.integrators.state import CREASES, HEAT
from modalshell.models.base.modal_motion import CONSTRAINT_MET
from modalshell.models.base.model import NO_POTENTIAL
from modalshell.motion.colliders import ColliderAccount
from modalshell.motion.stepping import Motion
from modalshell.motion.trajectory import Trajectory

_MOST_STEPS = 1_000_000_000
"""Longest run: one of more steps would never end."""
_QUARTER_DECAY = 0.1
"""Runs are judged only if free motion loses all but this fraction of its energy in a quarter of the run."""
_STILL_MOVING = 0.5
"""Share of the third quarter's kinetic energy in the last one, from which the motion may be a cycle."""
_REBOUND = 100.0
"""How far motion that decays may lie above its largest kinetic energy times the decay: about 20 at critical damping."""
_RUN_AWAY = 100.0
"""Energy over that which the load has put in, from which motion that still gathers it runs away."""
_GAINED = 0.1
"""Energy that steps on colliders at rest have added, over that of the load, from which it is reported."""
_LOST = 0.1
"""Energy that steps take from undamped motion, over what start and load have put in, from which it is reported."""
_STILL_FALLING = 0.99
"""Share of kinetic energy from one sixteenth of the run to the next, below which it falls."""
_AT_REST = 1e-9
"""Share of the largest energy below which kinetic energy counts as none."""
_INSIDE = 1e-3
"""Depth of a vertex in a collider, as a share of the shell's size, from which it is reported."""
_THROUGH = 0.5
"""Depth of a vertex, as a share of a collider's smallest radius, from which it may come out on the other side."""
_HUGE = 1e9
"""Coordinate from which positions may overflow single precision."""
_FAULTS = {
    Outcome.DISTORTED: "the surface stretched or folded over beyond what the model can describe",
    Outcome.WOUND_UP: "a part of the shell turned by more than 2 pi",
}


def step_count(duration: float, dt: float) -> int:
    """Whole steps of ``dt`` that cover ``duration``; OptionError if no run would ever end."""
    steps = np.ceil(duration / dt - 1e-9)
    if steps > _MOST_STEPS:
        raise OptionError(f"duration must be at most {_MOST_STEPS:,} steps of {dt:g} s (got {duration:g} s)")
    return int(steps)


def take_steps(motion: Motion, total: int, patience: int | None = None) -> Iterator[None]:
    """Step up to ``total`` steps in all, pausing after each.

    A motion that is no longer finite ends the loop without a pause; one with ``patience`` steps that did not converge
    ends it, too.
    """
    while motion.count < total and (patience is None or motion.unconverged < patience):
        motion.advance()
        if not motion.finite:
            return
        yield


@final
class Recorder:
    """Takes a motion to its end, watches it at its stored frames and names its outcome.

    Parameters
    ----------
    motion : Motion
        The motion, at its start or restored.
    total : int
        Steps to take in all.
    store_every : int
        Frames are stored every ``store_every`` steps, and at the last one.
    patience : int, optional
        Number of steps that may fail to converge before the motion is aborted.
    precision : dtype, optional
        In which positions are stored: a motion beyond its numbers has diverged.

    Attributes
    ----------
    times : list of float
        Times of the stored frames [s].
    energies : list of ndarray, shape (3,)
        Kinetic and elastic energy and potential of the load in each [J].
    residuals : list of ndarray, shape (k,)
        What was left to each constraint's target.
    levels : list of int
        Number of the model of each, of a model that switches itself; else empty.
    creases, heat : list
        Plastic folds (C,) [rad] of creases, and the heat [J] that they have made, in each; empty without creases.
    touched : list of TouchedFrame
        What touches in each, with contacts; else empty.
    fault : Outcome or None
        The gravest fault of a stored state that the model named, such as "wound up".
    fault_time : float
        When that was first [s].
    colliders : ColliderAccount
        What the stored frames tell of the colliders.
    """

    def __init__(
        self,
        motion: Motion,
        total: int,
        *,
        store_every: int = 1,
        patience: int | None = None,
        precision: DTypeLike = np.float64,
    ) -> None:
        self.motion, self.total, self.store_every, self.patience = motion, total, store_every, patience
        self._largest = float(np.finfo(np.dtype(precision)).max)
        self.times: list[float] = []
        self.energies: list[Array] = []
        self.residuals: list[Array] = []
        self.levels: list[int] = []
        self.creases: list[Array] = []
        self.heat: list[float] = []
        self.touched: list[TouchedFrame] = []
        self.fault: Outcome | None = None
        self.fault_time = 0.0
        rule = getattr(motion.model, "integrator", None)
        puts_back = isinstance(rule, FullIntegrator) and not isinstance(rule, ImplicitRule)
        self.colliders = ColliderAccount(motion.setup.contacts, motion.shell.mesh, add=puts_back)
        self._watch, self._seconds_before = Stopwatch(), 0.0

    @property
    def seconds(self) -> float:
        """Wall time of the motion [s], that before it was stopped and resumed included."""
        return self._seconds_before + self._watch()

    def resume(
        self, times: Array, energies: Array, residuals: Array, fault: Outcome | None, fault_time: float, seconds: float
    ) -> None:
        """Resume after stored frames: (F,), (F, 3), (F, k), their first fault, and their wall time."""
        self.times, self.energies, self.residuals = times.tolist(), list(energies), list(residuals)
        self.fault, self.fault_time = fault, fault_time
        self._watch, self._seconds_before = Stopwatch(), seconds

    def recall(self, states: Mapping[str, NDArray[Any]]) -> None:
        """Take levels and creases of stored frames from the arrays (F, ...) of their states, by name."""
        model = self.motion.model
        if model.level_names:
            self.levels = states["level"][:, 0].astype(int).tolist()
        if CREASES in states:
            self.creases = [model.crease_angles(np.array(angles)) for angles in states[CREASES]]
            self.heat = states[HEAT][:, 0].tolist()

    def look_back(self, positions: NDArray[np.floating]) -> None:
        """Take note again of what stored frames at ``positions`` (F, n, 3) [m] tell of the colliders."""
        for x, time, touched in zip(positions, self.times, self.touched, strict=True):
            beyond = self.fault is not None and time >= self.fault_time
            self.colliders.see(partial(x.astype, np.float64), time, touched, beyond=beyond)

    def frames(self, on_step: Progress = unheard) -> Iterator[None]:
        """Take the steps, pausing at each frame to be stored: the start (unless resumed) and every ``store_every``.

        ``on_step`` is called after each step with the steps done and their total.
        """
        motion = self.motion
        if not self.times:
            self._record_frame()
            yield
        if self.colliders.torn:
            motion.finite = False
            return
        for _ in take_steps(motion, self.total, self.patience):
            if motion.count % self.store_every == 0 or motion.count == self.total:
                if not self._fits_precision():
                    motion.finite = False
                    return
                self._record_frame()
                yield
                if self.colliders.torn:
                    motion.finite = False
                    return
            on_step(motion.count, self.total)

    def _fits_precision(self) -> bool:
        """Whether positions fit the precision in which they are stored; looked at where coordinates are huge."""
        near = float(np.abs(self.motion.state.coordinates).max(initial=0.0)) < _HUGE
        return near or float(np.abs(self.motion.positions()).max()) <= self._largest

    def _record_frame(self) -> None:
        """Take note of the present state."""
        motion = self.motion
        self.times.append(motion.time)
        self.energies.append(motion.energies())
        self.residuals.append(motion.constraint_residuals)
        if (touched := motion.touched()) is not None:
            self.touched.append(touched)
        if motion.model.level_names:
            self.levels.append(int(motion.state.memory["level"][0]))
        if CREASES in motion.state.memory:
            self.creases.append(motion.model.crease_angles(motion.state.memory[CREASES]))
            self.heat.append(float(motion.state.memory[HEAT][0]))
        fault = motion.fault()
        if fault is not None and (self.fault is None or gravest(self.fault, fault) is not self.fault):
            self.fault, self.fault_time = fault, motion.time
        if touched is not None:
            self.colliders.see(motion.positions, motion.time, touched, beyond=self.fault is not None)

    def trajectory(self, positions: NDArray[np.floating]) -> Trajectory:
        """The recorded motion, with the ``positions`` (F, n, 3) [m] of its stored frames."""
        outcome, message = self.verdict()
        shell = self.motion.shell
        contacts: dict[str, Any] = {}
        if self.touched:
            contacts = {
                name: np.array(each) for name, each in zip(TOUCHED, zip(*self.touched, strict=True), strict=True)
            }
            if np.isnan(contacts["self_contact"]).all():
                del contacts["self_contact"]
        return Trajectory(
            times=np.array(self.times),
            positions=positions,
            outcome=outcome,
            message=message,
            unconverged_steps=self.motion.unconverged,
            seconds=self.seconds,
            step_error=self.motion.errors.largest,
            damping_error=self.motion.errors.damping_error(self.motion.state),
            energies=np.array(self.energies),
            constraint_residuals=np.array(self.residuals),
            faces=np.asarray(shell.mesh.faces),
            rest_positions=shell.rest_positions,
            levels=tuple(self.motion.model.level_names[level] for level in self.levels),
            crease_angles=np.array(self.creases) if self.creases else np.empty((0, 0)),
            crease_heat=np.array(self.heat),
            **contacts,
        )

    def verdict(self) -> tuple[Outcome, str]:
        """The worst outcome that applies, and a message that names all of them and what the model remarks, or ""."""
        motion = self.motion
        crowded, torn = self.colliders.crowded, self.colliders.torn
        if torn:
            words = f"in contact the shell was drawn out to {torn:.2g} m, {torn / motion.shell.size:.2g} times its "
            words += (
                f"size, by {motion.time:.6g} s: colliders push it where its supports do not let it go, or farther than "
            )
            words += "this model reaches: leave it room, or take DS"
            return Outcome.DIVERGED, "; ".join([words, crowded] if crowded else [words])
        if not motion.finite:
            return Outcome.DIVERGED, f"positions left the finite numbers at {motion.time:.6g} s"
        found: dict[Outcome, str] = {}
        notes = [] if motion.setup.loading.conservative else [NO_POTENTIAL]
        if self.fault is not None:
            found[self.fault] = f"{_FAULTS[self.fault]} at {self.fault_time:.6g} s"
        if self._runs_away():
            found[Outcome.RUNS_AWAY] = "its energy grows on and on, far beyond the work of the load"
        elif not crowded and (gained := self._gained_on_contacts()) > _GAINED:
            words = (
                f"steps on contacts have added {gained:.2g} times the energy that the load has put in: take shorter "
            )
            words += "ones, or integrator 'composite' or 'implicit', which add none"
            if gained > 1.0:
                found[Outcome.RUNS_AWAY] = words
            else:
                notes.append(words)
        elif self._never_settles():
            found[Outcome.CYCLING] = "the motion does not settle although it is damped"
        scales = {"position": (motion.shell.size, "m"), "orientation": (1.0, "rad")}
        kinds = [constraint.kind for constraint in motion.setup.constraints]
        missed = np.array(self.residuals) / [scales[kind][0] for kind in kinds]
        if (missed > CONSTRAINT_MET).any():
            frame, one = np.unravel_index(missed.argmax(), missed.shape)
            words = f"{self.residuals[frame][one]:.2e} {scales[kinds[one]][1]} (constraint {one}, {kinds[one]}, "
            words += f"at {self.times[frame]:.3g} s): its target may be out of the model's reach"
            found[Outcome.CONSTRAINTS_MISSED] = f"constraints were missed by up to {words}"
        if crowded:
            found[Outcome.CONSTRAINTS_MISSED] = crowded
        if motion.unconverged:
            words = f"{motion.unconverged} of {motion.count} steps did not converge"
            found[Outcome.STEPS_NOT_CONVERGED] = words
        if self._has_died_away() and not motion.setup.loading.live and motion.present_model.is_saddle(motion.state):
            found[Outcome.UNSTABLE] = "it ends at rest at a saddle, which the smallest push aside leaves"
        said = [motion.errors.remark(motion.state), motion.errors.undersampled()]
        said = said if any(said) or found else [self._lost_energy_note()]
        if Outcome.CYCLING in found or Outcome.RUNS_AWAY in found:
            said.append(motion.errors.unresolved())
        said += [motion.model.account(motion.state), self._inside_note() or self._dip_note()]
        notes += [note for note in said if note]
        return gravest(Outcome.COMPLETED, *found), "; ".join([*found.values(), *notes, *motion.remarks])

    def _inside_note(self) -> str:
        """What is said of vertices inside colliders that do not push them out; "" of none."""
        deepest = [touched.deepest for touched in self.touched]
        if self._pushes_out or self.colliders.crowded or max(deepest, default=0.0) <= _INSIDE * self.motion.shell.size:
            return ""
        time, colliders = self.times[int(np.argmax(deepest))], [one for _, one in self.colliders.contacts]
        where = f"up to {max(deepest):.2g} m inside a collider, at {time:.6g} s"
        if max(deepest) > _THROUGH * min(one.collider.smallest_radius for one in colliders):
            where += ", and may have passed through it"
        return f"vertices are {where}: take a finer mesh, the coarse one of models that have it, or shorter steps"

    @property
    def _pushes_out(self) -> bool:
        return any(getattr(contact, "push_out", 0.0) for contact in self.motion.setup.contacts)

    def _dip_note(self) -> str:
        """What is said of edges that dip into colliders at the end; "" of none."""
        touched = self.motion.touched()
        if touched is None or self._pushes_out or self.colliders.crowded or not touched.touches.any():
            return ""
        return self.colliders.dips(self.motion.positions(), self.motion.time, touched)

    @property
    def _keeps_energy(self) -> bool:
        """Whether loads with a potential that stays alone do work."""
        return self._by_load_alone and not self.motion.setup.contacts

    @property
    def _by_load_alone(self) -> bool:
        """Whether loads with a potential that stays do all the work that contacts do not."""
        setup = self.motion.setup
        steady = setup.loading.steady and setup.loading.conservative
        return steady and setup.supports is None and not setup.constraints

    def _gained_on_contacts(self) -> float:
        """Rise of all energy beyond the work of colliders, over what these and the load have put in; 0 without any.

        What moving colliders have done is known of rules that may add energy, where each step is a frame.
        """
        contacts, worked = self.motion.setup.contacts, self.colliders.worked
        unknown = self._pushes_out or not self.colliders.knows_work(self.store_every)
        if not contacts or unknown or not self._by_load_alone or len(self.times) < 2:
            return 0.0
        energies = np.array(self.energies)
        put_in = float(energies[0, :2].sum() + np.ptp(energies[:, 2])) + worked
        rise = float(np.max(energies.sum(axis=1) - energies[0].sum())) - worked
        return rise / put_in if put_in > 0.0 else 0.0

    def _lost_energy_note(self) -> str:
        """What is said of energy that steps have taken from motion that keeps it; "" of little."""
        motion = self.motion
        takes = motion.setup.damping.any or motion.shell.has_dashpots or CREASES in motion.state.memory
        if not self._keeps_energy or takes or len(self.times) < 2:
            return ""
        energies = np.array(self.energies)
        put_in = float(energies[0, :2].sum() + np.ptp(energies[:, 2]))
        lost = float(energies[0].sum() - energies[-1].sum())
        if lost <= _LOST * put_in:
            return ""
        rule = getattr(motion.model, "integrator", None)
        keeps = not isinstance(rule, ImplicitRule) or isinstance(rule, Composite)
        other = "" if keeps else ", or integrator 'composite', which keeps more of it"
        share = f"{lost / put_in:.2g} of the energy that start and load put in"
        return f"steps have taken {share}: take shorter ones{other}"

    def _has_died_away(self) -> bool:
        """Whether motion has died away under a load that does not change."""
        if not self._keeps_energy or len(self.times) < 2:
            return False
        energies = np.array(self.energies)
        return bool(energies[:, 0].max() > 0.0 and energies[-1, 0] <= _AT_REST * np.abs(energies).max())

    def _runs_away(self) -> bool:
        """Whether there is far more energy than the load has put in, most of it new in the last quarter."""
        if not self._keeps_energy or len(self.times) < 8:
            return False
        energies = np.array(self.energies)
        stored = energies[:, 0] + energies[:, 1]
        put_in = float(stored[0] + np.ptp(energies[:, 2]))
        before, late = stored[: 3 * len(stored) // 4].max(), stored[3 * len(stored) // 4 :].max()
        return bool(late > max(_RUN_AWAY * put_in, 2.0 * before))

    def _never_settles(self) -> bool:
        """Whether kinetic energy has stopped falling although damping, under a constant load, must have eaten it."""
        motion = self.motion
        damped = motion.setup.damping.any
        if not self._keeps_energy or not damped or len(self.times) < 40:
            return False
        rate = motion.model.decay_rate(motion.setup.dt, motion.setup.damping)
        if np.exp(-rate * self.times[-1] / 4.0) > _QUARTER_DECAY:
            return False
        energies = np.array(self.energies)
        peaks = np.array([part.max() for part in np.array_split(energies[len(energies) // 2 :, 0], 8)])
        third, last = peaks[:4].max(), peaks[4:].max()
        if last <= 1e-9 * np.abs(energies[:, 1:]).max() or last <= _STILL_MOVING * third:
            return False
        # Near critical damping motion turns once, very slowly, and then seems to gather speed.
        if last <= _REBOUND * energies[:, 0].max() * np.exp(-0.75 * rate * self.times[-1]):
            return False
        # Chaotic motion has peaks of every size; only a slow decay lets them fall one after the other.
        return bool((peaks[1:] > _STILL_FALLING * peaks[:-1]).any())
