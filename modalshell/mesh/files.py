"""Reading and writing of mesh files, through trimesh."""

from __future__ import annotations

import codecs
import errno
import io
import logging
import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from modalshell.core.checks import checked_choice, checked_folder, checked_kind, shown
from modalshell.core.errors import FileFormatError, MeshError, ModalShellWarning, OptionError
from modalshell.core.single_precision import lost_in_single_precision
from modalshell.core.typing import Array, Index
from modalshell.core.units import LENGTHS
from modalshell.files.atomic_io import write_bytes
from modalshell.files.outputs import SIGNATURE
from modalshell.files.regular import read_regular
from modalshell.mesh import validation
from modalshell.mesh.file_checks import check_gltf
from modalshell.mesh.msh_files import MSH, read_msh
from modalshell.mesh.parts import Component
from modalshell.mesh.polygon_files import read_obj, read_off, read_ply, read_stl
from modalshell.mesh.polygons import Polygons
from modalshell.mesh.repair import RepairReport, repair
from modalshell.mesh.triangle_mesh import TriangleMesh
from modalshell.mesh.unjoined import warn_of_unjoined
from modalshell.mesh.usd_files import USD, read_usd, usd_up
from modalshell.mesh.welding import drop_unused, weld_arrays

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it logs tracebacks of files that it then reads

READABLE = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf", MSH, *USD)
POLYGONS = {".obj": read_obj, ".off": read_off, ".ply": read_ply, ".stl": read_stl}
"""Readers of formats that hold polygons or triangles alone."""
WRITABLE = (".obj", ".ply", ".stl", ".off", ".glb")
_CAD = (".step", ".stp", ".iges", ".igs", ".brep")
Up = Literal["x", "y", "z"]
"""Axes of a file that may point up."""
_GLTF = (".glb", ".gltf")
_WELDED = (".stl", *_GLTF, *USD)
"""Formats in which triangles may each have vertices of their own."""
_TURNED: dict[str, tuple[list[int], list[float]]] = {
    "x": ([2, 1, 0], [-1.0, 1.0, 1.0]),
    "y": ([0, 2, 1], [1.0, -1.0, 1.0]),
}
"""Axes of the file, and their signs, that become x, y and z."""


def up_axis(path: str | os.PathLike[str], up: Up | None = None) -> Up:
    """The axis of a mesh file that points up: ``up`` if it is given, by definition y in glTF, as stated in USD, else z.

    OptionError for another axis; MeshError for a USD file that cannot be read.
    """
    if up is not None:
        checked_choice("up", up, ("x", "y", "z"))
        return up
    file = Path(path)
    if file.suffix.lower() in USD and file.is_file():  # of a missing file the reader says so
        try:
            return "y" if usd_up(file) == "y" else "z"
        except MeshError as error:
            raise _located(file, error) from error
    return "y" if Path(path).suffix.lower() in _GLTF else "z"


def up_as_text(path: str | os.PathLike[str], up: Up | None = None) -> str:
    """The axis that points up, as text."""
    axis = up_axis(path, up)
    if axis == "z":
        return "z is up" if up or up_axis(path) != "z" else "z is up (`--up y` for files of Blender and its like)"
    return f"{axis} is up in the file and was rotated to z"


