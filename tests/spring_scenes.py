"""Grids of springs, and the same as a shell's model, for the tests of springs."""

import numpy as np

import modalshell as ms
from modalshell.springs import SheetGrid


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
