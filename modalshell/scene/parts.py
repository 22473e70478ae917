"""Objects from the tables of a scene: mesh, material, path of the supports, forces, constraints."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from modalshell.core.checks import as_array, checked_times, checked_vectors, shortened, shown
from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.core.typing import Array
from modalshell.files.provenance import repository_file
from modalshell.mesh import TriangleMesh, cylinder_panel, flat_beam, leaf, load_mesh, paper_bird, sheet, v_beam
from modalshell.mesh.files import repair_mesh
from modalshell.mesh.parts import chosen_part
from modalshell.mesh.selection import selected
from modalshell.mesh.usd_files import USD
from modalshell.motion import SupportPath
from modalshell.motion.step_error import Tolerance
from modalshell.scene.index_files import read_numbers
from modalshell.scene.sheets import MaterialTable, SheetTable
from modalshell.scene.signatures import Built, signature_table
from modalshell.scene.tables import (
    Constrained,
    Force,
    MeshFile,
    MotionTable,
    Moved,
    PhysicalSheet,
    Stiffnesses,
    SupportList,
    Supports,
    Vector,
)
from modalshell.shell import Isotropic, Material, Sheet
from modalshell.shell.damping import Damping
from modalshell.supports.constraints import Constraint, OrientationConstraint, PositionConstraint


class Shape(Built, frozen=True, tag_field="shape"):
    """``[mesh]``: a generated shape and its parameters."""


SHAPES: dict[str, type[Shape]] = {
    function.__name__: signature_table(function, Shape, tag_field="shape", tag=function.__name__)
    for function in (flat_beam, v_beam, sheet, cylinder_panel, leaf, paper_bird)
}
"""Every shape by its name."""


def mesh_digest(mesh: TriangleMesh) -> str:
    """SHA-256 of a mesh's vertices and faces."""
    return hashlib.sha256(mesh.vertices.tobytes() + np.asarray(mesh.faces, dtype="<i8").tobytes()).hexdigest()


def build_mesh(table: MeshFile | Shape, folder: Path, metres: float = 1.0) -> TriangleMesh:
    """Build the mesh; files are searched in ``folder``, then among the bundled ones.

    ``metres`` is the scene's unit of length [m]: USD files alone state theirs, others are read as in the scene's.
    """
    if isinstance(table, Shape):
        return table.build()
    file = found_file(table.file, folder)
    unit = metres if file.suffix.lower() in USD else 1.0
    mesh = _read_mesh(table, file, None if table.join is None else unit * table.join)
    return mesh if unit == 1.0 else TriangleMesh(mesh.vertices / unit, mesh.faces)


def _read_mesh(table: MeshFile, file: Path, join: float | None) -> TriangleMesh:
    if not (table.repair or table.split):
        return chosen_part(load_mesh(file, up=table.up), table.component, join)
    mesh, report = repair_mesh(file, tolerance=join, component=table.component, split=table.split, up=table.up)
    if report.changed:
        warnings.warn(f"{file}: {'; '.join(report.messages)}", ModalShellWarning, stacklevel=3)
    return mesh


def found_file(name: str, folder: Path) -> Path:
    """A file of a scene in ``folder``, or among the bundled meshes."""
    file = folder / name
    return repository_file(name) if not file.exists() and name.startswith("meshes/") else file


def input_files(scene: Any) -> list[Path]:
    """Files that a scene reads: its own, those of its mesh and its colliders, and of its material's fields."""
    folder = scene.file.parent
    names = [getattr(scene.material, name, None) for name in ("young", "poisson", "thickness", "density")]
    names += [getattr(scene.mesh, "file", None), *(scene.rest.files if scene.rest else ())]
    names += [getattr(table, "file", None) for table in getattr(scene, "contacts", ())]
    return [scene.file, *(folder / name for name in names if isinstance(name, str))]


def build_material(table: MaterialTable, mesh: TriangleMesh, folder: Path) -> Material | Sheet:
    """The material on ``mesh``; files are looked for as those of meshes."""
    if isinstance(table, Stiffnesses):
        return Material(**table.plain())
    if isinstance(table, SheetTable):
        return table.sheet().on(mesh)
    values = material_values(table, folder)
    if not table.calibrated:
        return Isotropic(**values).on(mesh)
    for name, value in values.items():
        if np.ndim(value):
            raise OptionError(f"{name} must be one number where the material is calibrated: leave out calibrated")
    return Material.from_physical(**values, mesh=mesh)


def material_values(table: PhysicalSheet, folder: Path) -> dict[str, Any]:
    """Young's modulus, Poisson's ratio, thickness and density, each a number or (T,), files read."""
    values = {name: getattr(table, name) for name in ("young", "poisson", "thickness", "density")}
    for name, value in values.items():
        if isinstance(value, str):
            values[name] = file_numbers(name, value, folder)
    return values