def load_mesh(path: str | os.PathLike[str], *, up: Up | None = None, unit: str | None = None) -> TriangleMesh:
    """Read a triangle mesh from an OBJ, PLY, STL, OFF, GLB, glTF, USD or MSH (Gmsh) file.

    Polygons are split into triangles and the parts of a scene are joined. Materials, normals and texture coordinates
    are ignored, so texture seams of an OBJ do not cut the shell. Coincident vertices of STL, glTF and USD are merged.
    Vertices in no face are dropped with a warning.

    Parameters
    ----------
    path : path
        The file; its suffix names the format. Coordinates of USD are converted to metres from the unit that the file
        states.
    up : str, optional
        Axis of the file that points up, "x", "y" or "z", which is rotated to z; by default y for glTF, as it is
        defined, that which a USD file states, else z.
    unit : str, optional
        Unit of the file's coordinates, which are converted to metres: "m", "cm", "mm", "um", "km", "in" or "ft"; by
        default they are taken as they are. STL, OBJ, PLY, OFF and MSH state none, and those of CAD are mostly in mm.

    Returns
    -------
    TriangleMesh
        The mesh.

    Raises
    ------
    MeshError
        When the file cannot be read or holds no valid shell; names the file, the fault and the first offending
        indices, counted from 0 in the file's own order.
    OptionError
        For another axis or unit, or a unit for a USD file.
    """
    file = checked_folder("path", path)
    polygons = read_polygons(file, up, unit)
    try:
        vertices = validation.as_vertices(polygons.vertices)
        faces = validation.as_faces(polygons.triangles(), len(vertices))
        polygons.refuse_crossed(faces)
        vertices, faces = _without_unused(file, vertices, faces)
        if file.suffix.lower() in _WELDED:
            vertices, faces = _weld(file, vertices, faces)
        mesh = TriangleMesh(vertices, faces)
    except MeshError as error:
        raise _located(file, error, split=bool((polygons.sizes > 3).any())) from error
    warn_of_unjoined(mesh, str(file))
    return mesh


def repair_mesh(
    path: str | os.PathLike[str],
    *,
    tolerance: float | None = None,
    component: Component | None = None,
    split: bool = False,
    up: Up | None = None,
    unit: str | None = None,
) -> tuple[TriangleMesh, RepairReport]:
    """Apply :func:`~modalshell.repair` to a file of a format that :func:`load_mesh` reads; same parameters."""
    file = checked_folder("path", path)
    polygons = read_polygons(file, up, unit)
    try:
        mesh, report = repair(polygons.vertices, polygons, tolerance=tolerance, component=component, split=split)
    except MeshError as error:
        raise _located(file, error, split=True) from error
    warn_of_unjoined(mesh, str(file))
    return mesh, report


def read_polygons(file: Path, up: Up | None = None, unit: str | None = None) -> Polygons:
    """Vertices, z up, and polygons of a mesh file in its own order; MeshError if it is not of its suffix's format.

    Coordinates in ``unit`` are converted to metres; OptionError for one that is not known, or that USD states itself.
    """
    axis = up_axis(file, up)
    metres = 1.0 if unit is None else LENGTHS[checked_choice("unit", unit, tuple(LENGTHS))]
    if unit is not None and file.suffix.lower() in USD:
        raise OptionError(f"unit must be left out for USD files, which state theirs (got {unit!r} for {file})")
    polygons = _read_as_stored(file)
    if polygons.vertices.ndim != 2 or polygons.vertices.shape[1] != 3:
        return polygons
    if metres != 1.0:
        polygons = replace(polygons, vertices=polygons.vertices * metres)
    if axis == "z":
        return polygons
    order, signs = _TURNED[axis]
    return replace(polygons, vertices=polygons.vertices[:, order] * signs)


def _read_as_stored(file: Path) -> Polygons:
    suffix = _check_suffix(file, READABLE, "read")
    try:
        data = read_regular(file)
    except ValueError as error:
        raise MeshError(f"{shown(str(file))}: no path of a file ({error}); check the path") from error
    except FileNotFoundError as error:
        raise _absent(file) from error
    except OSError as error:
        raise MeshError(f"{file}: cannot be read ({error.strerror}); give a readable file") from error
    data = data.removeprefix(codecs.BOM_UTF8)
    if not data.strip():
        raise MeshError(f"{file}: the file is empty; write or download the mesh again")
    try:
        if suffix in USD:
            return read_usd(file)
        if suffix == MSH:
            return read_msh(file, data)
        if suffix in POLYGONS:
            return POLYGONS[suffix](data)
        check_gltf(data)
        loaded = _trimesh_load(file, data, suffix)
        faces = np.asarray(loaded.faces, dtype=np.int64)
        if len(faces) == 0:
            read = f"{len(loaded.vertices)} vertices read"
            raise MeshError(f"the file has no faces ({read}); a shell needs triangles")
        return Polygons(np.asarray(loaded.vertices, dtype=np.float64), faces.ravel(), np.full(len(faces), 3))
    except MeshError as error:
        raise _located(file, error) from error


