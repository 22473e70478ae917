"""Meshes with junctions: those of the study, and a Moebius strip."""

import numpy as np

import modalshell as ms
from studies.frame_meshes import cellular_box, frame, joined, strip

__all__ = ["cellular_box", "frame", "joined", "moebius", "strip"]


def moebius(count=24, rows=3, width=0.3, radius=1.0):
    """A Moebius strip: its triangles cannot all be wound alike."""
    turn = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    across = np.linspace(-0.5, 0.5, rows + 1) * width
    ring = radius + across * np.cos(turn / 2.0)[:, None]
    height = across * np.sin(turn / 2.0)[:, None]
    points = np.stack([ring * np.cos(turn)[:, None], ring * np.sin(turn)[:, None], height], axis=2).reshape(-1, 3)

    def number(i, j):
        return (i * (rows + 1) + j) if i < count else rows - j

    faces = []
    for i in range(count):
        for j in range(rows):
            a, b, c, d = number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)
            faces += [[a, b, c], [a, c, d]]
    return ms.TriangleMesh(points, faces)
