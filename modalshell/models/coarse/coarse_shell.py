"""Coarse shells: fewer vertices of the same surface, calibrated to the fine shell's lowest frequencies."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_count, checked_kind, shown
from modalshell.core.errors import MeshError, ModalShellWarning, OptionError, SupportError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Index
from modalshell.mesh import TriangleMesh
from modalshell.models.coarse.coarse_mesh import places_on, remeshed_to_supports
from modalshell.models.coarse.taken_over import CreasesBelow, FacesBelow, restricted_options, restricted_sheet
from modalshell.modes import Factoriser, lowest_modes
from modalshell.modes.rigid import rigid_motions
from modalshell.shell import GAUSS_NEWTON, Material, Sheet, Shell

_WIDEST = 2.5
"""Logarithm of the largest factor on the membrane that calibration tries."""
_SOFTEST, _STIFFEST = -1.2, 0.6
"""Logarithms of the membrane's factor beyond which the flexure is scaled in its place: meshes are not so far apart."""
_MEMBRANE_SHARE = 0.1
"""Slope of the lowest eigenvalue over the membrane stiffness, both as logarithms, below which bending decides."""
_COMPARED = 6
"""Lowest modes among which one is looked for that the other stiffness decides."""
_APART = 0.3
"""Least difference of two modes' fractions of membrane energy for them to determine both stiffnesses."""
_ALIKE = 0.7
"""Square of the cosine between fine modes of one eigenvalue and the coarse eigenspace that is theirs."""
_EQUAL = 1e-6
"""Relative gap below which modes are of one eigenspace, of which any others would do."""
_TWISTED = 0.5
"""Part of the logarithm of the flexure's factor that is taken from a mode above the lowest: uniform bends need less."""
_NEARER = 1.0 / 3.0
"""Squared error under gravity with the flexure alone scaled, over that of the other calibration, to take the former."""
_ANOTHER_REGION = 0.04
"""Change of the free surface, as a share, that is worth a warning: more than that of surfaces that are remeshed."""
_ROUNDS, _MET = 12, 1e-4
"""Newton steps on both stiffnesses at most, and the logarithm of a ratio of eigenvalues that counts as met."""


@final
@short_repr
@dataclass(frozen=True)
class CoarseMesh:
    """A coarser mesh of the same surface."""

    mesh: TriangleMesh
    name: str
    material: Material | Sheet | None = None
    """Where that is another than the fine shell's."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Keys of a scene's ``[model]`` table that make it: ``cells`` of a generated shape, or ``triangles``; empty if
    no scene can name it."""


def remeshed(shell: Shell, triangles: int) -> CoarseMesh:
    """The surface of ``shell`` in about ``triangles`` triangles; see :func:`remeshed_to_supports`."""
    mesh = remeshed_to_supports(shell, triangles)
    return CoarseMesh(mesh, f"{triangles} triangles", options={"triangles": triangles})


