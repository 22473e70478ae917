"""Checks of motions: static error bars under d'Alembert's inertial loads."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import ImplicitRule
from modalshell.integrators.modal import ModalIntegrator
from modalshell.loads import Loading
from modalshell.models.base.bars import check_bar
from modalshell.models.base.model import Model
from modalshell.models.coarse.profile_step import quick_estimator
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.modes import Basis
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator, Estimator
from modalshell.supports import Pose, SupportPath
from modalshell.supports.constraints import LedVertices

if TYPE_CHECKING:
    from modalshell.contact import Contact  # motions without contacts do not import it
    from modalshell.contact.motion_bar import TouchingFrames


class Instant(NamedTuple):
    """A frame of a motion at ``time`` [s]: positions (n, 3) [m] and their derivatives, in the frame of the supports."""

    positions: Array
    velocities: Array
    accelerations: Array
    time: float


def instant_of(times: Array, frames: Array) -> Instant:
    """The middle one of three ``frames`` (3, n, 3) [m] at ``times`` (3,) [s], by their differences."""
    first, second = np.diff(times)
    before, after = (frames[1] - frames[0]) / first, (frames[2] - frames[1]) / second
    velocity = (second * before + first * after) / (first + second)
    return Instant(frames[1], velocity, 2.0 * (after - before) / (first + second), float(times[1]))


def acting_load(
    x: Array, v: Array, time: float, dead: Array, loading: Loading, mass: Array, supports: SupportPath | None
) -> Array:
    """All loads (n, 3) [N] as they act in the frame of the supports, inertial ones of their motion with them.

    On a shell of vertex masses (n,) [kg] at x (n, 3) [m] with velocities v (n, 3) [m/s] there, at ``time`` [s]; the
    ``dead`` ones (n, 3) [N] of the world are given.
    """
    pose = None if supports is None else supports.at(time)
    load = dead
    if loading.live:
        at = (x, v) if pose is None else (pose.to_world(x), pose.world_velocities(x, v))
        load = load + loading.live_force(*at, time)
    return load if pose is None else pose.shell_load(load, mass, x, v)


def balancing_load(
    now: Instant,
    shell: Shell,
    loading: Loading,
    damping: Damping,
    supports: SupportPath | None = None,
    dead: Array | None = None,
) -> Array:
    """Load (n, 3) [N] in the frame of the supports under which a moving shell is in balance as if it rested.

    All loads as they act on it (``dead`` ones (n, 3) [N] in place of the loading's own, if given), with the forces of
    dashpots, less inertia and damping by the mass, ``M (a + xi v)``. Of other damping see :func:`strained_ahead`.
    """
    v, dead = now.velocities, loading.dead if dead is None else dead
    load = acting_load(now.positions, v, now.time, dead, loading, shell.mass, supports)
    if shell.has_dashpots:
        load = load + shell.damping_force(now.positions, v, 0.0)
    return np.asarray(load - shell.mass[:, None] * (now.accelerations + damping.mass_factor * v))


def damped_basis(model: Model) -> Basis | None:
    """The basis whose modes the ratios of a model's damping are of; None of models that are not of such modes."""
    basis = getattr(model, "basis", None)
    return basis if isinstance(basis, Basis) else None


def strained_ahead(now: Instant, damping: Damping, basis: Basis | None = None) -> Array | None:
    """By what (n, 3) [m] the stresses of a moving shell are ahead of its shape, as it damps strains; None without.

    Elastic and viscous forces ``g(x) + zeta K v`` are nearly the elastic ones at ``x + zeta v``; for modes of a
    ``basis`` that ratios d damp the time is ``2 d / omega``. As forces in the load they would act through velocities of
    cheap models, which stretch the membrane, and would drown all else.
    """
    if not damping.strains:
        return None
    ahead = damping.stiffness_factor * now.velocities
    if damping.ratios and basis is not None:
        squared = basis.eigenvalues
        rates = basis.modes.T @ (np.repeat(basis.shell.mass, 3) * now.velocities.ravel())
        times = np.divide(Damping(ratios=damping.ratios).of_modes(squared), squared, where=squared > 0.0, out=0 * rates)
        ahead += (basis.modes @ (times * rates)).reshape(-1, 3)
    return ahead


def touching_frames(
    model: Model,
    contacts: Sequence[Contact],
    dt: float,
    supports: SupportPath | None = None,
    shell: Shell | None = None,
    led: LedVertices | None = None,
) -> TouchingFrames | None:
    """What finds bars with the contacts of a motion in steps of ``dt`` [s]; None without any.

    ``shell`` takes the place of the model's own true one; constraints lead further vertices. OptionError for
    self-contact, and for friction of rules whose steps do not smooth it.
    """
    if not contacts:
        return None
    from modalshell.contact.motion_bar import TouchingFrames  # not without contacts

    shell = model.true_shell if shell is None else shell
    check_bar(shell, contacts=contacts)
    if not any(contact.friction for contact in contacts):
        return TouchingFrames(shell, contacts, supports, led=led)
    rule = getattr(getattr(model, "full", model), "integrator", None)
    if isinstance(rule, ModalIntegrator):
        raise OptionError(
            f"bars of motions with friction are not for models on modes (got {model.name}): take DS or coarse DS, or "
            "set friction to 0"
        )
    if not isinstance(rule, ImplicitRule):
        raise OptionError("bars of motions with friction take implicit steps: take 'composite', or set friction to 0")
    return TouchingFrames(shell, contacts, supports, dt / rule.stand_ins, led)


class BalancedBars(ABC):
    """Finds the bars of a motion, one checked frame after the other, under loads that balance its inertia.

    OptionError for a shell that its supports do not hold.

    Parameters
    ----------
    shell : Shell
        What moves.
    loading : Loading
        Its loads.
    damping : Damping
        Its damping.
    supports : SupportPath, optional
        How its supports move.
    coarse : CoarseDiscreteShell, optional
        The coarse shell of it on which bars are found, in place of itself.
    estimator : ErrorEstimator, optional
        What finds bars of the shell that they are found on; by default one whose bars are compiled where that serves.
        Contacts have their own, and of constraints one must be given that leads their vertices in that frame.
    touching : TouchingFrames, optional
        Its contacts, of which a coarse shell takes none; see :func:`touching_frames`.

    Attributes
    ----------
    basis : Basis or None
        That of a modal model, whose modes the ratios of the damping are of; none at first.
    unjudged : str
        Why the last bar, which is void then, could not be found where contacts alone prevent it; "" elsewhere.
    """

    def __init__(
        self,
        shell: Shell,
        loading: Loading,
        damping: Damping,
        supports: SupportPath | None = None,
        coarse: CoarseDiscreteShell | None = None,
        *,
        estimator: ErrorEstimator | None = None,
        touching: TouchingFrames | None = None,
    ) -> None:
        check_bar(shell)
        self._shell, self._loading, self._damping, self._supports = shell, loading, damping, supports
        self.basis: Basis | None = None
        self._coarse, self.unjudged = coarse, ""
        self._touching = touching
        self._estimator: Estimator
        if touching is not None:
            self._estimator = touching.estimator
        else:
            self._estimator = estimator or quick_estimator(shell if coarse is None else coarse.coarse.shell)

    @abstractmethod
    def supports_at(self, time: float) -> Pose | None:
        """Where supports are at ``time`` [s] in the axes of frames and forces; None where these are in their frame."""

    def own(self, time: float, positions: Array) -> Array:
        """Positions (n, 3) [m] of a frame in the frame of the supports."""
        x, pose = np.asarray(positions, dtype=np.float64), self.supports_at(time)
        return x if pose is None else pose.to_shell(x)

    def bar(self, times: Array, frames: Array, forces: Array | None = None) -> ErrorBar:
        """Bar of the middle one of three frames (3, n, 3) [m] at ``times`` (3,) [s].

        ``forces`` (3, n, 3) [N] are those of contacts in the frames, which friction is taken from.
        """
        return self.bar_under(times, frames, forces=forces)[0]

    def bar_under(
        self, times: Array, frames: Array, dead: Array | None = None, *, forces: Array | None = None
    ) -> tuple[ErrorBar, Array, Array | None]:
        """As :meth:`bar`, also what :meth:`load_under` says of it; ``dead`` replaces the loading's own load."""
        own = self._in_frame_of_supports(times, frames)
        load, ahead = self._in_balance(times, own, dead)
        x, time = own[1], float(times[1])
        if self._touching is not None:
            if forces is not None:
                turned = [self._own_force(float(time), force) for time, force in zip(times, forces, strict=True)]
                load = load + self._touching.friction(times, own, np.stack(turned))
            bar, self.unjudged = self._touching.bar(times, own, load, ahead)
        elif self._coarse is None:
            bar = self._estimator.bar(x, load, time=time, ahead=ahead)
        else:
            begin, felt = self._coarse.sampled(x), self._coarse.restrict(load)
            further = None if ahead is None else self._coarse.sampled(x + ahead) - begin
            bar = self._estimator.bar(begin, felt, on="coarse", ahead=further)
        return bar, load, ahead

    def _in_frame_of_supports(self, times: Array, frames: Array) -> Array:
        """Frames (F, n, 3) [m] at ``times`` (F,) [s] in the frame of the supports."""
        return np.stack([self.own(float(time), frame) for time, frame in zip(times, frames, strict=True)])

    def _own_force(self, time: float, force: Array) -> Array:
        """Forces (n, 3) [N] of a frame in the frame of the supports."""
        pose = self.supports_at(time)
        return force if pose is None else force @ pose.rotation

    def load_under(self, times: Array, frames: Array, dead: Array | None = None) -> tuple[Array, Array | None]:
        """The load (n, 3) [N] in balance, without friction, and by what (n, 3) [m] its shape is strained ahead."""
        return self._in_balance(times, self._in_frame_of_supports(times, frames), dead)

    def _in_balance(self, times: Array, own: Array, dead: Array | None) -> tuple[Array, Array | None]:
        """The same of frames (3, n, 3) [m] in the frame of the supports."""
        now = instant_of(times, own)
        load = balancing_load(now, self._shell, self._loading, self._damping, self._supports, dead)
        return load, strained_ahead(now, self._damping, self.basis)

    def static(self, positions: Array, load: Array, time: float = 0.0, ahead: Array | None = None) -> ErrorBar:
        """Bar of an answer at positions (n, 3) [m] under a load (n, 3) [N].

        It rests there, or stresses are those of a shape ``ahead`` (n, 3) [m] of it; see :meth:`Estimator.bar`.
        Colliders and constraints are as at ``time`` [s].
        """
        if self._touching is not None:
            self._touching.estimator.look(time)
        return self._estimator.bar(positions, load, time=time, ahead=ahead)

    def moved(self, positions: Array) -> float:
        """Displacement in the norm of the mass [kg^(1/2) m] of positions in the frame of the supports."""
        return self.norm(positions - self._shell.rest_positions)

    def off(self, bar: ErrorBar, positions: Array) -> float:
        """Distance of positions in the frame of the supports from those that a bar corrects them to."""
        if bar.message:
            return np.inf
        own = positions if self._coarse is None else self._coarse.sampled(positions)
        return self._estimator.length(bar.corrected - own)

    def norm(self, displacement: Array) -> float:
        """Of displacements (n, 3) [m], in the norm of the mass [kg^(1/2) m]."""
        return float(np.sqrt(np.sum(self._shell.mass[:, None] * displacement**2)))


@final
class MotionCheck(BalancedBars):
    """Bars of frames in the world."""

    def supports_at(self, time: float) -> Pose | None:
        """See :meth:`BalancedBars.supports_at`."""
        return None if self._supports is None else self._supports.at(time)


def bar_at_largest(
    times: Array,
    frames: NDArray[np.floating],
    shell: Shell,
    loading: Loading,
    damping: Damping,
    supports: SupportPath | None = None,
    contacts: Sequence[Contact] = (),
) -> tuple[float, ErrorBar] | None:
    """Time [s] and bar of the frame of largest displacement, with contacts without friction.

    None of motions of under three frames, and of a frame that contacts keep from being judged. OptionError for a shell
    that its supports do not hold.
    """
    if len(times) < 3:
        return None
    touching = None
    if contacts:
        from modalshell.contact.motion_bar import TouchingFrames  # not without contacts

        touching = TouchingFrames(shell, contacts, supports)
    estimator = ErrorEstimator(shell)  # one bar is not worth compiling
    check = MotionCheck(shell, loading, damping, supports, estimator=estimator, touching=touching)
    moved = [check.moved(check.own(float(at), x)) for at, x in zip(times[1:-1], frames[1:-1], strict=True)]
    k = 1 + int(np.argmax(moved))
    around = slice(k - 1, k + 2)
    bar = check.bar(times[around], np.asarray(frames[around], dtype=np.float64))
    return None if check.unjudged else (float(times[k]), bar)
