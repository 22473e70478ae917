"""The modal basis of a shell: modes, eigenvalues and modal rotations; computed once, saved and loaded."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import (
    checked_count,
    checked_folder,
    checked_kind,
    checked_vectors,
    finite_answer,
    shortened,
)
from modalshell.core.drawn import DRAWING, Drawn
from modalshell.core.errors import FileFormatError, ModalShellWarning, OptionError, SupportError
from modalshell.core.memory import demand_memory
from modalshell.core.plugins import load_plugins
from modalshell.core.short_repr import short_repr
from modalshell.core.thread_safety import ReadOnlyArrays, read_only, read_only_copy
from modalshell.core.typing import Array
from modalshell.core.units import SI
from modalshell.files.atomic_io import read_npz, write_npz
from modalshell.loads import Load
from modalshell.mesh import TriangleMesh
from modalshell.mesh.parts import loose_parts_fault
from modalshell.modes.attachments import attached_forces, with_attachments
from modalshell.modes.derivatives import BasisSensitivity, basis_sensitivity
from modalshell.modes.eigenpairs import eigenpairs
from modalshell.modes.factorisation import Factoriser
from modalshell.modes.loaded import LoadedModes, State, loaded_modes
from modalshell.modes.modal_rotation import rotation_matrix
from modalshell.shell import Isotropic, Material, Shell
from modalshell.shell.elements import ENERGIES
from modalshell.supports import SUPPORTS

_FORMAT = 1
"""Version of the saved file."""
_UNITS = {"vertices": "m", "eigenvalues": "1/s^2", "modes": "1/sqrt(kg)", "rotations": "1/(m sqrt(kg))"}
_CONSTANTS: dict[type, dict[str, str]] = {
    Material: {"stretch": "N/m", "shear": "N", "flexure": "N m", "density": "kg/m^2"},
    Isotropic: {"young": "Pa", "poisson": "", "thickness": "m", "density": "kg/m^3"},
}
"""Units of the saved arrays, and of the constants of materials."""
_COPIES, _RIGID_COPIES = 6, 6
"""Vectors of all unknowns that are held at once for a mode asked for, and for a rigid motion."""


@short_repr
@dataclass(frozen=True)
class Basis(ReadOnlyArrays, Drawn):
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
        Psi = W Phi, the modal rotation matrix [choi2007, eq. 15].
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
    def frequencies(self) -> Array:
        """Natural frequencies (m,) [Hz]."""
        return np.sqrt(self.eigenvalues) / (2.0 * np.pi)

    @property
    def count(self) -> int:
        """Number of modes m."""
        return int(self.eigenvalues.size)

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
        """Write the basis with its shell to an ``.npz`` file (no pickle)."""
        shell, material = self.shell, self.shell.material
        if isinstance(material, Isotropic):  # functions cannot be stored, their values can
            material = material.on(shell.mesh)
        write_npz(
            path,
            modalshell_basis=np.array(_FORMAT),
            vertices=shell.mesh.vertices,
            faces=shell.mesh.faces,
            supports=np.array(json.dumps([[support.key, support.plain()] for support in shell.supports])),
            **{field.name: np.asarray(getattr(material, field.name)) for field in fields(material)},
            energies=np.array(json.dumps([[energy.key, asdict(energy)] for energy in shell.energies])),  # type: ignore[call-overload]
            eigenvalues=self.eigenvalues,
            modes=self.modes,
            rotations=self.rotations,
            rigid_modes=np.array(self.rigid_modes),
            residual=np.array(self.residual),
            backend=np.array(self.backend),
            units=SI.array(_UNITS | _CONSTANTS[type(material)]),
        )

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
        file = checked_folder("path", path)
        load_plugins()
        try:
            data = read_npz(file)
            if int(data["modalshell_basis"]) != _FORMAT:
                raise ValueError(f"format {data['modalshell_basis']} (this version reads {_FORMAT})")
            kind = Isotropic if "young" in data else Material
            constants: dict[str, Any] = {field.name: data[field.name] for field in fields(kind)}
            if "correct_clamp" in constants:
                constants["correct_clamp"] = bool(constants["correct_clamp"])
            further = json.loads(str(data["energies"]))
            energies = [ENERGIES[key](**fields) for key, fields in further]
            mesh = TriangleMesh(data["vertices"], data["faces"])
            supports = [SUPPORTS[key](**parameters) for key, parameters in json.loads(str(data["supports"]))]
            shell = Shell(mesh, kind(**constants), supports=supports, energies=energies)
            values = checked_vectors("eigenvalues", data["eigenvalues"], data["eigenvalues"].shape)
            shape = (shell.rest_positions.size, values.size)
            modes = checked_vectors("modes", data["modes"], shape)
            rotations = checked_vectors("rotations", data["rotations"], shape)
            if values.ndim != 1 or not 0 <= int(data["rigid_modes"]) <= values.size:
                raise ValueError(f"{data['rigid_modes']} rigid modes of {values.size}")
            counts = (int(data["rigid_modes"]), float(data["residual"]), str(data["backend"]))
        except Exception as error:  # zip, zlib, OS, key, mesh and value errors all mean the same to the user
            raise FileFormatError(f"cannot read a saved basis from {file}: {shortened(str(error))}") from error
        return cls(shell, values, modes, rotations, *counts)


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
        stiffness, unsymmetric where they have no potential; forces by velocity, such as drag, are left out. About
        positions [m] alone loads count as dead.
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
        found, whole = _solved(shell, count, attachments, backend)
    else:
        if attachments is not None:
            raise OptionError("attachments are shapes about rest: leave them out, or about=")
        found, whole = loaded_modes(shell, about, count, backend)
    if whole < count:
        warnings.warn(
            f"mode {count} belongs to a repeated eigenvalue that the count of modes ({count}) cuts in two; ask for one "
            "or two modes more to hold its whole subspace",
            ModalShellWarning,
            stacklevel=2,
        )
    return found


def lowest_modes(shell: Shell, count: int) -> tuple[Basis, int]:
    """As :func:`solve_modes`; how many are of eigenspaces that ``count`` does not cut is returned, with no warning."""
    _checked_parts(shell, count, None)
    return _solved(shell, count, None, None)


def _solved(
    shell: Shell, count: int, attachments: Sequence[Load | ArrayLike] | None, backend: str | None
) -> tuple[Basis, int]:
    """The basis, and how many of its modes are of eigenspaces that ``count`` does not cut."""
    forces = attached_forces(shell, attachments)
    eigenvalues, free_modes, rigid_modes, residual, name, whole = eigenpairs(shell, count, backend)
    if forces.shape[1]:
        eigenvalues, free_modes = with_attachments(shell, eigenvalues, free_modes, forces, backend)
    modes = np.asarray(shell.unknowns.prolong(free_modes))
    rotations = shell.unknowns.turns(np.asarray(rotation_matrix(shell.mesh) @ modes))
    finite_answer("the modes", eigenvalues, modes, rotations)
    return Basis(shell, eigenvalues, read_only(modes), read_only(rotations), rigid_modes, residual, name), whole


def _checked_parts(shell: Shell, count: int, backend: str | None) -> None:
    """SupportError for parts that no support holds, OptionError for too many modes or an unknown ``backend``."""
    if fault := loose_parts_fault(shell.mesh, shell.unknowns.supported):
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
    told = f"{count} modes of {vertices} vertices" + (f" with {loose} rigid motions" if loose > 6 else "")
    demand_memory(told, size, "take fewer modes, a coarser mesh, or one part of it")
