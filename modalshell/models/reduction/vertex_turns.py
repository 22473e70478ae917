"""Turns of a mesh's vertices from where they are, by an edge and the normal of each."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.thread_safety import read_only_view
from modalshell.core.typing import Array
from modalshell.kernels.compiler import njit
from modalshell.mesh import TriangleMesh

_TINY = 1e-300


@final
class VertexTurns:
    """Turns of a mesh's vertices from their positions ``rest`` (n, 3) [m]."""

    def __init__(self, mesh: TriangleMesh, rest: Array) -> None:
        self._faces = mesh.faces
        self._neighbour = np.zeros(len(rest), dtype=np.int64)
        ends = mesh.edges
        self._neighbour[ends[:, 0]], self._neighbour[ends[:, 1]] = ends[:, 1], ends[:, 0]
        self._rest = np.empty((len(rest), 3, 3))
        _frames(read_only_view(rest), self._faces, self._neighbour, self._rest)

    def vectors(self, x: Array) -> Array:
        """Rotation vectors (n, 3) [rad] at positions x (n, 3)."""
        frames, out = np.empty_like(self._rest), np.empty((len(self._rest), 3))
        _frames(read_only_view(x), self._faces, self._neighbour, frames)
        _turns(frames, self._rest, out)
        return out


@njit(entry=True, error_model="numpy", fastmath=False)
def _frames(x, faces, neighbour, out):  # type: ignore[no-untyped-def]
    """Axes ``out`` (n, 3, 3), as columns: along an edge, across it, and along the normal."""
    out[:] = 0.0
    for t in range(faces.shape[0]):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            part = (x[b, j] - x[a, j]) * (x[c, k] - x[a, k]) - (x[b, k] - x[a, k]) * (x[c, j] - x[a, j])
            out[a, i, 2] += part
            out[b, i, 2] += part
            out[c, i, 2] += part
    for v in range(out.shape[0]):
        frame, w = out[v], neighbour[v]
        size = max(np.sqrt(frame[0, 2] ** 2 + frame[1, 2] ** 2 + frame[2, 2] ** 2), _TINY)
        along = 0.0
        for i in range(3):
            frame[i, 2] /= size
            along += (x[w, i] - x[v, i]) * frame[i, 2]
        square = 0.0
        for i in range(3):
            frame[i, 0] = x[w, i] - x[v, i] - along * frame[i, 2]
            square += frame[i, 0] ** 2
        for i in range(3):
            frame[i, 0] /= max(np.sqrt(square), _TINY)
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            frame[i, 1] = frame[j, 2] * frame[k, 0] - frame[k, 2] * frame[j, 0]


@njit(entry=True, error_model="numpy", fastmath=False)
def _turns(frames, rest, out):  # type: ignore[no-untyped-def]
    """Rotation vectors ``out`` (n, 3) that take axes at rest to those of ``frames``, both (n, 3, 3)."""
    turn, quaternion = np.empty((3, 3)), np.empty(4)
    for v in range(out.shape[0]):
        for i in range(3):
            for j in range(3):
                turn[i, j] = frames[v, i, 0] * rest[v, j, 0]
                turn[i, j] += frames[v, i, 1] * rest[v, j, 1] + frames[v, i, 2] * rest[v, j, 2]
        # Of the quaternion the largest component comes first: no digits are lost near half a turn.
        trace = turn[0, 0] + turn[1, 1] + turn[2, 2]
        largest, value = 3, trace
        for i in range(3):
            if turn[i, i] > value:
                largest, value = i, turn[i, i]
        if largest == 3:
            quaternion[3] = 1.0 + trace
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                quaternion[i] = turn[k, j] - turn[j, k]
        else:
            i = largest
            j, k = (i + 1) % 3, (i + 2) % 3
            quaternion[i] = 1.0 + 2.0 * turn[i, i] - trace
            quaternion[j], quaternion[k] = turn[j, i] + turn[i, j], turn[k, i] + turn[i, k]
            quaternion[3] = turn[k, j] - turn[j, k]
        if quaternion[3] < 0.0:
            for i in range(4):
                quaternion[i] = -quaternion[i]
        sine = np.sqrt(quaternion[0] ** 2 + quaternion[1] ** 2 + quaternion[2] ** 2)
        size = np.sqrt(sine**2 + quaternion[3] ** 2)
        angle = 2.0 * np.arctan2(sine, quaternion[3])
        factor = angle / sine if sine > 1e-12 * size else 2.0 / max(quaternion[3], _TINY)
        for i in range(3):
            out[v, i] = factor * quaternion[i]
