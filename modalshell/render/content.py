"""Content of pictures: surfaces grouped into views, and the checks of their input."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import shown
from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import make_folder

Style = Literal["surface", "outline"]
Color = str | tuple[float, float, float]
_HEXADECIMAL = re.compile("#[0-9a-fA-F]{6}")

# From target to camera: a three-quarter view with the x axis across the picture and z up.
DEFAULT_CAMERA = (0.6, -1.0, 0.9)


@dataclass
class ShadedSurface:
    """One triangle surface and how it is painted."""

    vertices: ArrayLike
    """Positions [m]; shape (n, 3)."""
    faces: ArrayLike
    """Vertex indices of each triangle; shape (T, 3)."""
    color: Color = "#8fb3d9"
    """A matplotlib colour: a name, ``"#rrggbb"`` or three numbers in [0, 1]."""
    opacity: float = 1.0
    """In (0, 1]; 1 is opaque."""
    scalars: ArrayLike | None = None
    """Values that colour the surface in place of `color`; shape (n,)."""
    label: str | None = None
    """Entry in the legend; with scalars, the title of the colour bar."""
    edges: bool = False
    """Draw the sides of every triangle."""
    smooth: bool = False
    """Shade with averaged vertex normals; leave off for folded shells, whose ridges it would blur."""
    style: Style = "surface"
    """``"surface"``, or ``"outline"`` (border, creases and contour only)."""
    lined: bool = True
    """Draw border, creases and contour over the style ``"surface"``; leave off for small things and shadows."""
    framed_in: NDArray[np.float64] | None = None
    """Lower and upper corner of a box [m]: what lies beyond it does not widen the picture; shape (2, 3)."""

    def framed(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the camera is to show of ``positions`` (..., n, 3) [m] of its vertices, as points (k, 3)."""
        points = positions.reshape(-1, 3)
        return points if self.framed_in is None else np.clip(points, *self.framed_in)

    def __post_init__(self) -> None:
        """Check and convert the arrays."""
        self.vertices = checked_positions(self.vertices, "vertices")
        self.faces = checked_faces(self.faces, len(self.vertices))
        if not (isinstance(self.opacity, int | float) and 0.0 < self.opacity <= 1.0):
            raise OptionError(f"opacity must lie in (0, 1] (got {self.opacity!r})")
        if self.style not in get_args(Style):
            raise OptionError(f"style must be one of {get_args(Style)} (got {self.style!r})")
        if self.scalars is not None:
            values = np.asarray(self.scalars, dtype=np.float64)
            expected = (len(self.vertices),)
            if values.shape != expected:
                raise OptionError(f"scalars must have shape {expected}, one value per vertex (got {values.shape})")
            if not np.isfinite(values).all():
                raise OptionError(f"scalars must be finite (vertex {int(np.argmin(np.isfinite(values)))} is not)")
            self.scalars = values


@dataclass
class View:
    """One cell of a picture."""

    surfaces: Sequence[ShadedSurface]
    """What is drawn, at least one surface."""
    title: str | None = None
    subtitle: str | None = None
    """Text above the cell."""
    camera: tuple[float, float, float] = DEFAULT_CAMERA
    """Direction from the target to the camera, of any length; z points up in the picture."""

    def __post_init__(self) -> None:
        """Check the cell."""
        self.surfaces = list(self.surfaces)
        if not self.surfaces or not all(isinstance(surface, ShadedSurface) for surface in self.surfaces):
            raise OptionError("a View needs at least one ShadedSurface, and nothing else, in its surfaces")
        self.camera = checked_direction(self.camera)


def checked_positions(values: ArrayLike, name: str, frames: bool = False) -> NDArray[np.float64]:
    """Return positions as float64 of shape (n, 3), or (F, n, 3) with `frames`; refuse what is not finite."""
    expected = "(F, n, 3)" if frames else "(n, 3)"
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise OptionError(f"{name} must be numbers of shape {expected} (got {error})") from error
    if array.ndim != (3 if frames else 2) or array.shape[-1] != 3 or array.size == 0:
        raise OptionError(f"{name} must have shape {expected} and not be empty (got {array.shape})")
    finite = np.isfinite(array).all(axis=-1)
    if not finite.all():
        where = [int(index) for index in np.argwhere(~finite)[0]]
        place = f"frame {where[0]}, vertex {where[1]}" if frames else f"vertex {where[0]}"
        raise OptionError(f"{name} must be finite (first fault at {place}: got {array[tuple(where)].tolist()})")
    return array


def checked_faces(values: ArrayLike, vertex_count: int) -> NDArray[np.int64]:
    """Return triangles as int64 of shape (T, 3) whose indices lie in [0, `vertex_count`)."""
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0 or not np.issubdtype(array.dtype, np.integer):
        raise OptionError(f"faces must be integers of shape (T, 3), T > 0 (got {array.dtype} of shape {array.shape})")
    outside = ((array < 0) | (array >= vertex_count)).any(axis=1)
    if outside.any():
        first = int(np.argmax(outside))
        raise OptionError(f"faces must index 0 to {vertex_count - 1} (face {first} is {array[first].tolist()})")
    return array.astype(np.int64)


def checked_direction(values: Any) -> tuple[float, float, float]:
    """Return a camera direction as three finite numbers that are not all zero."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (3,) or not np.isfinite(array).all() or not array.any():
        raise OptionError(f"camera must be three finite numbers, not all zero (got {shown(values)})")
    return float(array[0]), float(array[1]), float(array[2])


def checked_size(size: tuple[int, int], even: bool = False) -> tuple[int, int]:
    """Return a picture size in pixels, (width, height), each from 64 to 8192 and even where a film needs it."""
    values = tuple(size)
    if len(values) != 2 or not all(isinstance(value, int | np.integer) and 64 <= value <= 8192 for value in values):
        raise OptionError(f"size must be (width, height) in whole pixels from 64 to 8192 (got {shown(size)})")
    if even and any(value % 2 for value in values):
        raise OptionError(f"the size of a film must be even in both directions for H.264 (got {shown(size)})")
    return int(values[0]), int(values[1])


def checked_path(path: str | Path, suffix: str) -> Path:
    """Return the path of a file to be written, whose folder is made where it is missing."""
    target = Path(path)
    if target.suffix.lower() != suffix:
        raise OptionError(f"the file name must end in {suffix} (got {str(path)!r})")
    make_folder(target.parent)
    return target


def rgb(color: Color) -> NDArray[np.float64]:
    """Turn a matplotlib colour into three numbers in [0, 1]."""
    if isinstance(color, str) and _HEXADECIMAL.fullmatch(color):
        return np.array([int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
    from matplotlib.colors import to_rgb  # not before there is a name: its import takes long

    try:
        return np.array(to_rgb(color), dtype=np.float64)
    except ValueError as error:
        raise OptionError(
            f"color must be a matplotlib colour, 'tab:blue' or '#8fb3d9' say (got {shown(color)})"
        ) from error
