"""Element groups over generated kernels (stretch, shear, flexure, further ones), and the sum of their energies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from types import ModuleType
from typing import Any, ClassVar, final

import numpy as np
import scipy.sparse as sps

from modalshell.core.cost import count_elements
from modalshell.core.errors import OptionError, SupportError
from modalshell.core.registry import Registry
from modalshell.core.thread_safety import read_only, read_only_view, writeable
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.bending import clamp_line_hinges, hinge_weights
from modalshell.shell.elastic_energy import GAUSS_NEWTON, ElasticEnergy, Part
from modalshell.shell.extended import Extended, add_forces, measure_changes
from modalshell.shell.kernels.generated import flexure, shear, stretch
from modalshell.shell.kernels.split_folds import fold_angles
from modalshell.shell.material import Material
from modalshell.shell.mirrored_hinges import MirroredFlexure
from modalshell.shell.pattern import SparsePattern, build_pattern
from modalshell.shell.slopes import HeldSlopes
from modalshell.supports import Unknowns


@dataclass(frozen=True, eq=False)
class ElementSet:
    """All elements of one energy, ``sum_e weight_e (g_e - rest_e)^2``."""

    name: str
    """Name of the energy."""
    kernel: ModuleType | MirroredFlexure
    """Generated kernel of the energy, or what takes its place."""
    stencils: Index
    """Vertices of each element, in the kernel's order; shape (elements, vertices)."""
    rest: Array
    """Measures at rest: areas [m^2], lengths [m] or fold angles [rad]. Shape (elements,)."""
    weight: Array
    """Stiffness over rest size; shape (elements,)."""
    viscosity: Array | None = None
    """Weight of the dissipation ``sum_e viscosity_e (dg_e/dt)^2`` of parallel dashpots; none by default. Shape
    (elements,)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "stencils", read_only_view(self.stencils))  # as those of meshes, also in copies

    @classmethod
    def at_rest(
        cls, name: str, kernel: ModuleType | MirroredFlexure, mesh: TriangleMesh, stencils: Index, weight: Array
    ) -> ElementSet:
        """Elements of ``weight`` on ``stencils`` of a mesh, without stress where the mesh is at rest."""
        stencils = np.ascontiguousarray(stencils, dtype=np.int64)
        rest = np.empty(stencils.shape[0])
        kernel.measures(np.asarray(mesh.vertices), stencils, rest)
        return cls(name, kernel, stencils, rest, np.ascontiguousarray(weight))

    def __getstate__(self) -> dict[str, Any]:  # a module cannot be pickled, its name can
        kernel = self.kernel
        return self.__dict__ | {"kernel": kernel.__name__ if isinstance(kernel, ModuleType) else kernel}

    def __setstate__(self, state: dict[str, Any]) -> None:
        kernel = state["kernel"]
        self.__dict__.update(state, kernel=import_module(kernel) if isinstance(kernel, str) else kernel)
        read_only(self.stencils)  # and no view of them, for compiled steps of this shell have the same array

    def resistance(self, factor: float) -> Array:
        """Weight of all damping that follows the elements' rates: ``factor`` [s] times the stiffness, and dashpots."""
        return factor * self.weight if self.viscosity is None else factor * self.weight + self.viscosity


class Energy(ABC):
    """An energy in addition to those of a shell's material.

    A subclass is a frozen dataclass whose fields are numbers, texts, or tuples of them:
    ``class Fibres(Energy, key="fibres")``. By its key scenes know it, as the table ``[energies.fibres]`` with its
    fields as keys, and saved bases.
    """

    key: ClassVar[str]

    def __init_subclass__(cls, *, key: str) -> None:
        cls.key = key
        ENERGIES[key] = cls

    @abstractmethod
    def elements(self, mesh: TriangleMesh) -> ElementSet:
        """The elements on a mesh; :meth:`ElementSet.at_rest` takes their rest state from it."""


ENERGIES: Registry[type[Energy]] = Registry("energy")
"""Every further energy by its key."""


