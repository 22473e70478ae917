"""Numbers of theory 15: a frame, a plate with two moduli, a strip with a rest curvature, and a folded map."""

from __future__ import annotations

from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Array
from studies import folded_map
from studies.frame_meshes import frame
from studies.stiffened_panel import FRAMES, deflection

WOOD: dict[str, Any] = {"young": (10e9, 1e9), "shear": 0.7e9, "poisson": 0.35, "thickness": 2e-3, "density": 600.0}
LENGTH, WIDTH = 0.6, 0.45
"""Of the plate [m]."""


def closed_form(count: int = 6) -> tuple[Array, Any]:
    """Lowest frequencies [Hz] of a simply supported plate, and their half waves along it and across (count, 2)."""
    first, second = WOOD["young"]
    ratio = 1.0 - WOOD["poisson"] ** 2 * second / first
    d11, d22, d12 = first / ratio, second / ratio, WOOD["poisson"] * second / ratio
    m, n = (index.ravel() for index in np.meshgrid(np.arange(1, 9), np.arange(1, 9), indexing="ij"))
    a, b = m / LENGTH, n / WIDTH
    plane = d11 * a**4 + 2.0 * (d12 + 2.0 * WOOD["shear"]) * (a * b) ** 2 + d22 * b**4
    found = np.pi / 2.0 * np.sqrt(plane * WOOD["thickness"] ** 2 / 12.0 / WOOD["density"])
    order = np.argsort(found)[:count]
    return found[order], np.column_stack([m, n])[order]


def plate(cells: int) -> Array:
    """The lowest frequencies of the plate on right triangles."""
    mesh = ms.sheet(length=LENGTH, width=WIDTH, cells=(cells, cells), family="alternating")
    shell = ms.Shell(mesh, ms.Orthotropic(**WOOD), supports=[ms.Pin("boundary")])
    return ms.solve_modes(shell, 6).frequencies[:6]


def curled(curvature: float = 1.5, length: float = 0.5) -> float:
    """Distance of the end of a strip from that of the circle, over how far it has moved [%]."""
    mesh = ms.flat_beam(length=length, width=0.06, cells=(24, 3))
    sheet = ms.Isotropic(young=1e9, poisson=0.0, thickness=2e-3, density=1000.0)
    tensor = curvature * np.diag([1.0, 0.0, 0.0])
    state = ms.DiscreteShell(ms.Shell(mesh, sheet, clamped="x < 1e-9", rest_curvature=tensor)).equilibrium()
    tip = state.positions[mesh.vertices[:, 0] > length - 1e-9].mean(axis=0)[[0, 2]]
    angle = length * curvature
    exact = np.array([np.sin(angle), np.cos(angle) - 1.0]) / curvature
    return float(100.0 * np.linalg.norm(tip - exact) / np.linalg.norm(exact - [length, 0.0]))


def statements() -> list[str]:
    """What the chapter states."""
    ends, exact = FRAMES["T"]
    off = 100.0 * abs(deflection(frame(ends, cells=(8, 2), family="jittered"), ends) / exact - 1.0)
    frequencies, waves = closed_form()
    assert waves[5].tolist() == [2, 3]
    coarse, fine = plate(24), plate(48)
    assert (np.abs(coarse[:5] / frequencies[:5] - 1.0) < 0.01).all()
    sixth = [100.0 * (found[5] / frequencies[5] - 1.0) for found in (coarse, fine)]
    rest = 100.0 * np.abs((4.0 * fine - coarse) / 3.0 / frequencies - 1.0).max()
    kept, plain = (folded_map.case(2, limit, 0.05)["kept"] for limit in (folded_map.LIMIT, None))
    assert max(plain) < 1e-3
    return [
        f"with 8 cells along each strip its deflection is {off:.2f} % off",
        f"is off by {sixth[0]:.2f} % at 24 cells and by {sixth[1]:.2f} % at 48",
        f"all six are within {rest:.3f} % of the closed form",
        "whose rest curvature is 1.5 along its length of one half comes to rest on that circle: its end is within "
        f"{curled():.2f} % of its place",
        f"led to folds of {folded_map.FOLD:.0f} degrees keeps {kept[0]:.1f}, {kept[1]:.1f} and {kept[2]:.1f} degrees",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
