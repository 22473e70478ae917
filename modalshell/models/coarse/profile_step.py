"""Implicit Euler steps and error bars of small shells, each in one compiled function.

The kernels add element blocks straight into the storage of a profile factorisation; blocks above the diagonal and those
of held vertices have no place there. Of the milliseconds that a step of a few hundred unknowns takes through
SciPy nearly all is the interpreter's.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.cost import count_elements, count_factorisation, count_solves
from modalshell.core.thread_safety import PerThread, writeable
from modalshell.core.typing import Array, Index
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.kernels.by_reference import Placed
from modalshell.linalg import Profile, ProfileAnalysis
from modalshell.models.coarse.profile_check import check, make_lanczos
from modalshell.models.coarse.profile_folds import folds_of
from modalshell.models.coarse.profile_hinges import KERNELS, hinges_of
from modalshell.models.coarse.profile_newton import Body, Start, implicit_step, make_room
from modalshell.models.coarse.profile_numbering import numbering_of
from modalshell.shell import Sheet, Shell
from modalshell.shell.damping import Damping
from modalshell.shell.split_fold_energy import SplitFoldEnergy
from modalshell.statics.error_bar import ErrorEstimator, QuickCheck
from modalshell.statics.margin import probe
from modalshell.supports.constraints import LedVertices

_PRODUCTS, _CHECKED = 4e7, 1e8
"""Multiplications of a factorisation above which sparse steps, which keep their factors, are quicker; and checks."""
_STRAIGHT = 12
"""Iterations up to which a step is a straight one."""


@final
class ProfileStep:
    """Steps of implicit Euler and error bars of one shell without further energies; see :func:`profile_step`.

    ``profile`` is that of the stiffness of its free unknowns, and of the energy's internal ones; ``place`` (n,) is the
    block of every vertex in it, -1 of held ones.
    """

    def __init__(self, shell: Shell, profile: Profile, place: Index, elastic: Any) -> None:
        self._shell = shell
        self._unknowns, self._products = profile.size, profile.products
        free = shell.free[np.argsort(place[shell.free])]
        # Writeable copies, as kernels are compiled for one kind of argument alone; faces are read-only everywhere.
        body = Body(
            shell.rest_positions.copy(),
            shell.mesh.moment_length,
            shell.mesh.faces,
            shell.mass.copy(),
            free,
            place[free],
            profile.first,
            profile.starts,
            np.where(place >= 0, profile.strides[place], 0),
            elastic,
        )
        self._body = Placed(body)
        self._damping = PerThread(self._body.copied)
        self._rooms = PerThread(functools.partial(_make_rooms, body))
        self._probe = np.zeros(3 * profile.first.size)
        self._probe[(3 * place[shell.free][:, None] + np.arange(3)).ravel()] = probe(3 * shell.free.size)

    def __call__(
        self, start: EulerStart, load: Array, damping: Damping, tolerance: float, *, straight: bool = False
    ) -> tuple[Array, bool]:
        """Positions (n, 3) [m] after a step under ``load`` (n, 3) [N], and whether the step's equations are solved.

        The held vertices rest. ``tolerance`` is the residual over the push of load and inertia. A ``straight`` step is
        one of few iterations, which has gone down no way of its own to one of several minima; others are not solved.
        """
        # Writeable, as above: a shell's positions at rest are not.
        begin, rooms = Start(*map(writeable, (start.origin, start.rates, start.near))), self._rooms()
        body, load = self._damped(start, load, damping.stiffness_factor)
        room, other = rooms.room.record, body is not self._body
        if other:
            room.elastic.forget()
        iterations, solved = implicit_step(body, rooms.room, begin, load, start.dt, damping.mass_factor, tolerance)
        if other:
            room.elastic.forget()
        count_elements(3 * (iterations + 1) * self._body.record.elastic.evaluated)  # gradient, Hessian and stresses
        count_factorisation(self._unknowns, iterations, self._products)
        count_solves(self._unknowns, iterations)
        return room.x.copy(), bool(solved) and (iterations <= _STRAIGHT or not straight)

    def check(self, x: Array, load: Array, *, early: bool = False) -> tuple[Array, float] | None:
        """Positions (n, 3) [m] after the two steps of an error bar, and the margin; None where a pivot vanishes.

        The bar is that of :class:`modalshell.statics.error_bar.ErrorEstimator` from x (n, 3) [m], where the supports
        allow it, under ``load`` (n, 3) [N]. The margin may be an ``early`` one, that before the second step, where this
        is short: for half the work, to a tenth of what stresses take.
        """
        rooms = self._rooms()
        given = writeable(x), writeable(load), self._probe, early
        margin, products, factors, passes = check(self._body, *rooms, *given)
        # With each factor gradients, Hessians, geometric part and stresses.
        count_elements((2 * factors + passes) * self._body.record.elastic.evaluated)
        count_factorisation(self._unknowns, factors, self._products)
        count_solves(self._unknowns, 3 + products)  # Lanczos solves once more than it multiplies
        return (rooms.room.record.x.copy(), float(margin)) if np.isfinite(margin) else None

    def _damped(self, start: EulerStart, load: Array, factor: float) -> tuple[Placed, Array]:
        """The body whose energy is what damping makes of its own in a step, and the load; both over one factor."""
        if not (factor or self._shell.has_dashpots):
            return self._body, load
        shell = self._shell
        begun = start.damping_measures(lambda _, state: shell.changes(state.coordinates), shell.elastic_energy.periods)
        body, changed = self._body.record, self._damping()
        elastic, whole = body.elastic.damped(shell.damped(begun, factor, start.dt))
        changed.take(body._replace(mass=body.mass / whole, elastic=elastic), self._body)
        return changed, load / whole


class _Rooms(NamedTuple):
    """Where a thread's steps write: a room, the same with its two matrices in each other's place, and Lanczos's."""

    room: Placed
    swapped: Placed
    lanczos: Placed