def coarse_shell(shell: Shell, mesh: TriangleMesh | int, material: Material | Sheet | None = None) -> Shell:
    """A coarse shell on ``mesh`` with the supports of ``shell`` and, by calibration, its lowest frequencies.

    A coarse mesh is too stiff in its membrane and, with hinges, too soft or too stiff against bending. Stiffnesses are
    scaled until elastic eigenvalues agree, modes of one eigenvalue counting as one; the first row that fits holds:

    =========================================================== ======================================================
    lowest six modes of the fine shell                          what is scaled
    =========================================================== ======================================================
    the membrane decides the lowest, bending another            membrane and flexure, by both modes; the flexure by
                                                                half as much, as a logarithm: the other is a twist,
                                                                and uniform bends ask for less
    bending decides the lowest, the membrane another            membrane and flexure, by both modes
    the lowest stretches; the membrane's factor is 0.3 to 1.8   membrane, by the lowest
    else                                                        flexure, by the lowest
    =========================================================== ======================================================

    The flexure is scaled alone, too, where that brings the small displacements under gravity along the three axes much
    nearer to those of a supported fine shell: their squared error below a third. Sheets of :class:`Isotropic` need no
    calibration. To clamp alike, give ``mesh`` a row of vertices where the held region ends: else it warns.

    Fields over the triangles of a sheet, and of its rest shape, become means over the fine triangles under each coarse
    one; another mesh at rest is sampled. Creases become the edges of ``mesh`` along them. A number of triangles gives a
    mesh that has edges there, at junctions, and where a region ends in which a field is constant.

    Hinges of a remeshed surface bend and twist in other proportions than those of the fine mesh, which two factors
    cannot correct. Under gravity a leaf and V-beams in a fifth to three fifths of the triangles were within 0.5 to 5 %
    of DS, panels of 90 degrees between held straight edges within 5 to 19 %. A stiff V-beam in 271 triangles twisted at
    9.7 Hz in place of 10.9, and after its snap it was 27 % off.

    Parameters
    ----------
    shell : Shell
        The fine shell.
    mesh : TriangleMesh or int
        The same surface with fewer vertices; or about how many triangles to remesh it in (extra ``remesh``), with an
        edge wherever the clamped region ends. On hinges the new mesh has a twist stiffness of its own: compare.
    material : Material or Isotropic, optional
        Stiffnesses for ``mesh``; without it those of ``shell``, of a :class:`Material` if they are single numbers: its
        shear stiffness, a force, is scaled by edge length.

    Returns
    -------
    Shell
        The coarse shell.

    Raises
    ------
    OptionError
        If ``material`` is left out and a :class:`Material` has values of single elements; if it gives the lowest mode
        of either mesh no stiffness; or if a number of triangles is given and MeshLab is not installed or they are not
        fewer than those of ``shell``.
    MeshError
        If MeshLab fails on this surface; if ``mesh`` has no edges along a crease; or if triangles of it face the other
        way than those of ``shell`` and curvatures, temperatures or directions count by their normals.
    SupportError
        If no vertex of ``mesh`` lies where ``shell`` is held, or if those that do leave it free to turn.
    """
    checked_kind("shell", shell, Shell)
    shell.require_clamps("a coarse shell")
    if not isinstance(mesh, TriangleMesh):
        if isinstance(mesh, bool) or not isinstance(mesh, int | np.integer):
            raise OptionError(f"mesh must be a TriangleMesh or a number of triangles (got {shown(mesh)})")
        mesh = remeshed_to_supports(shell, checked_count("mesh", mesh, at_least=4))
    if not isinstance(given := shell.material if material is None else material, Material | Sheet):
        raise OptionError(f"material must be a Material, an Isotropic or another sheet (got {shown(given)})")
    if material is None and isinstance(given, Material) and any(map(np.ndim, vars(given).values())):
        raise OptionError("the fine shell's material has a value an element: pass the material of the coarse mesh")
    below, clamped = FacesBelow(shell.mesh, mesh), places_on(shell, mesh)[2]
    if material is None and isinstance(given, Sheet):
        given = restricted_sheet(given, below)
    _refuse_supports(shell, mesh, given, clamped)
    _refuse_turned(shell, given, below)
    options = restricted_options(shell, mesh, below)
    made = Shell(mesh, given, clamped, energies=shell.energies, loose_parts=shell.loose_parts, **options)
    if isinstance(given, Material):
        ratio = 1.0 if material is not None else float(mesh.edge_lengths.mean() / shell.mesh.edge_lengths.mean())
        made = made.with_material(_calibrated(shell, mesh, replace(given, shear=given.shear * ratio)))
    _warn_of_another_region(shell, made)
    return _creased(shell, made)


def _warn_of_another_region(shell: Shell, coarse: Shell) -> None:
    """Say so where a coarse shell of a sheet, which is not calibrated, is clamped in less or more of its surface."""
    if isinstance(coarse.material, Material):
        return
    held, taken = (float(one.mesh.face_areas[one.clamped[one.mesh.faces].all(axis=1)].sum()) for one in (shell, coarse))
    more = (held - taken) / max(shell.mesh.area - held, 1e-300)
    if abs(more) > _ANOTHER_REGION:
        warnings.warn(
            f"the coarse shell has {abs(more):.1%} {'more' if more > 0.0 else 'less'} free surface than the fine one: "
            f"{taken:.4g} m^2 are clamped where {held:.4g} are; give its mesh a row of vertices where the held region "
            "ends, or a number of triangles, which puts one there",
            ModalShellWarning,
            stacklevel=3,
        )


def _refuse_supports(shell: Shell, mesh: TriangleMesh, given: Material | Sheet, clamped: NDArray[np.bool_]) -> None:
    """SupportError where ``clamped`` (k,) vertices of the coarse mesh do not hold it as the fine shell is held."""
    if shell.clamped.any() and not clamped.any():
        raise SupportError("no vertex of the coarse mesh lies where the fine shell is held: refine it there")
    below = Shell(mesh, given, clamped, loose_parts=shell.loose_parts)
    if clamped.any() and rigid_motions(below).shape[1] > rigid_motions(shell).shape[1]:
        raise SupportError(
            "a row of held vertices leaves the coarse shell free to turn where the fine one is clamped: give its "
            "mesh a second row of held vertices there, or hold a region of triangles of the fine shell"
        )


def _calibrated(shell: Shell, mesh: TriangleMesh, given: Material) -> Material:
    """The material on ``mesh``, as of shells without another shape at rest and without creases."""
    plain = not shell.stressed and shell.creases is None
    own = shell
    if not plain:
        further, loose = shell.energies, shell.loose_parts
        own = Shell(shell.mesh, shell.material, None, shell.supports, energies=further, loose_parts=loose)
    found = _Calibration(own, mesh, given).best().material
    assert isinstance(found, Material)
    return found


