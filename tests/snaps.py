"""V-beams of stiff membrane, their motions through a snap and back, and the errors of these."""

import numpy as np

import modalshell as ms
from modalshell.models.coarse.coarse_mesh import drawn_to_supports
from modalshell.models.coarse.coarse_shell import coarse_shell

LOADED, RELEASED, DT = 30, 15, 1 / 30


def snapping_beam(fold, cells, below=None, width=0.2):
    """A V-beam, held where x is less than ``below`` [m], by default by its first two rows of vertices."""
    mesh = ms.v_beam(length=1.0, width=width, fold=fold, cells=cells)
    material = ms.Material(2000.0, 2000.0, 0.05, 0.2)
    return ms.Shell(mesh, material, mesh.vertices[:, 0] < (below or 1.5 / cells[0]))


def coarse_beam(fine, fold, cells, width=0.2):
    """The same beam on fewer cells."""
    return coarse_shell(fine, drawn_to_supports(fine, ms.v_beam(length=1.0, width=width, fold=fold, cells=cells)))


def snapping_loads(shell, gravity):
    """Gravity [m/s^2] 15 degrees aside, and downwards, twice as strong on one edge as on the other: (n, 3) each."""
    tilt, y = np.radians(15.0), np.array(shell.rest_positions)[:, 1:2]
    aside = np.array(shell.gravity_force((0.0, gravity * np.sin(tilt), -gravity * np.cos(tilt))))
    return aside, np.array(shell.gravity_force((0.0, 0.0, -gravity))) * (1.0 + y / (3.0 * np.abs(y).max()))


def frames_through(model, load, damping):
    """Positions (f, n, 3) of a motion under a load and after it."""
    state, found = model.start_motion(), []
    for frame in range(LOADED + RELEASED):
        state, solved = model.step(state, DT, load if frame < LOADED else np.zeros_like(load), damping)
        assert solved
        found.append(np.array(model.positions(state)))
    return np.array(found)


def motion_error(shell, frames, exact):
    """Error of a motion over its size."""
    return np.linalg.norm(frames - exact) / np.linalg.norm(exact - np.array(shell.rest_positions))