def file_numbers(name: str, given: str, folder: Path) -> Array:
    """Numbers (T,) of the parameter ``name`` from a ``.npy`` file, or from text with one per line."""
    file = found_file(given, folder)
    try:
        return as_array(name, read_numbers(file, float), "real numbers", OptionError).astype(np.float64)
    except (ValueError, TypeError) as error:
        raise OptionError(
            f"{name} must be a number, one per triangle, or a readable file of these, .npy or text with one number "
            f"per line (got {shown(str(file))}: {shortened(str(error))})"
        ) from error


def build_path(declared: Supports | SupportList | None) -> SupportPath | None:
    """The path of the supports; None if they rest, or there are none."""
    table = declared.path if isinstance(declared, SupportList) else declared
    if table is None:
        return None
    if table.times is None:
        for key in ("translations", "rotations", "pivot"):
            if getattr(table, key) is not None:
                raise OptionError(f"{key} needs keyframe times: give times")
        return None
    return moved_path(table, "times need")


def moved_path(table: Moved | Supports, what: str) -> SupportPath:
    """The path through the keyframes of a table; OptionError that begins with ``what`` where nothing moves."""
    if table.translations is None and table.rotations is None:
        raise OptionError(f"{what} translations or rotations, one entry for each of times")
    times = table.times or []
    moved = np.zeros((len(times), 3)) if table.translations is None else table.translations
    return SupportPath(times, moved, table.rotations, pivot=table.pivot or (0.0, 0.0, 0.0))


def build_damping(table: MotionTable) -> Damping:
    """The damping of a motion, by its factors or by measured ratios; OptionError where it is declared twice."""
    given = [key for key in ("damping_ratios", "modal_damping") if getattr(table, key) is not None]
    if len(given) + any(table.damping) > 1:
        raise OptionError(f"{given[-1]} takes the place of other damping: leave one of them out")
    if table.damping_ratios is not None:
        return Damping.from_ratios(*table.damping_ratios)
    return Damping(*table.damping, tuple(table.modal_damping or ()))


def build_tolerance(table: MotionTable) -> Tolerance | None:
    """The error that the steps of a motion may make; None where its steps are taken whole."""
    return None if table.tolerance is None else Tolerance(table.tolerance, table.duration)


def spread_force(table: Force, mesh: TriangleMesh) -> Array:
    """The force (n, 3) [N] on every vertex, by its share of the selected area."""
    chosen = selected("where", table.where, mesh)
    areas = np.where(chosen, mesh.shared_among_corners(mesh.face_areas), 0.0)
    return areas[:, None] / areas.sum() * np.array(table.total)


def build_constraint(table: Constrained, mesh: TriangleMesh, moving: bool) -> Constraint:
    """Build the constraint; ``moving`` says whether the scene is a motion, so that targets can move."""
    if (table.vertices is None) == (table.nearest is None):
        raise OptionError("a constraint needs either vertices or nearest, and not both")
    if table.vertices is not None:
        vertices = [table.vertices] if isinstance(table.vertices, int) else table.vertices
        patch = np.flatnonzero(selected("vertices", vertices, mesh))
    else:
        patch = np.array([np.argmin(np.linalg.norm(mesh.vertices - np.array(table.nearest), axis=1))])
    if table.relative and table.kind == "orientation":
        raise OptionError("relative is for positions: an orientation is always relative to rest")
    origin = mesh.vertices[patch].mean(axis=0) if table.relative else np.zeros(3)
    make = PositionConstraint if table.kind == "position" else OrientationConstraint
    return make(patch, _target(table, origin, moving))


def _target(table: Constrained, origin: Array, moving: bool) -> Array | Callable[[float], Array]:
    """A fixed target or one through keyframes, ``origin`` added."""
    if (table.target is None) == (table.targets is None):
        raise OptionError("a constraint needs either target or targets, and not both")
    if table.target is not None:
        if table.times is not None:
            raise OptionError("times need targets, one entry each")
        return origin + np.array(table.target)
    if not moving:
        raise OptionError("targets that move need a [motion] table; give one target for an equilibrium")
    times, points = checked_keyframes(table.times, table.targets)
    spline: Any = None
    if table.path == "cubic":
        from scipy.interpolate import CubicSpline  # not before targets move: its import takes long

        spline = CubicSpline(times, points, bc_type="clamped")

    def at(time: float) -> Array:
        inside = float(np.clip(time, times[0], times[-1]))
        if spline is not None:
            return origin + spline(inside)
        return np.array([origin[axis] + np.interp(inside, times, points[:, axis]) for axis in range(3)])

    return at


def checked_keyframes(times: list[float] | None, targets: list[Vector] | None) -> tuple[Array, Array]:
    """Times (k,) and targets (k, 3) as arrays, or OptionError if the times are missing or do not increase."""
    if times is None:
        raise OptionError("targets need keyframe times: give times")
    moments = checked_times(times)
    return moments, checked_vectors("targets", targets, (moments.size, 3), OptionError)
