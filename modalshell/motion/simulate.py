"""Motion of any rung under a dead load: time stepping, with a named outcome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.checks import checked_count, checked_number
from modalshell.errors import OptionError, SupportError
from modalshell.motion.supports import SupportPath
from modalshell.rungs import Damping, Model
from modalshell.rungs.model import Stopwatch, total_load

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """A simulated motion.

    Attributes
    ----------
    times : ndarray, shape (F,)
        Times of the stored frames [s], the start at 0 included.
    positions : ndarray, shape (F, n, 3)
        Vertex positions [m]; every one finite.
    status : str
        "completed", or what went wrong and when; then the frames up to there are kept.
    unconverged_steps : int
        Steps whose own solver did not converge.
    seconds : float
        Wall time.
    """

    times: Array
    positions: Array
    status: str
    unconverged_steps: int
    seconds: float


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
    store_every: int = 1,
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
    store_every : int
        Store every so many steps (explicit steps are short).
    on_step : callable, optional
        Called after each step with the steps done and their total.

    Returns
    -------
    Trajectory
        The stored frames. A motion that leaves the finite numbers stops with the status "diverged at ...".

    Raises
    ------
    OptionError
        For a duration, step, damping or store_every out of range, or an explicit step above its stability estimate.
    LoadError
        For loads or positions of the wrong shape or not finite.
    SupportError
        If ``supports`` moves a shell that holds no vertex.
    """
    dt = checked_number("dt", dt, above=0.0, unit="s")
    duration = checked_number("duration", duration, at_least=dt, unit="s")
    store_every = checked_count("store_every", store_every)
    if np.shape(damping) != (2,):
        raise OptionError(f"damping must be two Rayleigh factors xi, zeta (got {damping!r})")
    rayleigh = Damping(*(checked_number("each damping factor", factor, at_least=0.0) for factor in damping))
    load = total_load(model.shell, gravity, force)
    model.check_step(dt, rayleigh)
    shell = model.shell
    state = model.start_motion(None if start is None else shell.checked_positions(start))
    if supports is not None and not shell.clamped.any():
        raise SupportError("supports move the held vertices, but this shell holds none: name them with clamped=")

    watch = Stopwatch()
    total = int(np.ceil(duration / dt - 1e-9))
    current = model.positions(state)
    before = current
    times, frames = [0.0], [current.copy() if supports is None else supports.at(0.0).to_world(current)]
    if supports is not None and not model.in_shell_frame:
        state.coordinates = frames[0].copy()
    status, unconverged = "completed", 0
    for count in range(1, total + 1):
        with np.errstate(over="ignore", invalid="ignore"):
            if supports is None:
                state, converged = model.step(state, dt, load, rayleigh)
            else:
                pose = supports.at(count * dt)
                if model.in_shell_frame:
                    felt = pose.shell_load(load, shell.mass, current, (current - before) / dt)
                    state, converged = model.step(state, dt, felt, rayleigh)
                    before, current = current, model.positions(state)
                else:
                    held = pose.to_world(shell.rest_positions[shell.clamped])
                    state, converged = model.step(state, dt, load, rayleigh, held)
            unconverged += not converged
            # A sum is finite only if every entry is (or it overflows, which is no better).
            finite = np.isfinite(state.coordinates.sum() + state.rates.sum())
        if not finite:
            status = f"diverged at {count * dt:.6g} s: positions left the finite numbers"
            break
        if count % store_every == 0 or count == total:
            times.append(count * dt)
            if supports is None or not model.in_shell_frame:
                frames.append(model.positions(state).copy())
            else:
                frames.append(pose.to_world(current))
        if on_step is not None:
            on_step(count, total)
    if status == "completed" and unconverged:
        status = f"completed, but {unconverged} of {total} steps did not converge"
    return Trajectory(np.array(times), np.array(frames), status, unconverged, watch())
