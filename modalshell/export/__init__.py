"""Trajectory files: NumPy archives, clips, VTK files, and formats of animation programs."""

from modalshell.export.archive import load_trajectory
from modalshell.export.clip import load_clip
from modalshell.export.compression import compress
from modalshell.export.gltf import save_modes_gltf
from modalshell.export.modal_exchange import save_modal_body
from modalshell.export.save import check_formats, save_trajectory

__all__ = [
    "check_formats",
    "compress",
    "load_clip",
    "load_trajectory",
    "save_modal_body",
    "save_modes_gltf",
    "save_trajectory",
]
