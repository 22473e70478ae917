"""Colours of a motion: a field of its triangles, or the displacement, at the vertices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.core.units import with_unit
from modalshell.motion.trajectory import Trajectory
from modalshell.shell.fields import FIELDS, TENSORS, scalar_of, vertex_means

DISPLACEMENT = "displacement"
"""Colour of films, pictures and pages that is no field of the triangles."""


@final
@dataclass(frozen=True)
class Colouring:
    """Values (F, n) at the vertices that colour a motion, their name with its unit, and a colour map."""

    values: Array
    label: str
    colormap: str

    @classmethod
    def of(cls, run: Trajectory, name: str) -> Colouring:
        """The field of a trajectory, averaged over the triangles at each vertex by their area at rest."""
        if name == DISPLACEMENT:
            moved = np.linalg.norm(np.asarray(run.positions, dtype=np.float64) - run.rest_positions, axis=2)
            return cls(moved, with_unit(name, run.units.of("m")), "viridis")
        values = vertex_means(scalar_of(name, run.fields[name]), run.rest_positions, run.faces)
        label = with_unit(name.replace("_", " ").replace("mises", "Mises"), run.units.of(FIELDS[name]))
        return cls(values, label, "coolwarm" if name in TENSORS else "viridis")

    def spread(self, frames: int | slice = slice(None)) -> tuple[float, float]:
        """Values of some frames at the ends of the colour map: about zero for fields of either sign."""
        low, high = float(self.values[frames].min()), float(self.values[frames].max())
        if self.colormap == "coolwarm":
            high = max(abs(low), abs(high))
            return -high, high
        return low, high
