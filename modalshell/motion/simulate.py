"""Simulation of any model: motion from rest under loads, with an outcome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.core.checks import checked_callback, checked_count, checked_kind, checked_number, checked_precision
from modalshell.core.memory import demand_memory
from modalshell.core.typing import Progress
from modalshell.loads import Load
from modalshell.models import Model
from modalshell.models.base.setup import given_contacts
from modalshell.motion.fields import checked_fields, with_fields, with_stretch_remark
from modalshell.motion.motion_check import wanted_bars, with_bars
from modalshell.motion.recorder import Recorder, step_count
from modalshell.motion.step_error import Tolerance
from modalshell.motion.stepping import Motion, checked_step
from modalshell.motion.trajectory import Trajectory
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.supports import SupportPath
from modalshell.supports.constraints import Constraint, checked_constraints

if TYPE_CHECKING:
    from modalshell.contact import Contact


def simulate(
    model: Model,
    *,
    duration: float,
    dt: float = 1.0 / 30.0,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
    damping: tuple[float, float] | Damping = (0.0, 0.0),
    start: ArrayLike | None = None,
    supports: SupportPath | None = None,
    constraints: Sequence[Constraint] | None = None,
    contacts: Sequence[Contact] | None = None,
    integrator: str | None = None,
    tolerance: float | None = None,
    store_every: int = 1,
    dtype: DTypeLike = np.float64,
    fields: Sequence[str] = (),
    bars: int | tuple[int, str | Shell] | None = None,
    on_step: Progress | None = None,
) -> Trajectory:
    """Move a model from rest under loads, by steps in time.

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
    loads : sequence of Load, optional
        Further loads, such as :class:`~modalshell.PointForce`.
    damping : (float, float) or Damping
        Rayleigh factors xi [1/s] of the mass and zeta [s] of the stiffness. Where supports move, xi slows velocity
        relative to them.
    start : array_like, shape (n, 3), optional
        Positions at the start [m], with the supports in their rest pose; by default the rest shape. The shell begins at
        rest relative to its supports: where these move already, it moves with them.
    supports : SupportPath, optional
        Moves the supports. Full models hold vertices along the path; modal models, and full ones whose supports hold
        single components, feel it as inertial loads in their own frame, with positions given in the world's.
    constraints : sequence of PositionConstraint or OrientationConstraint, optional
        Prescribed positions and orientations of patches, in the world frame. Modal models are moved there by
        the modal forces of least work, as near as their modes reach; DS moves the patches as boundaries.
    contacts : sequence of Contact or SelfContact, optional
        Colliders that vertices stay out of, for models that take contacts. Where what touches changes, implicit Euler
        stands in for rules of order two.
    integrator : str, optional
        Another rule of the steps than the model's own: "exponential", "implicit_euler" or "implicit_midpoint" of modal
        models; of others "composite", "sdirk2", "bdf2", "implicit", and further ones of those with every vertex free.
    tolerance : float, optional
        Error, as a share of ``mesh.moment_length``, that steps may make by their length. Each is then taken in as
        many halves of halves as that needs; frames stay where they are. Under constraints it does not bound the errors
        of the exponential rule, which does not know those that constraints cause.
    store_every : int
        Number of steps per stored frame (explicit steps are short).
    dtype : {float64, float32}
        Of the stored positions.
    fields : sequence of str
        Fields of the triangles to store with each frame, such as "curvature" or "von_mises"; see
        :class:`~modalshell.ShellFields`.
    bars : int or (int, on), optional
        Check every this many stored frames (of a shorter motion the last but one) how far the motion is from that of
        DS: two Newton steps and a stability margin under d'Alembert's inertial loads, kept in :attr:`Trajectory.bars`.
        Once a margin has failed, the bars of a model that is quadratic about rest stay void. Frames must be close
        enough for accelerations to be their differences. Lags of phase that add up do not show. With ``on``, "coarse"
        or a coarse shell, bars are found there, in milliseconds, as those of :func:`modalshell.error_bar`. With
        contacts they are found on the shell, by the colliders where they are then and the friction of the frame; where
        something strikes one just then, the bar is void and says so, and those after it hold.
    on_step : callable, optional
        Called after each step with the steps done and their total.

    Returns
    -------
    Trajectory
        The stored frames. A motion that leaves the finite numbers stops with the outcome "diverged". One that runs
        away, has wound up, keeps cycling although damped, whose constraints were not met or whose steps did not all
        converge says so in its outcome and its message. That a load is beyond the linear buckling load, which modal
        models cannot follow, is not looked for here, as it takes a factorisation: their static answers and runs of
        scenes say so, and :func:`modalshell.buckling_factors` has the factor.

    Raises
    ------
    OptionError
        For a duration, step, damping, store_every or bars out of range, an explicit step above its stability estimate,
        bars under self-contact, on a coarse shell with contacts or constraints, or of a shell that its supports do not
        hold, contacts of a model that takes none, colliders that begin inside the shell or move too fast for the step,
        or a contact whose vertices supports all hold.
    LoadError
        For loads or positions of the wrong shape or not finite.
    SupportError
        If ``supports`` moves a shell that holds no vertex.
    """
    on_step = checked_callback("on_step", on_step)
    dt = checked_step(dt)
    duration = checked_number("duration", duration, at_least=dt, unit="s")
    store_every = checked_count("store_every", store_every)
    dtype = checked_precision(dtype)
    checked_kind("model", model, Model, "make one of a shell, as ms.DiscreteShell(shell) is")  # type: ignore[type-abstract]
    chosen = checked_fields(fields, model.shell)
    if integrator is not None:
        model = model.stepped_by(integrator)
    wanted, touching = None, given_contacts(contacts, model.shell)
    if bars is not None:
        led = checked_constraints(constraints, model.shell.unknowns)
        wanted = wanted_bars(bars, model, touching, dt, supports, led)
    motion = Motion(
        model,
        model.shell.loading(gravity, force, loads),
        dt=dt,
        damping=damping,
        start=start,
        supports=supports,
        constraints=constraints,
        contacts=touching,
        tolerance=None if tolerance is None else Tolerance(tolerance, duration),
    )
    recorder = Recorder(motion, step_count(duration, dt), store_every=store_every, precision=dtype)
    positions = _stored_frames(recorder, dtype, on_step)
    run = with_stretch_remark(
        with_fields(recorder.trajectory(positions), model.shell, chosen, supports), model.shell, supports
    )
    run = replace(run, contacts=touching)
    if wanted is None:
        return run
    setup = motion.setup
    return with_bars(run, model, setup.loading, wanted, damping=setup.damping, supports=supports)


def _stored_frames(recorder: Recorder, dtype: np.dtype[Any], on_step: Progress) -> NDArray[np.floating]:
    """Take a motion to its end; positions (F, n, 3) [m] of its stored frames."""
    motion, stored = recorder.motion, recorder.total // recorder.store_every + 2
    shape = motion.shell.rest_positions.shape
    size = float(stored) * shape[0] * shape[1] * dtype.itemsize
    demand_memory(f"a trajectory of {stored} frames", size, "store fewer (store_every), or in float32 (dtype)")
    frames, count = np.empty((stored, *shape), dtype=dtype), 0
    for _ in recorder.frames(on_step):
        frames[count] = motion.positions()
        count += 1
    # Of a motion that ended early the frames alone.
    return frames[:count] if 2 * count > stored else frames[:count].copy()
