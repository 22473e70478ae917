"""The dancer's clothes: tubes of rings around a vertical axis, in near-equilateral triangles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import PchipInterpolator

import modalshell as ms
from modalshell.core.typing import Array, Index

# Rings from the top: height z, half widths along x and y, shift along y [m].
HAT = (
    (2.06, 0.018, 0.018, 0.060), (1.97, 0.038, 0.036, 0.040), (1.82, 0.078, 0.080, 0.015), (1.71, 0.103, 0.112, 0.0),
    (1.675, 0.110, 0.120, 0.0), (1.665, 0.145, 0.155, 0.0), (1.660, 0.190, 0.200, 0.0), (1.665, 0.235, 0.245, 0.0),
)  # fmt: skip
TORSO = (
    (1.475, 0.066, 0.064, 0.0), (1.445, 0.120, 0.085, 0.0), (1.405, 0.175, 0.105, 0.0), (1.33, 0.182, 0.118, 0.0),
    (1.20, 0.158, 0.112, 0.0), (1.08, 0.140, 0.108, 0.0), (1.02, 0.160, 0.130, 0.0), (0.985, 0.184, 0.160, 0.0),
)  # fmt: skip
LEG = (
    (0.90, 0.080, 0.086, 0.0), (0.70, 0.082, 0.086, 0.0), (0.50, 0.070, 0.074, 0.0), (0.30, 0.072, 0.076, 0.0),
    (0.12, 0.112, 0.116, 0.0),
)  # fmt: skip


class Tube:
    """A tube of rings, each of as many vertices (a multiple of six, from 18 on) as its girth needs.

    Parameters
    ----------
    profile : sequence of (z, half width along x, half width along y, shift along y)
        From the top [m].
    spacing : float
        Wanted length of edges [m].
    shift : float
        Of the whole tube along x [m].
    """

    def __init__(
        self, profile: Sequence[tuple[float, float, float, float]], spacing: float, shift: float = 0.0
    ) -> None:
        points = np.array(profile)
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(points[:, 0]), np.diff(points[:, 1])))])
        rings = max(4, round(arc[-1] / (0.5 * np.sqrt(3.0) * spacing)) + 1)
        levels = PchipInterpolator(arc, points)(np.linspace(0.0, arc[-1], rings))
        girths = np.pi * (levels[:, 1] + levels[:, 2])
        self.heights: Array = levels[:, 0]
        self.counts: Index = 6 * np.maximum(3, np.rint(girths / spacing / 6.0)).astype(np.int64)
        self.starts: Index = np.concatenate([[0], np.cumsum(self.counts)[:-1]])
        places = []
        for ring, (z, wide, deep, back) in enumerate(levels):
            angle = self._angles(ring)[:-1]
            across = (shift + wide * np.cos(angle), back + deep * np.sin(angle))
            places.append(np.column_stack([*across, np.full(angle.size, z)]))
        faces = [face for ring in range(rings - 1) for face in self._band(ring)]
        self.mesh = ms.TriangleMesh(np.concatenate(places), np.array(faces))

    def _angles(self, ring: int) -> Array:
        """Angles around a ring [rad], the first once more at the end; every other ring starts half a cell later."""
        count = self.counts[ring]
        return np.asarray(2.0 * np.pi / count * (np.arange(count + 1) + 0.5 * (ring % 2)))

    def _band(self, ring: int) -> list[tuple[int, int, int]]:
        """Triangles between a ring and the next, closed like a zip: ahead goes the side whose next edge is behind."""
        upper, lower = self._angles(ring), self._angles(ring + 1)
        above, below = upper[1:] + upper[:-1], lower[1:] + lower[:-1]

        def corner(ring: int, place: int) -> int:
            return int(self.starts[ring] + place % self.counts[ring])

        i, j, faces = 0, 0, []
        while i < above.size or j < below.size:
            base = (corner(ring, i), corner(ring + 1, j))
            if j == below.size or (i < above.size and above[i] <= below[j]):
                i += 1
                faces.append((*base, corner(ring, i)))
            else:
                j += 1
                faces.append((*base, corner(ring + 1, j)))
        return faces

    def patch(self, height: float) -> Index:
        """Six vertices around the ring nearest to a height [m]: enough that no low mode ovals it unseen."""
        ring = int(np.argmin(np.abs(self.heights - height)))
        return self.starts[ring] + np.arange(0, self.counts[ring], self.counts[ring] // 6)