def _located(file: Path, error: MeshError, split: bool = False) -> MeshError:
    """The error with the file's name, and a note on how its indices are counted."""
    text = str(error)
    note = ""
    if file.suffix.lower() == ".obj" and "counted from 0" in text and not text.startswith("line"):
        note = " (an OBJ file itself counts from 1: add one)"
    if split and "face" in text:
        note += " (faces are counted after larger polygons were split into triangles)"
    return MeshError(f"{file}: {text}{note}")


def save_mesh(mesh: TriangleMesh, path: str | os.PathLike[str]) -> None:
    """Write a mesh to an OBJ, PLY, STL, OFF or GLB file, replacing an existing one.

    OBJ, OFF and PLY keep every bit of the coordinates; STL and GLB hold float32 by their definition, and STL forgets
    the numbering of the vertices.

    Parameters
    ----------
    mesh : TriangleMesh
        The mesh.
    path : path
        The file; its suffix selects the format.

    Raises
    ------
    MeshError
        For another suffix, if the file cannot be written, or where float32 loses the shape far from the origin.
    """
    checked_kind("mesh", mesh, TriangleMesh)
    file = Path(path)
    suffix = _check_suffix(file, WRITABLE, "write")
    held = lost_in_single_precision(mesh.vertices) if suffix in (".stl", ".glb") else ""
    if held:
        raise MeshError(f"{file}: {suffix[1:].upper()} files hold {held}: move the mesh near the origin, or write PLY")
    if suffix in (".obj", ".off"):
        data = _text(mesh, suffix).encode()
    elif suffix == ".ply":
        data = _binary_ply(mesh)
    else:
        import trimesh

        upright = mesh.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0] if suffix == ".glb" else mesh.vertices  # y is up
        plain = trimesh.Trimesh(upright, mesh.faces, process=False)
        exported = plain.export(file_type=suffix[1:])
        data = exported if isinstance(exported, bytes) else str(exported).encode()
    try:
        if file.exists() and not file.is_file():
            raise OSError(errno.EINVAL, "it is no regular file")
        if not file.parent.is_dir():
            raise OSError(errno.ENOENT, "there is no such folder")
        write_bytes(file, data)
    except FileFormatError as error:
        raise MeshError(str(error)) from error
    except ValueError as error:
        raise MeshError(f"{shown(str(file))}: no path of a file ({error}); check the path") from error
    except OSError as error:
        raise MeshError(f"{file}: cannot be written ({error.strerror}); give a path in an existing folder") from error


def _check_suffix(file: Path, known: tuple[str, ...], verb: str) -> str:
    suffix = file.suffix.lower()
    if suffix not in known:
        if verb == "read":
            _check_presence(file)
        if suffix == ".toml":
            raise MeshError(f"{file}: a scene, where a mesh is expected: `modalshell run` and `advise` take scenes")
        if suffix in _CAD:
            raise MeshError(
                f"{file}: surfaces of CAD without triangles, where a mesh is expected: mesh the surface in the middle "
                "of its sheets (in Gmsh: gmsh -2) and save it as .msh, .stl or .ply"
            )
        raise MeshError(
            f"{file}: cannot {verb} files with suffix {file.suffix!r}; expected one of {', '.join(known)}: convert the "
            "mesh or rename the file"
        )
    return suffix


