"""The modal basis of a shell: modes, eigenvalues and modal rotations; computed once, saved and loaded."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import LARGEST, checked_count, checked_kind, finite_answer
from modalshell.core.drawn import DRAWING, Drawn
from modalshell.core.errors import ModalShellWarning, OptionError, SupportError
from modalshell.core.memory import demand_memory
from modalshell.core.registry import load_plugins
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import read_only, read_only_copy
from modalshell.core.typing import Array
from modalshell.files.archive import Archive, Field
from modalshell.files.atomic_io import write_npz
from modalshell.loads import Load
from modalshell.mesh import TriangleMesh
from modalshell.mesh.parts import loose_parts_fault
from modalshell.modes.attachments import attached_forces, with_attachments
from modalshell.modes.derivatives import BasisSensitivity, VibrationModes, basis_sensitivity
from modalshell.modes.eigenpairs import AtRest, eigenpairs
from modalshell.modes.factorisation import Factoriser
from modalshell.modes.loaded import LoadedModes, State, loaded_modes
from modalshell.modes.modal_rotation import rotation_matrix
from modalshell.modes.resolution import unresolved_remark
from modalshell.modes.settled import settled_modes
from modalshell.shell import Isotropic, Material, Sheet, Shell
from modalshell.shell.elements import ENERGIES
from modalshell.shell.sheet import SHEETS
from modalshell.supports import SUPPORTS

_FLAT = 1e-6
"""Extent across a mesh, as a share of its size, up to which it counts as flat."""

_BASIS = Archive(
    "a saved basis",
    "modalshell_basis",
    {
        "vertices": Field("f", ("n", 3), "m"),
        "faces": Field("iu", ("T", 3)),
        "supports": Field("U"),
        "energies": Field("U"),
        "eigenvalues": Field("f", ("m",), "1/s^2"),
        "modes": Field("f", ("N", "m"), "1/sqrt(kg)"),
        "rotations": Field("f", ("N", "m"), "1/(m sqrt(kg))"),
        "rigid_modes": Field("iu"),
        "residual": Field("f"),
        "backend": Field("U"),
    },
    most=LARGEST,
)
_CONSTANTS: dict[type, dict[str, Field]] = {
    Material: {
        "stretch": Field("f", None, "N/m"),
        "shear": Field("f", None, "N"),
        "flexure": Field("f", None, "N m"),
        "density": Field("f", None, "kg/m^2"),
        "correct_clamp": Field("b"),
    },
    Isotropic: {
        "young": Field("f", None, "Pa"),
        "poisson": Field("f", None, ""),
        "thickness": Field("f", None, "m"),
        "density": Field("f", None, "kg/m^3"),
    },
}
"""Constants of materials."""
_SHEET = {"sheet": Field("U")}
"""Other sheets, as the text of their kind and constants."""
_COPIES, _RIGID_COPIES = 6, 6
"""Vectors of all unknowns that are held at once for a mode asked for, and for a rigid motion."""


@short_repr
@dataclass(frozen=True)
class Basis(VibrationModes, Drawn):
    """What the modal models need of a shell.

    Attributes
    ----------
    shell : Shell
        The shell the modes belong to.
    eigenvalues : ndarray, shape (m,)
        Squared angular frequencies [1/s^2], ascending; zero for rigid modes.
    modes : ndarray, shape (3n, m)
        Phi, mass-orthonormal, zero at held vertices [1/sqrt(kg)].
    rotations : ndarray, shape (3n, m)
        Psi = W Phi, the modal rotation matrix [choi2007, eq. 15; theory 2, eq. 3].
    rigid_modes : int
        Number of leading modes that are rigid motions left free by the supports: six for a free shell.
    residual : float
        Largest relative residual of the eigenpairs.
    backend : str
        Library that factorised the stiffness.
    """

    shell: Shell
    eigenvalues: Array
    modes: Array
    rotations: Array
    rigid_modes: int
    residual: float
    backend: str

    def __post_init__(self) -> None:
        for name in ("eigenvalues", "modes", "rotations"):
            object.__setattr__(self, name, read_only_copy(getattr(self, name)))

    @property
    def participation_factors(self) -> Array:
        """How much each mode is moved by accelerations of the supports along x, y and z (m, 3) [sqrt(kg)].

        ``Phi^T M e``: supports with acceleration a make ``q'' + lambda q = -a Phi^T M e`` [clough1993, 12-6].
        """
        mass = self.shell.mass[:, None, None]
        return np.asarray((mass * self.modes.reshape(-1, 3, self.count)).sum(axis=0).T)

    @property
    def effective_masses(self) -> Array:
        """Mass that moves with each mode along x, y and z (m, 3) [kg]; of all modes together the mass that can move."""
        return self.participation_factors**2

    def averaged_mass_frequencies(self) -> Array:
        """Natural frequencies (m,) [Hz] by half of the vertex masses and half of the consistent mass of triangles.

        For flat plates of shell theory, with a warning for others. Their bending is too soft by a share that falls with
        the square of the edge length, and the consistent mass, that of the linear function on each triangle, is too
        light by such a share: both halves leave little of either (theory 7, eq. 7). The modes are those of the vertex
        masses; of supported plates six at 24 cells are within 1 % for ratios of the moduli up to 25, where
        ``frequencies`` are within 2 %. Of curved shells, whose membrane is not too soft, ``frequencies`` are nearer.
        Motions have the vertex masses.
        """
        mesh = self.shell.rest_mesh
        flat = np.ptp((mesh.vertices - mesh.vertices[0]) @ mesh.principal_axes[2]) <= _FLAT * mesh.size
        if not (flat and isinstance(self.shell.material, Sheet)):
            warnings.warn(
                "averaged_mass_frequencies are for flat plates of shell theory (Isotropic, Orthotropic, ...): take "
                "frequencies for other shells, which these are no nearer to",
                ModalShellWarning,
                stacklevel=2,
            )
        masses = self.shell.material.area_density(mesh) * mesh.face_areas / 12.0
        consistent, lumped = np.zeros((2, self.count))
        for axis in range(3):
            moves = self.modes[axis::3]
            corners = moves[mesh.faces]
            consistent += masses @ (corners.sum(axis=1) ** 2 + np.sum(corners**2, axis=1))
            lumped += self.shell.mass @ moves**2
        return np.asarray(self.frequencies / np.sqrt(0.5 * (lumped + consistent)))

    def sensitivity(self, wrt: str) -> BasisSensitivity:
        """Derivatives of eigenvalues, frequencies and modes by a constant of the material [nelson1976; fox1968].

        Parameters
        ----------
        wrt : str
            A constant that is one number for the whole mesh, such as "young", "thickness", "flexure" or "density".

        Raises
        ------
        OptionError
            For a name that is none, attachment vectors in the basis, or modes that share an eigenvalue: those have no
            derivatives of their own.
        SolverError
            Where the eigenvalue above the basis is nearly the last one in it.
        """
        return basis_sensitivity(self, checked_kind("wrt", wrt, str))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the basis with its shell to an ``.npz`` file (no pickle); OptionError for a mesh under stress."""
        if self.shell.stressed:
            raise OptionError("a file of a basis holds no rest shape: solve the modes of a settled shell again")
        shell, material = self.shell, self.shell.material
        if isinstance(material, Isotropic):  # functions cannot be stored, their values can
            material = material.on(shell.mesh)
        constants = _CONSTANTS.get(type(material), _SHEET)
        if isinstance(material, Sheet) and constants is _SHEET:
            values: dict[str, Any] = {"sheet": json.dumps([material.kind, material.plain(shell.mesh)])}
        else:
            values = {name: getattr(material, name) for name in constants}
        values |= {name: getattr(self, name) for name in _BASIS.fields if hasattr(self, name)}
        values |= {"vertices": shell.mesh.vertices, "faces": shell.mesh.faces}
        values["supports"] = json.dumps([[support.key, support.plain()] for support in shell.supports])
        values["energies"] = json.dumps([[energy.key, asdict(energy)] for energy in shell.energies])  # type: ignore[call-overload]
        write_npz(path, **_BASIS.arrays(values, further=constants))

    def page(self, path: str | os.PathLike[str] | None = None, **options: Any) -> Any:
        """A self-contained :class:`modalshell.page.Page` that moves in a browser; ``path`` names a file to write it to.

        See :func:`modalshell.page.modal_page` for the options.
        """
        page = DRAWING["page"](self, **options)
        if path is not None:
            page.save(path)
        return page

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Basis:
        """Read a basis that :meth:`save` wrote.

        Raises
        ------
        FileFormatError
            If the file is missing, damaged, or not a saved basis.
        """
        load_plugins()
        with _BASIS.read(path) as data:
            material = _read_material(data)
            energies = [ENERGIES[key](**parameters) for key, parameters in json.loads(str(data["energies"]))]
            supports = [SUPPORTS[key](**parameters) for key, parameters in json.loads(str(data["supports"]))]
            mesh = TriangleMesh(data["vertices"], data["faces"])
            shell = Shell(mesh, material, supports=supports, energies=energies)
            count, rigid = len(data["eigenvalues"]), int(data["rigid_modes"])
            if len(data["modes"]) != shell.rest_positions.size or not 0 <= rigid <= count:
                raise ValueError(f"{count} modes of {len(data['modes'])} numbers each, {rigid} of them rigid")
            counts = rigid, float(data["residual"]), str(data["backend"])
            return cls(shell, data["eigenvalues"], data["modes"], data["rotations"], *counts)


