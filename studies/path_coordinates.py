"""Statics in coordinates of an equilibrium path: along it, and quadratic across it [prototype of a model].

Points of a path of equilibria under one growing load stand for the states that a snap leads through. Along it the mean
displacement ``q = C.u`` under that load is the coordinate; across it, with ``C.v = 0``, the energy is quadratic:

    x(q, p) = x(q) + B p,    V(q, p) = E(q) + p.K(q) p / 2 - f.x(q, p),    K(q) = B'.H(x(q)).B

H is the exact Hessian. The linear term in p vanishes, since points of the path are equilibria but for a multiple of C.
B holds modes of the constrained tangents, and their answers to other loads. A load's equilibria are the minima of a
function of q alone, ``V(q) = E(q) - f.x(q) - b.K(q)^-1 b / 2`` with ``b = B.f``: all stable states are found. Energies
with such a valley are known from implicit condensation [touze2021] and the reaction-path Hamiltonian [miller1980].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla
from scipy.interpolate import CubicSpline, PPoly

import modalshell as ms
from modalshell.kernels.compiler import njit

MODES = 8
"""Modes of the constrained tangent at each point of the path."""
RANK = 60
"""Vectors across the path."""
_ALONG = 1e-9
"""Relative singular value down to which vectors along the path are kept."""
_CELLS = 1
"""Intervals of the search between neighbouring points of the path."""
_FAR, _SMALL = 0.5, 0.2
"""Largest motion across the path over that along it, and least share of the longest that counts as that."""
_APART = 0.15
"""Distance of two states, over their displacement, from which they are two."""
_FOUND = 1e-9
"""Slope of the potential at a minimum over those at the ends of its interval."""
_REFINEMENTS = 12
"""Evaluations at most that the place of a minimum takes."""


@dataclass(frozen=True)
class State:
    """A stable equilibrium in the chart.

    Attributes
    ----------
    q : float
        Mean displacement along the path's load [m].
    coordinates : ndarray, shape (y + r,)
        Along the path, and across it.
    energy : float
        Potential [J].
    """

    q: float
    coordinates: np.ndarray = field(repr=False)
    energy: float


@dataclass(frozen=True)
class PathChart:
    """Coordinates along a path, and across it; see the module.

    Attributes
    ----------
    shell : Shell
        The shell.
    knots : ndarray, shape (k,)
        q of the path's points [m].
    basis : ndarray, shape (3n, y + r)
        Vectors along and across.
    along : int
        How many of them are along.
    path, energy, stiffness : PPoly
        Coordinates along (y,), energy less that at rest [J] and K (r, r), over q.
    """

    shell: ms.Shell
    knots: np.ndarray
    basis: np.ndarray = field(repr=False)
    along: int
    path: PPoly = field(repr=False)
    energy: PPoly = field(repr=False)
    stiffness: PPoly = field(repr=False)
    _data: tuple[np.ndarray, ...] = field(init=False, repr=False)
    _least: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        inner = (self.knots[:-1, None] + np.diff(self.knots)[:, None] * np.arange(_CELLS) / _CELLS).ravel()
        q = np.append(inner, self.knots[-1])
        stiffness = self.stiffness(q)
        definite = np.linalg.eigvalsh(stiffness)[:, 0] > 0.0
        inverses = np.zeros_like(stiffness)
        inverses[definite] = np.linalg.inv(stiffness[definite])
        path = self.path(q)
        grid = q, definite, inverses, path, self.energy(q)
        curves = tuple(np.ascontiguousarray(one.c.reshape(*one.c.shape[:2], -1)) for one in (self.path, self.stiffness))
        object.__setattr__(
            self, "_data", (*grid, self.knots, curves[0], np.ascontiguousarray(self.energy.c), curves[1])
        )
        object.__setattr__(self, "_least", _SMALL * float(np.linalg.norm(path, axis=1).max()))

    def states(self, load: np.ndarray) -> list[State]:
        """Every stable equilibrium under a load (n, 3) [N], in order along the path."""
        pushed = load.ravel() @ self.basis
        found = []
        for q, energy, *parts in _minima(pushed[: self.along], pushed[self.along :], *self._data):
            path, across = np.array(parts[: self.along]), np.array(parts[self.along :])
            if np.linalg.norm(across) <= _FAR * max(float(np.linalg.norm(path)), self._least):
                found.append(State(q, np.concatenate([path, across]), energy))
        return found

    def positions(self, state: State) -> np.ndarray:
        """Vertex positions (n, 3) [m]."""
        return self.shell.rest_positions + (self.basis @ state.coordinates).reshape(-1, 3)


@njit(error_model="numpy", fastmath={"contract"}, nogil=True)
def _powers(coefficients, interval, step, value, slope):  # type: ignore[no-untyped-def]
    """Value and derivative of a cubic, flattened."""
    a, b, c, d = (
        coefficients[0, interval],
        coefficients[1, interval],
        coefficients[2, interval],
        coefficients[3, interval],
    )
    for k in range(value.size):
        value[k] = ((a[k] * step + b[k]) * step + c[k]) * step + d[k]
        slope[k] = (3.0 * a[k] * step + 2.0 * b[k]) * step + c[k]


@njit(error_model="numpy", fastmath={"contract"}, nogil=True)
def _slope(q, along, across, knots, path, energy, stiffness):  # type: ignore[no-untyped-def]
    """Derivative of the potential by q, the potential, and the coordinates along and across; NaN if not definite."""
    rank = across.size
    interval = min(max(np.searchsorted(knots, q) - 1, 0), knots.size - 2)
    step = q - knots[interval]
    place, speed = np.empty(along.size), np.empty(along.size)
    _powers(path, interval, step, place, speed)
    matrix, change = np.empty(rank * rank), np.empty(rank * rank)
    _powers(stiffness, interval, step, matrix, change)
    e = energy[:, interval]
    height = (((e[0] * step + e[1]) * step + e[2]) * step + e[3]) * step + e[4]
    push = ((4.0 * e[0] * step + 3.0 * e[1]) * step + 2.0 * e[2]) * step + e[3]
    eased = np.linalg.solve(matrix.reshape(rank, rank), across)
    bent = 0.0
    for i in range(rank):
        for j in range(rank):
            bent += eased[i] * change[i * rank + j] * eased[j]
    potential = height - np.dot(place, along) - 0.5 * np.dot(across, eased)
    return push - np.dot(speed, along) + 0.5 * bent, potential, place, eased


@njit(error_model="numpy", fastmath={"contract"}, nogil=True)
def _minima(along, across, grid, definite, inverses, grid_path, grid_energy, knots, path, energy, stiffness):  # type: ignore[no-untyped-def]
    """Rows (m, 2 + y + r): q, potential and coordinates of every minimum where the stiffness across is definite."""
    potential = np.full(grid.size, np.inf)
    for g in range(grid.size):
        if definite[g]:
            potential[g] = (
                grid_energy[g] - np.dot(grid_path[g], along) - 0.5 * np.dot(across, np.dot(inverses[g], across))
            )
    rows = np.empty((grid.size, 2 + along.size + across.size))
    count = 0
    for g in range(1, grid.size - 1):
        if not (definite[g - 1] and definite[g] and definite[g + 1]):
            continue
        if potential[g] > potential[g - 1] or potential[g] > potential[g + 1]:
            continue
        low, high = grid[g - 1], grid[g + 1]
        below = _slope(low, along, across, knots, path, energy, stiffness)[0]
        above = _slope(high, along, across, knots, path, energy, stiffness)[0]
        if not (below < 0.0 and above > 0.0):
            continue
        scale = max(-below, above)
        q = grid[g]
        for _ in range(_REFINEMENTS):
            value, height, place, eased = _slope(q, along, across, knots, path, energy, stiffness)
            if abs(value) <= _FOUND * scale:
                break
            if value < 0.0:
                low, below = q, value
            else:
                high, above = q, value
            width = high - low
            q = min(max(low - below * width / (above - below), low + 0.02 * width), high - 0.02 * width)
        rows[count, 0], rows[count, 1] = q, height
        rows[count, 2 : 2 + along.size] = place
        rows[count, 2 + along.size :] = eased
        count += 1
    return rows[:count]


@dataclass(frozen=True)
class Atlas:
    """Charts of the paths under several loads, of which each sees the branches near its own.

    Attributes
    ----------
    charts : list of PathChart
        The charts.
    """

    charts: list[PathChart]

    def states(self, load: np.ndarray) -> list[np.ndarray]:
        """Positions (n, 3) [m] of every stable equilibrium under a load (n, 3) [N], the least moved first.

        Of states that are close to each other that stays which is least far across its path.
        """
        found = [(chart, state) for chart in self.charts for state in chart.states(load)]
        found.sort(key=lambda pair: float(np.linalg.norm(pair[1].coordinates[pair[0].along :])))
        kept: list[tuple[float, np.ndarray]] = []
        for chart, state in found:
            moved = chart.basis @ state.coordinates
            size = float(np.linalg.norm(moved))
            if all(np.linalg.norm(moved - other) > _APART * max(size, length) for length, other in kept):
                kept.append((size, moved))
        rest = self.charts[0].shell.rest_positions
        return [rest + moved.reshape(-1, 3) for _, moved in sorted(kept, key=lambda pair: pair[0])]


def make_chart(
    shell: ms.Shell,
    force: np.ndarray,
    until: float,
    back: float,
    others: Sequence[np.ndarray] = (),
    rank: int = RANK,
    steps: int = 40,
) -> PathChart:
    """The chart of the path under ``force`` (n, 3) [N] times ``back`` (negative) to ``until``.

    ``others`` (n, 3) [N] are loads whose answers across the path are taken into the basis.
    """
    ahead = ms.equilibrium_path(shell, force=force, until=until, steps=steps)
    behind = ms.equilibrium_path(shell, force=force, until=back, steps=max(2, steps // 8))
    factors = np.concatenate([behind.factors[:0:-1], ahead.factors])
    positions = np.concatenate([behind.positions[:0:-1], ahead.positions])
    dofs = (3 * shell.free[:, None] + np.arange(3)).ravel()
    mass = np.repeat(shell.mass[shell.free], 3)
    push = force.ravel()[dofs]
    total = float(np.abs(push).sum())
    pattern = push / total
    moves = (positions - shell.rest_positions).reshape(len(positions), -1)[:, dofs]
    q = moves @ pattern
    kept = np.concatenate([[True], np.diff(q) > 1e-4 * np.ptp(q)])
    if (np.diff(q[kept]) <= 0.0).any():
        raise ms.SolverError("the mean displacement turns back along this path: it is no coordinate of it")
    q, factors, positions, moves = q[kept], factors[kept], positions[kept], moves[kept]
    tangents = [stiffness_at(shell, x, dofs) for x in positions]
    vectors = [
        column
        for tangent in tangents
        for column in across_vectors(tangent, mass, pattern, [other.ravel()[dofs] for other in others])
    ]
    root = np.sqrt(mass)
    aside = leading(root[:, None] * np.array(vectors).T, rank) / root[:, None]
    along = leading(root[:, None] * moves.T, len(moves), _ALONG) / root[:, None]
    coordinates = (mass[:, None] * along).T @ moves.T
    whole = np.zeros((shell.rest_positions.size, along.shape[1] + aside.shape[1]))
    whole[dofs] = np.concatenate([along, aside], axis=1)
    stiffness = np.array([aside.T @ (tangent @ aside) for tangent in tangents])
    energy = CubicSpline(q, total * factors).antiderivative()
    energy.c[-1] -= energy(q[np.argmin(np.abs(factors))])
    return PathChart(shell, q, whole, along.shape[1], CubicSpline(q, coordinates.T), energy, CubicSpline(q, stiffness))


def stiffness_at(shell: ms.Shell, positions: np.ndarray, dofs: np.ndarray) -> sps.csc_array:
    """Exact Hessian on the free unknowns."""
    return sps.csc_array(sps.csr_array(shell.stiffness(positions))[dofs][:, dofs])


def leading(columns: np.ndarray, count: int, least: float = 0.0) -> np.ndarray:
    """The first left singular vectors of columns, ``count`` at most and none below a share of the first."""
    vectors, values, _ = np.linalg.svd(columns, full_matrices=False)
    return vectors[:, : min(count, int((values > least * values[0]).sum()))]


def across_vectors(
    tangent: sps.csc_array, mass: np.ndarray, pattern: np.ndarray, others: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Lowest modes of a tangent constrained by ``pattern``, and its constrained answers to loads; each of length 1."""
    shift = -1e-3 * float(tangent.diagonal().mean() / mass.mean()) * 1e-3
    factor = spla.splu(sps.csc_array(tangent - shift * sps.diags_array(mass)))
    eased = factor.solve(pattern)
    compliance = float(pattern @ eased)

    def solve(right: np.ndarray) -> np.ndarray:
        plain = factor.solve(right)
        return plain - eased * (float(pattern @ plain) / compliance)

    root = np.sqrt(mass)
    size = len(mass)
    operator = spla.LinearOperator((size, size), lambda z: root * solve(root * z.ravel()), dtype=float)
    start = np.random.default_rng(0).standard_normal(size)
    _, found = spla.eigsh(operator, k=MODES, which="LM", v0=start)
    columns = [mode / root for mode in found.T] + [solve(other) for other in others]
    return [column / np.sqrt(mass @ column**2) for column in columns]
