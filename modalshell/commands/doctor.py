"""Diagnosis of the machine: versions, solvers, BLAS and its threads, renderer, and installed extras."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
import warnings
from dataclasses import dataclass

from threadpoolctl import threadpool_info

from modalshell.core.errors import ModalShellWarning
from modalshell.modes.factorisation import known_factorisations
from modalshell.render.backend import choose_backend, drawing_hint

_CORE = ("numpy", "scipy", "numba", "trimesh", "matplotlib")
_EXTRAS = {
    "vtk": ("pyvista", "windows to play scenes in, files for ParaView, pictures by OpenGL"),
    "web": ("trame", "scenes played in a browser"),
    "interchange": ("pxr", "motions as USD and glTF"),
    "msh": ("meshio", "meshes of Gmsh"),
    "remesh": ("pymeshlab", "meshes made coarser or finer"),
    "contact": ("ipctk", "shells that touch themselves and each other"),
    "gpu": ("warp", "springs and crowds on a GPU"),
    "mpi": ("petsc4py", "one sheet of springs over several processes"),
    "cluster": ("distributed", "sweeps over several machines"),
    "parquet": ("pyarrow", "the summary of a sweep as Parquet"),
    "symbolic": ("sympy", "generation of the energies' kernels"),
}


@dataclass(frozen=True)
class Reading:
    """One line of the diagnosis; ``hint`` says how to improve ``value`` and is empty if nothing is missing."""

    name: str
    value: str
    hint: str = ""


def examine() -> list[Reading]:
    """Examine the machine; rendering is tried in a child process, which takes a second."""
    packages = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in _CORE)
    readings = [
        Reading("machine", f"{platform.system()} on {platform.machine()}, {os.cpu_count()} cores"),
        Reading("python", platform.python_version()),
        Reading("packages", packages),
        Reading("factorisation", known_factorisations()),
        *_blas(),
        _drawing(),
    ]
    for extra, (module, gain) in _EXTRAS.items():
        here = importlib.util.find_spec(module) is not None
        hint = "" if here else f"pip install 'modalshell[{extra}]': {gain}"
        readings.append(Reading(f"extra {extra}", "installed" if here else "not installed", hint))
    return readings


def _blas() -> list[Reading]:
    """Each BLAS in this process, with its threads and the processor type that it detected."""
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
    """The renderer of this machine."""
    with warnings.catch_warnings(action="ignore", category=ModalShellWarning):
        renders = choose_backend() == "pyvista"
    return Reading("drawing", "PyVista" if renders else "built-in rasteriser", "" if renders else drawing_hint())
