"""Shell: mesh, material and supports, with energy, force, stiffness and mass."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sps
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, checked_switch, checked_vectors, shown
from modalshell.core.errors import OptionError, SupportError
from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Array, Index
from modalshell.loads import Load, Loading
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import held_vertices
from modalshell.shell.calibration_range import warn_of_two_way_bending
from modalshell.shell.creases import Crease, CreaseSet, CreaseState
from modalshell.shell.demands import demand_shell
from modalshell.shell.elastic_energy import EXACT, ElasticEnergy
from modalshell.shell.elements import ElementSet, ElementSum, Energy
from modalshell.shell.energies_of import checked_energies, energy_of, further_elements
from modalshell.shell.energy_access import EnergyAccess
from modalshell.shell.fields import BARE_SHEET, ShellFields, flat_triangles, refuse_collapse
from modalshell.shell.material import Material
from modalshell.shell.rest_folds import RestFolds
from modalshell.shell.rest_shape import Temperature, Tensor, mesh_at_rest, own_copy, rest_shape
from modalshell.shell.sheet import Sheet
from modalshell.shell.slopes import held_slopes
from modalshell.shell.split_fold_energy import SplitFoldEnergy
from modalshell.shell.vertex_masses import masses_of
from modalshell.supports import Clamp, Pin, Support, Unknowns, VertexUnknowns, supported_unknowns
from modalshell.supports.base import checked_supports, shared_reactions


class Shell(EnergyAccess):
    """A thin shell on a triangle mesh: a discrete shell [choi2007, section 3; grinspun2003], or one of shell theory.

    Parameters
    ----------
    mesh : TriangleMesh
        The rest shape; its fold angles, areas and lengths are the rest values of the energies. Where three triangles
        or more meet at an edge an :class:`Isotropic` shell has a rigid joint that is free to turn; a
        :class:`Material`'s has a hinge between the first of them and each of the others, so that a couple goes from
        one to the next through that first one alone.
    material : Material, or Isotropic, Orthotropic, Laminate or Fabric
        Stiffnesses of the discrete-shell energies; or a sheet, whose energy is that of split folds.
    clamped : str, array_like of bool, shape (n,), or of int, optional
        Vertices that are held, short for one :class:`Clamp`. To clamp an edge of a :class:`Material`'s shell hold two
        rows of vertices: with one row the triangles next to it can hinge freely about the clamped edge; the span then
        begins at the second row, and is shorter by the distance between them. An :class:`Isotropic` shell is clamped
        by one row: at every edge with both ends held.
    supports : sequence of Support, optional
        Further supports, such as :class:`Pin`, :class:`Roller` or :class:`Symmetry`.
    energies : sequence of Energy, optional
        Energies in addition to those of the material.
    loose_parts : bool
        Whether parts of a mesh may be left without support; :func:`solve_modes` refuses them otherwise.
    prestrain, rest_curvature : float, array_like of shape (T,), (3, 3) or (T, 3, 3), or callable, optional
        Green strain, and curvature [1/m], at which a sheet has no stress: a number for all directions, or a tensor in
        space, of which each triangle takes the part in its plane; or a function of the centroids (T, 3) that gives
        them. Curvature is positive where the normals spread. The mesh itself is then under stress, and is no
        equilibrium: modes are those about a state.
    temperature : Temperature, optional
        A change of temperature, which strains the sheet and, where it changes through the thickness, bends it.
    rest : TriangleMesh or array_like, shape (n, 3), optional
        Another mesh with the same triangles, or its vertices: the shape without stress, from which lengths, areas, fold
        angles and masses are taken. The mesh itself is then under stress; clamped edges keep its slope.
    creases : sequence of Crease, optional
        Edges that yield under a moment and keep a part of their fold; see :attr:`crease_state` and :meth:`creased`.

    Attributes
    ----------
    rest_positions : ndarray, shape (n, 3)
        Vertex positions at rest [m].
    mass : ndarray, shape (n,)
        Lumped vertex masses [kg]: a third of each triangle's mass to each corner; of an `Isotropic` shell corrected
        along free edges and sharp folds, see :mod:`modalshell.shell.vertex_masses`.
    supports : tuple of Support
        The supports, a :class:`Clamp` of ``clamped`` first.
    unknowns : Unknowns
        What they leave free, and the affine map from it to the vertices' positions.
    clamped : ndarray of bool, shape (n,)
        Vertices that cannot move.
    free : ndarray of int
        Vertices that can.
    rest_mesh : TriangleMesh
        The shape without stress: the mesh itself, unless ``rest`` is another one.
    creases : CreaseSet or None
        Hinges that yield, and when.
    crease_state : CreaseState or None
        What they have kept.

    Raises
    ------
    MaterialError
        If the material's arrays, or those of a rest shape, do not fit the mesh.
    SupportError
        If ``clamped`` has the wrong shape, selects no such vertex, or holds every vertex; or for ``supports`` that do
        not fit the mesh or one another.
    OptionError
        For a support that selects no vertex.
    """

    def __init__(
        self,
        mesh: TriangleMesh,
        material: Material | Sheet,
        clamped: ArrayLike | str | None = None,
        supports: Sequence[Support] = (),
        *,
        energies: Sequence[Energy] = (),
        loose_parts: bool = False,
        prestrain: Tensor | None = None,
        rest_curvature: Tensor | None = None,
        temperature: Temperature | None = None,
        rest: TriangleMesh | ArrayLike | None = None,
        creases: Sequence[Crease] = (),
    ) -> None:
        self.loose_parts = checked_switch("loose_parts", loose_parts)
        self.mesh = checked_kind("mesh", mesh, TriangleMesh)
        self.rest_mesh = mesh_at_rest(mesh, rest)
        self._clamped_on, self._settled = mesh, False
        if not isinstance(material, Material | Sheet):
            raise OptionError(f"material must be a Material, an Isotropic or another sheet (got {shown(material)})")
        self.material = material
        self.rest_positions: Array = np.asarray(mesh.vertices)
        count = len(mesh.vertices)
        demand_shell(count, split=isinstance(material, Sheet))
        clamp = held_vertices(clamped, count, mesh)
        self.supports = (*((Clamp(read_only(clamp)),) if clamp.any() else ()), *checked_supports(supports))
        unknowns = supported_unknowns(self.supports, mesh)
        self._slopes = held_slopes(self.supports, mesh)
        self.energies = checked_energies(energies)
        if isinstance(material, Material) and material.correct_clamp:  # it is calibrated, by from_physical
            warn_of_two_way_bending(mesh, unknowns.supported)
        self.mass = read_only(masses_of(self.rest_mesh, material, unknowns.held, self.supports))
        self._energy = energy_of(self.rest_mesh, material, self._slopes, self.energies, unknowns.held)
        if self.rest_mesh is not mesh:
            if self._slopes.mirrored.size:
                raise SupportError("rest does not go with planes of symmetry: take a mesh of the whole surface")
            self._energy = self._energy.anchored(mesh)
        self.rest_shape = rest_shape(self.rest_mesh, material, prestrain, rest_curvature, temperature)
        self._given = {
            "rest": self.rest_mesh,
            "prestrain": own_copy(prestrain),
            "rest_curvature": own_copy(rest_curvature),
            "temperature": temperature,
            "creases": tuple(creases) if isinstance(creases, list | tuple) else creases,
        }
        if self.rest_shape is not None:
            self._energy = self._energy.resting(self.rest_shape)
        self.creases = CreaseSet.of(creases, mesh, self.rest_mesh)
        self.crease_state = None if self.creases is None else CreaseState(np.zeros(self.creases.hinges.size))
        self._support(unknowns)

    def _support(self, unknowns: Unknowns) -> None:
        self.unknowns = unknowns
        self.clamped = unknowns.held
        self.free = read_only(np.flatnonzero(~self.clamped))
        self.pattern, self._slots = self._energy.pattern(unknowns)
        self._folds: RestFolds | None = None  # of discrete shells: what fields take the curvature from

    @property
    def free_unknowns(self) -> Index:
        """Unknowns of the free vertices in flattened (3n,) vectors; SupportError where vertices are held in part."""
        if isinstance(self.unknowns, VertexUnknowns):
            return self.unknowns.indices
        raise SupportError(
            "this takes only Clamp and Pin supports (got supports that hold single components, or tie vertices): "
            "use ms.Clamp or ms.Pin, or a model that takes the others, such as ms.DiscreteShell"
        )

    def require_clamps(self, name: str) -> None:
        """SupportError if a support is anything but a clamp, which ``name`` does not take."""
        for support in self.supports:
            if not support.clamps:
                raise SupportError(f"{name} takes clamped vertices only (got a support of kind {support.key!r})")

    @property
    def elements(self) -> list[ElementSet]:
        """Element sets of the discrete-shell energies, or of springs; OptionError for an :class:`Isotropic` shell."""
        if not isinstance(self._energy, ElementSum):
            raise OptionError(
                f"this needs a shell of the discrete-shell energies (got one of ms.{type(self.material).__name__}): "
                "take ms.Material.from_physical(...), in [material] calibrated = true, for simulate --calibrated"
            )
        return self._energy.elements

    def holding(self, vertices: ArrayLike) -> Shell:
        """The same shell, with the same energy of what can move, that holds ``vertices`` too (bool (n,) or indices)."""
        return self.also_supported([Pin(read_only(held_vertices(vertices, len(self.clamped))))])

    def also_supported(self, supports: Sequence[Support]) -> Shell:
        """The same shell, with the same energy of what can move, under further ``supports``; see its constructor."""
        further = copy.copy(self)
        further.supports = (*self.supports, *checked_supports(supports))
        unknowns = supported_unknowns(further.supports, self.mesh)
        further._energy = self._energy.holding(unknowns.held)
        further._support(unknowns)
        return further

    def with_elements(self, elements: list[ElementSet]) -> Shell:
        """The same, with elements in place of its material's, and of further energies that are named as they are."""
        if self._slopes.mirrored.size:
            raise SupportError("springs across hinges know no plane of symmetry: take a mesh of the whole surface")
        other = copy.copy(self)
        given = {each.name for each in elements}
        further = [each for each in further_elements(self.energies, self.rest_mesh) if each.name not in given]
        other._energy = ElementSum([*elements, *further], len(self.rest_positions))
        other._support(self.unknowns)
        return other

    def with_material(self, material: Material | Sheet) -> Shell:
        """A shell of another material, with the same mesh, supports and further energies; OptionError if settled."""
        own = {"energies": self.energies, "loose_parts": self.loose_parts, **self.options}
        return Shell(self.mesh, material, None, self.supports, **own)

    @property
    def options(self) -> dict[str, Any]:
        """What was given of ``rest``, ``prestrain``, ``rest_curvature``, ``temperature`` and ``creases``.

        OptionError for a :meth:`settled` shell: what was given belongs to another mesh.
        """
        if self._settled:
            raise OptionError("a settled shell cannot be built again: start from the shell that it was made of")
        return dict(self._given)

    @property
    def size(self) -> float:
        """Longest side of the box around the rest shape [m]."""
        return self.mesh.size

    def centred(self) -> tuple[Shell, Array]:
        """The same shell about the origin, and where its origin was (3,) [m]; itself where it is near the origin.

        Far away the rounding of coordinates would affect the energy. The shift is by whole multiples of a power of two,
        so that not a bit of the shape is lost.
        """
        grid = 4.0 * 2.0 ** np.ceil(np.log2(self.size))
        origin = grid * np.round(0.5 * (self.rest_positions.min(axis=0) + self.rest_positions.max(axis=0)) / grid)
        return (self.shifted(origin) if origin.any() else self), origin

    def shifted(self, origin: Array) -> Shell:
        """The same shell with ``origin`` (3,) [m] at the origin."""
        other = self._with_energy(self._energy.shifted(origin))
        other.rest_positions = read_only(self.rest_positions - origin)
        return other

    def posed(self, place: Callable[[Array], Array]) -> Shell:
        """The same shell with what clamps its edges where ``place`` maps it; itself if vertices alone are held."""
        energy = self._energy.posed(place)
        return self if energy is self._energy else self._with_energy(energy)

    def _with_energy(self, energy: ElasticEnergy) -> Shell:
        other = copy.copy(self)
        other._energy, other._folds = energy, None
        return other

    def __repr__(self) -> str:
        return f"Shell({len(self.rest_positions)} vertices, {len(self.mesh.faces)} triangles, {len(self.free)} free)"

    def energy(self, positions: ArrayLike) -> float:
        """Elastic energy [J] at ``positions`` (n, 3) [m]; LoadError where it is not finite."""
        x = self.checked_positions(positions)
        energy = self._energy.energy(x)
        refuse_collapse(self.mesh, "energy", energy, x)
        return energy

    def force(self, positions: ArrayLike) -> Array:
        """Elastic force (n, 3) [N], minus the energy's gradient, at ``positions`` (n, 3) [m].

        LoadError where it is not finite: a triangle that has collapsed to a line has no normal to bend about.
        """
        x = self.checked_positions(positions)
        gradient = self.energy_gradient(x)[1]
        refuse_collapse(self.mesh, "force", gradient, x)
        return -gradient

    def stiffness(self, positions: ArrayLike | None = None) -> sps.csr_array:
        """Hessian of the energy, sparse (3n, 3n) [N/m], at ``positions`` (n, 3) [m]; by default at rest.

        LoadError where it is not finite. That of an :class:`Isotropic` shell is the Schur complement without the fold
        shares: exact to rounding, but as its entries fall off slowly it is almost full, and made for checks on meshes
        of some thousand vertices; the solvers never form it.
        """
        x = self.rest_positions if positions is None else self.checked_positions(positions)
        data = self.hessian(x, EXACT)
        refuse_collapse(self.mesh, "stiffness", data, x)
        return self.pattern.condensed(data)

    def fields(self, positions: ArrayLike) -> ShellFields:
        """Strains, curvatures, energy density and stress resultants at ``positions`` (n, 3) [m].

        Curvatures are those of split folds at their least bending energy; of a :class:`Material`, whose hinges know no
        curvature tensor, with Poisson's ratio 0. Triangles whose vertices are all clamped have none. Stresses of modal
        and coarse models' positions can be far too large; those of DS and ``ms.error_bar(...).corrected`` are right.

        Returns
        -------
        ShellFields
            One value per triangle; ``membrane_force``, ``moment`` and ``von_mises`` are None of a :class:`Material`.

        Raises
        ------
        LoadError
            For positions of the wrong shape or not finite, or where a triangle has collapsed to a line.
        """
        x = self.checked_positions(positions)
        mesh, energy = self.rest_mesh, self._energy
        refuse_collapse(mesh, "curvature", np.where(flat_triangles(mesh, x), np.nan, 0.0), x)
        if not isinstance(energy, RestFolds):
            if self._folds is None:
                bare = SplitFoldEnergy(mesh, BARE_SHEET, self._slopes, [], self.clamped).anchored(self._clamped_on)
                self._folds = bare.shifted(self.mesh.vertices[0] - self.rest_positions[0])
            energy = self._folds
        density = self._energy.face_energies(mesh, x) / mesh.face_areas
        return ShellFields.of(mesh, self.material, x, energy.bending(x)[0], density, self.rest_shape)

    def gravity_force(self, gravity: ArrayLike) -> Array:
        """Weight of every vertex (n, 3) [N] for ``gravity`` (3,) [m/s^2]."""
        return self.mass[:, None] * checked_vectors("gravity", gravity, (3,))

    def total_load(
        self, gravity: ArrayLike | None = None, force: ArrayLike | None = None, loads: Sequence[Load] | None = None
    ) -> Array:
        """Load (n, 3) [N] of the shape at rest, at time 0, or LoadError for a part of the wrong shape or not finite."""
        return self.loading(gravity, force, loads).force(self.rest_positions)

    def loading(
        self, gravity: ArrayLike | None = None, force: ArrayLike | None = None, loads: Sequence[Load] | None = None
    ) -> Loading:
        """All loads together, those that change with the shell apart from the sum of the dead ones.

        LoadError if a part is of the wrong shape or not finite.
        """
        dead = np.zeros_like(self.rest_positions)
        if gravity is not None:
            dead += self.gravity_force(gravity)
        if force is not None:
            dead += checked_vectors("force", force, dead.shape)
        return Loading.of(self.mesh, self.mass, self.rest_positions, self.clamped, dead, loads or ())

    def reactions(
        self,
        positions: ArrayLike,
        *,
        gravity: ArrayLike | None = None,
        force: ArrayLike | None = None,
        loads: Sequence[Load] | None = None,
    ) -> Array:
        """Forces (n, 3) [N] of the supports on their vertices at ``positions`` (n, 3) [m]; zero elsewhere.

        In equilibrium their sum is minus the load's. Where an edge is clamped on one row of vertices, its share of the
        force acts at both ends of the edge; the moment by which it holds the slope is not among the forces.

        Parameters
        ----------
        positions : array_like, shape (n, 3)
            Vertex positions in equilibrium [m].
        gravity, force, loads : optional
            The load, as in :meth:`Model.equilibrium`; in contact ``force`` has the answer's ``contact_forces`` too.

        Raises
        ------
        LoadError
            For arrays of the wrong shape or not finite, or where a triangle has collapsed.
        """
        x = self.checked_positions(positions)
        gradient = self._energy.support_gradient(x)
        refuse_collapse(self.mesh, "force", gradient, x)
        out_of_balance = gradient - self.loading(gravity, force, loads).force(x)
        reactions = np.zeros_like(out_of_balance)
        reactions[self.unknowns.supported] = self.unknowns.resisted(out_of_balance[:, :, None])[:, :, 0]
        return reactions

    def support_reactions(
        self,
        positions: ArrayLike,
        *,
        gravity: ArrayLike | None = None,
        force: ArrayLike | None = None,
        loads: Sequence[Load] | None = None,
    ) -> list[Array]:
        """The :meth:`reactions` (n, 3) [N] of each of :attr:`supports`; their sum over the vertices is its resultant.

        Several supports that hold a vertex along one direction share the force evenly; a tie passes its own to them.
        Parameters and errors are those of :meth:`reactions`.
        """
        return shared_reactions(
            self.supports, self.mesh, self.reactions(positions, gravity=gravity, force=force, loads=loads)
        )

    def checked_positions(self, positions: ArrayLike) -> Array:
        """Positions as a float64 array (n, 3), or LoadError if they are of another shape or not finite."""
        return checked_vectors("positions", positions, self.rest_positions.shape)
