"""Profile factorisation ``L D L^T`` in 3 x 3 blocks, for small or banded symmetric matrices [george1981, chapter 4].

Every block row is stored from its first entry to its diagonal, and nothing before the first entry fills in. The inner
products run over contiguous numbers, nine of them at a time from six rows, in packed registers: on one thread 15 to 27
Gflop/s at 285 to 1,053 unknowns, where LAPACK's banded ``dpbtrf`` makes 7 to 10. Pivots are taken in their order,
whatever their sign: their signs are those of the eigenvalues. Definite matrices are factorised stably, indefinite ones
well enough for Newton directions.
"""

from __future__ import annotations

import functools
from typing import Any, final

import numpy as np
import scipy.sparse as sps
from scipy.sparse.csgraph import reverse_cuthill_mckee

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.packed import LANES, load, load_first, spread, store, total
from modalshell.linalg.cholesky import symmetric_block_graph
from modalshell.linalg.known_analyses import known_analysis

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract", "nsz"}} | UNCOUNTED
# Rows start, and are padded with zeros, at multiples of LANES. Sums stand in packed registers, as in `packed.dot`, and
# not in loops that LLVM packs by "reassoc": kernels that others call would round by what was loaded first.


@njit(**_options)
def factorise(values, first, starts, own, pivots):  # type: ignore[no-untyped-def]
    """Factorise in place; returns the number of negative pivots, or -1 - k where pivot k is zero or no number.

    ``values`` holds the rows of block i from ``starts[i]``, three of one length, from column ``first[i]`` on; what is
    below the diagonal of its diagonal block moves to ``own`` (b, 3), and zeros take the block's place. ``pivots``,
    one longer than a packed register reaches beyond the last unknown, receives their reciprocals.
    """
    zero = spread(0.0)
    pivots[:] = 0.0
    negative = 0
    for i in range(first.size):
        width = (starts[i + 1] - starts[i]) // 3
        begin_i = first[i]
        x = starts[i]
        y, z = x + width, x + 2 * width
        end = 3 * i - begin_i
        a00, a10, a11 = values[x + end], values[y + end], values[y + end + 1]
        a20, a21, a22 = values[z + end], values[z + end + 1], values[z + end + 2]
        for k in range(end, width):
            values[x + k] = 0.0
            values[y + k] = 0.0
            values[z + k] = 0.0
        for j in range((begin_i + 2) // 3, i):
            width_j = (starts[j + 1] - starts[j]) // 3
            begin = max(begin_i, first[j])
            u = starts[j] + begin - first[j]
            v, w = u + width_j, u + 2 * width_j
            p = x + begin - begin_i
            q, r = p + width, p + 2 * width
            s00, s01, s02 = zero, zero, zero
            s10, s11, s12 = zero, zero, zero
            s20, s21, s22 = zero, zero, zero
            size = 3 * j - begin
            for k in range(0, size, LANES):
                a, b, c = load(values, p + k), load(values, q + k), load(values, r + k)
                d = load(values, u + k)
                s00, s10, s20 = s00 + a * d, s10 + b * d, s20 + c * d
                d = load(values, v + k)
                s01, s11, s21 = s01 + a * d, s11 + b * d, s21 + c * d
                d = load(values, w + k)
                s02, s12, s22 = s02 + a * d, s12 + b * d, s22 + c * d
            l10, l20, l21 = own[j, 0], own[j, 1], own[j, 2]
            p, q, r = p + size, q + size, r + size
            values[p] -= total(s00)
            values[p + 1] -= total(s01) + values[p] * l10
            values[p + 2] -= total(s02) + values[p] * l20 + values[p + 1] * l21
            values[q] -= total(s10)
            values[q + 1] -= total(s11) + values[q] * l10
            values[q + 2] -= total(s12) + values[q] * l20 + values[q + 1] * l21
            values[r] -= total(s20)
            values[r + 1] -= total(s21) + values[r] * l10
            values[r + 2] -= total(s22) + values[r] * l20 + values[r + 1] * l21
        # The rows are those of L D up to here.
        s00, s10, s11, s20, s21, s22 = zero, zero, zero, zero, zero, zero
        for k in range(0, end, LANES):
            a, b, c = load(values, x + k), load(values, y + k), load(values, z + k)
            d = load(pivots, begin_i + k)
            p, q, r = a * d, b * d, c * d
            s00, s10, s11 = s00 + a * p, s10 + b * p, s11 + b * q
            s20, s21, s22 = s20 + c * p, s21 + c * q, s22 + c * r
            store(values, x + k, p)
            store(values, y + k, q)
            store(values, z + k, r)
        g10, g20 = a10 - total(s10), a20 - total(s20)
        pivot = a00 - total(s00)
        if not 0.0 < abs(pivot) < np.inf:
            return -1 - 3 * i
        negative += pivot < 0.0
        d0 = 1.0 / pivot
        l10, l20 = g10 * d0, g20 * d0
        g21 = a21 - total(s21) - g20 * l10
        pivot = a11 - total(s11) - g10 * l10
        if not 0.0 < abs(pivot) < np.inf:
            return -2 - 3 * i
        negative += pivot < 0.0
        d1 = 1.0 / pivot
        l21 = g21 * d1
        pivot = a22 - total(s22) - g20 * l20 - g21 * l21
        if not 0.0 < abs(pivot) < np.inf:
            return -3 - 3 * i
        negative += pivot < 0.0
        pivots[3 * i], pivots[3 * i + 1], pivots[3 * i + 2] = d0, d1, 1.0 / pivot
        own[i, 0], own[i, 1], own[i, 2] = l10, l20, l21
    return negative


@njit(entry=False, **_options)
def substitute_back(values, first, starts, own, vector):  # type: ignore[no-untyped-def]
    """Solve ``L^T y = vector`` in place; of unit vector k ``y`` has the curvature ``y . A y`` of pivot k."""
    for i in range(first.size - 1, -1, -1):
        width = (starts[i + 1] - starts[i]) // 3
        x = starts[i]
        y, z, begin = x + width, x + 2 * width, first[i]
        f2 = vector[3 * i + 2]
        f1 = vector[3 * i + 1] - own[i, 2] * f2
        f0 = vector[3 * i] - own[i, 0] * f1 - own[i, 1] * f2
        vector[3 * i], vector[3 * i + 1] = f0, f1
        for k in range(3 * i - begin):
            vector[begin + k] -= values[x + k] * f0 + values[y + k] * f1 + values[z + k] * f2


@njit(**_options)
def solve(values, first, starts, own, pivots, vector):  # type: ignore[no-untyped-def]
    """Solve in place for ``vector`` (3b,), in order of elimination, with what :func:`factorise` left."""
    zero = spread(0.0)
    for i in range(first.size):
        width = (starts[i + 1] - starts[i]) // 3
        x = starts[i]
        y, z, begin = x + width, x + 2 * width, first[i]
        size = 3 * i - begin
        whole = size // LANES * LANES
        p0, p1, p2 = zero, zero, zero
        for k in range(0, whole, LANES):
            d = load(vector, begin + k)
            p0, p1, p2 = p0 + load(values, x + k) * d, p1 + load(values, y + k) * d, p2 + load(values, z + k) * d
        if whole < size:  # the rows go on with zeros
            d, k = load_first(vector, begin + whole, size - whole), whole
            p0, p1, p2 = p0 + load(values, x + k) * d, p1 + load(values, y + k) * d, p2 + load(values, z + k) * d
        s0, s1, s2 = total(p0), total(p1), total(p2)
        f0 = vector[3 * i] - s0
        f1 = vector[3 * i + 1] - s1 - own[i, 0] * f0
        vector[3 * i + 2] -= s2 + own[i, 1] * f0 + own[i, 2] * f1
        vector[3 * i], vector[3 * i + 1] = f0, f1
    for k in range(vector.size):
        vector[k] *= pivots[k]
    substitute_back(values, first, starts, own, vector)


@njit(entry=False, **_options)
def add_product(values, first, starts, vector, out):  # type: ignore[no-untyped-def]
    """Add the product with a matrix that is not factorised yet to ``out`` (3n,), in order of elimination."""
    zero = spread(0.0)
    for i in range(first.size):
        width = (starts[i + 1] - starts[i]) // 3
        begin = first[i]
        whole = (3 * i - begin) // LANES * LANES
        for d in range(3):
            x, mine, products = starts[i] + d * width, spread(vector[3 * i + d]), zero
            for k in range(0, whole, LANES):
                row = load(values, x + k)
                products = products + row * load(vector, begin + k)
                store(out, begin + k, load(out, begin + k) + row * mine)
            total_here = total(products)
            for k in range(whole, 3 * i - begin):
                total_here += values[x + k] * vector[begin + k]
                out[begin + k] += values[x + k] * vector[3 * i + d]
            for k in range(3 * i - begin, 3 * i + 3 - begin):
                total_here += values[x + k] * vector[begin + k]
            out[3 * i + d] += total_here


@final
class Profile:
    """Storage of a symmetric pattern in an ``order`` (k,) of elimination of blocks of 3 unknowns or 1.

    ``rows`` and ``columns`` (e,) are where the pattern has entries, by blocks; there may be several of one place.

    Attributes
    ----------
    size : int
        Number of unknowns.
    first, starts : ndarray of int64, shape (b,) and (b + 1,)
        First column of every row of three unknowns, and where it begins in the storage.
    strides : ndarray of int64, shape (b,)
        Length of each of the three.
    """

    def __init__(self, order: Index, rows: Index, columns: Index, block: int = 3) -> None:
        self.order, self.block, self.size = order, block, block * order.size
        place = np.empty_like(order)
        place[order] = np.arange(order.size)
        count = -(-self.size // 3)
        first = 3 * np.arange(count, dtype=np.int64)
        np.minimum.at(first, block * place[rows] // 3, block * place[columns] // 3 * 3)
        self.first = first // LANES * LANES
        ends = 3 * np.arange(1, count + 1) - self.first
        self.strides = -(-ends // LANES) * LANES
        self.starts = np.concatenate([[0], np.cumsum(3 * self.strides)])

    @property
    def products(self) -> float:
        """Multiplications of a factorisation, those with zeros of the profile included."""
        return float(1.5 * np.sum(self.strides.astype(np.float64) ** 2))

    def places(self, i: Index, j: Index) -> Index:
        """Where entries stand, from their rows and columns in the order of elimination; -1 above diagonal blocks."""
        places = self.starts[i // 3] + i % 3 * self.strides[i // 3] + j - self.first[i // 3]
        return np.asarray(np.where(j // 3 <= i // 3, places, -1))


@final
class ProfileAnalysis:
    """Elimination order and storage of a matrix (N, N), both triangles stored: the order of least profile among a few.

    With ``points`` (N / 3, d), where the 3 x 3 blocks are, orders along each axis are tried in addition to reverse
    Cuthill-McKee [george1981, 4.3].
    """

    def __init__(self, matrix: sps.csc_array, points: Array | None = None) -> None:
        block, graph = symmetric_block_graph(matrix)
        orders = [np.asarray(reverse_cuthill_mckee(sps.csr_matrix(graph), symmetric_mode=True), dtype=np.int64)]
        for axis in () if points is None or block == 1 else points.T:
            orders.append(np.argsort(axis, kind="stable").astype(np.int64))
        entries = sps.coo_array(graph)
        rows, columns = entries.row.astype(np.int64), entries.col.astype(np.int64)
        tried = [Profile(order, rows, columns, block) for order in orders]
        self.profile = min(tried, key=lambda one: one.products)
        place = np.empty_like(self.profile.order)
        place[self.profile.order] = np.arange(place.size)
        self.position = (block * place[:, None] + np.arange(block)).ravel()
        self._pattern = matrix.indptr.copy(), matrix.indices.copy()  # those of a shared matrix may be sorted later

    @classmethod
    def known(cls, matrix: sps.csc_array) -> ProfileAnalysis:
        """The analysis of the pattern of ``matrix``, that of an earlier matrix where one had the same."""
        return known_analysis("profile", matrix, lambda: cls(matrix))

    @property
    def entries(self) -> int:
        """Stored numbers of a factor, and one that is not read."""
        return int(self.profile.starts[-1]) + 1

    @property
    def products(self) -> float:
        """Multiplications of a factorisation."""
        return self.profile.products

    @functools.cached_property
    def _filled(self) -> tuple[Index, Index]:
        """Places of a matrix's entries, and of unknowns of their own that fill up the last block."""
        (starts, rows), of = self._pattern, self.profile
        columns = np.repeat(self.position, np.diff(starts))
        padded = np.arange(of.size, 3 * of.first.size)
        return of.places(self.position[rows], columns), of.places(padded, padded)

    def workspace(self) -> tuple[Array, Array]:
        """Room for the numbers of diagonal blocks and for pivots that :func:`factorise` fills."""
        count = self.profile.first.size
        return np.empty((count, 3)), np.empty(3 * count + LANES)

    def factorise(self, matrix: sps.csc_array) -> ProfileFactor:
        """Factor of a matrix with this pattern, definite or not.

        SolverError where a pivot is zero, or an entry not finite.
        """
        values, (places, padded) = np.zeros(self.entries), self._filled
        values[places] = matrix.data  # what lies above the diagonal blocks goes to the last place of all
        values[padded] = 1.0
        rest = self.workspace()
        negative = factorise(values, self.profile.first, self.profile.starts, *rest)
        if negative < 0:
            unknown = int(np.flatnonzero(self.position == -1 - negative)[0])
            size = self.profile.size
            raise SolverError(f"the matrix ({size} unknowns) has no factor: pivot {unknown} is zero or no number")
        return ProfileFactor(self, (values, *rest), negative)


@final
class ProfileFactor:
    """A factor ``A = P^T L D L^T P`` in profile storage, with as many negative pivots as A has negative eigenvalues."""

    def __init__(self, analysis: ProfileAnalysis, factor: tuple[Array, Array, Array], negative: int) -> None:
        self.negative = negative
        self._analysis, self._factor = analysis, factor

    def solve(self, right_side: Array) -> Array:
        """Solution of ``A x = right_side`` for (N,) or (N, r) right sides."""
        of, position, (values, own, pivots) = self._analysis.profile, self._analysis.position, self._factor
        columns = np.asarray(right_side, dtype=np.float64).reshape(of.size, -1)
        solution = np.empty_like(columns)
        for k in range(columns.shape[1]):
            vector = np.zeros(3 * of.first.size)
            vector[position] = columns[:, k]
            solve(values, of.first, of.starts, own, pivots, vector)
            solution[:, k] = vector[position]
        return solution.reshape(np.shape(right_side))
