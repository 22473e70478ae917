"""Numbers of theory 3: bending constants of meshes of hinges, and how far such a sheet is from a plate."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from modalshell.mesh import TriangleMesh
from modalshell.shell.bending import bending_constants
from studies.pages import committed

FAMILIES = ("equilateral", "right", "union-jack", "lloyd", "delaunay")


def square(family: str) -> TriangleMesh:
    """A sheet of 30 cells across, nearly square."""
    if family == "equilateral":
        return ms.sheet(length=35.0 / 30.0 * np.sqrt(0.75), width=1.0, cells=(35, 30), family=family)
    return ms.sheet(length=1.0, width=1.0, cells=(30, 30), family=family)


def row(family: str) -> str:
    """Constants along an axis, aslant, and for a narrow strip along the axis, and what they calibrate."""
    mesh = square(family)
    along, aslant = (bending_constants(mesh, direction) for direction in ((1.0, 0.0, 0.0), (1.0, 1.0, 0.0)))
    factors = 0.5 / along.wide, 0.5 / along.narrow
    constants = f"{along.wide:.2f} | {aslant.wide:.2f} | {along.narrow:.2f}"
    return f"| {family} | {constants} | {factors[0]:.3f} | {factors[1]:.3f} |"


def statements() -> list[str]:
    """What the chapter states."""
    finest = [each for each in committed("mesh_bias").findings["rows"] if each["cells"] == 36]

    def errors(problem: str) -> str:
        found = {e["mesh"]: 100.0 * e["error"] for e in finest if (e["energy"], e["problem"]) == ("hinges", problem)}
        return f"{found['union-jack']:.0f} % (union-jack) and {found['equilateral']:.1f} % (equilateral)"

    return [*map(row, FAMILIES), errors("supported"), errors("twisted")]


if __name__ == "__main__":
    print(*statements(), sep="\n")
