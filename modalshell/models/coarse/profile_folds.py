"""Shell theory's energy in a compiled step: split folds, whose shares are unknowns of the profile.

The shares are least at every iterate (theory 4, eq. 10), so their part of a residual is zero. In the matrix they stand
by threes among the vertices: without them it would be almost full. Its negative pivots are as many as those of the
Hessian by positions, as the shares' own stiffness is positive definite.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sps

from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.linalg import Profile
from modalshell.linalg.columns import ColumnFactor
from modalshell.models.coarse import profile_elasticity as elasticity
from modalshell.models.coarse.profile_elasticity import block_places
from modalshell.models.coarse.profile_fold_kernels import (
    add_bending,
    add_membrane,
    add_tensions,
    couples_of,
    tensions_of,
)
from modalshell.models.coarse.profile_numbering import Numbering
from modalshell.shell import Shell
from modalshell.shell.kernels.split_folds import (
    add_edge_forces,
    add_fold_curvatures,
    add_fold_forces,
    fold_angles,
    fold_rates,
    half_square_rates,
    half_squares,
)
from modalshell.statics.mixed_newton import operation_of, write

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True} | UNCOUNTED


class Bending(NamedTuple):
    """Pairs of triangles; see :class:`modalshell.shell.split_folds.SplitFolds`, and where their blocks go."""

    stencils: Index
    folds: Index
    places: Index
    shares: Array
    share_index: Index
    moments: Array
    slots: Index
    share_slots: Index
    share_steps: Index
    factor: ColumnFactor


class Blocks(NamedTuple):
    """Blocks of the membrane's Hessian: factors times the vectors of edges ``rows`` and ``columns``."""

    slots: Index
    strides: Index
    starts: Index
    rows: Index
    columns: Index
    factors: Array


class Membrane(NamedTuple):
    """Edges, half their squared lengths at rest, the matrix of these by rows, and where blocks go."""

    edges: Index
    half_squares: Array
    starts: Index
    columns: Index
    values: Array
    slots: Index
    blocks: Blocks


class Folds(NamedTuple):
    """The energy: ``hinges`` of ``angles`` at rest, on vertices and then ``ghosts``; ``shares`` is G in the profile."""

    ghosts: Array
    hinges: Index
    angles: Array
    slots: Index
    bending: Bending
    membrane: Membrane
    vertices: Index
    shares: Array

    def room(self) -> FoldRoom:
        """Room for one step."""
        hinges, edges = len(self.hinges), len(self.membrane.edges)
        known = np.vstack([np.full((self.vertices.size, 3), np.nan), self.ghosts])  # no measures are known yet
        moved, forces = np.zeros((2, *known.shape))
        slopes = np.empty((hinges, 9))
        angles, rates, couples, own_couples = np.empty((4, hinges))
        stretches, square_rates, tensions, own_tensions = np.empty((4, edges))
        right, shares = np.zeros((2, 1, self.bending.factor.pivots.size))
        return FoldRoom(
            known, moved, forces, slopes, angles, rates, couples, own_couples, stretches, square_rates, tensions,
            own_tensions, np.empty((edges, 3)), right, shares,
        )  # fmt: skip

    @property
    def evaluated(self) -> int:
        """Elements that an evaluation takes: pairs of triangles, hinges and edges."""
        return len(self.bending.stencils) + len(self.hinges) + len(self.membrane.edges)

    def damped(self, shell: Shell) -> tuple[Folds, float]:
        """The energy of a shell of the same folds, of other measures at rest, over its factor; and the factor."""
        forms = shell.elastic_energy.constant_forms()  # type: ignore[attr-defined]
        membrane = self.membrane._replace(half_squares=forms.half_squares)
        return self._replace(angles=forms.angles, membrane=membrane), forms.factor


class FoldRoom(NamedTuple):
    """Arrays that a step writes to: of points, of hinges, of edges, of shares.

    ``points`` are where ``slopes``, ``angles`` and ``stretches`` are, ``couples`` and ``tensions`` the predicted
    stresses.
    """

    points: Array
    moved: Array
    forces: Array
    slopes: Array
    angles: Array
    rates: Array
    couples: Array
    own_couples: Array
    stretches: Array
    square_rates: Array
    tensions: Array
    own_tensions: Array
    vectors: Array
    right: Array
    shares: Array

    def forget(self) -> None:
        """Forget the measures: those of another energy are others."""
        self.points[0] = np.nan


# ---- tables


