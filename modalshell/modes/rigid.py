"""Rigid motions that the supports leave free, and solves with the singular stiffness."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.linalg
import scipy.sparse as sps

from modalshell.core.typing import Array, Index
from modalshell.modes.factorisation import Factor, Factoriser, condensed_factor
from modalshell.shell import Shell


def six_motions(points: Array) -> Array:
    """Translations and turns about the centre of points (k, 3), as columns (k, 3, 6) of similar size."""
    centred = points - points.mean(axis=0)
    centred /= np.linalg.norm(centred, axis=1).max()
    motions = np.zeros((len(points), 3, 6))
    for axis in range(3):
        motions[:, axis, axis] = 1.0
        motions[:, :, 3 + axis] = np.cross(np.eye(3)[axis], centred)
    return motions


def left_free(shell: Shell) -> str:
    """Description of the rigid motions that the supports leave free; "" if there are none."""
    parts = [(vertices, free) for vertices, free in _free_motions(shell) if free.shape[1]]
    if not parts:
        return ""
    words = _described(shell.rest_positions, *parts[0])
    if len(parts) == 1 and shell.mesh.components.max() == 0:
        return f"the supports leave free {words}"
    return f"the supports leave {len(parts)} parts of the shell free, that of vertex {parts[0][0][0]} by {words}"


def _described(positions: Array, vertices: Index, free: Array) -> str:
    """Description of rigid motions, given by their coefficients (6, r) of :func:`six_motions`."""
    if free.shape[1] == 6:
        return "all translations and turns"
    translations, turns = _separated(free)
    words = [f"a translation along {_written(axis)}" for axis in _axes(translations)]
    points = positions[vertices]
    centre = points.mean(axis=0)
    size = np.linalg.norm(points - centre, axis=1).max()
    for axis in _axes(turns[3:]):
        motion = turns @ np.linalg.lstsq(turns[3:], axis, rcond=None)[0]
        speed = motion[:3]
        if translations.size:
            speed = speed - translations @ np.linalg.lstsq(translations, speed, rcond=None)[0]
        through = centre + size * np.cross(axis, speed)
        words.append(f"a turn about {_written(axis)} through {_written(through)}")
    return " and ".join(words)


def _separated(free: Array) -> tuple[Array, Array]:
    """Directions (3, k) of the translations among rigid motions (6, r), and what turns of them (6, r - k)."""
    _, values, right = np.linalg.svd(free[3:])
    turning = int(np.count_nonzero(values > 1e-6))
    return free[:3] @ right[turning:].T, free @ right[:turning].T


def _axes(vectors: Array) -> list[Array]:
    """Directions that span the columns (3, k): coordinate axes as far as these lie among them."""
    columns, values, _ = np.linalg.svd(vectors, full_matrices=False)
    basis = columns[:, values > 1e-9]
    found = [axis for axis in np.eye(3) if np.linalg.norm(basis.T @ axis) > 1.0 - 1e-9]
    known = np.array(found).reshape(-1, 3)
    columns, values, _ = np.linalg.svd(basis - known.T @ (known @ basis), full_matrices=False)
    return [*found, *columns[:, values > 0.5].T]


def _written(vector: Array) -> str:
    return "(" + ", ".join(f"{round(float(value), 6) + 0.0:g}" for value in vector) + ")"


def rigid_motions(shell: Shell) -> Array:
    """Mass-orthonormal rigid motions (free unknowns, r) compatible with the supports.

    Each connected part of the shell has six; held vertices take away those that would move them, so a part held along
    one straight line keeps one, the turn about that line, unless an edge on it is clamped.
    """
    unknowns, positions = shell.unknowns, shell.rest_positions
    columns = []
    for vertices, free in _free_motions(shell):
        if free.shape[1]:
            whole = np.zeros((*positions.shape, free.shape[1]))
            whole[vertices] = six_motions(positions[vertices]) @ free
            columns.append(unknowns.values(whole.reshape(positions.size, -1)))
    if not columns:
        return np.empty((unknowns.count, 0))
    root_mass = np.sqrt(unknowns.masses(shell.mass))[:, None]
    orthonormal, _ = np.linalg.qr(root_mass * np.hstack(columns))
    return orthonormal / root_mass


def _free_motions(shell: Shell) -> Iterator[tuple[Index, Array]]:
    """Vertices of every connected part, and what shares (6, r) of :func:`six_motions` its supports leave free."""
    positions, labels, edges = shell.rest_positions, shell.mesh.components, shell.elastic_energy.held_slopes()
    for part in range(int(labels.max()) + 1):
        vertices = np.flatnonzero(labels == part)
        whole = np.zeros((*positions.shape, 6))
        whole[vertices] = six_motions(positions[vertices])
        resisted = shell.unknowns.resisted(whole).reshape(-1, 6)
        own = edges[labels[edges[:, 0]] == part]
        if own.size:  # about their own directions they cannot turn
            along = positions[own[:, 1]] - positions[own[:, 0]]
            turns = along / np.linalg.norm(along, axis=1, keepdims=True)
            resisted = np.vstack([resisted, np.hstack([np.zeros_like(turns), turns])])
        if not resisted.any():
            yield vertices, np.eye(6)
            continue
        _, values, right = np.linalg.svd(np.linalg.qr(resisted, mode="r"))
        yield vertices, right[np.count_nonzero(values > 1e-6 * values[0]) :].T


def free_translations(shell: Shell) -> list[tuple[Index, Array, int]]:
    """Vertices, directions (3, k) along which supports let it translate, and number of free motions, of every part."""
    found = []
    for vertices, free in _free_motions(shell):
        directions = _separated(free)[0]
        found.append((vertices, np.linalg.qr(directions)[0] if directions.size else directions, free.shape[1]))
    return found


class RigidFreeSolver:
    """Solves ``K x = b`` on the complement of the rigid motions.

    As many unknowns as there are rigid motions are held, statically determinate, so that the rest of K is positive
    definite and no shift has to be chosen; the rigid part is projected out of ``b`` and ``x``. ``stiffness`` (N, N) is
    that of the free unknowns, which internal ones without mass may follow; ``rigid`` (N, r) are the mass-orthonormal
    rigid motions, ``mass`` (N,) is that of each unknown.
    """

    def __init__(self, stiffness: sps.csc_array, rigid: Array, mass: Array, backend: str | None = None) -> None:
        self._rigid = rigid
        self._mass = mass
        self._kept = np.arange(mass.size)
        internal = stiffness.shape[0] - mass.size
        if rigid.shape[1]:
            _, _, order = scipy.linalg.qr(rigid.T, pivoting=True, mode="economic")
            self._kept = np.sort(order[rigid.shape[1] :])
            kept = np.concatenate([self._kept, mass.size + np.arange(internal)])
            stiffness = sps.csc_array(stiffness[kept][:, kept])
        self.factor: Factor = condensed_factor(Factoriser(backend, use="solve").definite(stiffness), internal)

    @classmethod
    def of(cls, shell: Shell, data: Array, backend: str | None = None) -> RigidFreeSolver:
        """The solver of a shell's Hessian, of these numbers in its pattern, with the shell's rigid motions."""
        masses = shell.unknowns.masses(shell.mass)
        return cls(shell.pattern.free_matrix(data), rigid_motions(shell), masses, backend)

    def solve(self, right_side: Array) -> Array:
        """Solution without rigid part, for (N,) or (N, k) right sides; their rigid part is left out."""
        if not self._rigid.shape[1]:
            return self.factor.solve(right_side)
        mass = self._mass.reshape(-1, *[1] * (right_side.ndim - 1))
        balanced = right_side - mass * (self._rigid @ (self._rigid.T @ right_side))
        solution = np.zeros_like(balanced)
        solution[self._kept] = self.factor.solve(balanced[self._kept])
        return solution - self._rigid @ (self._rigid.T @ (mass * solution))


def rigid_share(shell: Shell, load: Array) -> float:
    """Share of a load (n, 3), in the norm of the inverse mass, along the rigid motions that the supports leave free."""
    free = shell.unknowns.restrict(load.ravel())
    pushed = rigid_motions(shell).T @ free
    return float(np.linalg.norm(pushed) / np.sqrt(np.sum(free**2 / shell.unknowns.masses(shell.mass))))
