"""Small scenes that many tests share: shells of one material, grids of springs, and the text of scene files."""

import contextlib
import copy
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np

import modalshell as ms
from modalshell.shell.kernels.generated import flexure
from modalshell.springs import SheetGrid

PLAIN = ms.Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2)


class Made(Mapping):
    """Things by name, each made when it is first asked for and then kept: collecting the tests makes none."""

    def __init__(self, makers):
        self._makers = {name: cache(make) for name, make in makers.items()}

    def __getitem__(self, name):
        return self._makers[name]()

    def __iter__(self):
        return iter(self._makers)

    def __len__(self):
        return len(self._makers)


# ---- shells


def held(mesh, below=None, material=PLAIN):
    """The mesh's shell, clamped where x is less than ``below`` [m]; free without it."""
    return ms.Shell(mesh, material, None if below is None else mesh.vertices[:, 0] < below)


def cantilever(cells=(12, 4), **shape):
    """A V-beam of 1 m, clamped by its first two rows of vertices."""
    return held(ms.v_beam(cells=cells, **shape), 1.5 / cells[0])


def strip(cells=(6, 2), below=None):
    """A flat strip of 1 m x 0.2 m, free or clamped where x is less than ``below`` [m]."""
    return held(ms.flat_beam(cells=cells), below)


def sheet_strip(cells=(16, 2)):
    """A strip of shell theory 1 m long, clamped at an end, that bends far under its weight."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
    return ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0), clamped="x < 1e-6")


def leaf(cells=(8, 6), clamped=None):
    """A leaf, free unless some vertices are ``clamped``."""
    return ms.Shell(ms.leaf(cells=cells), PLAIN, clamped)


def jittered(cells=(8, 6), length=0.3, width=0.2):
    """A flat sheet whose inner vertices lie up to a fifth of a cell beside their places."""
    mesh = ms.sheet(length=length, width=width, cells=cells, family="alternating")
    points = np.array(mesh.vertices)
    inner = np.setdiff1d(np.arange(len(points)), mesh.boundary_vertices)
    cell = np.array([length / cells[0], width / cells[1]])
    points[inner, :2] += np.random.default_rng(0).uniform(-0.2, 0.2, (inner.size, 2)) * cell
    return ms.TriangleMesh(points, mesh.faces)


SHELLS = Made(
    {
        "clamped v_beam": lambda: cantilever((10, 4)),
        "free leaf": leaf,
        "free cylinder": lambda: held(ms.cylinder_panel(cells=(6, 5), angle=100.0)),
        "hinged leaf": lambda: leaf(clamped=[0]),
    }
)
"""Shells with none, six and three rigid modes."""

# ---- hinges


def hinge_mesh(angle, apex=(0.3, 1.1), other=(0.7, -0.8)):
    """Two triangles over the edge (0,0,0)-(1,0,0); the second turned about x by ``angle``."""
    vertices = [
        (0.0, 0.0, 0.0),
        (1.0, 0.0, 0.0),
        (*apex, 0.0),
        (other[0], other[1] * np.cos(angle), other[1] * np.sin(angle)),
    ]
    return np.array(vertices), np.array([[0, 1, 2], [1, 0, 3]])


def noisy(mesh, x, noise, seed=0):
    return x + noise * mesh.edge_lengths.min() * np.random.default_rng(seed).standard_normal(x.shape)


def folds(mesh, x):
    out = np.empty(len(mesh.hinges))
    flexure.measures(np.ascontiguousarray(x), mesh.hinges, out)
    return out


# ---- springs


def grid_of(shape=(6, 8), pins=(), **changes):
    pinned = np.zeros(shape, bool)
    for pin in pins:
        pinned[pin] = True
    values = {"spacing": 0.1, "particle_mass": 0.01, "structural": 50.0, "shear": 20.0, "flexion": 8.0}
    return SheetGrid(shape=shape, pinned=pinned, **(values | changes))


def grid_mesh(grid):
    index = np.arange(grid.count).reshape(grid.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    return ms.TriangleMesh(grid.rest_positions(), np.vstack([np.c_[a, b, c], np.c_[b, d, c]]))


def grid_model(grid, **options):
    """The grid's springs and masses as a SpringSheet."""
    shell = ms.Shell(grid_mesh(grid), ms.Material(1.0, 1.0, 1.0, 1.0), clamped=grid.pinned.ravel())
    shell.mass = np.full(grid.count, grid.particle_mass)
    return ms.SpringSheet(shell, grid.springs(), **options)


