"""What is known of the vertices and triangles of a frame, by name, with units, as files of it hold it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from modalshell.motion import Trajectory
from modalshell.shell.fields import FIELDS, TENSORS

_IN_SPACE = ("x", "y", "z")
_COMPONENTS = dict.fromkeys(TENSORS, ("11", "22", "12")) | {"von_mises_faces": ("top", "bottom")}


@final
@dataclass(frozen=True)
class FrameArray:
    """Values (n,) or (n, k) of a frame."""

    name: str
    unit: str
    """What they are; a number without a dimension has the unit ""."""
    values: NDArray[Any]
    """One row for each vertex or triangle; shape (n,) or (n, k)."""
    components: tuple[str, ...] = ()
    """Names of the columns; empty for scalars."""


def of_vertices(run: Trajectory, index: int) -> list[FrameArray]:
    """Displacement, reactions and contact of the vertices in a frame, in its positions' precision.

    Whether a vertex is in contact is one where it is, and zero where it is not.
    """
    moved = run.positions[index] - run.rest_positions.astype(run.positions.dtype)
    arrays = [FrameArray("displacement", run.units.of("m"), moved, _IN_SPACE)]
    if run.reactions.size:
        arrays.append(FrameArray("reaction", run.units.of("N"), run.reactions[index], _IN_SPACE))
    if run.contact_forces.size:
        arrays.append(FrameArray("contact_force", run.units.of("N"), run.contact_forces[index], _IN_SPACE))
        arrays.append(FrameArray("in_contact", "", run.in_contact[index].astype(np.uint8)))
    return arrays


def of_triangles(run: Trajectory, index: int) -> list[FrameArray]:
    """The fields that the trajectory has of the triangles, in a frame."""
    return [
        FrameArray(name, run.units.of(FIELDS[name]), run.fields[name][index], _COMPONENTS.get(name, ()))
        for name in run.fields
    ]