def _creased(shell: Shell, coarse: Shell) -> Shell:
    """A coarse shell whose creases have kept what those of ``shell`` have."""
    state, creases = shell.crease_state, CreasesBelow.of(shell, coarse)
    if state is None or creases is None or not (state.dissipated or state.angles.any()):
        return coarse
    return coarse.creased(creases.state_of(state, restrict=True))


def _refuse_turned(shell: Shell, material: Material | Sheet, below: FacesBelow) -> None:
    """MeshError where coarse triangles face the other way and something counts by their normals."""
    given, direction = shell.options, getattr(material, "direction", None)
    vectors = direction is None or (not callable(direction) and np.shape(direction)[-1:] == (3,))
    counts = not vectors or given["rest_curvature"] is not None or given["temperature"] is not None
    if counts and below.turned.any():
        first = int(np.argmax(below.turned))
        raise MeshError(
            f"triangle {first} of the coarse mesh faces the other way than the fine ones, by whose normals curvatures, "
            "temperatures through the thickness and directions count: wind it as those are"
        )


@final
class _Calibration:
    """Coarse shells on a mesh, with stiffnesses scaled so that some of their modes agree with those of a fine shell."""

    def __init__(self, shell: Shell, mesh: TriangleMesh, material: Material) -> None:
        self._shell, self._mesh, self._material = shell, mesh, material
        nearest, self._shares, self._clamped = places_on(shell, mesh)
        self._corners = shell.mesh.faces[nearest]
        self._goal = _lowest(shell)
        if not self._goal > 0.0:
            raise OptionError(
                "a coarse shell is calibrated on the lowest mode of the fine one, which has no stiffness (got "
                f"{self._goal:g}): give the material more, or pass the coarse mesh's own"
            )
        start = _lowest(self._scaled(1.0, 1.0))
        if not start > 0.0:
            raise OptionError(
                "the material gives the lowest mode of the coarse mesh no stiffness that can be scaled (got "
                f"{material!r}): give it more"
            )
        self._softer = float(np.exp(-np.log(start / self._goal)))

    def best(self) -> Shell:
        """The coarse shell that is described in :func:`coarse_shell`."""
        bent, found = self.flexure(), self.both() or self.membrane()
        if found is None:
            return bent
        if rigid_motions(self._shell).shape[1]:
            return found
        exact = self._sampled(_small_displacements(self._shell))
        alone, other = (
            float(np.sum(coarse.mass[:, None, None] * (_small_displacements(coarse) - exact) ** 2))
            for coarse in (bent, found)
        )
        return bent if alone < _NEARER * other else found

    def flexure(self) -> Shell:
        """With a flexure by which the lowest eigenvalue agrees, were it of bending alone."""
        return self._scaled(1.0, self._softer)

    def membrane(self) -> Shell | None:
        """With a membrane by which the lowest eigenvalues agree; None where none does, or none that may be."""
        from scipy.optimize import brentq  # not before a shell is calibrated: its import takes long

        low, high = self._excess(-_WIDEST), self._excess(_WIDEST)
        if not (high - low > _MEMBRANE_SHARE * 2.0 * _WIDEST and low < 0.0 < high):
            return None
        factor = float(brentq(self._excess, -_WIDEST, _WIDEST, xtol=1e-3))
        return self._scaled(float(np.exp(factor)), 1.0) if _SOFTEST < factor < _STIFFEST else None

    def both(self) -> Shell | None:
        """With both stiffnesses by which two modes agree; None if no two modes determine them."""
        fine = _lowest_spaces(self._shell)
        apart = fine.parts[:1, 0] - fine.parts[:, 0]
        if apart.max(initial=0.0) >= _APART:
            pair, taken = [0, int(np.argmax(apart >= _APART))], _TWISTED
        elif apart.min(initial=0.0) <= -_APART:
            pair, taken = [int(np.argmax(apart <= -_APART)), 0], 1.0
        else:
            return None
        modes = fine.modes.reshape(len(self._shell.mass), 3, -1)
        sampled = self._sampled(modes).reshape(-1, fine.modes.shape[1])
        factors = np.zeros(2)
        for _ in range(_ROUNDS):
            coarse = self._scaled(*np.exp(factors))
            own = _lowest_spaces(coarse)
            same = _alike(fine, own, sampled, np.repeat(coarse.mass, 3)[:, None], pair)
            if same is None:
                return None
            excess = np.log(own.eigenvalues[same] / fine.eigenvalues[pair])
            slope = own.parts[same]
            excess[1] += (1.0 / taken - 1.0) * slope[1, 1] * factors[1]
            slope[1, 1] /= taken
            if np.abs(excess).max() < _MET:
                return coarse
            if abs(np.linalg.det(slope)) < 0.5 * _APART:
                return None
            factors -= np.linalg.solve(slope, excess).clip(-1.0, 1.0)
            if np.abs(factors).max() > _WIDEST:
                return None
        return None

    def _scaled(self, membrane: float, flexure: float) -> Shell:
        given = self._material
        changed = replace(
            given, stretch=given.stretch * membrane, shear=given.shear * membrane, flexure=given.flexure * flexure
        )
        fine = self._shell
        return Shell(self._mesh, changed, self._clamped, energies=fine.energies, loose_parts=fine.loose_parts)

    def _excess(self, logarithm: float) -> float:
        """Logarithm of the ratio of the lowest eigenvalues, with a membrane scaled by another logarithm."""
        return float(np.log(_lowest(self._scaled(np.exp(logarithm), 1.0)) / self._goal))

    def _sampled(self, fields: Array) -> Array:
        """Fields (n, 3, m) of the fine shell at the coarse vertices (k, 3, m)."""
        return np.einsum("kc,kcxm->kxm", self._shares, fields[self._corners])


