"""Saving of trajectories; the file suffix selects the format."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError
from modalshell.core.typing import Progress
from modalshell.export.archive import save_archive
from modalshell.export.clip import save_clip
from modalshell.export.csv_tables import save_csv
from modalshell.export.gltf import save_gltf
from modalshell.export.point_cache import save_mdd, save_pc2
from modalshell.export.usd import save_usd
from modalshell.export.vtk import save_pvd, save_vtkhdf
from modalshell.motion import Trajectory
from modalshell.motion.trajectory import WRITERS

_FORMATS: dict[str, Callable[[Trajectory, Path, Progress], Path]] = {
    ".npz": lambda run, path, _: save_archive(run, path),
    ".vtkhdf": save_vtkhdf,
    ".pvd": save_pvd,
    ".csv": save_csv,
    ".clip": lambda run, path, _: save_clip(run, path),
    ".usdc": save_usd,
    ".usda": save_usd,
    ".glb": lambda run, path, _: save_gltf(run, path),
    ".pc2": lambda run, path, _: save_pc2(run, path),
    ".mdd": lambda run, path, _: save_mdd(run, path),
}
"""What writes each kind of file."""
_NEEDED = {
    "vtkhdf": ("vtkmodules", "VTK", "vtk"),
    "pvd": ("vtkmodules", "VTK", "vtk"),
    "usdc": ("pxr", "usd-core", "interchange"),
    "usda": ("pxr", "usd-core", "interchange"),
    "glb": ("pygltflib", "pygltflib", "interchange"),
}
"""Module that a format needs, the package that it is of, and the extra that brings it."""
_WITHOUT_FACES = (".npz", ".pc2", ".mdd")


def check_formats(formats: Iterable[str]) -> None:
    """Raise OptionError where a format needs a package that is not installed."""
    for kind in formats:
        module, package, extra = _NEEDED.get(kind, ("", "", ""))
        if module and importlib.util.find_spec(module) is None:
            raise OptionError(f"{kind} files need {package}, which is not installed: pip install 'modalshell[{extra}]'")


def save_trajectory(
    run: Trajectory, path: str | os.PathLike[str], *, on_frame: Callable[[int, int], None] | None = None
) -> Path:
    """Write a trajectory; the file appears only when it is complete.

    Parameters
    ----------
    run : Trajectory
        What to write.
    path : path
        Its suffix names the format: ``.npz`` (everything; read back by :func:`load_trajectory`), ``.vtkhdf`` (one
        file for ParaView 5.13 or later), ``.pvd`` (with a folder ``NAME_frames`` of VTP files, for any ParaView),
        ``.clip`` (small; read back by :func:`load_clip`), ``.usdc`` and ``.usda`` (USD), ``.glb`` (glTF with morph
        targets), ``.pc2`` and ``.mdd`` (point caches: positions alone), ``.csv`` (a table for spreadsheets of
        the vertices, and with fields ``NAME_triangles.csv`` of the triangles).
    on_frame : callable, optional
        Called with the frames done and their total while VTK, USD and CSV files are written.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    OptionError
        For another suffix, for a trajectory without faces where the format needs them, or if what writes the format is
        not installed.
    FileFormatError
        If the file cannot be written.
    """
    return checked_kind("run", run, Trajectory).save(path, on_frame=on_frame)


def _save(run: Trajectory, path: Path, on_frame: Progress) -> Path:
    """Write a format once all that it needs is there."""
    suffix = path.suffix
    if suffix not in _WITHOUT_FACES and len(run.faces) == 0:
        raise OptionError(f"{suffix} files need the triangles: give the trajectory its faces (simulate does)")
    check_formats([suffix[1:]])
    return _FORMATS[suffix](run, path, on_frame)


WRITERS.update(dict.fromkeys(_FORMATS, _save))
