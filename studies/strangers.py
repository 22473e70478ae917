"""Meshes that other people made: files in installed packages, and what other packages generate."""

from __future__ import annotations

import importlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from modalshell.mesh.files import READABLE

OWN = {"modalshell"}
"""Distributions whose meshes are no strangers."""
LARGEST_FILE = 3_000_000
"""Bytes of a file, at most: about 30,000 triangles of an ASCII STL of many digits, 60,000 of a binary one."""
Polygons = tuple[Any, Iterable[Sequence[int]]]
"""Vertices (n, 3) and polygons."""


class Stranger(NamedTuple):
    """A mesh file.

    Attributes
    ----------
    name : str
        Package and file or shape.
    path : Path
        The file.
    """

    name: str
    path: Path


def installed_files(per_package: int) -> list[Stranger]:
    """Mesh files of the installed packages, at most ``count`` of each, from as many of its folders as it has."""
    found = []
    known: set[tuple[str, int]] = set()
    for package in sorted(distributions(), key=lambda one: one.name.lower()):
        folders: dict[tuple[str, ...], list[Path]] = defaultdict(list)
        for entry in package.files or ():
            if entry.suffix.lower() in READABLE and package.name not in OWN:
                path = Path(str(entry.locate()))
                copy = (path.name, path.stat().st_size if path.is_file() else 0)
                if 0 < copy[1] <= LARGEST_FILE and copy not in known:
                    known.add(copy)
                    folders[entry.parts[:2] if len(entry.parts) > 2 else entry.parts[:1]].append(path)
        chosen: list[Path] = []
        while folders and len(chosen) < per_package:
            for key in spread(sorted(folders), per_package - len(chosen)):
                files = sorted(folders[key], key=lambda path: (path.stat().st_size, path.name))
                chosen.append(files[len(files) // 2])
                folders[key].remove(chosen[-1])
                if not folders[key]:
                    del folders[key]
        found += [Stranger(f"{package.name}: {path.name}", path) for path in sorted(chosen)]
    return found


def spread(items: Sequence[Any], count: int) -> list[Any]:
    """At most ``count`` of the items, evenly."""
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int))]


def generated(folder: Path, per_package: int, only: str | None = None) -> list[Stranger]:
    """Shapes that installed packages (``only`` one) generate, at most ``per_package``, written to ``folder`` as OBJ."""
    found = []
    for package, shapes in GENERATORS.items():
        if only not in (None, package):
            continue
        try:
            module = importlib.import_module(package)
        except ImportError:
            continue
        for name, make in spread(sorted(shapes(module).items()), per_package):
            vertices, polygons = polygons_of(make())
            path = folder / f"{package}_{name}.obj"
            lines = ["v " + " ".join(map(repr, point)) for point in np.asarray(vertices, dtype=float).tolist()]
            lines += ["f " + " ".join(str(int(corner) + 1) for corner in polygon) for polygon in polygons]
            path.write_text("\n".join(lines) + "\n", encoding="ascii")
            found.append(Stranger(f"{package}: {name}", path))
    return found


def polygons_of(made: Any) -> Polygons:
    """Vertices and polygons of what a package generates: its own pair, a mesh of trimesh, or data of pyvista."""
    if isinstance(made, tuple):
        return made
    if hasattr(made, "vertices"):
        return made.vertices, made.faces
    surface = made.extract_surface(algorithm=None)
    if surface.n_strips:
        surface = surface.triangulate()
    flat, at, rows = np.asarray(surface.faces), 0, []
    while at < len(flat):
        rows.append(flat[at + 1 : at + 1 + flat[at]].tolist())
        at += 1 + int(flat[at])
    return surface.points, rows


def _of_trimesh(module: Any) -> dict[str, Callable[[], Any]]:
    creation = importlib.import_module("trimesh.creation")

    def slices() -> Polygons:
        """A capsule without a band of faces, which leaves two open parts."""
        mesh = module.creation.capsule()
        height = mesh.triangles_center[:, 2]
        return mesh.vertices, mesh.faces[np.abs(height - np.median(height)) > 0.1 * np.ptp(height)]

    return {
        "annulus": partial(creation.annulus, r_min=0.5, r_max=1.0, height=0.3),
        "axis": creation.axis,
        "box": creation.box,
        "capsule": creation.capsule,
        "cone": partial(creation.cone, radius=1.0, height=2.0),
        "cylinder": partial(creation.cylinder, radius=1.0, height=2.0),
        "icosphere": creation.icosphere,
        "sliced capsule": slices,
        "soup": partial(creation.random_soup, face_count=30),
        "torus": partial(creation.torus, major_radius=1.0, minor_radius=0.3),
        "uv sphere": creation.uv_sphere,
    }


def _of_pyvista(module: Any) -> dict[str, Callable[[], Any]]:
    solids = ("Arrow", "Capsule", "Disc", "SolidSphere", "Superquadric", "Tube")
    names = [name for name in dir(module) if name.startswith("Parametric") or name in solids]
    return {name: getattr(module, name) for name in names} | {
        "contour of a wavelet": lambda: module.Wavelet().contour([150.0]),
        "Text3D": lambda: module.Text3D("shell"),
        "globe": lambda: importlib.import_module("pyvista.examples").load_globe(),
    }


def _of_skimage(module: Any) -> dict[str, Callable[[], Any]]:
    del module
    measure = importlib.import_module("skimage.measure")

    def gyroid() -> Polygons:
        x, y, z = 2.0 * np.pi * np.mgrid[0:1:28j, 0:1:28j, 0:1:28j]
        field = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
        return tuple(measure.marching_cubes(field, 0.0)[:2])

    return {"gyroid": gyroid}


GENERATORS: dict[str, Callable[[Any], dict[str, Callable[[], Any]]]] = {
    "trimesh": _of_trimesh,
    "pyvista": _of_pyvista,
    "skimage": _of_skimage,
}
"""Shapes by name of each package that generates some."""
