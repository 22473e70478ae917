"""Reading of USD stages: every mesh in its place, in metres, with the axis that points up (extra ``interchange``)."""

from __future__ import annotations

import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from modalshell.core.checks import shortened
from modalshell.core.errors import MeshError, ModalShellWarning
from modalshell.core.typing import Array, Index
from modalshell.mesh.polygons import Polygons

USD = (".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of USD files."""
_MOST_MESHES = 20_000


def usd_up(file: Path) -> str:
    """The axis of a stage that points up: "y" or "z"; y by definition where none is authored."""
    stage = _opened(file)
    from pxr import UsdGeom

    return str(UsdGeom.GetStageUpAxis(stage)).lower()


def read_usd(file: Path) -> Polygons:
    """Vertices [m] and polygons of all meshes of a stage, joined, at its first time; axes are those of the file.

    Lengths are converted by the stage's ``metersPerUnit``, by definition 0.01 where none is authored. Meshes that
    the stage makes invisible, and those that only guide or stand in for others, are left out; instances are in.
    Left-handed meshes are turned over. Of subdivision surfaces the control mesh is taken, with a warning.
    """
    try:
        return _read(file)
    except MeshError:
        raise
    except Exception as error:  # errors of the composition, of decoding and of conversion all mean the same to the user
        raise _damaged(error) from error


def _read(file: Path) -> Polygons:
    from pxr import Usd, UsdGeom

    stage = _opened(file)
    metres = float(UsdGeom.GetStageMetersPerUnit(stage))
    if not (np.isfinite(metres) and metres > 0.0):
        raise MeshError(f"the stage's metersPerUnit must be above 0 (got {metres:g}); author another")
    start = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() else 0.0
    places = UsdGeom.XformCache(Usd.TimeCode(start))
    points: list[Array] = []
    corners: list[Index] = []
    sizes: list[Index] = []
    smooth, offset, skipped = 0, 0, 0
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.PointInstancer):
            raise MeshError(f"{prim.GetPath()} is a point instancer, which is not read; export its copies as meshes")
        if not prim.IsA(UsdGeom.Mesh):
            skipped += prim.IsA(UsdGeom.Gprim)
            continue
        mesh = UsdGeom.Mesh(prim)
        shown = UsdGeom.Imageable(prim)
        if shown.ComputePurpose() in ("guide", "proxy") or shown.ComputeVisibility(start) == "invisible":
            continue
        own, indices, counts = _arrays(mesh, start, str(prim.GetPath()))
        if not len(counts):
            continue
        scheme = mesh.GetSubdivisionSchemeAttr()
        # By definition a mesh without one is Catmull-Clark: it counts where it is the file's own choice.
        smooth += scheme.Get() not in ("none", None) and bool(scheme.HasAuthoredValue())
        matrix = np.array(places.GetLocalToWorldTransform(prim), dtype=np.float64)
        turned = (mesh.GetOrientationAttr().Get() == "leftHanded") != (np.linalg.det(matrix[:3, :3]) < 0.0)
        points.append(own @ matrix[:3, :3] + matrix[3, :3])
        corners.append((_reversed(indices, counts) if turned else indices) + offset)
        sizes.append(counts)
        offset += len(own)
        if len(points) > _MOST_MESHES:
            raise MeshError(f"the stage has more than {_MOST_MESHES} meshes; join them into one mesh")
    if not points:
        others = f"; its {skipped} other shapes (spheres, curves, ...) are not read: convert them to meshes"
        raise MeshError(f"the stage has no visible mesh with faces{others if skipped else ''}")
    if smooth:
        warnings.warn(
            f"{file}: {smooth} of {len(points)} meshes are subdivision surfaces, of which the control mesh is taken",
            ModalShellWarning,
            stacklevel=4,
        )
    return Polygons(metres * np.concatenate(points), np.concatenate(corners), np.concatenate(sizes))


def _opened(file: Path) -> Any:
    try:
        from pxr import Usd
    except ImportError:
        raise MeshError(
            "USD files need usd-core, which is not installed: pip install 'modalshell[interchange]', or convert the "
            "mesh to OBJ"
        ) from None
    try:
        if file.suffix.lower() == ".usdz":
            _check_package(file)
        return Usd.Stage.Open(str(file))
    except Exception as error:  # Tf.ErrorException, and what the decoding of its own text raises
        raise _damaged(error) from error


def _check_package(file: Path) -> None:
    """ValueError where the parts of a package do not match their checksums: the library may not end on such a one."""
    with zipfile.ZipFile(file) as package:
        if (damaged := package.testzip()) is not None:
            raise ValueError(f"{damaged} does not match its checksum")
        if any(part.compress_type != zipfile.ZIP_STORED for part in package.infolist()):
            raise ValueError("parts of a USD package must be stored without compression")


def _arrays(mesh: Any, start: float, name: str) -> tuple[Array, Index, Index]:
    """Points (n, 3), corners and sizes of one mesh, without its holes; MeshError where they do not fit together."""
    attributes = (mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr(), mesh.GetFaceVertexCountsAttr())
    values = [attribute.Get(start) for attribute in attributes]
    if any(value is None for value in values):
        return np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    points = np.array(values[0], dtype=np.float64).reshape(-1, 3)
    corners, counts = (np.array(value, dtype=np.int64).ravel() for value in values[1:])
    if len(counts) and (counts.min() < 3 or counts.sum() != len(corners)):
        raise MeshError(
            f"mesh {name}: faceVertexCounts must be 3 or more and add up to the {len(corners)} faceVertexIndices "
            f"(got a least count of {counts.min()} and a sum of {counts.sum()}); export the mesh again"
        )
    if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise MeshError(
            f"mesh {name}: faceVertexIndices must be from 0 to {len(points) - 1} (got {corners.min()} to "
            f"{corners.max()}); export the mesh again"
        )
    holes = np.array(mesh.GetHoleIndicesAttr().Get(start) or (), dtype=np.int64)
    if holes.size:
        kept = np.ones(len(counts), dtype=np.bool_)
        kept[holes[(holes >= 0) & (holes < len(counts))]] = False
        corners, counts = corners[np.repeat(kept, counts)], counts[kept]
    return points, corners, counts


def _reversed(corners: Index, counts: Index) -> Index:
    """The corners of all polygons in the other sense, each from its first corner."""
    first = np.repeat(np.cumsum(counts) - counts, counts)
    step = np.arange(len(corners)) - first
    return np.asarray(corners[first + (np.repeat(counts, counts) - step) % np.repeat(counts, counts)])


def _damaged(error: Exception) -> MeshError:
    try:
        text = str(error)
    except UnicodeDecodeError:  # the reader quotes the file's own bytes
        text = "bytes that are no text"
    reasons = re.findall(r" : '(.*?)'?\s*$", text, re.MULTILINE)  # without the lines of the reader's own source
    reason = shortened(reasons[0] if reasons else text.strip(), 160)
    return MeshError(
        f"the file is damaged, cut short or not USD (the reader stopped with {reason}); write or download it again, or "
        "convert it to OBJ"
    )
