"""Strips of the study ``contact_truth``, and those between plates: a quarter of a ring, and a strip bent back."""

from __future__ import annotations

from typing import Any

import numpy as np

import modalshell as ms
from studies.contact_motions import GRAVITY
from studies.shell_theory import columns

YOUNG, THICKNESS = 1e9, 1e-3
FLEXURE = YOUNG * THICKNESS**3 / 12.0
RINGS = {1.9: 0.625408, 1.6: 2.115300, 1.4: 2.929674, 1.0: 5.742160}
"""Force per width over D / R^2, by the gap of the plates over R."""
BENT = 2.8710800
"""Force per width times d^2 / D of a strip bent back between plates d apart."""


def heavy() -> ms.Isotropic:
    """A sheet whose length l_g is 1 m, without Poisson effect."""
    density = FLEXURE / (GRAVITY * THICKNESS)
    return ms.Isotropic(young=YOUNG, poisson=0.0, thickness=THICKNESS, density=density)


def strip(family: str, length: float, width: float, cells: int) -> ms.TriangleMesh:
    """A strip of about square cells."""
    across = max(2, round(cells * width / length))
    return ms.flat_beam(length=length, width=width, cells=(columns(family, cells), across), family=family)


def pinned(mesh: ms.TriangleMesh, x: float = 0.0) -> ms.Fix:
    """Holds one vertex at the end x along y."""
    points = mesh.vertices
    end = np.flatnonzero(np.abs(points[:, 0] - x) < 1e-9)
    return ms.Fix([int(end[points[end, 1].argmin()])], "y")


def ring(family: str, gap: float, cells: int) -> dict[str, Any]:
    """A quarter of a ring between plates, which begins inside them and is led out."""
    flat = strip(family, np.pi / 2, 0.2, cells)
    angle, y = flat.vertices[:, 0], flat.vertices[:, 1]
    mesh = ms.TriangleMesh(np.stack([np.sin(angle), y, np.cos(angle)], axis=1), flat.faces)
    x, _, z = mesh.vertices.T
    supports = [ms.Symmetry(x < 1e-9, (1, 0, 0)), ms.Symmetry(z < 1e-9, (0, 0, 1)), pinned(mesh)]
    contact = ms.Contact(ms.Plane((0, 0, -1), -0.5 * gap), push_out=1.0)
    state = ms.DiscreteShell(ms.Shell(mesh, heavy(), supports=supports)).equilibrium(contacts=[contact])
    found = -2.0 * float(state.contact_forces[:, 2].sum()) / np.ptp(y) / FLEXURE
    return pressed(family, f"ring, gap {gap:g} R", cells, state, found / RINGS[gap] - 1.0)


def bent(family: str, cells: int) -> dict[str, Any]:
    """Half of a strip bent back between plates."""
    length = np.pi / 4 + 2.0
    mesh = strip(family, length, 0.3, cells)
    start, arc = mesh.vertices.copy(), mesh.vertices[:, 0]
    turn = np.minimum(2.0 * arc, np.pi / 2)
    start[:, 0], start[:, 2] = 0.5 * np.sin(turn), 0.5 * (1.0 - np.cos(turn)) + np.maximum(arc - np.pi / 4, 0.0)
    contact = ms.Contact(ms.Plane((-1, 0, 0), -0.5))
    model = ms.DiscreteShell(ms.Shell(mesh, heavy(), clamped=arc < 1e-9))
    state = model.equilibrium(start=start, contacts=[contact])
    found = -float(state.contact_forces[:, 0].sum()) / 0.3 / FLEXURE
    return pressed(family, "bend", cells, state, found / BENT - 1.0)


def pressed(family: str, case: str, cells: int, state: ms.Equilibrium, force: float) -> dict[str, Any]:
    """A row of a shell between plates."""
    row = {"mesh": family, "case": case, "cells": cells, "converged": state.converged, "force": force}
    return row | {"iterations": state.iterations, "deepest": state.deepest}