def _check_presence(file: Path) -> None:
    """MeshError where no file has that name, whatever its suffix."""
    try:
        file.stat()
    except FileNotFoundError as error:
        raise _absent(file) from error
    except (OSError, ValueError):  # what is wrong is said where it is read
        return


def _absent(file: Path) -> MeshError:
    return MeshError(f"{file}: no such file; check the path (working folder: {Path.cwd()})")


def _beside(file: Path) -> Any:
    """Give trimesh access to regular files in the folder of ``file``."""
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):
        def get(self, name: str) -> bytes:
            folder = Path(os.path.abspath(self.parent))
            path = Path(os.path.normpath(folder / name.strip()))
            if not path.is_relative_to(folder):
                raise ValueError(f"{name!r} lies outside the mesh's own folder")
            return read_regular(path)

    return Beside(str(file))


def _trimesh_load(file: Path, data: bytes, suffix: str) -> Any:
    import trimesh

    options: dict[str, Any] = {"process": False, "maintain_order": True, "skip_materials": True}
    try:
        with warnings.catch_warnings(action="ignore"):
            if suffix == ".gltf":  # its buffers lie in files beside it
                options["resolver"] = _beside(file)
            return trimesh.load_mesh(io.BytesIO(data), file_type=suffix[1:], **options)
    except Exception as error:  # trimesh's readers raise whatever their parsing met: IndexError, KeyError, struct.error
        reason = f"{type(error).__name__}: {error}".splitlines()[0][:200]
        raise MeshError(
            f"the file is damaged, cut short or not {suffix[1:].upper()} (the reader stopped with {reason}); write or "
            "download it again, or convert it to OBJ"
        ) from error


def _weld(file: Path, vertices: Array, faces: Index) -> tuple[Array, Index]:
    welded, kept, dropped = weld_arrays(vertices, faces)
    if dropped:
        warnings.warn(
            f"{file}: dropped {dropped} of {len(faces)} triangles that collapsed when coincident vertices were merged; "
            "repair the file to silence this",
            ModalShellWarning,
            stacklevel=3,
        )
    return welded, kept


def _without_unused(file: Path, vertices: Array, faces: Index) -> tuple[Array, Index]:
    unused = validation.unused_vertices(faces, len(vertices))
    if len(unused):
        # Checked before vertices are renumbered, so that an error names the file's own indices.
        validation.check_faces(vertices, faces)
        faces, _ = validation.paired_edges(faces, len(vertices))
        vertices, faces = drop_unused(vertices, faces)
        warnings.warn(
            f"{file}: dropped {len(unused)} vertices that are in no face, first vertex {unused[0]} (counted from 0): "
            "those after it get other numbers; remove them from the file to silence this",
            ModalShellWarning,
            stacklevel=3,
        )
    return vertices, faces


def _text(mesh: TriangleMesh, suffix: str) -> str:
    """Coordinates in Python's shortest form that reads back to the same float64."""
    obj = suffix == ".obj"
    points = [" ".join(map(repr, p)) for p in mesh.vertices.tolist()]
    faces = [" ".join(map(str, f)) for f in (mesh.faces + int(obj)).tolist()]
    if obj:
        lines = [f"{SIGNATURE}; metres", *(f"v {p}" for p in points), *(f"f {f}" for f in faces)]
    else:
        lines = ["OFF", f"{len(points)} {len(faces)} {len(mesh.edges)}", *points, *(f"3 {f}" for f in faces)]
    return "\n".join(lines) + "\n"


def _binary_ply(mesh: TriangleMesh) -> bytes:
    """Binary PLY in double precision: trimesh writes single."""
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment written by modalshell; metres\n"
        f"element vertex {len(mesh.vertices)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(mesh.faces), dtype=[("count", "<u1"), ("index", "<i4", (3,))])
    rows["count"], rows["index"] = 3, mesh.faces
    return header.encode() + mesh.vertices.astype("<f8").tobytes() + rows.tobytes()