def element_sets(mesh: TriangleMesh, material: Material, clamped: Mask, slopes: HeldSlopes) -> list[ElementSet]:
    """Elements of a material's energies: stretch over triangles, shear over edges, flexure over hinges.

    Of edges in planes of symmetry half belongs to the mesh, and so does half of the hinge over such an edge.
    Stiffnesses that are given edge by edge stay as they are.
    """
    stretch_stiffness, shear_stiffness, flexure_stiffness = material.per_element(mesh)
    if material.correct_clamp:
        flexure_stiffness = flexure_stiffness * np.where(clamp_line_hinges(mesh, clamped), 2.0, 1.0)
    if slopes.mirrored.size and np.ndim(material.shear) == 0:
        shear_stiffness = shear_stiffness.copy()
        shear_stiffness[slopes.mirrored] *= 0.5
    return [
        ElementSet.at_rest("stretch", stretch, mesh, mesh.faces, stretch_stiffness * (1.0 / mesh.face_areas)),
        ElementSet.at_rest("shear", shear, mesh, mesh.edges, shear_stiffness * (1.0 / mesh.edge_lengths)),
        ElementSet.at_rest("flexure", flexure, mesh, mesh.hinges, flexure_stiffness * hinge_weights(mesh)),
        *_mirrored_sets(mesh, material, slopes),
    ]


def _mirrored_sets(mesh: TriangleMesh, material: Material, slopes: HeldSlopes) -> list[ElementSet]:
    """Halves of the hinges over edges in planes of symmetry, one set for each normal."""
    if slopes.mirrored.size and np.ndim(material.flexure):
        raise SupportError(
            f"a plane of symmetry needs one flexure for all hinges, as those across it are not in the mesh (got "
            f"{np.size(material.flexure)} values)"
        )
    if (mesh.edge_faces[slopes.mirrored, 1] >= 0).any():
        raise SupportError(
            "hinges of ms.Material know no junction in a plane of symmetry: take ms.Isotropic, or a mesh of the whole "
            "surface"
        )
    sets = []
    for reflection in np.unique(slopes.reflections(), axis=0):
        edges = slopes.mirrored[(slopes.reflections() == reflection).all(axis=(1, 2))]
        faces, ends = mesh.edge_faces[edges, 0], mesh.edges[edges]
        stencils = np.column_stack([ends, mesh.faces[faces].sum(axis=1) - ends.sum(axis=1)])
        weight = 0.5 * float(material.flexure) * 1.5 * mesh.edge_lengths[edges] ** 2 / mesh.face_areas[faces]
        sets.append(ElementSet.at_rest("mirrored flexure", MirroredFlexure(reflection), mesh, stencils, weight))
    return sets


