"""Cameras that frame given points exactly, the same for both renderers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.errors import OptionError

VIEW_ANGLE = math.radians(22.0)
_MARGIN = 0.06
"""Free part of a picture at each side."""
NEAREST = 1e-9
"""Distance from the camera, as a share of that of its target, below which nothing is drawn nearer."""


@dataclass(frozen=True)
class Camera:
    """A camera that looks along minus its third axis."""

    axes: NDArray[np.float64]
    """Rows: unit vectors to the right, up and from target to camera. Shape (3, 3)."""
    center: NDArray[np.float64]
    """Target point in these axes [m]; shape (3,)."""
    distance: float
    """From target to camera [m]."""
    slope: float
    """Tangent of half the vertical view angle."""
    aspect: float
    """Width over height of the picture."""

    @property
    def target(self) -> NDArray[np.float64]:
        """Point looked at [m], shape (3,)."""
        return np.asarray(self.center @ self.axes, dtype=np.float64)

    @property
    def position(self) -> NDArray[np.float64]:
        """Position of the camera [m], shape (3,)."""
        return np.asarray(self.target + self.distance * self.axes[2], dtype=np.float64)

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points (n, 3) [m] to picture coordinates in [-1, 1] and the height towards the camera [m], (n, 3)."""
        local = points @ self.axes.T - self.center
        reach = self.slope * np.maximum(self.distance - local[:, 2], NEAREST * self.distance)
        return np.column_stack([local[:, 0] / (reach * self.aspect), local[:, 1] / reach, local[:, 2]])


def camera_axes(direction: ArrayLike) -> NDArray[np.float64]:
    """Build the rows right, up, backward from the direction target to camera, with z (or else y) up."""
    backward = np.asarray(direction, dtype=np.float64)
    backward = backward / np.linalg.norm(backward)
    upright = np.array([0.0, 0.0, 1.0]) if abs(backward[2]) < 0.999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(upright, backward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(backward, right), backward])


def look_at(position: ArrayLike, target: ArrayLike, view_angle: float, aspect: float) -> Camera:
    """A perspective camera at a ``position`` (3,) [m] that looks at a ``target`` elsewhere.

    ``view_angle`` [rad] is the vertical one, ``aspect`` the picture's width over its height.
    """
    goal = np.asarray(target, dtype=np.float64)
    backward = np.asarray(position, dtype=np.float64) - goal
    distance = float(np.linalg.norm(backward))
    if not distance > 0.0:
        raise OptionError(f"a camera needs a target away from its position (got {position!r} for both)")
    axes = camera_axes(backward)
    return Camera(axes, axes @ goal, distance, math.tan(0.5 * view_angle), aspect)


def frame_points(
    points: NDArray[np.float64],
    direction: ArrayLike,
    aspect: float,
) -> Camera:
    """A camera so placed that the points (n, 3) [m] just fill the picture but for a margin.

    ``direction`` (3,) is from target to camera, ``aspect`` the picture's width over its height.
    """
    axes = camera_axes(direction)
    local = points @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    center = 0.5 * (low + high)
    span = max(float(np.max(high - low)), 1e-9 * float(np.abs(local).max())) or 1.0
    slope = math.tan(0.5 * VIEW_ANGLE)
    free = 1.0 - 2.0 * _MARGIN
    # Smallest distance at which every point lies in the cone; the best offset across has a closed form.
    needed = [float(high[2]) + 0.05 * span]
    for axis, tangent in ((0, free * slope * aspect), (1, free * slope)):
        plus = float(np.max(local[:, 2] + local[:, axis] / tangent))
        minus = float(np.max(local[:, 2] - local[:, axis] / tangent))
        center[axis] = 0.5 * tangent * (plus - minus)
        needed.append(0.5 * (plus + minus))
    return Camera(axes, center, max(needed) - float(center[2]), slope, aspect)
