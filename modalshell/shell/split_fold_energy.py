"""Split-fold energy: shell theory on fold angles, with a membrane smoothed over edges."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, cast, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.cost import count_elements
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell import smoothed_membrane as membrane
from modalshell.shell.constant_forms import ConstantForms
from modalshell.shell.constant_slopes import ConstantSlopes
from modalshell.shell.elastic_energy import GAUSS_NEWTON, MIXED, PROJECTED, ElasticEnergy, Part
from modalshell.shell.elements import ElementSet, ElementSum
from modalshell.shell.extended import Extended, add_forces, measure_changes
from modalshell.shell.fold_shares import FoldShares, Measures
from modalshell.shell.kernels import split_folds as kernels
from modalshell.shell.kernels.generated import flexure
from modalshell.shell.mirrored_hinges import MirroredHinges, add_fold_curvatures
from modalshell.shell.pattern import InternalUnknowns, SparsePattern, block_slots, build_pattern
from modalshell.shell.rest_folds import RestFolds
from modalshell.shell.rest_shape import RestShape
from modalshell.shell.sheet import Sheet
from modalshell.shell.slopes import HeldSlopes
from modalshell.shell.split_folds import split_folds
from modalshell.shell.triangle_pairs import alike_edges, moments_of_triangles
from modalshell.supports import Unknowns


@final
class SplitFoldEnergy(RestFolds):
    """Bending by split folds and smoothed membrane of a sheet; see theory 4, eq. 11, and theory 6, eq. 6.

    Parameters
    ----------
    mesh : TriangleMesh
        Rest shape.
    material : Sheet
        The sheet.
    slopes : HeldSlopes
        Clamped edges, and edges in planes of symmetry.
    further : list of ElementSet
        Further energies, which are added.
    held : ndarray of bool, shape (n,)
        Vertices that cannot move: triangles of them do not bend, and are clamps of their neighbours, but single rows of
        them leave the slope free.
    halved : bool
        Whether folds are halved between their pairs; see :func:`split_folds`.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        material: Sheet,
        slopes: HeldSlopes,
        further: list[ElementSet],
        held: Mask,
        *,
        halved: bool = False,
    ) -> None:
        self._parts = mesh, material, slopes, further
        self._held_vertices = held
        self._origin, self._rest_shape = np.zeros(3), cast("RestShape | None", None)
        self._plastic, self._anchor = cast("Array | None", None), cast("TriangleMesh | None", None)
        self._further = ElementSum(further, len(mesh.vertices))
        stiffness, rigidity, poisson = material.elasticity(mesh)
        self._vertex_count = len(mesh.vertices)
        scale = float(stiffness.mean())
        in_plane, bending = material.directed(mesh) or (None, None)
        folds = split_folds(mesh, rigidity, poisson, slopes, held, scale, halved=halved, bending=bending)
        self._folds = folds
        self._shares = FoldShares(folds)
        self._edges = np.ascontiguousarray(mesh.edges)
        self._rest_angles, self._rest_squares = np.zeros(len(folds.hinges)), np.zeros(len(self._edges))
        angles = np.zeros(len(mesh.hinges))
        rest = np.array(mesh.vertices)
        kernels.fold_angles(rest, np.array(mesh.hinges), np.zeros_like(angles), angles, np.empty((angles.size, 9)))
        self._mirrors = MirroredHinges(folds.hinges, folds.reflections)
        state = self._measured(rest)
        self._rest_angles, self._rest_squares = state.folds, state.stretches
        self._rest_angles[self._mirrors.places] *= 2.0
        smooth = (np.abs(angles) <= membrane.SHARP) & alike_edges(mesh, stiffness, poisson, in_plane)[mesh.hinge_edges]
        mirrored = self._mirrors.edges(mesh)[np.abs(self._rest_angles[self._mirrors.places]) <= membrane.SHARP]
        mirrored = mirrored[mesh.edge_faces[mirrored, 1] < 0]
        self._strained = partial(membrane.strained_elements, mesh, held, smooth, mirrored)
        self._membrane = membrane.membrane_of(mesh, self._strained(), stiffness, poisson, in_plane)
        self._tension = membrane.membrane_matrix(self._membrane, len(self._edges))
        self._constants = ConstantSlopes(mesh, material, folds, self._strained, self._tension)

    def constant_forms(self) -> ConstantForms:
        """What the energy is made of."""
        own = self._folds.hinges, self._rest_angles, self._shares, self._folds, self._edges, self._rest_squares
        points = self._points(np.array(self._parts[0].vertices) - self._origin)
        return ConstantForms(points, *own, self._membrane, self._tension, self._factor)

    def _points(self, x: Array) -> Array:
        return self._mirrors.placed(np.vstack([x, self._folds.ghosts]))

    def _measured(self, x: Array) -> Measures:
        points, hinges = self._points(x), self._folds.hinges
        count_elements(len(hinges) + len(self._edges))
        angles, slopes, stretches = np.empty(len(hinges)), np.empty((len(hinges), 9)), np.empty(len(self._edges))
        kernels.fold_angles(points, hinges, self._rest_angles, angles, slopes)
        self._mirrors.halve(angles, slopes)
        kernels.half_squares(points, self._edges, self._rest_squares, stretches)
        return Measures(points, angles, slopes, stretches)

    def _gradient(self, state: Measures, couples: Array, tensions: Array) -> Array:
        return self._point_gradient(state, couples, tensions)[: self._vertex_count]

    def _point_gradient(self, state: Measures, couples: Array, tensions: Array) -> Array:
        gradient = np.zeros_like(state.points)
        kernels.add_fold_forces(self._folds.hinges, state.slopes, couples, gradient)
        kernels.add_edge_forces(state.points, self._edges, tensions, gradient)
        return gradient

    def gradient_by_constant(self, name: str, x: Array, step: Array | None) -> Array:
        """Derivative (n, 3) of the sheet's gradient by a constant, or of the Hessian's first part times a step."""
        state = self._measured(x)
        folds, stretches = (state.folds, state.stretches) if step is None else self._rates(state, step)
        return self._gradient(state, *self._constants.stresses(name, self._shares, folds, stretches))

    def support_gradient(self, x: Array) -> Array:
        """Gradient (n, 3) [N], half of each ghost's force at either end of its edge."""
        state, count = self._measured(x), self._vertex_count
        couples = self._shares.couples(state.folds)
        gradient = self._point_gradient(state, couples, self._tension @ state.stretches)
        self._mirrors.spread(state, couples, gradient)
        hinges = self._folds.hinges[self._folds.hinges[:, 3] >= count]
        np.add.at(gradient, hinges[:, :2], 0.5 * gradient[hinges[:, 3:]])
        return gradient[:count] + self._further.support_gradient(x)

    def _rates(self, state: Measures, step: Array) -> tuple[Array, Array]:
        """Rates of the fold angles and of half the squared lengths along ``step`` (n, 3)."""
        moved = np.vstack([step, np.zeros_like(self._folds.ghosts)])
        folds, stretches = np.empty_like(state.folds), np.empty_like(state.stretches)
        kernels.fold_rates(moved, self._folds.hinges, state.slopes, folds)
        kernels.half_square_rates(state.points, moved, self._edges, stretches)
        return folds, stretches

    def pattern(self, unknowns: Unknowns) -> tuple[SparsePattern, list[Index]]:
        """Pattern of the Hessian, and the slots of the elements in it."""
        folds = self._folds
        stencils = [folds.stencils, folds.hinges, self._edges, *(e.stencils for e in self._membrane)]
        stencils += [e.stencils for e in self._further.elements]
        coupled = folds.coupled_vertices(self._vertex_count)
        internal = InternalUnknowns(coupled, self._shares.stiffness, self._shares.solve)
        pattern, slots = build_pattern(self._vertex_count, stencils, unknowns, internal)
        place = 0, pattern.block_size, pattern.size
        return pattern, [*slots, block_slots(folds.share_index, folds.stencils, coupled, *place)]

    @property
    def has_dashpots(self) -> bool:
        """Whether further energies are damped by dashpots of their own."""
        return self._further.has_dashpots

    def held_slopes(self) -> Index:
        """Vertices (k, 2) of the edges that ghosts clamp or mirror."""
        return self._folds.hinges[self._folds.hinges[:, 3] >= self._vertex_count, :2]

    def bending(self, x: Array) -> tuple[Array, Array]:
        """Bending moments conjugate to each triangle's folds, and energies [J]: (T, 3) [N m] and (T,).

        Zero in triangles whose vertices are all held; the energy of a pair is shared by area.
        """
        folds, delta = self._folds, self._measured(x).folds
        gamma = folds.parts_of_folds(delta, -self._shares.solve(self._shares.coupling @ delta))
        moments = np.einsum("tkl,tl->tk", folds.moments, gamma)
        mesh = self._parts[0]
        areas = np.append(mesh.face_areas, 0.0)
        pairs = 0.5 * np.sum(gamma * moments, axis=1) / areas[folds.faces].sum(axis=1)
        energies = np.zeros_like(areas)
        energies[folds.faces] = pairs[:, None] * areas[folds.faces]
        return moments_of_triangles(mesh, folds.faces, folds.corners, moments), energies[:-1]

    def halved(self) -> SplitFoldEnergy:
        """The same energy, each fold halved between its pairs: shares are small, but more positions coupled."""
        return self._again(self._held_vertices, halved=True)

    def least_shares(self, x: Array) -> Array:
        """Fold shares (m,) at the minimum."""
        return -self._shares.solve(self._shares.coupling @ self._measured(x).folds)

    def share_rates(self, x: Array, steps: Array) -> Array:
        """Their rates (m, r) along ``steps`` (n, 3, r)."""
        return -self._shares.solve(self._shares.coupling @ self._all_rates(self._measured(x), steps)[0])

    def _all_rates(self, state: Measures, steps: Array) -> tuple[Array, Array]:
        rates = [self._rates(state, step) for step in np.moveaxis(steps, 2, 0)]
        return np.stack([folds for folds, _ in rates], axis=1), np.stack([squares for _, squares in rates], axis=1)

    @property
    def further_elements(self) -> list[ElementSet]:
        """The further sets."""
        return self._further.elements

    @property
    def element_stencils(self) -> list[Index]:
        """Vertices (or -1) of every element: pairs that bend, pairs and single triangles that stretch, further sets."""
        bending = np.where(self._folds.stencils < self._vertex_count, self._folds.stencils, -1)
        return [bending, *(e.stencils for e in self._membrane), *(e.stencils for e in self._further.elements)]

    @property
    def share_stiffness(self) -> sps.csr_array:
        """Second derivatives (m, m) of the energy by the fold shares."""
        return self._shares.stiffness

    def element_forces(self, x: Array, chosen: Sequence[Index], steps: Array, shares: Array) -> list[Array]:
        """Generalised forces (elements, r + s) of chosen elements along ``steps`` (n, 3, r) and ``shares`` (m, s).

        Of pairs that bend, and of pairs and single triangles that stretch, with all shares at the minimum.
        """
        state, folds = self._measured(x), self._folds
        fold_rates, square_rates = self._all_rates(state, steps)
        gamma = folds.parts_of_folds(state.folds, -self._shares.solve(self._shares.coupling @ state.folds))
        moments = np.einsum("tkl,tl->tk", folds.moments, gamma)[chosen[0]]
        none = np.zeros((1, steps.shape[2])), np.zeros((1, shares.shape[1]))
        along = np.vstack([fold_rates, none[0]])[folds.folds[chosen[0]]]
        fields = np.vstack([shares, none[1]])[folds.share_index[chosen[0]]]
        own = np.einsum("tk,tks->ts", moments * folds.shares[chosen[0]], fields)
        forces = [np.hstack([np.einsum("tk,tkr->tr", moments, along), own])]
        for e, picked in zip(self._membrane, chosen[1:], strict=True):
            edges = e.edges[picked]
            tensions = np.einsum("epq,eq->ep", e.matrices[picked], state.stretches[edges])
            stretching = np.einsum("ep,epr->er", tensions, square_rates[edges])
            forces.append(np.hstack([stretching, np.zeros((len(picked), shares.shape[1]))]))
        return forces

    def part(self, chosen: Sequence[Index], factors: Sequence[Array], internal: Array | None = None) -> Part:
        """Chosen pairs that bend, pairs and single triangles that stretch, and elements of further sets."""
        stencils = [stencil[picked].ravel() for stencil, picked in zip(self.element_stencils, chosen, strict=True)]
        vertices = np.unique(np.concatenate(stencils))
        vertices = vertices[vertices >= 0]
        other = copy.copy(self)
        other._vertex_count = vertices.size
        other._folds, hinges, shares = self._folds.part(chosen[0], factors[0], vertices, self._vertex_count)
        other._mirrors = MirroredHinges(other._folds.hinges, other._folds.reflections)
        other._shares = FoldShares(other._folds, None if internal is None else internal[shares])
        kinds = zip(self._membrane, chosen[1:3], factors[1:3], strict=True)
        own = [e.part(picked, factor, vertices) for e, picked, factor in kinds]
        edges = np.unique(np.concatenate([e.edges.ravel() for e in own]))
        other._membrane = [replace(e, edges=np.searchsorted(edges, e.edges)) for e in own]
        other._edges = np.ascontiguousarray(np.searchsorted(vertices, self._edges[edges]))
        other._tension = membrane.membrane_matrix(other._membrane, edges.size)
        other._rest_angles, other._rest_squares = self._rest_angles[hinges], self._rest_squares[edges]
        other._further = self._further.renumbered(chosen[3:], factors[3:], vertices)
        return Part(other, vertices)

    def face_energies(self, mesh: TriangleMesh, x: Array) -> Array:
        """Energy of every triangle (T,) [J]; that of membrane elements goes to triangles by their areas in them."""
        stretches = self._measured(x).stretches
        energies = self.bending(x)[1]
        for e in self._membrane:
            s = stretches[e.edges]
            shared = 0.5 * np.einsum("ep,epq,eq->e", s, e.matrices, s)
            np.add.at(energies, e.faces, (shared / e.areas.sum(axis=1))[:, None] * e.areas)
        return energies + self._further.face_energies(mesh, x)

    def energy(self, x: Array) -> float:
        """Energy [J]."""
        state = self._measured(x)
        own = state.energy(self._shares.couples(state.folds), self._tension @ state.stretches)
        return self._factor * own + self._further.energy(x)

    def energy_gradient(self, x: Array) -> tuple[float, Array]:
        """Energy [J] and gradient (n, 3) [N]."""
        return self._energy_gradient(x)[:2]

    def _energy_gradient(self, x: Array) -> tuple[float, Array, Measures, list[Array]]:
        """Energy and gradient, and the measures and stresses that they are of."""
        state = self._measured(x)
        couples, tensions = self._shares.couples(state.folds), self._tension @ state.stretches
        total, gradient = self._further.energy_gradient(x)
        total += self._factor * state.energy(couples, tensions)
        return total, self._factor * self._gradient(state, couples, tensions) + gradient, state, [couples, tensions]

    def energy_gradient_hessian(
        self, slots: list[Index], pattern: SparsePattern, x: Array, geometric: int, stresses: list[Array] | None
    ) -> tuple[float, Array, Array]:
        """Energy, gradient and Hessian values."""
        total, gradient, state, acting = self._energy_gradient(x)
        acting = acting if stresses is None or geometric != MIXED else stresses
        return total, gradient, self._hessian(slots, pattern, x, state, geometric, acting)

    def hessian(
        self, slots: list[Index], pattern: SparsePattern, x: Array, geometric: int, stresses: list[Array] | None
    ) -> Array:
        """Hessian values; with stresses given, those at ``x`` and their fold shares are not solved for."""
        if stresses is None or geometric != MIXED:
            return super().hessian(slots, pattern, x, geometric, stresses)
        return self._hessian(slots, pattern, x, self._measured(x), geometric, stresses)

    def _hessian(
        self, slots: list[Index], pattern: SparsePattern, x: Array, state: Measures, how: int, stresses: list[Array]
    ) -> Array:
        data, strides = self._material_part(slots, pattern, state), pattern.strides
        if how != GAUSS_NEWTON:
            (couples, tensions), projected = stresses[:2], how == PROJECTED
            self._mirrors.add_curvatures(state.points, couples, projected, slots[1], strides, data)
            own = state.points, self._folds.hinges, self._mirrors.without(couples), projected
            add_fold_curvatures(*own, slots[1], strides, data)
            kernels.add_edge_curvatures(self._edges, tensions, projected, slots[2], strides, data)
        if self._factor != 1.0:
            data *= self._factor
        if self._further.elements:
            data += self._further.energy_gradient_hessian(slots[5:-1], pattern, x, how, stresses[2:] or None)[2]
        return data

    def _material_part(self, slots: list[Index], pattern: SparsePattern, state: Measures) -> Array:
        """Entries of the first, positive semi-definite part of the Hessian."""
        folds, strides, data = self._folds, pattern.strides, np.zeros(pattern.size)
        tables = folds.stencils, folds.folds, folds.places, folds.shares, folds.moments
        kernels.add_bending(state.slopes, *tables, slots[0], slots[-1], strides, data)
        for e, place in zip(self._membrane, slots[3:5], strict=True):
            kernels.add_membrane(state.points, *e.as_pairs(place), strides, data)
        data[data.size - self._shares.stiffness.nnz :] = self._shares.stiffness.data
        return data

    def extended_gradient(self, rest: Array, displacement: Extended) -> Extended:
        """Gradient (n, 3) [N] in extended precision: of the measures, as the constant matrices do not cancel."""
        still = self._measured(rest)
        ghosts = np.zeros((len(self._folds.ghosts), 3), dtype=np.longdouble)
        moved: Extended = self._mirrors.placed(np.concatenate([displacement, ghosts]))
        change, slope = measure_changes(flexure, self._folds.hinges, still.points, moved)
        self._mirrors.halve(change, slope.T)
        total = np.zeros(moved.shape, dtype=np.longdouble)
        add_forces(self._folds.hinges, self._shares.couples(still.folds + change.astype(np.float64)), slope, total)
        first, second = self._edges.T
        edges, steps = still.points[second] - still.points[first].astype(np.longdouble), moved[second] - moved[first]
        stretches = np.sum((edges + 0.5 * steps) * steps, axis=1)
        forces = (self._tension @ (still.stretches + stretches.astype(np.float64)))[:, None] * (edges + steps)
        np.add.at(total, second, forces)
        np.add.at(total, first, -forces)
        return total[: len(rest)] + self._further.extended_gradient(rest, displacement)

    def shifted(self, origin: Array) -> SplitFoldEnergy:
        """The same energy with its ghosts moved as the positions are."""
        other = copy.copy(self.posed(lambda ghosts: ghosts - origin))
        other._origin = self._origin + origin
        return other

    def posed(self, place: Callable[[Array], Array]) -> SplitFoldEnergy:
        """The same energy with its ghosts carried along by the supports; itself if there are none."""
        if not len(self._folds.ghosts):
            return self
        other = copy.copy(self)
        other._folds = replace(self._folds, ghosts=place(self._folds.ghosts))
        return other

    def pull(self, x: Array, after: Any) -> Array:
        """Change (n, 3) [N] of the gradient as the ghosts move on to those of ``after``, without that of the slopes."""
        state, folds = self._measured(x), np.empty(len(self._folds.hinges))
        moved = np.vstack([np.zeros_like(x), after._folds.ghosts - self._folds.ghosts])
        kernels.fold_rates(moved, self._folds.hinges, state.slopes, folds)
        return self._gradient(state, self._shares.couples(folds), np.zeros_like(state.stretches))

    def holding(self, held: Mask) -> ElasticEnergy:
        """The same energy with the vertices ``held`` (n,) held, its clamped ones among them."""
        return self._again(held)

    def _again(self, held: Mask, halved: bool = False) -> SplitFoldEnergy:
        mesh, material, slopes, further = self._parts
        again: RestFolds = SplitFoldEnergy(mesh, material, slopes, further, held, halved=halved)
        again = again if self._anchor is None else again.anchored(self._anchor)
        again = again if self._rest_shape is None else again.resting(self._rest_shape)
        again = again if self._plastic is None else again.with_rest_angles(self._plastic)
        return cast("SplitFoldEnergy", again.shifted(self._origin))

    def linear_stresses(self, x: Array, step: Array) -> list[Array]:
        """Stresses after ``step`` by the linearised measures."""
        state = self._measured(x)
        folds, stretches = self._rates(state, step)
        own = [self._shares.couples(state.folds + folds), self._tension @ (state.stretches + stretches)]
        return own + self._further.linear_stresses(x, step)

    def linear_energy(self, x: Array, step: Array) -> float:
        """Energy [J] of the measures' rates along ``step``."""
        folds, stretches = self._rates(self._measured(x), step)
        own = 0.5 * float(folds @ self._shares.couples(folds) + stretches @ (self._tension @ stretches))
        return self._factor * own + self._further.linear_energy(x, step)

    def damping_force(self, x: Array, velocity: Array, factor: float) -> Array:
        """Force (n, 3) [N] of stiffness-proportional damping."""
        state = self._measured(x)
        folds, stretches = self._rates(state, velocity)
        own = self._gradient(state, self._shares.couples(folds), self._tension @ stretches)
        return self._further.damping_force(x, velocity, factor) - factor * own

    def damping_matrix(self, slots: list[Index], pattern: SparsePattern, x: Array, factor: float) -> Array:
        """Values of its matrix [N s/m] on the pattern."""
        own = factor * self._material_part(slots, pattern, self._measured(x))
        return own + self._further.damping_matrix(slots[5:-1], pattern, x, factor)