def folds_of(shell: Shell, numbering: Numbering) -> Folds:
    """The energy of a shell of shell theory without further energies or planes of symmetry."""
    forms = shell.elastic_energy.constant_forms()  # type: ignore[attr-defined]
    profile, count = numbering.profile, len(shell.mass)
    ghosts = np.array(forms.points[count:])
    place = np.concatenate([numbering.place, np.full(len(ghosts) + 1, -1)])  # the last, of vertex -1, is no vertex
    of, hinged = place[forms.folds.stencils], place[forms.hinges]
    ends = place[forms.edges]
    folds = forms.folds
    # Writeable copies: kernels are compiled for one kind of argument alone.
    bending = Bending(
        np.array(folds.stencils, dtype=np.int64),
        np.array(folds.folds, dtype=np.int64),
        np.array(folds.places, dtype=np.int64),
        np.array(folds.shares),
        np.array(folds.share_index, dtype=np.int64),
        np.array(folds.moments),
        block_places(profile, of[:, :, None], of[:, None, :]),
        *_share_places(numbering, folds.share_index, of),
        _share_factor(forms.shares.factor),
    )
    tension = sps.csr_array(forms.tension)
    membrane = Membrane(
        read_only(np.array(forms.edges, dtype=np.int64)),
        np.array(forms.half_squares),
        tension.indptr.astype(np.int64),
        tension.indices.astype(np.int64),
        np.array(tension.data),
        block_places(profile, ends[:, :, None], ends[:, None, :]),
        _membrane_blocks(profile, tension, ends),
    )
    # As a shell's own energy has them, or its kernel would be compiled for another kind of arguments.
    slots: Any = block_places(profile, hinged[:, :, None], hinged[:, None, :]).astype(np.int32)
    hinges, angles = np.array(forms.hinges, dtype=np.int64), np.array(forms.angles)
    shares = _share_stiffness(numbering, forms.shares.stiffness)
    return Folds(ghosts, hinges, angles, slots, bending, membrane, np.arange(count), shares)


def _share_factor(factor: ColumnFactor | None) -> ColumnFactor:
    """The factor in arrays of its own, of the types that a shell's own has; empty without shares."""
    starts, rows, values, pivots, order = factor or ([0], [], [], [], [])
    integers = (np.array(part, dtype=np.int32) for part in (starts, rows, order))
    numbers = np.array(values, dtype=np.float64), np.array(pivots, dtype=np.float64)
    starts, rows, order = integers
    return ColumnFactor(starts, rows, *numbers, order)


