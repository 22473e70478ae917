"""Implicit Euler of a sheet of springs, by parallel conjugate gradients on blocks of particles."""

from __future__ import annotations

import time
from typing import NamedTuple, final

import numpy as np
import scipy.sparse as sps
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import reverse_cuthill_mckee

from modalshell.core.checks import checked_count, checked_kind, checked_number, checked_vectors
from modalshell.core.errors import MeshError, OptionError
from modalshell.core.typing import Array, Index
from modalshell.mesh.selection import held_vertices
from modalshell.springs.kernels import blocks as kernels
from modalshell.springs.springs import Springs, checked_masses
from modalshell.springs.threads import ThreadChoice

TASKS = ("force", "matrix update", "acceleration", "velocity", "position")
"""The timed parts of a step; the acceleration is the solution of the linear equations."""
_EACH = 2000
"""Particles for which a thread pays."""


class RankBlock(NamedTuple):
    """What one rank holds: particles with the new numbers ``first`` to ``last - 1``, and their springs.

    Local numbers are those of the own particles, then those of the ghosts: the other ranks' particles at the far ends
    of own springs.
    """

    first: int
    last: int
    order: Index
    """Old numbers of all particles by new number, shape (n,)."""
    ghosts: Index
    """New numbers of the ghosts, ascending, shape (g,)."""
    starts: Index
    """Where each own particle's springs start, shape (last - first + 1,)."""
    others: NDArray[np.int32]
    """Local numbers of the springs' far ends, in each row by ascending new number, shape (s,)."""
    springs: Index
    """Numbers of the springs, shape (s,)."""

    @property
    def owned(self) -> int:
        """Count of own particles."""
        return self.last - self.first

    @property
    def particles(self) -> Index:
        """Old numbers by local number, shape (last - first + g,)."""
        return np.concatenate([self.order[self.first : self.last], self.order[self.ghosts]])


def rank_block(springs: Springs, count: int, size: int, rank: int) -> RankBlock:
    """The part of ``rank`` among ``size`` of ``count`` particles; each rank gets the same number, or one more.

    The particles are renumbered by reverse Cuthill-McKee, which keeps neighbours together, and cut into runs: on a
    sheet into strips. A single rank has them all. OptionError for more ranks than particles. MeshError for springs that
    name particles beyond ``count``.
    """
    if size > count:
        raise OptionError(f"there are more ranks than particles (got {size} and {count}); start fewer ranks")
    if springs.pairs.max(initial=-1) >= count:
        raise MeshError(f"springs must join the particles 0 to {count - 1} (got {springs.pairs.max()})")
    ends = np.concatenate([springs.pairs, springs.pairs[:, ::-1]])
    graph = sps.csr_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count))
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    place = np.argsort(order)
    first, last = rank * count // size, (rank + 1) * count // size

    rows, columns = place[ends].T
    mine = np.flatnonzero((rows >= first) & (rows < last))
    mine = mine[np.lexsort((columns[mine], rows[mine]))]
    rows, columns = rows[mine], columns[mine]
    outside = (columns < first) | (columns >= last)
    ghosts = np.unique(columns[outside])
    others = np.where(outside, last - first + np.searchsorted(ghosts, columns), columns - first)
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows - first, minlength=last - first))])
    return RankBlock(first, last, order, ghosts, starts, others.astype(np.int32), mine % len(springs))


class ImplicitStep(NamedTuple):
    """Result of a step: iterations, residual over load and momentum, whether it converged, wall times."""

    iterations: int
    residual: float
    converged: bool
    seconds: dict[str, float]


