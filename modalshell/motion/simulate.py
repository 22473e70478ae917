"""Motion of any rung under a dead load: time stepping, with a named outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from modalshell.checks import checked_count, checked_kind, checked_number, checked_precision
from modalshell.constraints import Constraint
from modalshell.errors import OptionError
from modalshell.models import Model
from modalshell.models.modal import CONSTRAINT_MET
from modalshell.motion.stepping import Motion, checked_step
from modalshell.motion.supports import SupportPath
from modalshell.motion.trajectory import Trajectory
from modalshell.timings import Stopwatch
from modalshell.typing import Array

_MOST_STEPS = 1_000_000_000
_QUARTER_DECAY = 0.1
"""Share of its energy that free motion may keep over a quarter of the run, for the run to be judged."""
_STILL_MOVING = 0.5
"""Share of the third quarter's kinetic energy in the last one, from which the motion may be a cycle."""
_REBOUND = 100.0
"""How far motion that decays may lie above its largest kinetic energy times the decay: about 20 at critical damping."""
_RUN_AWAY = 100.0
"""Energy over that which the load has put in, from which motion that still gathers it runs away."""
_STILL_FALLING = 0.99
"""Share of kinetic energy from one sixteenth of the run to the next, below which it falls."""


def simulate(
    model: Model,
    *,
    duration: float,
    dt: float = 1.0 / 30.0,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    damping: tuple[float, float] = (0.0, 0.0),
    start: ArrayLike | None = None,
    supports: SupportPath | None = None,
    constraints: Sequence[Constraint] | None = None,
    store_every: int = 1,
    dtype: DTypeLike = np.float64,
    on_step: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Step a model from rest under a dead load.

    Parameters
    ----------
    model : Model
        Any rung.
    duration : float
        Simulated time [s]; rounded up to whole steps.
    dt : float
        Step [s].
    gravity : array_like, shape (3,), optional
        Acceleration on every vertex [m/s^2].
    force : array_like, shape (n, 3), optional
        Further force on every vertex [N].
    damping : (float, float)
        Rayleigh factors xi [1/s] of the mass and zeta [s] of the stiffness. Where supports move, xi slows velocity in
        the model's own frame: relative to the supports for modal models, absolute for full ones.
    start : array_like, shape (n, 3), optional
        Positions at the start [m], at rest, with the supports in their rest pose; the rest shape without them.
    supports : SupportPath, optional
        Moves the held vertices. Full models hold them along the path; modal models feel it as inertial loads in their
        own frame, with positions given in the world's.
    constraints : sequence of PositionConstraint or OrientationConstraint, optional
        Where patches of vertices shall be, and how they shall be turned, in the world. Modal models are moved there by
        the modal forces of least work, as near as their modes reach; DS moves the patches as boundaries.
    store_every : int
        Store every so many steps (explicit steps are short).
    dtype : {float64, float32}
        Of the stored positions.
    on_step : callable, optional
        Called after each step with the steps done and their total.

    Returns
    -------
    Trajectory
        The stored frames. A motion that leaves the finite numbers stops with the status "diverged at ...".
        A motion that runs away, has wound up, keeps cycling although damped, whose constraints were not met or whose
        steps did not all converge says so in its status.

    Raises
    ------
    OptionError
        For a duration, step, damping or store_every out of range, or an explicit step above its stability estimate.
    LoadError
        For loads or positions of the wrong shape or not finite.
    SupportError
        If ``supports`` moves a shell that holds no vertex.
    """
    dt = checked_step(dt)
    duration = checked_number("duration", duration, at_least=dt, unit="s")
    store_every = checked_count("store_every", store_every)
    dtype = checked_precision(dtype)
    checked_kind("model", model, Model)  # type: ignore[type-abstract]
    total = step_count(duration, dt)
    motion = Motion(
        model,
        dt=dt,
        gravity=gravity,
        force=force,
        damping=damping,
        start=start,
        supports=supports,
        constraints=constraints,
    )
    watch = Stopwatch()
    observer = Observer(motion)
    times, frames, residuals = [0.0], [motion.positions().astype(dtype)], [motion.constraint_residuals]
    observer.look()
    for _ in stored_steps(motion, total, store_every, on_step):
        times.append(motion.time)
        frames.append(motion.positions().astype(dtype))
        residuals.append(motion.constraint_residuals)
        observer.look()
    return Trajectory(
        np.array(times),
        np.array(frames),
        observer.status(total),
        motion.unconverged,
        watch(),
        np.array(observer.energies),
        np.array(residuals),
        np.asarray(model.shell.mesh.faces),
        model.shell.rest_positions,
    )


def stored_steps(
    motion: Motion, total: int, store_every: int, on_step: Callable[[int, int], None] | None
) -> Iterator[None]:
    """Step up to ``total``, pausing after each step to be stored; a motion that is no longer finite ends it."""
    while motion.count < total:
        motion.advance()
        if not motion.finite:
            return
        if motion.count % store_every == 0 or motion.count == total:
            yield
        if on_step is not None:
            on_step(motion.count, total)


def step_count(duration: float, dt: float) -> int:
    """Whole steps of ``dt`` that cover ``duration``; OptionError if no run would ever end."""
    steps = np.ceil(duration / dt - 1e-9)
    if steps > _MOST_STEPS:
        raise OptionError(f"duration must be at most {_MOST_STEPS:,} steps of {dt:g} s (got {duration:g} s)")
    return int(steps)


class Observer:
    """Watches a motion at its stored frames, and names its outcome."""

    def __init__(self, motion: Motion) -> None:
        self.motion = motion
        self.energies: list[Array] = []
        self.times: list[float] = []
        self.fault: str | None = None
        self.worst_residual = 0.0

    def look(self) -> None:
        """Take note of the present state."""
        motion = self.motion
        self.energies.append(motion.energies())
        self.times.append(motion.time)
        self.worst_residual = max(self.worst_residual, float(motion.constraint_residuals.max(initial=0.0)))
        if self.fault is None and (fault := motion.model.fault(motion.state)) is not None:
            self.fault = f"{fault} at {motion.time:.6g} s"

    def recall(self, times: Array, energies: Array, residuals: Array, fault: str) -> None:
        """Go on after frames of the same motion seen before: (F,), (F, 3), (F, k), and their first fault or ""."""
        self.times, self.energies = list(times), list(energies)
        self.worst_residual = float(np.max(residuals, initial=0.0))
        self.fault = fault or None

    def status(self, total: int) -> str:
        """The outcome in words, "completed" where there is nothing to say."""
        motion = self.motion
        if not motion.finite:
            return f"diverged at {motion.time:.6g} s: positions left the finite numbers"
        notes = []
        if self.fault is not None:
            notes.append(self.fault)
        if self._runs_away():
            notes.append("runs away: its energy grows on and on, far beyond the work of the load")
        elif self._cycles():
            notes.append("bounded cycle: the motion does not settle although it is damped")
        size = float(np.ptp(motion.model.shell.rest_positions, axis=0).max())
        if self.worst_residual > CONSTRAINT_MET * max(size, 1.0):
            notes.append(f"constraints were missed by up to {self.worst_residual:.2e}")
        if motion.unconverged:
            notes.append(f"{motion.unconverged} of {total} steps did not converge")
        return "completed" + (", but " + "; ".join(notes) if notes else "")

    @property
    def _steady(self) -> bool:
        """Whether the load alone does work."""
        return self.motion.supports is None and not self.motion.constraints

    def _runs_away(self) -> bool:
        """Whether there is far more energy than the load has put in, most of it new in the last quarter."""
        if not self._steady or len(self.times) < 8:
            return False
        energies = np.array(self.energies)
        stored = energies[:, 0] + energies[:, 1]
        put_in = float(stored[0] + np.ptp(energies[:, 2]))
        before, late = stored[: 3 * len(stored) // 4].max(), stored[3 * len(stored) // 4 :].max()
        return bool(late > max(_RUN_AWAY * put_in, 2.0 * before))

    def _cycles(self) -> bool:
        """Whether kinetic energy has stopped falling although damping, under a constant load, must have eaten it."""
        motion = self.motion
        damped = motion.damping.mass_factor > 0.0 or motion.damping.stiffness_factor > 0.0
        if not self._steady or not damped or len(self.times) < 40:
            return False
        rate = motion.model.decay_rate(motion.dt, motion.damping)
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