def _alike(fine: _Spaces, own: _Spaces, sampled: Array, mass: Array, pair: list[int]) -> Index | None:
    """The coarse eigenspaces (2,) that are a ``pair`` of fine ones; None where they are not two.

    ``sampled`` (3k, m) are the fine modes on the coarse mesh, of ``mass`` (3k, 1).
    """
    if not own.starts.size:
        return None
    lengths = np.sum(mass * sampled**2, axis=0)[:, None] * np.sum(mass * own.modes**2, axis=0)
    cosines = (sampled.T @ (mass * own.modes)) ** 2 / lengths
    alike = _means(np.add.reduceat(cosines, own.starts, axis=1), fine.starts)[pair]
    same = np.asarray(alike.argmax(axis=1))
    return None if alike.max(axis=1).min() < _ALIKE or same[0] == same[1] else same


def _small_displacements(shell: Shell) -> Array:
    """Linear static displacements (n, 3, 3) [m] under a gravity of 1 m/s^2 along each axis, which comes last."""
    data = shell.hessian(shell.rest_positions, GAUSS_NEWTON)
    factor = Factoriser(use="solve").symmetric(shell.pattern.free_matrix(data))
    weights = np.kron(shell.mass[:, None], np.eye(3))
    answers = shell.unknowns.prolong(factor.solve(np.asarray(shell.unknowns.restrict(weights))))
    return np.asarray(answers).reshape(len(shell.mass), 3, 3)


@final
class _Spaces(NamedTuple):
    """Lowest elastic eigenspaces: a mode of its own each, or several of one eigenvalue."""

    eigenvalues: Array
    """(g,) [1/s^2]."""
    modes: Array
    """(3n, k), those of a space next to each other."""
    starts: Index
    """First mode (g,) of each."""
    parts: Array
    """Shares (g, 2) of membrane and flexure in the energy, the mean of the modes of a space."""


def _lowest_spaces(shell: Shell) -> _Spaces:
    """The eigenspaces of the lowest six elastic modes, without one that has further modes."""
    rigid = rigid_motions(shell).shape[1]
    basis, whole = lowest_modes(shell, min(rigid + _COMPARED, shell.unknowns.count))
    modes, eigenvalues = basis.modes[:, rigid:whole], basis.eigenvalues[rigid:whole]
    rest, parts = shell.rest_positions, np.zeros((modes.shape[1], 2))
    offsets = shell.predicted_stresses(rest, np.zeros_like(rest))
    for mode, part in zip(modes.T, parts, strict=True):
        stresses = shell.predicted_stresses(rest, mode.reshape(-1, 3))
        for elements, stress, offset in zip(shell.elements, stresses, offsets, strict=True):
            stiff = elements.weight != 0
            energy = float(np.sum((stress - offset)[stiff] ** 2 / (4.0 * elements.weight[stiff])))
            if elements.name in ("stretch", "shear"):
                part[0] += energy
            elif elements.name.endswith("flexure"):
                part[1] += energy
    starts = np.flatnonzero(np.diff(eigenvalues, prepend=-1.0) > _EQUAL * eigenvalues)
    means = _means(eigenvalues, starts), _means(2.0 * parts / eigenvalues[:, None], starts)
    return _Spaces(means[0], modes, starts, means[1])


def _means(values: Array, starts: Index) -> Array:
    """Means (g, ...) of the rows (k, ...) from each of ``starts`` (g,) to the next."""
    if not len(starts):
        return values
    sizes = np.diff(starts, append=len(values)).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / sizes)


def _lowest(shell: Shell) -> float:
    """Lowest elastic eigenvalue [1/s^2]."""
    rigid = rigid_motions(shell).shape[1]
    return float(lowest_modes(shell, rigid + 1)[0].eigenvalues[-1])