@final
class ElementSum(ElasticEnergy):
    """Sum of element sets on n vertices, such as the stretch, shear and flexure of a discrete shell."""

    def __init__(self, elements: list[ElementSet], vertex_count: int) -> None:
        self.elements = elements
        self._vertex_count = vertex_count

    @property
    def has_dashpots(self) -> bool:
        """Whether elements are damped by dashpots of their own."""
        return any(e.viscosity is not None for e in self.elements)

    def pattern(self, unknowns: Unknowns) -> tuple[SparsePattern, list[Index]]:
        """Pattern of the Hessian, and the slots of the elements in it."""
        return build_pattern(self._vertex_count, [e.stencils for e in self.elements], unknowns)

    def held_slopes(self) -> Index:
        """Vertices (k, 2) of the edges in planes of symmetry."""
        mirrored = [e.stencils[:, :2] for e in self.elements if isinstance(e.kernel, MirroredFlexure)]
        return np.concatenate([np.empty((0, 2), dtype=np.int64), *mirrored])

    def _counted(self) -> list[ElementSet]:
        """The sets, about to be evaluated."""
        count_elements(sum(e.rest.size for e in self.elements))
        return self.elements

    def energy(self, x: Array) -> float:
        """Energy [J]."""
        x = read_only_view(x)
        return float(sum(e.kernel.energy(x, e.stencils, e.rest, e.weight) for e in self._counted()))

    def face_energies(self, mesh: TriangleMesh, x: Array) -> Array:
        """Energy of every triangle (T,) [J]: an element's goes to the triangles that share most of its vertices."""
        vertex_count, face_count = len(mesh.vertices), len(mesh.faces)
        corners = np.asarray(mesh.faces).ravel(), np.repeat(np.arange(face_count), 3)
        incidence = sps.csr_array((np.ones(3 * face_count), corners), shape=(vertex_count, face_count))
        energies = np.zeros(face_count)
        for e, stress in zip(self.elements, self.linear_stresses(x, np.zeros_like(x)), strict=True):
            count, size = e.stencils.shape
            entries = np.ones(count * size), (np.repeat(np.arange(count), size), e.stencils.ravel())
            shared = sps.csr_array(sps.csr_array(entries, shape=(count, vertex_count)) @ incidence)
            most = np.repeat(shared.max(axis=1).toarray().ravel(), np.diff(shared.indptr))
            shared.data = (shared.data == most).astype(np.float64)
            own = np.divide(stress**2, 4.0 * e.weight, out=np.zeros(count), where=e.weight != 0.0)
            energies += np.asarray(shared.T @ (own / np.maximum(shared.sum(axis=1), 1.0)))
        return energies

    def energy_gradient(self, x: Array) -> tuple[float, Array]:
        """Energy [J] and gradient (n, 3) [N]."""
        x, gradient = read_only_view(x), np.zeros_like(x)
        total = sum(e.kernel.add_gradient(x, e.stencils, e.rest, e.weight, gradient) for e in self._counted())
        return float(total), gradient

    def support_gradient(self, x: Array) -> Array:
        """Gradient (n, 3) [N] with what planes of symmetry resist at both ends of their edges."""
        gradient = self.energy_gradient(x)[1]
        for e in self.elements:
            if isinstance(e.kernel, MirroredFlexure):
                e.kernel.spread(x, e.stencils, e.rest, e.weight, gradient)
        return gradient

    def energy_gradient_hessian(
        self, slots: list[Index], pattern: SparsePattern, x: Array, geometric: int, stresses: list[Array] | None
    ) -> tuple[float, Array, Array]:
        """Energy, gradient and Hessian values."""
        x, gradient = read_only_view(x), np.zeros_like(x)
        data, none, total = np.zeros(pattern.size), np.empty(0), 0.0
        for index, e in enumerate(self._counted()):
            stress = none if stresses is None else stresses[index]
            place = (slots[index], pattern.strides, data, gradient)
            total += e.kernel.add_stiffness(x, e.stencils, e.rest, e.weight, stress, geometric, *place)
        return float(total), gradient, data

    def pulled_by_rest_angles(self, x: Array, weights: Array) -> Array:
        """Derivative (H,) of ``weights . gradient`` at ``x`` by the rest angles of the hinges, the third set."""
        bending = ElementSum([self._hinges()], self._vertex_count)
        ahead, here = (bending.linear_stresses(x, step)[0] for step in (weights, np.zeros_like(x)))
        return here - ahead

    def _hinges(self) -> ElementSet:
        """The set of the mesh's hinges, the third; OptionError for springs."""
        hinges = self.elements[2:3]
        if not hinges or hinges[0].name != "flexure":
            raise OptionError("springs have no rest angles: take a model of the shell's own energies, such as DS")
        return hinges[0]

    def with_rest_angles(self, angles: Array) -> ElementSum:
        """The same energy with ``angles`` (H,) [rad] added to the rest angles of the mesh's hinges."""
        hinges = self._hinges()
        turned = replace(hinges, rest=hinges.rest + angles)
        return ElementSum([*self.elements[:2], turned, *self.elements[3:]], self._vertex_count)

    def _folded(self, x: Array, hinges: Index) -> tuple[ElementSet, Array, Array]:
        """Some of the mesh's hinges, with the changes of their angles (C,) at x and the slopes (C, 9) of these."""
        e = self._hinges()
        own = replace(
            e, stencils=np.ascontiguousarray(e.stencils[hinges]), rest=e.rest[hinges], weight=e.weight[hinges]
        )
        change, slopes = np.empty(own.rest.size), np.empty((own.rest.size, 9))
        # As the energy of shell theory has them: the kernel is compiled once.
        fold_angles(writeable(x), writeable(own.stencils), own.rest, change, slopes)
        return own, change, slopes

    def fold_couples(self, x: Array, hinges: Index) -> Array:
        """Derivatives (C,) [N m] of the energy at ``x`` by the fold angles of some hinges of the mesh."""
        own, change, _ = self._folded(x, hinges)
        return np.asarray(2.0 * own.weight * change)

    def fold_stiffness(self, hinges: Index) -> Array:
        """Derivatives (C, C) [N m/rad] of these couples by those angles."""
        return np.diag(2.0 * self._hinges().weight[hinges])

    def rest_angle_pulls(self, x: Array, hinges: Index) -> Array:
        """Derivatives (C, n, 3) [N/rad] of the gradient at ``x`` by the rest angles of some hinges of the mesh."""
        own, _, slopes = self._folded(x, hinges)
        pulls = np.zeros((own.rest.size, *x.shape))
        for pull, stencil, slope, weight in zip(pulls, own.stencils, slopes, own.weight, strict=True):
            pull[stencil[1:]] = -2.0 * weight * slope.reshape(3, 3)
            pull[stencil[0]] = -pull[stencil[1:]].sum(axis=0)
        return pulls

    def extended_gradient(self, rest: Array, displacement: Extended) -> Extended:
        """Gradient (n, 3) [N] in extended precision."""
        total = np.zeros(displacement.shape, dtype=np.longdouble)
        for e in self.elements:
            change, slope = measure_changes(e.kernel, e.stencils, rest, displacement)
            stored = np.empty(len(e.stencils))
            e.kernel.measures(rest, e.stencils, stored)
            add_forces(e.stencils, 2.0 * e.weight * (change + (stored - e.rest)), slope, total)
        return total

    def part(self, chosen: Sequence[Index], factors: Sequence[Array], internal: Array | None = None) -> Part:  # noqa: ARG002 (it has none)
        """Chosen elements of each set times factors."""
        stencils = [e.stencils[picked].ravel() for e, picked in zip(self.elements, chosen, strict=True)]
        vertices = np.unique(np.concatenate(stencils))
        return Part(self.renumbered(chosen, factors, vertices), vertices)

    def renumbered(self, chosen: Sequence[Index], factors: Sequence[Array], vertices: Index) -> ElementSum:
        """Chosen elements of each set times factors, on a numbering of the sorted ``vertices``."""
        elements = [
            replace(
                e,
                stencils=np.ascontiguousarray(np.searchsorted(vertices, e.stencils[picked])),
                rest=e.rest[picked],
                weight=e.weight[picked] * factor,
                viscosity=None if e.viscosity is None else e.viscosity[picked] * factor,
            )
            for e, picked, factor in zip(self.elements, chosen, factors, strict=True)
        ]
        return ElementSum(elements, vertices.size)

    def linear_stresses(self, x: Array, step: Array) -> list[Array]:
        """Stresses after ``step`` by the linearised measures."""
        stresses = []
        x, step = read_only_view(x), read_only_view(step)
        for e in self._counted():
            stress = np.empty(e.rest.size)
            e.kernel.linear_stress(x, step, e.stencils, e.rest, e.weight, stress)
            stresses.append(stress)
        return stresses

    def linear_energy(self, x: Array, step: Array) -> float:
        """Energy [J] of the measures' rates along ``step``."""
        # A sum of squares keeps the digits that step . K step loses where stiffnesses are many decades apart.
        zero, stresses = (self.linear_stresses(x, moved) for moved in (np.zeros_like(x), step))
        return sum(
            float(np.sum((stress - offset)[e.weight != 0] ** 2 / (4.0 * e.weight[e.weight != 0])))
            for stress, offset, e in zip(stresses, zero, self.elements, strict=True)
        )

    def changes(self, x: Array) -> list[Array]:
        """Changes of the measures of every set at ``x`` from those at rest."""
        x, none = read_only_view(x), read_only_view(np.zeros_like(x))
        found = [np.empty(e.rest.size) for e in self.elements]
        for e, change in zip(self.elements, found, strict=True):
            e.kernel.linear_stress(x, none, e.stencils, e.rest, np.full(e.rest.size, 0.5), change)
        return found

    @property
    def periods(self) -> list[Array | float | None]:
        """Period of the measures of every set: a turn of folds."""
        return [2.0 * np.pi if e.kernel.PERIODIC else None for e in self.elements]

    def damped(self, begun: list[Array], factor: float, dt: float) -> ElementSum:
        """Sum of it and of what damping takes in a step of ``dt`` [s] in which measures change from ``begun``."""
        elements = []
        for e, change in zip(self.elements, begun, strict=True):
            lost = e.resistance(factor) / dt
            weight = e.weight + lost
            share = np.divide(lost, weight, out=np.zeros_like(lost), where=weight != 0.0)
            elements.append(replace(e, rest=e.rest + share * change, weight=weight, viscosity=None))
        return ElementSum(elements, self._vertex_count)

    def damping_force(self, x: Array, velocity: Array, factor: float) -> Array:
        """Force (n, 3) [N] of stiffness-proportional damping."""
        force = np.zeros_like(x)
        x, velocity = read_only_view(x), read_only_view(velocity)
        for e in self.elements:
            e.kernel.add_damping(x, velocity, e.stencils, e.resistance(factor), force)
        return force

    def damping_matrix(self, slots: list[Index], pattern: SparsePattern, x: Array, factor: float) -> Array:
        """Values of its matrix [N s/m] on the pattern."""
        data = np.zeros(pattern.size)
        unused, none = np.zeros_like(x), np.empty(0)
        x = read_only_view(x)
        for place, e in zip(slots, self.elements, strict=True):
            where = (place, pattern.strides, data, unused)
            e.kernel.add_stiffness(x, e.stencils, e.rest, e.resistance(factor), none, GAUSS_NEWTON, *where)
        return data
