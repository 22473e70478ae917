"""Shells by CalculiX: ``python calculix.py < case.json``.

Six-node triangles S6, those of the case, with Young's modulus [Pa], Poisson's ratio, the thickness [m] and the
density [kg/m^3] as they are; statics with geometric nonlinearity, loads one after another. Nodes of clamped edges, with
both ends held, have no turn; other held ones may have one. Only the program ``ccx`` is needed.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def deck(case: dict[str, Any]) -> str:
    """The input file."""
    points, faces = list(case["vertices"]), case["faces"]
    count, middle = len(points), dict[tuple[int, int], int]()

    def between(first: int, second: int) -> int:
        ends = min(first, second), max(first, second)
        if ends not in middle:
            middle[ends] = len(points)
            points.append([0.5 * (a + b) for a, b in zip(points[first], points[second], strict=True)])
        return middle[ends]

    elements = [[a, b, c, between(a, b), between(b, c), between(c, a)] for a, b, c in faces]
    corners = set(case["held"])
    edges = {node: ends for ends, node in middle.items() if corners.issuperset(ends)}
    held = sorted(corners | set(edges))
    turned = sorted({node for middle_node, ends in edges.items() for node in (middle_node, *ends)})
    lines = ["*NODE,NSET=ALL", *(f"{i},{x:.12g},{y:.12g},{z:.12g}" for i, (x, y, z) in enumerate(points, 1))]
    lines.append("*ELEMENT,TYPE=S6,ELSET=SHELL")
    lines += [
        ",".join(str(node) for node in [row, *(1 + node for node in nodes)]) for row, nodes in enumerate(elements, 1)
    ]
    lines += ["*NSET,NSET=HELD", *(f"{node + 1}," for node in held)]
    if turned:  # isolated vertices are on no clamped edge
        lines += ["*NSET,NSET=TURNED", *(f"{node + 1}," for node in turned)]
    lines += ["*NSET,NSET=SEEN", *(f"{node + 1}," for node in range(count))]
    lines += ["*MATERIAL,NAME=SHEET", "*ELASTIC", f"{case['young']:.12g},{case['poisson']:.12g}"]
    lines += ["*DENSITY", f"{case['density']:.12g}", "*SHELL SECTION,ELSET=SHELL,MATERIAL=SHEET"]
    lines += [f"{case['thickness']:.12g}", "*BOUNDARY", "HELD,1,3", *["TURNED,4,6"] * bool(case["clamped"] and turned)]
    if case.get("modes"):
        lines += ["*STEP", "*FREQUENCY", f"{case['modes']}", "*END STEP"]
    for load in case["loads"]:
        size = sum(value * value for value in load["gravity"]) ** 0.5
        lines += ["*STEP,NLGEOM,INC=1000", "*STATIC", "0.2,1.,1e-3,0.5", "*DLOAD,OP=NEW"]
        if size:
            direction = ",".join(f"{value / size:.12g}" for value in load["gravity"])
            lines.append(f"SHELL,GRAV,{size:.12g},{direction}")
        lines.append("*CLOAD,OP=NEW")
        if load.get("force"):
            for node, force in enumerate(load["force"], 1):
                lines += [f"{node},{axis},{value:.12g}" for axis, value in enumerate(force, 1) if value]
        lines += ["*NODE PRINT,NSET=SEEN,FREQUENCY=1000", "U", "*END STEP"]
    return "\n".join(lines) + "\n"


def displacements(written: list[str], count: int) -> list[list[list[float]]]:
    """Displacements at the end of every load: steps end at whole times, one after another."""
    ends: list[list[list[float]]] = []
    for row, line in enumerate(written):
        if line.split()[:1] == ["displacements"] and abs(float(line.split()[-1]) - len(ends) - 1.0) < 1e-6:
            rows = [entry.split() for entry in written[row + 2 : row + 2 + count]]
            ends.append([[float(value) for value in entry[1:]] for entry in rows])
    return ends


def main() -> None:
    """Answer all loads in one run, or find the modes."""
    case = json.load(sys.stdin)
    program = shutil.which("ccx")
    if program is None:
        raise ModuleNotFoundError("No program named 'ccx'")
    text = subprocess.run([program, "-v"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"Version (\S+)", text)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "case.inp").write_text(deck(case), encoding="utf-8")
        begin, before = time.perf_counter(), os.times().children_user
        ended = subprocess.run(
            [program, "case"], cwd=folder, check=False, stdout=subprocess.DEVNULL, timeout=case.get("limit")
        )
        # On Windows processes tell no time of their children.
        seconds = os.times().children_user - before or time.perf_counter() - begin
        written = Path(folder, "case.dat").read_text(encoding="utf-8").splitlines()
    answer: dict[str, Any] = {"version": f"CalculiX {version[1] if version else '?'}", "seconds": seconds}
    if case.get("modes"):
        rows = [line.split() for line in written]
        rows = [row for row in rows if len(row) == 5 and row[0].isdigit()]
        answer["frequencies"] = [float(row[3]) for row in rows][: case["modes"]]
    answer["positions"] = [
        [[a + b for a, b in zip(point, step, strict=True)] for point, step in zip(case["vertices"], moved, strict=True)]
        for moved in displacements(written, len(case["vertices"]))
    ]
    if len(answer["positions"]) < len(case["loads"]):
        answer["note"] = f"no equilibrium beyond load {len(answer['positions'])} (status {ended.returncode})"
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