def _share_places(numbering: Numbering, share_index: Index, of: Index) -> tuple[Index, Index]:
    """Where couplings (B, 5, 8) of shares to vertices of blocks ``of`` (B, 8) begin, and how far entries are apart."""
    profile = numbering.profile
    rows = np.append(numbering.shares, -1)[share_index][:, :, None]
    rows, blocks = np.broadcast_arrays(rows, of[:, None, :])
    slots, steps = np.full(rows.shape, -1), np.zeros(rows.shape, dtype=np.int64)
    there = (rows >= 0) & (blocks >= 0)
    before = there & (rows // 3 > blocks)  # vertices that are eliminated before the share
    slots[before], steps[before] = profile.places(rows[before], 3 * blocks[before]), 1
    after = there & ~before
    slots[after], steps[after] = profile.places(3 * blocks[after], rows[after]), profile.strides[blocks[after]]
    return slots, steps


def _share_stiffness(numbering: Numbering, stiffness: sps.csr_array) -> Array:
    """The profile with the shares' own stiffness, and ones for the unknowns that fill up their last three."""
    profile, entries = numbering.profile, sps.coo_array(stiffness)
    values = np.zeros(profile.starts[-1])
    own = np.ones(profile.size, dtype=bool)
    own[(3 * numbering.place[numbering.place >= 0][:, None] + np.arange(3)).ravel()] = False
    own[numbering.shares] = False
    padded = np.flatnonzero(own)
    values[profile.places(padded, padded)] = 1.0
    places = profile.places(numbering.shares[entries.row], numbering.shares[entries.col])
    values[places[places >= 0]] = entries.data[places >= 0]
    return values


def _membrane_blocks(profile: Profile, tension: sps.csr_array, ends: Index) -> Blocks:
    """Blocks of ``sum s_u s_v Q_pq d_p d_q^T`` over the ends u, v of edges p, q, of signs s; ends (E, 2) by block."""
    entries = sps.coo_array(tension)
    p, q = entries.row.astype(np.int64), entries.col.astype(np.int64)
    rows, columns = np.broadcast_arrays(ends[p][:, :, None], ends[q][:, None, :])
    factors = entries.data[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    slots = block_places(profile, rows, columns)
    kept = slots >= 0
    of = np.broadcast_to(np.arange(p.size)[:, None, None], slots.shape)[kept]
    places = slots[kept]
    order = np.argsort(places, kind="stable")
    of, places = of[order], places[order]
    starts = np.flatnonzero(np.diff(places, prepend=-1))  # no place is negative
    strides = profile.strides[rows[kept][order[starts]]]
    return Blocks(places[starts], strides, np.append(starts, order.size), p[of], q[of], factors[kept][order])


# ---- operations


@njit(**_options)
def _measure(elastic, room, x):  # type: ignore[no-untyped-def]
    """Write the measures at ``x`` to ``room``, if they are not there."""
    points, known = room.points, True
    for v in range(x.shape[0]):
        for axis in range(3):
            known = known and points[v, axis] == x[v, axis]
    if not known:
        write(x, points)
        fold_angles(points, elastic.hinges, elastic.angles, room.angles, room.slopes)
        half_squares(points, elastic.membrane.edges, elastic.membrane.half_squares, room.stretches)


@njit(**_options)
def _forces(elastic, room, points, slopes, angles, stretches):  # type: ignore[no-untyped-def]
    """Write the forces of changes of measures to ``room``; twice their energy."""
    couples, tensions, forces = room.own_couples, room.own_tensions, room.forces
    couples_of(angles, elastic.bending, room.right, room.shares, couples)
    tensions_of(stretches, elastic.membrane, tensions)
    forces[:] = 0.0
    add_fold_forces(elastic.hinges, slopes, couples, forces)
    add_edge_forces(points, elastic.membrane.edges, tensions, forces)
    work = 0.0
    for hinge in range(angles.size):
        work += angles[hinge] * couples[hinge]
    for edge in range(stretches.size):
        work += stretches[edge] * tensions[edge]
    return work


@operation_of(Folds, elasticity.energy, **_options)
def _energy(elastic, room, x):  # type: ignore[no-untyped-def]
    """Elastic energy; its gradient goes to ``room``."""
    own = room.elastic
    _measure(elastic, own, x)
    work = _forces(elastic, own, own.points, own.slopes, own.angles, own.stretches)
    for v in range(x.shape[0]):
        for axis in range(3):
            room.gradient[v, axis] = own.forces[v, axis]
    return 0.5 * work


@operation_of(Folds, elasticity.assemble, **_options)
def _assemble(elastic, body, room, x):  # type: ignore[no-untyped-def]
    """Write the elastic gradient and Hessian at ``x``, its geometric part with the stresses in ``room``."""
    own, values, strides = room.elastic, room.values, body.strides
    elasticity.energy(elastic, room, x)
    write(elastic.shares, values)
    add_bending(own.slopes, elastic.bending, strides, values)
    add_membrane(own.points, elastic.membrane, own.vectors, values)
    add_fold_curvatures(own.points, elastic.hinges, own.couples, elastic.slots, strides, values)
    add_tensions(own.tensions, elastic.membrane, strides, values)


@operation_of(Folds, elasticity.soften, **_options)
def _soften(elastic, body, room, x):  # type: ignore[no-untyped-def]
    """Write the geometric part alone."""
    own, values, strides = room.elastic, room.values, body.strides
    _measure(elastic, own, x)
    values[:] = 0.0
    add_fold_curvatures(own.points, elastic.hinges, own.couples, elastic.slots, strides, values)
    add_tensions(own.tensions, elastic.membrane, strides, values)


@operation_of(Folds, elasticity.harden, **_options)
def _harden(elastic, body, room, x):  # type: ignore[no-untyped-def]
    """Write the gradient and the first part of the Hessian at ``x``."""
    own, values, strides = room.elastic, room.second, body.strides
    elasticity.energy(elastic, room, x)
    write(elastic.shares, values)
    add_bending(own.slopes, elastic.bending, strides, values)
    add_membrane(own.points, elastic.membrane, own.vectors, values)


@njit(**_options)
def _rates(elastic, room, x, step):  # type: ignore[no-untyped-def]
    """Write how measures at ``x`` change along a ``step`` (n, 3)."""
    _measure(elastic, room, x)
    write(step, room.moved)
    fold_rates(room.moved, elastic.hinges, room.slopes, room.rates)
    half_square_rates(room.points, room.moved, elastic.membrane.edges, room.square_rates)


@operation_of(Folds, elasticity.resist, **_options)
def _resist(elastic, room, x):  # type: ignore[no-untyped-def]
    """Write forces against ``room.step``."""
    own = room.elastic
    _rates(elastic, own, x, room.step)
    _forces(elastic, own, own.points, own.slopes, own.rates, own.square_rates)
    for v in range(x.shape[0]):
        for axis in range(3):
            room.gradient[v, axis] = -own.forces[v, axis]


@operation_of(Folds, elasticity.predict, **_options)
def _predict(elastic, room, x):  # type: ignore[no-untyped-def]
    """Write the stresses after ``room.step``, by the measures linearised at ``x``."""
    own = room.elastic
    _rates(elastic, own, x, room.step)
    for hinge in range(own.rates.size):
        own.rates[hinge] += own.angles[hinge]
    for edge in range(own.square_rates.size):
        own.square_rates[edge] += own.stretches[edge]
    couples_of(own.rates, elastic.bending, own.right, own.shares, own.couples)
    tensions_of(own.square_rates, elastic.membrane, own.tensions)
