"""Load-deflection paths as curves: stable parts solid, unstable ones dashed, events marked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from modalshell.render.curves import Curve

MARKERS = {"limit": "^", "bifurcation": "s"}
"""Markers of the kinds of events."""


def path_curves(
    displacements: ArrayLike,
    factors: ArrayLike,
    stable: ArrayLike,
    events: Sequence[tuple[str, int, float]],
    label: str,
    color: str,
    *,
    marks: bool = True,
) -> list[Curve]:
    """Curves of one path, factors (k,) over displacements (k,); only its first part and marks are named in a legend."""
    x, y, good = np.asarray(displacements, float), np.asarray(factors, float), np.asarray(stable, bool)
    # A piece between two points is stable where both its ends are; at events one end may be either.
    at = {index for _, index, _ in events}
    pieces = [
        bool(good[k] and good[k + 1]) or (k in at and bool(good[k + 1])) or (k + 1 in at and bool(good[k]))
        for k in range(len(x) - 1)
    ]
    curves: list[Curve] = []
    first = 0
    for k in range(1, len(pieces) + 1):
        if k == len(pieces) or pieces[k] != pieces[first]:
            name = label if not curves else f"_{label}"
            curves.append(Curve(x[first : k + 1], y[first : k + 1], name, color, not pieces[first], points=False))
            first = k
    for kind, marker in MARKERS.items() if marks else ():
        chosen = [index for what, index, _ in events if what == kind]
        curves += [Curve([x[index]], [y[index]], f"_{kind}", color, marker=marker) for index in chosen]
    return curves
