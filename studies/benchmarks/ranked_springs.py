"""One large sheet over MPI ranks: implicit steps of springs, solved by PETSc.

Every rank holds a block of neighbouring particles and their springs (:class:`modalshell.springs.implicit.RankBlock`).
A step exchanges the places and velocities of the block's rim; PETSc's conjugate gradients, preconditioned by an
incomplete factor of every rank's own block (block Jacobi), exchange the rim and two sums an iteration. The answer is
the one of :class:`modalshell.springs.implicit.ImplicitSprings`, to the tolerance of both.

PETSc, petsc4py and MPI come from the system; pip would build them for an hour. On Debian 12 (petsc4py 3.18, which needs
NumPy below 2), as root::

    apt-get install --no-install-recommends python3-petsc4py python3-venv
    /usr/bin/python3 -m venv --system-site-packages mpi
    export PETSC_DIR=/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real
    mpi/bin/pip install '.[mpi]' 'numpy<2'
    mpiexec -n 2 mpi/bin/python -m studies.benchmarks.ranks --rows 256 --columns 256

Open MPI wants ``--allow-run-as-root`` from root, and ``--oversubscribe`` for more ranks than cores. The environment
variable ``PETSC_OPTIONS`` reaches the solver: ``-pc_type pbjacobi`` for the diagonal blocks of single particles.
"""

from __future__ import annotations

import time
from types import ModuleType
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_count, checked_number, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.kernels.compiler import njit
from modalshell.mesh.selection import held_vertices
from modalshell.springs.implicit import TASKS, ImplicitStep, rank_block
from modalshell.springs.kernels import blocks as spring_blocks
from modalshell.springs.springs import Springs, checked_masses
from modalshell.springs.threads import limited_to


def petsc() -> ModuleType:
    """PETSc's Python library; OptionError where it is not installed."""
    try:
        from petsc4py import PETSc
    except ImportError as error:
        words = "sheets over MPI ranks need PETSc and petsc4py, see the text of studies.benchmarks.ranked_springs"
        raise OptionError(f"{words} ({error})") from error
    return PETSc


