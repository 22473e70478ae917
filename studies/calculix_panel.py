"""A plate with a rib by CalculiX: its input file, and its numbers next to those of split folds.

Plate and rib are eight-node shells S8R with the same node lines as the triangles; both are clamped at the end x = 0.
Three steps: the sag under weight, the lowest frequencies, and the factors by which a uniform line force along -x on the
other end buckles the panel. ``python -m studies.calculix_panel FILE`` runs the program ``ccx`` on the meshes of
:data:`CELLS` and writes FILE, such as ``tests/data/calculix_panel.json``; a coarse input is kept next to it.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import modalshell as ms
from studies.frame_meshes import joined

LENGTH, WIDTH, HEIGHT = 0.6, 0.36, 0.04
"""Length and width of the plate, and height of the rib under its middle line [m]."""
STEEL = {"young": 2.1e11, "poisson": 0.3, "thickness": 3e-3, "density": 7850.0}
GRAVITY, PUSH = 9.81, 1e3
"""Weight [m/s^2], and line force [N/m] at the end of plate and rib."""
CELLS = ((20, 12, 2), (40, 24, 4))
"""Cells along the panel, across the plate, and over the rib's height, of the two inputs."""
MODES = 6


def nodes_of(cells: tuple[int, int, int], halves: int = 1) -> tuple[NDArray[np.float64], dict[tuple[int, int], int]]:
    """Nodes (n, 3) [m], and their numbers by step along and station: across the plate, then down the rib.

    ``halves = 2`` has nodes in the middles of the sides of the cells, too, but none in the middles of cells.
    """
    along, across, deep = (halves * count for count in cells)
    points: list[list[float]] = []
    number: dict[tuple[int, int], int] = {}
    for i in range(along + 1):
        for j in range(across + 1 + deep):
            down = j - across
            if halves == 2 and i % 2 and (down if down > 0 else j) % 2:
                continue
            y = WIDTH * (j / across - 0.5) if down <= 0 else 0.0
            number[i, j] = len(points)
            points.append([LENGTH * i / along, y, -HEIGHT * max(down, 0) / deep])
    return np.array(points), number


