"""A strip under gravity, and a plate's frequencies, by CalculiX: ``python calculix.py < case.json``.

Eight-node shells S8R, one a quadrilateral of the case's grid, with Young's modulus [Pa], Poisson's ratio, the thickness
[m] and the density [kg/m^3] as they are; statics with geometric nonlinearity, clamped at the first row of nodes. Only
the program ``ccx`` is needed.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def deck(case: dict[str, Any], gravities: list[float], modes: int) -> tuple[str, int]:
    """The input file, and the nodes of the tip."""
    length, width, (along, across) = case["length"], case["width"], case["cells"]
    number: dict[tuple[int, int], int] = {}
    lines = ["*NODE,NSET=ALL"]
    for i in range(2 * along + 1):
        for j in range(2 * across + 1):
            if i % 2 == 0 or j % 2 == 0:
                number[i, j] = len(number) + 1
                place = length * i / (2 * along), width * (j / (2 * across) - 0.5)
                lines.append(f"{number[i, j]},{place[0]:.12g},{place[1]:.12g},0.")
    lines.append("*ELEMENT,TYPE=S8R,ELSET=SHELL")
    steps = [(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1)]
    for cell in range(along * across):
        i, j = 2 * (cell // across), 2 * (cell % across)
        lines.append(",".join(str(entry) for entry in [cell + 1, *(number[i + a, j + b] for a, b in steps)]))
    for name, row in (("CLAMP", 0), ("TIP", 2 * along)):
        lines += [f"*NSET,NSET={name}", *(f"{node}," for (i, _), node in number.items() if i == row)]
    lines += ["*MATERIAL,NAME=SHEET", "*ELASTIC", f"{case['young']:.12g},{case['poisson']:.12g}"]
    lines += ["*DENSITY", f"{case['density']:.12g}", "*SHELL SECTION,ELSET=SHELL,MATERIAL=SHEET"]
    lines += [f"{case['thickness']:.12g}", "*BOUNDARY", "CLAMP,1,6"]
    if modes:
        lines += ["*STEP", "*FREQUENCY", f"{modes}", "*END STEP"]
    for gravity in gravities:
        lines += [
            "*STEP,NLGEOM,INC=1000",
            "*STATIC",
            "0.1,1.,1e-6,0.25",
            "*DLOAD",
            f"SHELL,GRAV,{gravity:.12g},0.,0.,-1.",
        ]
        lines += ["*NODE PRINT,NSET=TIP,FREQUENCY=1000", "U", "*END STEP"]
    return "\n".join(lines) + "\n", 2 * across + 1


def main() -> None:
    """Answer all loads in one run, or find the modes."""
    case = json.load(sys.stdin)
    program = shutil.which("ccx")
    if program is None:
        raise ModuleNotFoundError("No program named 'ccx'")
    gravities, modes = sorted(case.get("gravities", [])), int(case.get("modes", 0))
    text, nodes = deck(case, gravities, modes)
    told = subprocess.run([program, "-v"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"Version (\S+)", told)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "case.inp").write_text(text, encoding="utf-8")
        begin = time.perf_counter()
        subprocess.run([program, "case"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        seconds = time.perf_counter() - begin
        written = Path(folder, "case.dat").read_text(encoding="utf-8").splitlines()
    found: dict[str, Any] = {"version": f"CalculiX {version[1] if version else '?'}", "seconds": [seconds], "steps": []}
    numbers = [line.split() for line in written]
    if modes:
        found["frequencies"] = [float(row[3]) for row in numbers if len(row) == 5 and row[0].isdigit()][:modes]
    rows = [[float(value) for value in row[1:]] for row in numbers if len(row) == 4 and row[0].isdigit()]
    for index in range(len(gravities)):
        block = rows[index * nodes : (index + 1) * nodes]
        mean = [sum(column) / nodes for column in zip(*block, strict=True)]
        found.setdefault("tips", []).append([case["length"] + mean[0], mean[1], mean[2]])
    print(json.dumps(found))


if __name__ == "__main__":
    main()
