"""Trajectories as files: NumPy archives that load lazily, and VTK files for ParaView."""

from modalshell.export.archive import load_trajectory, save_archive
from modalshell.export.save import check_formats, save_trajectory

__all__ = ["check_formats", "load_trajectory", "save_archive", "save_trajectory"]
