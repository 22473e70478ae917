"""What this machine brings: versions, solvers, the BLAS and its threads, what draws, and which extras are there."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import warnings
from dataclasses import dataclass

from threadpoolctl import threadpool_info

from modalshell.errors import ModalShellWarning
from modalshell.modes import BACKENDS
from modalshell.render.backend import choose_backend, drawing_hint

_CORE = ("numpy", "scipy", "numba", "trimesh", "matplotlib")
_EXTRAS = {
    "vtk": ("pyvista", "windows to play scenes in, files for ParaView, pictures by OpenGL"),
    "web": ("trame", "scenes played in a browser"),
    "interchange": ("pxr", "motions as USD and glTF"),
    "remesh": ("pymeshlab", "meshes made coarser or finer"),
    "gpu": ("warp", "springs and crowds on a GPU"),
    "mpi": ("petsc4py", "one sheet of springs over several processes"),
    "cluster": ("distributed", "sweeps over several machines"),
    "parquet": ("pyarrow", "the summary of a sweep as Parquet"),
    "symbolic": ("sympy", "generating the energies' kernels anew"),
}


@dataclass(frozen=True)
class Reading:
    """One line of what was found: ``value``, and in ``hint`` what would better it, empty where nothing would."""

    name: str
    value: str
    hint: str = ""


def examine() -> list[Reading]:
    """Read the machine; drawing is tried out in a child process, which takes a second."""
    packages = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _CORE)
    readings = [
        Reading("machine", f"{platform.system()} on {platform.machine()}, {os.cpu_count()} cores"),
        Reading("python", platform.python_version()),
        Reading("packages", packages),
        Reading("factorisation", ", ".join(BACKENDS)),
        *_blas(),
        _drawing(),
    ]
    for extra, (module, gain) in _EXTRAS.items():
        here = importlib.util.find_spec(module) is not None
        hint = "" if here else f"pip install 'modalshell[{extra}]': {gain}"
        readings.append(Reading(f"extra {extra}", "installed" if here else "not installed", hint))
    return readings


def _blas() -> list[Reading]:
    """Each BLAS in this process with its threads and the processor that it takes this one for."""
    readings = []
    for pool in threadpool_info():
        if pool["user_api"] == "blas":
            value = f"{pool['internal_api']} {pool['version']}, {pool['num_threads']} threads"
            value += f", tuned for {pool['architecture']}" if pool.get("architecture") else ""
            hint = ""
            if pool["num_threads"] > 1:
                hint = "OPENBLAS_NUM_THREADS=1 is faster for small matrices and on a shared machine"
            readings.append(Reading("BLAS", value, hint))
    return readings


def _drawing() -> Reading:
    """Which library draws shapes here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)
        renders = choose_backend() == "pyvista"
    return Reading("drawing", "PyVista" if renders else "built-in rasteriser", "" if renders else drawing_hint())