def _read_material(data: dict[str, Any]) -> Material | Sheet:
    """The material of a saved basis; ValueError or KeyError for what is none."""
    if "sheet" in data:
        _BASIS.check(data, _SHEET)
        name, values = json.loads(str(data["sheet"]))
        return SHEETS[name].of_plain(values)
    kind = Isotropic if "young" in data else Material
    _BASIS.check(data, _CONSTANTS[kind])
    constants: dict[str, Any] = {name: data[name] for name in _CONSTANTS[kind]}
    if "correct_clamp" in constants:
        constants["correct_clamp"] = bool(constants["correct_clamp"])
    return kind(**constants)


@overload
def solve_modes(
    shell: Shell,
    count: int = 8,
    *,
    attachments: Sequence[Load | ArrayLike] | None = None,
    about: None = None,
    backend: str | None = None,
) -> Basis: ...


@overload
def solve_modes(
    shell: Shell, count: int = 8, *, about: State | ArrayLike, backend: str | None = None
) -> LoadedModes: ...


def solve_modes(
    shell: Shell,
    count: int = 8,
    *,
    attachments: Sequence[Load | ArrayLike] | None = None,
    about: State | ArrayLike | None = None,
    backend: str | None = None,
) -> Basis | LoadedModes:
    """Lowest vibration modes of a shell about its rest shape, with their modal rotations, or about a loaded state.

    Parameters
    ----------
    shell : Shell
        Shell with its supports.
    count : int
        Number of modes m, rigid ones counted in.
    attachments : sequence of Load or array_like, shape (n, 3), optional
        Loads, or forces [N], under which the shell's linear solution is added to the basis: for each that the modes
        do not hold already a vector follows them, so that vectors stay orthonormal and eigenvalues ascend.
    about : Equilibrium or array_like, shape (n, 3), optional
        A stable state: small vibrations are those about it. Loads of an equilibrium that follow the shell add their
        stiffness, unsymmetric where they have no potential; forces by velocity, such as drag, are left out, and a
        ModalShellWarning says where those of Coriolis count. About positions [m] alone loads count as dead. Contacts
        and constraints of a state are left out; a ModalShellWarning says so. Creases have the folds that an equilibrium
        has kept, and do not yield.
    backend : str, optional
        Factorisation to use; see :class:`modalshell.modes.Factoriser`.

    Returns
    -------
    LoadedModes
        With ``about``: frequencies and modes alone, as the modal models start from rest.
    Basis
        Modes with a fixed start vector and sign convention, so that results repeat. None is missing, of repeated
        eigenvalues neither; where ``count`` cuts such an eigenvalue in two, a ModalShellWarning says so, and as many
        orthonormal modes of its eigenspace are returned as there is room for. Where loose parts are asked for
        (``Shell(..., loose_parts=True)``), a ModalShellWarning says that six modes each are their rigid motions.
        Another names the modes with fewer than four edges of the mesh a half wave.

    Raises
    ------
    SupportError
        If the mesh is in several parts of which no support holds some.
    OptionError
        If ``count`` is not between 1 and the number of free unknowns, the modes do not fit into memory, ``about`` is no
        stable state, or ``attachments`` are asked for with it, or of a shell that its supports leave free.
    LoadError
        For attachments or positions of the wrong shape or not finite.
    SolverError
        If the stiffness is singular beyond its rigid motions, or a mode fails the residual check.
    """
    checked_kind("shell", shell, Shell)
    count = checked_count("count", count)
    _checked_parts(shell, count, backend)
    found: Basis | LoadedModes
    if about is None:
        basis, whole = _solved(shell, count, attachments, backend)
        modes, first = basis.modes[:, basis.rigid_modes : None if attachments is None else 0], basis.rigid_modes + 1
        found = basis
    else:
        if attachments is not None:
            raise OptionError("attachments are shapes about rest: leave them out, or about=")
        kept = getattr(about, "creases", None)
        loaded, whole = loaded_modes(shell if kept is None else shell.creased(kept), about, count, backend)
        found, modes, first = loaded, loaded.modes, 1
    _warn_of_cut(count, whole)
    if remark := unresolved_remark(shell.mesh, modes, "mode", "frequencies", first):
        warnings.warn(remark, ModalShellWarning, stacklevel=2)
    return found


