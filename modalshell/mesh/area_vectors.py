"""What meshes and pictures need of triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array


def area_vectors(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """Vectors (T, 3) along the normals of triangles, twice their areas [m^2] long."""
    corners = vertices[faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