def _make_rooms(body: Body) -> _Rooms:
    room = make_room(body)
    placed, swapped = Placed(room), room._replace(values=room.second, second=room.values)
    return _Rooms(placed, Placed(swapped), Placed(make_lanczos(body)))


def profile_step(shell: Shell, most: float = _PRODUCTS) -> ProfileStep | None:
    """The compiled step of a shell; None for energies, supports or sizes that it does not serve.

    Those are of more than ``most`` multiplications in a factorisation.
    """
    if shell.unknowns.matrix is not None:  # supports of single components
        return None
    found = _of_folds(shell, most) if isinstance(shell.material, Sheet) else _of_hinges(shell)
    if found is None or found[0].products > most:
        return None
    profile, place, elastic = found
    return ProfileStep(shell, profile, place, elastic())


def quick_estimator(shell: Shell, led: LedVertices | None = None) -> ErrorEstimator:
    """What finds bars of a shell by the compiled check, where that serves it, and by sparse algebra elsewhere."""
    held = shell if led is None else shell.holding(led.vertices)
    return ErrorEstimator(shell, quick_check(held), led=led)


def quick_check(shell: Shell, *, early: bool = False) -> QuickCheck | None:
    """The compiled check of a shell about the origin; None where none serves it. Threads may share it.

    Its margins may be ``early`` ones; see :meth:`ProfileStep.check`.
    """
    step = profile_step(shell.centred()[0], _CHECKED)
    return None if step is None else functools.partial(step.check, early=early)


def _of_hinges(shell: Shell) -> tuple[Profile, Index, Any] | None:
    """Profile, blocks of the vertices, and what makes the energy of a shell of discrete-shell energies."""
    if tuple(e.kernel for e in shell.elements) != KERNELS:
        return None
    free, points = shell.free, shell.rest_positions[shell.free]
    profile = ProfileAnalysis(shell.pattern.free_matrix(np.ones(shell.pattern.size)), points).profile
    place = np.full(len(shell.mass), -1, dtype=np.int64)
    place[free[profile.order]] = np.arange(free.size)
    return profile, place, functools.partial(hinges_of, shell, profile, place)


def _of_folds(shell: Shell, most: float) -> tuple[Profile, Index, Any] | None:
    """The same of a shell of shell theory."""
    energy = shell.elastic_energy
    if not isinstance(energy, SplitFoldEnergy) or energy.further_elements or _is_dear(shell, most):
        return None
    numbering = numbering_of(shell)
    return numbering.profile, numbering.place, functools.partial(folds_of, shell, numbering)


def _is_dear(shell: Shell, most: float) -> bool:
    """Whether a profile of the vertices alone, joined by edges, takes more than ``most`` products.

    With the shares of folds it takes two to four times as many, and to number these is a hundred times the work.
    """
    place = np.full(len(shell.mass), -1, dtype=np.int64)
    place[shell.free] = np.arange(shell.free.size)
    ends, points = place[shell.mesh.edges], shell.rest_positions[shell.free]
    start, end = ends[(ends >= 0).all(axis=1)].T
    rows, columns = np.concatenate([start, end]), np.concatenate([end, start])
    along = np.argsort(points[:, np.ptp(points, axis=0).argmax()], kind="stable")
    if 27.0 * Profile(along, rows, columns, block=1).products <= most:  # of blocks of three
        return False
    own = np.arange(shell.free.size)
    entries = np.ones(rows.size + own.size), (np.concatenate([rows, own]), np.concatenate([columns, own]))
    return 27.0 * ProfileAnalysis(sps.csc_array(entries, shape=(own.size, own.size))).products > most
