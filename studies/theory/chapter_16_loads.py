"""Numbers of theory 16: Beck's column, and the asymmetry of a pressure's stiffness with a free and a held rim."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.optimize import brentq

import modalshell as ms
from modalshell.core.typing import Array, Index

ELEMENTS = 8


def beam() -> tuple[Array, Array, Array, Array]:
    """Bending, geometric stiffness and mass of a clamped beam of cubic elements, and the follower force's; all unit."""
    h, size = 1.0 / ELEMENTS, 2 * ELEMENTS + 2
    bending, geometric, mass, follower = np.zeros((4, size, size))
    rows = np.array([[12, 6 * h, -12, 6 * h], [0, 4 * h**2, -6 * h, 2 * h**2], [0, 0, 12, -6 * h], [0, 0, 0, 4 * h**2]])
    turns = np.array([[36, 3 * h, -36, 3 * h], [0, 4 * h**2, -3 * h, -(h**2)], [0, 0, 36, -3 * h], [0, 0, 0, 4 * h**2]])
    inert = np.array(
        [[156, 22 * h, 54, -13 * h], [0, 4 * h**2, 13 * h, -3 * h**2], [0, 0, 156, -22 * h], [0, 0, 0, 4 * h**2]]
    )
    for first in range(0, 2 * ELEMENTS, 2):
        own = slice(first, first + 4)
        for whole, part, scale in ((bending, rows, h**-3), (geometric, turns, 1 / (30 * h)), (mass, inert, h / 420)):
            whole[own, own] += scale * (part + np.triu(part, 1).T)
    follower[-2, -1] = 1.0  # the end's slope turns the force aside
    return bending[2:, 2:], geometric[2:, 2:], mass[2:, 2:], follower[2:, 2:]


def flutter() -> tuple[float, float]:
    """Loads [E I / L^2] at which a column under a follower force flutters, and under a dead one buckles."""
    bending, geometric, mass, follower = beam()

    def apart(load: float) -> float:
        values = scipy.linalg.eigvals(bending - load * (geometric - follower), mass)
        first, second = values[np.argsort(values.real)][:2]
        return float((second - first).real ** 2 - (second - first).imag ** 2)

    dead = scipy.linalg.eigh(geometric, bending, eigvals_only=True)[-1]
    return float(brentq(apart, 15.0, 25.0)), float(1.0 / dead)


def asymmetry() -> tuple[float, float]:
    """``|K - K^T| / |K|`` of a follower pressure on a curved sheet: of all vertices, and of those inside."""
    flat = ms.sheet(length=1.0, width=1.0, cells=(8, 8))
    x = np.array(flat.vertices)
    x[:, 2] = 0.3 * np.sin(3.0 * x[:, 0] + 2.0 * x[:, 1])
    load = ms.Pressure(1.0).applied(flat, np.ones(len(x)))
    assert load is not None
    blocks = load.stiffness(x, None, 0.0, 0.0)
    whole = np.zeros((x.size, x.size))
    for corners, block in zip(load.stencils, blocks, strict=True):
        own = (3 * corners[:, None] + np.arange(3)).ravel()
        whole[np.ix_(own, own)] += block.reshape(9, 9)
    inside = np.setdiff1d(np.arange(len(x)), flat.boundary_vertices)

    def share(vertices: Index) -> float:
        own = (3 * vertices[:, None] + np.arange(3)).ravel()
        part = whole[np.ix_(own, own)]
        return float(np.linalg.norm(part - part.T) / np.linalg.norm(part))

    return share(np.arange(len(x))), share(inside)


def statements() -> list[str]:
    """What the chapter states."""
    beck, euler = flutter()
    whole, inside = asymmetry()
    assert inside < 1e-14
    return [f"flutters at {beck:.2f}", f"buckles at {euler:.2f}", f"its asymmetry is {whole:.2f} of its size"]


if __name__ == "__main__":
    print(*statements(), sep="\n")