def model_basis(shell: Shell, count: int, backend: str | None = None, at_rest: AtRest = None) -> Basis:
    """As :func:`solve_modes`, for a model, which may keep the solver: short waves are part of its shapes."""
    checked_kind("shell", shell, Shell)
    _checked_parts(shell, checked_count("count", count), backend)
    found, whole = _solved(shell, count, None, backend, at_rest)
    _warn_of_cut(count, whole)
    return found


def _warn_of_cut(count: int, whole: int) -> None:
    if whole < count:
        warnings.warn(
            f"mode {count} belongs to a repeated eigenvalue that the count of modes ({count}) cuts in two; ask for one "
            "or two modes more to hold its whole subspace",
            ModalShellWarning,
            stacklevel=3,
        )


def lowest_modes(shell: Shell, count: int) -> tuple[Basis, int]:
    """As :func:`solve_modes`; how many are of eigenspaces that ``count`` does not cut is returned, with no warning."""
    _checked_parts(shell, count, None)
    return _solved(shell, count, None, None)


def _solved(
    shell: Shell,
    count: int,
    attachments: Sequence[Load | ArrayLike] | None,
    backend: str | None,
    at_rest: AtRest = None,
) -> tuple[Basis, int]:
    """The basis, and how many of its modes are of eigenspaces that ``count`` does not cut."""
    shell.refuse_creases_in("a modal model")
    if shell.stressed:
        if attachments is not None:
            raise OptionError("attachments are shapes about a mesh without stress: leave them out")
        eigenvalues, modes, residual, name, whole = settled_modes(shell, count, backend)
        rotations = shell.unknowns.turns(np.asarray(rotation_matrix(shell.mesh) @ modes))
        return Basis(shell, eigenvalues, modes, read_only(rotations), 0, residual, name), whole
    forces = attached_forces(shell, attachments)
    eigenvalues, free_modes, rigid_modes, residual, name, whole = eigenpairs(shell, count, backend, at_rest)
    if forces.shape[1]:
        eigenvalues, free_modes = with_attachments(shell, eigenvalues, free_modes, forces, backend)
    modes = np.asarray(shell.unknowns.prolong(free_modes))
    rotations = shell.unknowns.turns(np.asarray(rotation_matrix(shell.mesh) @ modes))
    finite_answer("the modes", eigenvalues, modes, rotations)
    return Basis(shell, eigenvalues, read_only(modes), read_only(rotations), rigid_modes, residual, name), whole


