"""Film frames of a flight: levels of detail, positions, and a report on their error and cost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Array
from modalshell.crowd.flight import Flight
from modalshell.crowd.scene import FlockTable
from modalshell.crowd.shell_crowd import LEVELS
from modalshell.models import RotationStrain


@dataclass(frozen=True)
class FlightReport:
    """What a flight cost, and what its levels of detail show."""

    birds: int
    vertices: int
    """Number of birds, and of vertices of one."""
    shares: dict[str, float]
    """Part of the birds' frames at each level; "RSW" is the part with any share of it, counted in its own level too."""
    allowed_pixels: float
    """Largest distance allowed between a vertex as drawn and its position by MWTS [pixels]."""
    largest_error: float
    """That distance, largest over all frames [m]."""
    largest_pixels: float
    """The same as it is seen: over the distance of its bird times the focal length [pixels]."""
    strains_jump_pixels: float
    """Largest motion that a change of RSW's share caused between two frames [pixels]."""
    switches: int
    """How often a bird changed its level."""
    seconds_steps: float
    """Time spent in stepping boids and shells [s]."""


class FlightFilm:
    """Frames of a flight as a camera sees them: levels of detail, positions, and what these cost.

    The flight's state is overwritten.
    """

    def __init__(self, table: FlockTable, flight: Flight) -> None:
        self._flight, self._detail, camera = flight, table.detail, table.camera
        self._camera = camera
        self._focal = 0.5 * camera.size[1] / math.tan(0.5 * math.radians(camera.view_angle))
        crowd = flight.crowd
        rest = crowd.basis.shell.rest_positions
        self._radius = float(np.linalg.norm(rest, axis=1).max())
        self._strains = RotationStrain(crowd.basis) if self._detail.strains_within else None
        self._out = np.empty((crowd.count, crowd.vertices, 3), crowd.dtype)
        self._before: dict[str, NDArray[Any]] = {}
        self._counts, self._frames = np.zeros(len(LEVELS) + 1), 0
        self._errors = {"metres": 0.0, "pixels": 0.0, "jump": 0.0}
        self._switches = 0

    def choose_levels(self) -> None:
        """Levels of detail at the present state."""
        self._flight.crowd.choose_levels(self._distances(), self._detail.pixels / self._focal)

    def shift(self) -> Array:
        """How far the camera has gone along with the flock at the present state (3,) [m]."""
        if not self._camera.follow:
            return np.zeros(3)
        return np.asarray(self._flight.flock.positions.mean(axis=0) - self._camera.target)

    def positions(self) -> NDArray[Any]:
        """Vertex positions (B, n, 3) [m] at the present state; overwritten by the next call."""
        flock, crowd = self._flight.flock, self._flight.crowd
        frames, distances = self._flight.frames, self._distances()
        out = crowd.positions(frames, flock.positions, self._out)
        shares, gaps = np.zeros(crowd.count), np.zeros(crowd.count)
        if self._strains is not None:
            # One within the distance, zero beyond half as much again; smooth at both ends.
            part = np.clip(3.0 - 2.0 * distances / self._detail.strains_within, 0.0, 1.0)
            shares = part**2 * (3.0 - 2.0 * part)
            gaps = crowd.blend_strains(self._strains, shares, out, frames, flock.positions)
        self._note(distances, shares, gaps)
        return out

    def _distances(self) -> Array:
        """Lower bound of the distance from the camera to each bird's vertices, at least a tenth of a bird."""
        away = np.linalg.norm(self._flight.flock.positions - self._camera.position - self.shift(), axis=1)
        return np.maximum(away - self._radius, 0.1 * self._radius)

    def _note(self, distances: Array, shares: Array, gaps: Array) -> None:
        crowd = self._flight.crowd
        errors = crowd.level_errors()
        jumps = np.abs(shares - self._before.get("shares", shares)) * np.maximum(gaps, self._before.get("gaps", gaps))
        found = {"metres": errors, "pixels": self._focal * errors / distances, "jump": self._focal * jumps / distances}
        self._errors = {name: max(value, float(found[name].max())) for name, value in self._errors.items()}
        self._switches += int((crowd.levels != self._before.get("levels", crowd.levels)).sum())
        self._before = {"levels": crowd.levels.copy(), "shares": shares, "gaps": gaps}
        self._counts += [*np.bincount(crowd.levels, minlength=len(LEVELS)), np.count_nonzero(shares)]
        self._frames += 1

    def report(self, seconds_steps: float) -> FlightReport:
        """The report on the frames so far."""
        crowd = self._flight.crowd
        parts = self._counts / (crowd.count * self._frames)
        return FlightReport(
            birds=crowd.count,
            vertices=crowd.vertices,
            shares=dict(zip((*LEVELS, RotationStrain.name), parts.tolist(), strict=True)),
            allowed_pixels=self._detail.pixels,
            largest_error=self._errors["metres"],
            largest_pixels=self._errors["pixels"],
            strains_jump_pixels=self._errors["jump"],
            switches=self._switches,
            seconds_steps=seconds_steps,
        )
