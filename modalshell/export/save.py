"""One door for saving trajectories: the suffix names the format."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterable
from pathlib import Path

from modalshell.errors import OptionError
from modalshell.export.archive import save_archive
from modalshell.export.vtk import save_pvd, save_vtkhdf
from modalshell.motion import Trajectory

_SUFFIXES = (".npz", ".vtkhdf", ".pvd")


def check_formats(formats: Iterable[str]) -> None:
    """Raise OptionError where a format needs VTK and VTK is not installed."""
    wanted = {"vtkhdf", "pvd"} & set(formats)
    if wanted and importlib.util.find_spec("vtkmodules") is None:
        raise OptionError(f"{sorted(wanted)[0]} files need VTK, which is not installed: pip install 'modalshell[vtk]'")


def save_trajectory(
    run: Trajectory, path: str | os.PathLike[str], *, on_frame: Callable[[int, int], None] | None = None
) -> Path:
    """Write a trajectory; the file appears only when it is complete.

    Parameters
    ----------
    run : Trajectory
        What to write.
    path : path
        Ends in ``.npz`` (everything; read back by :func:`load_trajectory`), ``.vtkhdf`` (one file for ParaView 5.13 or
        later) or ``.pvd`` (with a folder ``NAME_frames`` of VTP files beside it, for any ParaView).
    on_frame : callable, optional
        Called with the frames done and their total while VTK files are written.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    OptionError
        For another suffix, or if VTK files are asked of a trajectory without faces, or VTK is not installed.
    FileFormatError
        If VTK cannot write.
    """
    target = Path(path)
    if target.suffix not in _SUFFIXES:
        raise OptionError(f"a trajectory is saved as {', '.join(_SUFFIXES)} (got {target.name!r})")
    if target.suffix == ".npz":
        return save_archive(run, target)
    if len(run.faces) == 0:
        raise OptionError("VTK files need the triangles: give the trajectory its faces (simulate does)")
    check_formats([target.suffix[1:]])
    return (save_vtkhdf if target.suffix == ".vtkhdf" else save_pvd)(run, target, on_frame)