def _checked_parts(shell: Shell, count: int, backend: str | None) -> None:
    """SupportError for parts that no support holds, OptionError for too many modes or an unknown ``backend``."""
    if fault := loose_parts_fault(shell.mesh, shell.unknowns.supported, wanted=shell.loose_parts):
        if not shell.loose_parts:
            raise SupportError(fault)
        warnings.warn(f"modes are spent on rigid motion: {fault}", ModalShellWarning, stacklevel=3)
    Factoriser(backend)  # refuses an unknown back end before any work
    _demand_memory(shell, count)


def _demand_memory(shell: Shell, count: int) -> None:
    """OptionError if ``count`` modes need more memory than there is; the factor is counted with the shell."""
    vertices, parts = len(shell.rest_positions), int(shell.mesh.components.max()) + 1
    loose = 6 * (parts - np.unique(shell.mesh.components[shell.unknowns.supported]).size)
    columns = _COPIES * count + _RIGID_COPIES * loose
    size = 8.0 * 3 * vertices * columns + 8.0 * (3.0 * min(count, 3 * vertices)) ** 2
    wanted = f"{count} modes of {vertices} vertices" + (f" with {loose} rigid motions" if loose > 6 else "")
    demand_memory(wanted, size, "take fewer modes, a coarser mesh, or one part of it")
