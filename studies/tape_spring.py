"""A tape spring: a quarter of a strip with a circular section, bent by a couple at a thick end block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import modalshell as ms

HALF = 4.0
"""Half of the length, in radii of the section."""
_BLOCK, _THICKER = 2, 10.0
"""Rows of cells of the end block, and how many times thicker it is."""
_BLEND = 1.5
"""Length over which the guess of a fold leads from the flat section to the round one, in radii."""


@dataclass(frozen=True)
class TapeSpring:
    """A quarter of a tape spring of unit radius, its middle at x = 0.

    Attributes
    ----------
    shell : Shell
        The shell.
    couple : ndarray, shape (n, 3)
        Forces along the axis at the end whose moment at rest is D alpha, half of that on the half width.
    watch : tuple
        The end's edge, and the direction in which a positive couple moves it.
    """

    shell: ms.Shell
    couple: np.ndarray
    watch: tuple[np.ndarray, tuple[float, float, float]]

    @property
    def end(self) -> np.ndarray:
        """Vertices of the end's edge (n,)."""
        return self.watch[0]


def tape_spring(*, angle: float, thickness: float, cells: tuple[int, int], poisson: float) -> TapeSpring:
    """A tape spring whose section subtends ``angle`` [rad], in radii of the section and Young's modulus 1."""
    flat = ms.flat_beam(length=HALF, width=0.5 * angle, cells=cells, family="union-jack")
    x, turn = flat.vertices[:, 0], flat.vertices[:, 1] - flat.vertices[:, 1].min()
    mesh = ms.TriangleMesh(np.column_stack([x, np.sin(turn), np.cos(turn)]), flat.faces)
    block = x[flat.faces].mean(axis=1) > HALF * (1.0 - _BLOCK / cells[0])
    sheet = ms.Isotropic(1.0, poisson, np.where(block, _THICKER * thickness, thickness), 1.0)
    middle = [int(np.argmin(x + turn))]
    planes = [ms.Symmetry(x < 1e-9, (1, 0, 0)), ms.Symmetry(turn < 1e-9, (0, 1, 0))]
    shell = ms.Shell(mesh, sheet, supports=[*planes, ms.Fix(middle, "z")])
    end = x > HALF - 1e-9
    share = np.where(end, np.where((turn < 1e-9) | (turn > turn.max() - 1e-9), 0.5, 1.0), 0.0)
    height = mesh.vertices[:, 2]
    force = share * (height - np.average(height, weights=share))
    stiffness = thickness**3 / (12.0 * (1.0 - poisson**2))
    couple = np.zeros_like(mesh.vertices)
    couple[:, 0] = -force / (force @ height) * 0.5 * stiffness * angle
    return TapeSpring(shell, couple, (end, (0.0, 0.0, 1.0)))


def moments(tape: TapeSpring, path: ms.EquilibriumPath) -> tuple[np.ndarray, np.ndarray]:
    """Moment over D alpha (k,) along a path, and the turn of its end (k,) [degrees]: with it the arms shrink."""
    rest = tape.shell.rest_positions
    unit = -float(tape.couple[:, 0] @ rest[:, 2])
    arms = -np.einsum("kn,n->k", path.positions[:, :, 2], tape.couple[:, 0]) / unit
    crown = np.flatnonzero(np.abs(rest[:, 1]) < 1e-9)
    inner, outer = crown[np.argsort(rest[crown, 0])][-2:]
    along = path.positions[:, outer] - path.positions[:, inner]
    return path.factors * arms, np.degrees(np.arctan2(along[:, 2], along[:, 0]))


def plateau_start(tape: TapeSpring, sense: float, turn: float) -> np.ndarray:
    """Guess (n, 3) of a folded tape spring whose end has turned by ``turn`` [rad].

    The section is flat and the axis bent to the section's radius in the middle; both go over to the shape at rest.
    """
    rest = tape.shell.rest_positions
    width = np.arctan2(rest[:, 1], rest[:, 2])
    grid = np.linspace(0.0, HALF, 4001)
    flat = np.clip((turn + 0.5 * _BLEND - grid) / _BLEND, 0.0, 1.0)
    flat = flat**2 * (3.0 - 2.0 * flat)

    def integral(values: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(grid))])

    slope = sense * integral(flat)
    axis_x, axis_z = integral(np.cos(slope)), integral(np.sin(slope))
    opened, tilt, along, up = (np.interp(rest[:, 0], grid, values) for values in (flat, slope, axis_x, axis_z))
    curvature = np.maximum(1.0 - opened, 1e-9)
    across = np.sin(width * curvature) / curvature
    below = (np.cos(width * curvature) - 1.0) / curvature
    return np.column_stack([along - below * np.sin(tilt), across, 1.0 + up + below * np.cos(tilt)])
