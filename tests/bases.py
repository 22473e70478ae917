"""Bases of arrays alone, for what asks no more of their shell than its rest positions."""

from types import SimpleNamespace

import numpy as np

from modalshell import Basis


def bare_basis(points, modes, rotations):
    """A basis of modes and rotations (3n, m) on points (n, 3)."""
    count = modes.shape[1]
    return Basis(SimpleNamespace(rest_positions=points), np.ones(count), modes, rotations, 0, 0.0, "none")