@final
class RankedSprings:
    r"""Particles and springs over MPI ranks, stepped by the implicit method of Baraff and Witkin [baraff1998, eq. 18].

    .. math:: (M - h\,\partial f/\partial v - h^2\,\partial f/\partial x)\,\Delta v
              = h\,(f_0 + h\,\partial f/\partial x\,v_0), \qquad \Delta x = h\,(v_0 + \Delta v)

    Collective: every rank of the communicator constructs it with the same arguments and calls the same methods.

    Parameters
    ----------
    springs, mass, held
        As for :class:`modalshell.springs.ImplicitSprings`; held particles do not move.
    positions : array_like, shape (n, 3)
        Where the particles start from rest [m].
    communicator : optional
        Communicator of petsc4py or mpi4py; by default all ranks.

    Attributes
    ----------
    block : RankBlock
        What this rank holds.

    Raises
    ------
    OptionError
        Where PETSc is not installed, or there are more ranks than particles.
    MeshError
        For springs that name particles beyond n.
    MaterialError
        For masses that are not positive.
    LoadError
        For positions of another shape, or not finite.
    SupportError
        For ``held`` that names no particle, or all.
    """

    def __init__(
        self,
        springs: Springs,
        mass: ArrayLike,
        positions: ArrayLike,
        held: ArrayLike | None = None,
        *,
        communicator: Any = None,
    ) -> None:
        self._petsc = PETSc = petsc()
        masses = checked_masses(mass)
        n = self.count = len(masses)
        places = checked_vectors("positions", positions, (n, 3))
        free = np.where(held_vertices(held, n), 0.0, 1.0)
        comm = PETSc.COMM_WORLD if communicator is None else PETSc.Comm(communicator)
        self.rank = comm.getRank()
        block = self.block = rank_block(springs, n, comm.getSize(), self.rank)
        owned, particles = block.owned, block.particles
        self._mass, self._free = masses[particles[:owned]], free[particles]
        self._spring = tuple(
            values[block.springs] for values in (springs.stiffness, springs.rest_lengths, springs.damping)
        )
        self._blocks, self._inverses = np.empty((len(block.springs), 4)), np.empty((owned, 6))
        self._load, self._force = np.empty((2, owned, 3))

        self._x = PETSc.Vec().createGhost(block.ghosts.astype(PETSc.IntType), (3 * owned, 3 * n), 3, comm)
        self._v, self._dv, self._right = self._x.duplicate(), PETSc.Vec().create(comm), PETSc.Vec().create(comm)
        for vector in (self._dv, self._right):
            vector.setSizes((3 * owned, 3 * n), 3)
            vector.setUp()
        self._x.getArray()[:] = places[particles[:owned]].ravel()
        self._pattern(comm)
        self._solver = PETSc.KSP().create(comm)
        self._solver.setType("cg")
        self._solver.getPC().setType("bjacobi")
        self._solver.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._solver.setInitialGuessNonzero(True)
        self._solver.setOperators(self._matrix)
        self._solver.setFromOptions()

    def _pattern(self, comm: Any) -> None:
        """Make the matrix with zeros for values: in every row the springs' far ends and, among them, the row itself."""
        block = self.block
        numbers = np.concatenate([np.arange(block.first, block.last), block.ghosts])[block.others]
        rows = np.repeat(np.arange(block.owned), np.diff(block.starts))
        self._lower = np.bincount(rows[numbers < block.first + rows], minlength=block.owned)
        columns = np.insert(numbers, block.starts[:-1] + self._lower, np.arange(block.first, block.last))
        kind = self._petsc.IntType
        self._rows = (block.starts + np.arange(block.owned + 1)).astype(kind)
        self._columns = columns.astype(kind)
        self._values = np.zeros((len(columns), 3, 3))
        sizes = (3 * block.owned, 3 * self.count)
        self._matrix = self._petsc.Mat().createBAIJ(
            (sizes, sizes), 3, csr=(self._rows, self._columns, self._values.ravel()), comm=comm
        )
        self._matrix.setOption(self._petsc.Mat.Option.SYMMETRIC, True)

    def step(
        self, dt: float, acceleration: ArrayLike, *, drag: float = 0.0, iterations: int = 1000, tolerance: float = 1e-12
    ) -> ImplicitStep:
        """Advance by ``dt`` [s]; every rank gets the same answer but for the seconds.

        Parameters
        ----------
        dt : float
            h [s].
        acceleration : array_like, shape (3,)
            Of every particle, as by gravity [m/s^2].
        drag : float
            Deceleration over velocity [1/s].
        iterations : int
            Most iterations of conjugate gradients.
        tolerance : float
            Norm of the residual over that of ``h load + M v``, or of the springs' impulse where that is zero, at which
            they stop.

        Returns
        -------
        ImplicitStep
            Converged if the residual met ``tolerance``.
        """
        dt = checked_number("dt", dt, above=0.0, unit="s")
        drag = checked_number("drag", drag, at_least=0.0, unit="1/s")
        limit = checked_count("iterations", iterations)
        tolerance = checked_number("tolerance", tolerance, above=0.0, at_most=1.0)
        np.multiply(self._mass[:, None], checked_vectors("acceleration", acceleration, (3,)), out=self._load)
        # Where ranks share a machine, each has one core.
        with limited_to(1):
            return self._timed_step(dt, drag, limit, tolerance)

    def _timed_step(self, dt: float, drag: float, limit: int, tolerance: float) -> ImplicitStep:
        block, vectors = self.block, (self._x, self._v)
        springs = ((block.starts, block.others, *self._spring), 0.0, drag, self._mass)
        free = self._free[: block.owned, None]
        times = [time.perf_counter()]
        for vector in vectors:
            vector.ghostUpdate(self._petsc.InsertMode.INSERT, self._petsc.ScatterMode.FORWARD)
        with self._x.localForm() as near_x, self._v.localForm() as near_v:
            x, v = (near.getArray().reshape(-1, 3) for near in (near_x, near_v))
            right = self._right.getArray().reshape(-1, 3)
            right[:] = free * (dt * self._load + self._mass[:, None] * v[: block.owned])
            scale = self._right.norm()
            spring_blocks.forces(*springs, x, v, self._load, self._force)
            times.append(time.perf_counter())
            spring_blocks.matrix(*springs, dt, x, v, self._force, self._blocks, self._inverses, right)
            right *= free
        weight = (1.0 + dt * drag) * self._mass
        fill_rows(block.starts, block.others, self._lower, self._blocks, weight, self._free, self._values)
        self._matrix.setValuesBlockedCSR(self._rows, self._columns, self._values)
        self._matrix.assemble()
        times.append(time.perf_counter())
        scale = scale or self._right.norm() or 1.0
        self._solver.setTolerances(rtol=1e-300, atol=tolerance * scale, max_it=limit)
        self._solver.solve(self._right, self._dv)
        times.append(time.perf_counter())
        self._v.axpy(1.0, self._dv)
        times.append(time.perf_counter())
        self._x.axpy(dt, self._v)
        times.append(time.perf_counter())
        residual = self._solver.getResidualNorm() / scale
        seconds = dict(zip(TASKS, map(float, np.diff(times)), strict=True))
        return ImplicitStep(self._solver.getIterationNumber(), residual, bool(residual <= tolerance), seconds)

    def positions(self) -> Array | None:
        """Positions (n, 3) [m] in the order they were given in, on rank 0; None on the others."""
        return self._gathered(self._x)

    def velocities(self) -> Array | None:
        """Velocities (n, 3) [m/s] in the same order, on rank 0; None on the others."""
        return self._gathered(self._v)

    def _gathered(self, vector: Any) -> Array | None:
        scatter, whole = self._petsc.Scatter.toZero(vector)
        scatter.scatter(vector, whole)
        if self.rank != 0:
            return None
        values = np.empty((self.count, 3))
        values[self.block.order] = whole.getArray().reshape(-1, 3)
        return values


@njit(error_model="numpy", fastmath=False)
def fill_rows(starts, others, lower, blocks, weight, free, values):  # type: ignore[no-untyped-def]
    """Write one rank's rows of a step's matrix into ``values`` (springs + rows, 3, 3).

    The diagonal block comes after the ``lower`` ones.

    Row i has ``weight[i] I`` plus the sum of its springs' ``a I + m m^T`` (``blocks``, see
    :mod:`modalshell.springs.kernels.blocks`) on the diagonal and minus each off it. Blocks that join a particle that
    is not ``free`` are 0, so that the matrix stays symmetric and leaves it alone.
    """
    for i in range(starts.size - 1):
        diagonal = starts[i] + i + lower[i]
        for row in range(3):
            for column in range(3):
                values[diagonal, row, column] = weight[i] if row == column else 0.0
        for s in range(starts[i], starts[i + 1]):
            slot = s + i if s - starts[i] < lower[i] else s + i + 1
            both = free[i] * free[others[s]]
            for row in range(3):
                for column in range(3):
                    value = blocks[s, 1 + row] * blocks[s, 1 + column]
                    if row == column:
                        value += blocks[s, 0]
                    values[slot, row, column] = -both * value
                    values[diagonal, row, column] += value