def stations(cells: tuple[int, int, int], halves: int = 1) -> list[int]:
    """Stations of the rib from the plate's middle line down."""
    across, deep = halves * cells[1], halves * cells[2]
    return [across // 2, *range(across + 1, across + deep + 1)]


def ribbed_plate(cells: tuple[int, int, int], family: str = "alternating") -> ms.TriangleMesh:
    """Triangles on the node lines; diagonals alternate or go one way."""
    points, number = nodes_of(cells)
    rows: list[list[int]] = []
    for lines in (list(range(cells[1] + 1)), stations(cells)):
        for i in range(cells[0]):
            for k, (a, b) in enumerate(pairwise(lines)):
                p, q, r, s = number[i, a], number[i + 1, a], number[i + 1, b], number[i, b]
                straight = family == "one-way" or (i + k) % 2 == 0
                rows += [[p, q, r], [p, r, s]] if straight else [[p, q, s], [q, r, s]]
    return joined((points, np.array(rows)))


def edge_loads(cells: tuple[int, int, int], number: dict[tuple[int, int], int]) -> dict[int, float]:
    """Forces [N] along -x on the nodes of the end, by Simpson's rule on every side of an element."""
    found: dict[int, float] = {}
    for lines, size in ((list(range(2 * cells[1] + 1)), WIDTH / cells[1]), (stations(cells, 2), HEIGHT / cells[2])):
        for start in range(0, len(lines) - 2, 2):
            for station, share in zip(lines[start : start + 3], (1 / 6, 4 / 6, 1 / 6), strict=True):
                node = number[2 * cells[0], station]
                found[node] = found.get(node, 0.0) + PUSH * size * share
    return found


def deck(cells: tuple[int, int, int]) -> str:
    """The input file."""
    points, number = nodes_of(cells, 2)
    elements = []
    for lines in (list(range(2 * cells[1] + 1)), stations(cells, 2)):
        for i in range(0, 2 * cells[0], 2):
            for k in range(0, len(lines) - 2, 2):
                a, m, b = lines[k : k + 3]
                corners = [(i, a), (i + 2, a), (i + 2, b), (i, b)]
                sides = [(i + 1, a), (i + 2, m), (i + 1, b), (i, m)]
                elements.append([number[place] + 1 for place in corners + sides])
    held = [n + 1 for n, point in enumerate(points) if point[0] == 0.0]
    seen = [number[2 * cells[0], station] + 1 for station in (0, cells[1], 2 * cells[1], 2 * (cells[1] + cells[2]))]
    text = ["*NODE,NSET=ALL", *(f"{n},{x:.9g},{y:.9g},{z:.9g}" for n, (x, y, z) in enumerate(points, 1))]
    text += ["*ELEMENT,TYPE=S8R,ELSET=SHELL", *(",".join(map(str, [n, *e])) for n, e in enumerate(elements, 1))]
    text += ["*NSET,NSET=HELD", *(f"{n}," for n in held), "*NSET,NSET=SEEN", *(f"{n}," for n in seen)]
    text += ["*MATERIAL,NAME=STEEL", "*ELASTIC", f"{STEEL['young']:g},{STEEL['poisson']:g}"]
    text += ["*DENSITY", f"{STEEL['density']:g}", "*SHELL SECTION,ELSET=SHELL,MATERIAL=STEEL"]
    text += [f"{STEEL['thickness']:g}", "*BOUNDARY", "HELD,1,6"]
    text += [
        "*STEP",
        "*STATIC",
        "*DLOAD",
        f"SHELL,GRAV,{GRAVITY:g},0.,0.,-1.",
        "*NODE PRINT,NSET=SEEN",
        "U",
        "*END STEP",
    ]
    text += ["*STEP", "*FREQUENCY", f"{MODES}", "*END STEP"]
    text += ["*STEP", "*BUCKLE", "4,1e-8", "*DLOAD,OP=NEW", "*CLOAD,OP=NEW"]
    text += [f"{n + 1},1,{-force:.9g}" for n, force in sorted(edge_loads(cells, number).items())]
    return "\n".join([*text, "*END STEP"]) + "\n"


def answer(cells: tuple[int, int, int]) -> dict[str, Any]:
    """What CalculiX finds: sag [m] at both corners, the middle and the rib's foot, frequencies [Hz], and factors."""
    program = shutil.which("ccx")
    if program is None:
        raise ms.OptionError("the program ccx is not installed: install CalculiX")
    version = re.search(
        r"Version (\S+)", subprocess.run([program, "-v"], capture_output=True, text=True, check=False).stdout
    )
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "panel.inp").write_text(deck(cells), encoding="utf-8")
        subprocess.run([program, "panel"], cwd=folder, check=False, capture_output=True)
        rows = [line.split() for line in Path(folder, "panel.dat").read_text(encoding="utf-8").splitlines()]
    sags = [float(row[3]) for row in rows if len(row) == 4 and row[0].isdigit()]
    modes = [float(row[3]) for row in rows if len(row) == 5 and row[0].isdigit()]
    factors = [float(row[1]) for row in rows if len(row) == 2 and row[0].isdigit()]
    return {
        "source": f"CalculiX {version[1] if version else ''}, S8R",
        "cells": list(cells),
        "sag": [-sag for sag in sags[:4]],
        "frequencies": modes[:MODES],
        "buckling": factors[:4],
    }


def main() -> None:
    """Write the answers of both inputs, and the coarse input."""
    target = Path(sys.argv[1])
    text = json.dumps([answer(cells) for cells in CELLS], indent=1)
    target.write_text(text + "\n", encoding="utf-8")
    target.with_suffix(".inp").write_text(deck(CELLS[0]), encoding="utf-8")


if __name__ == "__main__":
    main()