def shaken(grid, size, seed=0):
    noise = size * np.random.default_rng(seed).standard_normal((grid.count, 3))
    noise[grid.pinned.ravel()] = 0.0
    return grid.rest_positions() + noise


# ---- scene files


def beam_text(cells=12, clamped="x < 0.1", prefix=""):
    """Mesh, material and supports of a V-beam; the last table is that of the supports."""
    return f"""
[{prefix}mesh]
shape = "v_beam"
cells = [{cells}, 4]
[{prefix}material]
stretch = 20.0
shear = 20.0
flexure = 0.05
density = 0.2
[{prefix}supports]
clamped = "{clamped}"
"""


def stiff_beam_text(cells=20):
    """The same of a V-beam of a stiff membrane, which snaps; ``cells`` along, two rows of vertices held."""
    return f"""
[mesh]
shape = "v_beam"
fold = 150.0
cells = [{cells}, {cells // 5}]
[material]
stretch = 2000.0
shear = 2000.0
flexure = 0.05
density = 0.2
[supports]
clamped = "x < {1.0 / cells + 1e-3:g}"
"""


SWEPT_BEAM = (
    beam_text(prefix="scene.")
    + """[scene.model]
name = "mwts"
[scene.motion]
duration = {duration}
dt = 0.01
damping = [0.1, 0.0]
"""
)
"""The scene within a sweep's file."""

TINY_BEAM = """
name = "beam"
mesh = {shape = "v_beam", cells = [2, 2]}
material = {stretch = 20.0, shear = 20.0, flexure = 0.05, density = 0.2}
supports = {clamped = "x < 0.6"}
"""
"""The smallest beam, in lines that leave room for tables."""

LOADED_BEAM = (
    beam_text(8, "x < 0.13")
    + """[loads]
gravity = [0.0, 0.0, -4.0]
[[loads.forces]]
where = "x > 0.9"
total = [0.0, 0.0, -0.01]
[model]
name = "mwts"
modes = 4
"""
)
"""A scene that a sweep varies by ``SWEEP_AXES``."""

GRAVITIES = '"loads.gravity" = [[0, 0, -1], [0, 0, -2]]\n'
SWEEP_AXES = GRAVITIES + '"model.name" = ["lma", "mwts", "ds"]\n'


def stopped_and_resumed(scene, folder, stop_at):
    """Results of a scene's run: whole, and stopped as ``stop_at`` steps are done and then resumed."""

    def stop(done, _):
        if done == stop_at:
            raise KeyboardInterrupt

    whole = ms.run_scene(scene, out=folder / "whole")
    with contextlib.suppress(KeyboardInterrupt):
        ms.run_scene(scene, out=folder / "stopped", on_step=stop)
        raise AssertionError(f"not stopped after {stop_at} steps")
    return whole, ms.run_scene(scene, out=folder / "stopped")


def with_rest_angles(shell, change):
    """The shell with the rest angles of its hinges moved by ``change`` (H,) [rad]."""
    bent = copy.copy(shell)
    energy = bent._energy = copy.copy(shell._energy)
    if isinstance(shell.material, ms.Isotropic):
        own = {tuple(hinge): at for at, hinge in enumerate(shell.mesh.hinges.tolist())}
        moved = [change[own[tuple(hinge)]] if tuple(hinge) in own else 0.0 for hinge in energy._folds.hinges.tolist()]
        energy._rest_angles = energy._rest_angles + np.array(moved)
    else:
        hinges = energy.elements[2]
        energy.elements = list(energy.elements)
        energy.elements[2] = replace(hinges, rest=hinges.rest + change)
    return bent


def timed(measured, milliseconds=1.0, **costs):
    """What was measured, with frames of other times, and of other counted costs by label."""
    rows = [
        replace(row, frame_ms=milliseconds, work=replace(row.work, cost=costs.get(row.label, row.cost)))
        for row in measured.rows
    ]
    return replace(measured, rows=sorted(rows, key=lambda row: row.cost))