@final
class ImplicitSprings:
    r"""Particles and springs stepped by the implicit Euler method of Baraff and Witkin [baraff1998, eq. 6 and 18].

    .. math:: (M - h\,\partial f/\partial v - h^2\,\partial f/\partial x)\,\Delta v
              = h\,(f_0 + h\,\partial f/\partial x\,v_0), \qquad \Delta x = h\,(v_0 + \Delta v)

    This is the first Newton step of implicit Euler from where the particles are (theory 17, eq. 2): first order, and
    as stable as implicit Euler while one linearisation serves a step. The part of a compressed spring's Hessian that
    acts across it is left out, so that the matrix is positive definite; dashpots keep their direction over the step.
    Held particles are held to their new places in the search directions, as there.

    The particles are renumbered to keep neighbours together, and stay so: the state lives here.

    Parameters
    ----------
    springs : Springs
        Between the particles.
    mass : array_like, shape (n,)
        [kg].
    held : array_like of bool, shape (n,), or of int, optional
        Particles that do not move by themselves.
    threads : int, optional
        Number of threads; by default one or all of numba's, whichever is faster. The results do not depend on it.

    Raises
    ------
    MeshError
        For springs that name particles beyond n.
    MaterialError
        For masses that are not positive.
    SupportError
        For ``held`` that names no particle, or all.
    """

    def __init__(
        self, springs: Springs, mass: ArrayLike, held: ArrayLike | None = None, *, threads: int | None = None
    ) -> None:
        checked_kind("springs", springs, Springs)
        masses = checked_masses(mass)
        n = self.count = len(masses)
        self.held = held_vertices(held, n)
        self.threads = ThreadChoice(n, _EACH, threads)

        block = rank_block(springs, n, size=1, rank=0)
        self._order, self._starts, self._others = block.order, block.starts, block.others
        self._stiffness, self._rest, self._dashpot = (
            values[block.springs] for values in (springs.stiffness, springs.rest_lengths, springs.damping)
        )
        self._mass = masses[self._order]
        self._free = np.where(self.held[self._order], 0.0, 1.0)
        self._held_places = np.argsort(self._order)[self.held]
        self._blocks = np.empty((len(self._others), 4))
        self._inverses = np.empty((n, 6))
        self._x, self._v, self._load, self._force, self._right = np.zeros((5, n, 3))
        self._dv, self._p, self._q, self._r, self._z = np.zeros((5, n, 3))
        self._sums = np.zeros((kernels.PARTS, 2))

    def place(self, positions: ArrayLike, velocities: ArrayLike | None = None, change: ArrayLike | None = None) -> None:
        """Set ``positions`` (n, 3) [m] and ``velocities`` (n, 3) [m/s], by default zero.

        ``change`` (n, 3) [m/s] is a guess of the next step's change of velocity.
        """
        shape = (self.count, 3)
        self._x[:] = checked_vectors("positions", positions, shape)[self._order]
        self._v[:] = 0.0 if velocities is None else checked_vectors("velocities", velocities, shape)[self._order]
        self._dv[:] = 0.0 if change is None else checked_vectors("change", change, shape)[self._order]

    def _in_order(self, values: Array) -> Array:
        out = np.empty_like(values)
        kernels.scatter(self._order, values, out)
        return out

    @property
    def positions(self) -> Array:
        """Where the particles are (n, 3) [m]."""
        return self._in_order(self._x)

    @property
    def velocities(self) -> Array:
        """Their velocities (n, 3) [m/s]."""
        return self._in_order(self._v)

    @property
    def change(self) -> Array:
        """The last step's change of velocity (n, 3) [m/s], from which the next one's solution starts."""
        return self._in_order(self._dv)

    def step(
        self,
        dt: float,
        load: ArrayLike,
        *,
        drag: float = 0.0,
        stiffness_damping: float = 0.0,
        held: ArrayLike | None = None,
        iterations: int = 10,
        tolerance: float = 0.0,
    ) -> ImplicitStep:
        """Advance by ``dt`` [s] under ``load``.

        Parameters
        ----------
        dt : float
            h [s].
        load : array_like, shape (n, 3) or (3,)
            Force on every particle [N]; for (3,), acceleration [m/s^2].
        drag : float
            Deceleration over velocity [1/s].
        stiffness_damping : float
            Additional dashpot of each spring over its stiffness [s].
        held : array_like, shape (h, 3), optional
            Where the held particles are at the step's end [m], in the order of their numbers; where they were without.
        iterations : int
            Most iterations of conjugate gradients.
        tolerance : float
            Norm of the residual over that of ``h load + M v``, or of the springs' and the held particles' impulse
            where that is zero, at which they stop. 0: all iterations are done.

        Returns
        -------
        ImplicitStep
            Converged if the residual met ``tolerance``; at a tolerance of 0 if it is a finite number below 1.
        """
        dt = checked_number("dt", dt, above=0.0, unit="s")
        drag = checked_number("drag", drag, at_least=0.0, unit="1/s")
        zeta = checked_number("stiffness_damping", stiffness_damping, at_least=0.0, unit="s")
        limit = checked_count("iterations", iterations)
        tolerance = checked_number("tolerance", tolerance, at_least=0.0, at_most=1.0)
        if np.shape(load) == (3,):
            np.multiply(self._mass[:, None], checked_vectors("load", load, (3,)), out=self._load)
        else:
            self._load[:] = checked_vectors("load", load, (self.count, 3))[self._order]
        places = self._held_places
        pull = np.zeros((len(places), 3))
        if held is not None:
            pull = (checked_vectors("held", held, (len(places), 3)) - self._x[places]) / dt
        self._dv[places] = pull - self._v[places]
        momentum = self._free[:, None] * (dt * self._load + self._mass[:, None] * self._v)
        scale = float(np.sqrt(np.vdot(momentum, momentum)))

        with self.threads.steps():
            return self._timed_step(dt, drag, zeta, limit, tolerance, scale)

    def _timed_step(
        self, dt: float, drag: float, zeta: float, limit: int, tolerance: float, scale: float
    ) -> ImplicitStep:
        springs = (self._starts, self._others, self._stiffness, self._rest, self._dashpot)
        matter = (zeta, drag, self._mass)
        x, v = self._x, self._v
        times = [time.perf_counter()]
        kernels.forces(springs, *matter, x, v, self._load, self._force)
        times.append(time.perf_counter())
        kernels.matrix(springs, *matter, dt, x, v, self._force, self._blocks, self._inverses, self._right)
        weight = (1.0 + dt * drag) * self._mass
        if scale == 0.0:  # let go at rest, or led from there: by what sets it in motion
            led = self._mass[self._held_places, None] * self._dv[self._held_places]
            scale = float(np.hypot(np.linalg.norm(self._free[:, None] * self._right), np.linalg.norm(led))) or 1.0
        times.append(time.perf_counter())
        work = (self._p, self._q, self._r, self._z, self._sums)
        system = (self._starts, self._others, self._blocks, self._inverses, weight, self._free, self._right)
        count, residual = kernels.conjugate_gradients(*system, tolerance * scale, limit, self._dv, work)
        times.append(time.perf_counter())
        kernels.move(1.0, self._dv, v)
        times.append(time.perf_counter())
        kernels.move(dt, v, x)
        times.append(time.perf_counter())
        relative = float(residual) / scale
        converged = relative <= (tolerance or 1.0)
        return ImplicitStep(int(count), relative, bool(converged), dict(zip(TASKS, np.diff(times), strict=True)))
