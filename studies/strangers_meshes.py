"""Meshes of strangers: one command each, with and without ``--repair``, on what other packages bring and generate.

``modalshell simulate MESH`` is run as a stranger would, in a process of its own, without any other option. A film is
sensible where its motion completed and moves the shell by 0.2 to 100 % of its size, and where each part is held. What
is tried depends on the packages that are installed; the quick version takes shapes of trimesh alone, and pictures of
their equilibrium instead of films. Times are processor time, the start of Python included.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.commands.choices import LARGE, UNSEEN
from modalshell.core.checks import shortened
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.mesh.files import read_polygons, repair_mesh
from studies.pages import counted, markdown, paragraphs, result_of
from studies.strangers import Stranger, generated, installed_files

FIGURES = ("strangers_meshes",)

FILES, SHAPES = 6, 12
"""Files and shapes of one package, at most."""
LIMIT, BUSY = 120.0, 8.0
"""Processor time [s] that one command may take, and how many times that a busy machine may take for it."""
QUICK = ("annulus", "sliced capsule", "soup")
"""Shapes of the quick version."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Try every mesh; ``quick`` takes few shapes and no films."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if quick:
            shapes = [f"trimesh: {shape}" for shape in QUICK]
            strangers = [one for one in generated(folder, 99, only="trimesh") if one.name in shapes]
        else:
            strangers = installed_files(FILES) + generated(folder, SHAPES)
        rows: list[dict[str, Any]] = []
        unread: list[dict[str, str]] = []
        arrays: dict[str, Any] = {}
        options = ["--static"] if quick else []
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            answers = pool.map(lambda pair: tried(pair[1], folder / f"tried_{pair[0]}", options), enumerate(strangers))
            for _, (row, shown) in zip(counted(strangers, on_step), answers, strict=False):
                if "message" in row:
                    unread.append(row)
                else:
                    arrays |= {f"{key}_{len(rows)}": value for key, value in shown.items()}
                    rows.append(row)
    return result_of("strangers_meshes", {"rows": rows, "unread": unread}, arrays, quick=quick)


def tried(stranger: Stranger, folder: Path, options: list[str]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What a mesh gave, and the faces and the positions farthest from rest of its film, if there is one."""
    row: dict[str, Any] = {"name": stranger.name}
    try:
        triangles = read_polygons(stranger.path).triangles()
    except ms.MeshError as error:
        return row | {"message": _plain(str(error), stranger)}, {}
    try:
        mesh, report = repair_mesh(stranger.path, split=True)
        row |= {"triangles": len(mesh.faces), "parts": report.parts, "repair": report.messages}
    except ms.MeshError as error:
        row |= {"triangles": len(triangles), "parts": 0, "repair": [_plain(str(error), stranger)]}
    plain, shown = one_command(stranger, folder / "plain", options)
    mended = plain
    if row["repair"]:
        mended, shown_mended = one_command(stranger, folder / "mended", [*options, "--repair", "--split"])
        shown = shown or shown_mended
    return row | {"plain": plain, "mended": mended}, shown


def one_command(stranger: Stranger, folder: Path, options: list[str]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Run ``modalshell simulate`` on a mesh: what it said and made, and the faces and positions of its film."""
    command = [sys.executable, "-m", "modalshell", "simulate", str(stranger.path), "--out", str(folder), *options]
    with tempfile.TemporaryFile("w+", encoding="utf-8") as errors:
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors) as child:
            status, seconds = _wait(child)
        errors.seek(0)
        text = errors.read()
    answer: dict[str, Any] = {"film": False, "moved": None, "traceback": "Traceback" in text, "seconds": seconds}
    if seconds > LIMIT or status is None:
        return answer | {"message": f"took longer than {LIMIT:.0f} s"}, {}
    lines = [line.removeprefix("modalshell: ") for line in text.splitlines() if line.startswith("modalshell: ")]
    refusals = [line for line in lines if not line.startswith("warning: ")]
    stem = folder / f"{stranger.path.stem}_mwts"
    if status not in (0, 1) or not stem.with_suffix(".npz").is_file():
        told = refusals[-1] if refusals else f"ended with status {status} and no message"
        return answer | {"message": "refused: " + _plain(told, stranger)}, {}
    run = ms.load_trajectory(stem.with_suffix(".npz"))
    far = np.linalg.norm(run.positions - run.rest_positions, axis=2)
    size = float(np.ptp(run.rest_positions, axis=0).max())
    answer["moved"] = float(far.max()) / size
    loose = _loose_parts(run.faces, far.max(axis=0) == 0.0)
    picture = any(stem.with_suffix(suffix).is_file() for suffix in (".mp4", ".png"))
    answer["film"] = run.outcome.succeeded and picture and not loose and UNSEEN <= answer["moved"] <= LARGE
    faults = [f"{loose} loose parts"] if loose else []
    answer["message"] = "film" if answer["film"] else "; ".join([run.outcome.with_message(run.message), *faults])
    farthest = run.positions[int(far.max(axis=1).argmax())].astype(np.float32)
    return answer, {"positions": farthest, "faces": run.faces.astype(np.int32)} if answer["film"] else {}


def _wait(child: subprocess.Popen[bytes]) -> tuple[int | None, float]:
    """Exit status of a process, None if it had to be ended, and the processor time [s] it took with its children."""
    start = time.perf_counter()
    ended = False
    while True:
        pid, status, used = os.wait4(child.pid, os.WNOHANG)
        if pid:
            child.returncode = os.waitstatus_to_exitcode(status)
            return None if ended else child.returncode, used.ru_utime + used.ru_stime
        if time.perf_counter() - start > BUSY * LIMIT and not ended:
            ended = True
            child.kill()
        time.sleep(0.05)


def _loose_parts(faces: np.ndarray, still: np.ndarray) -> int:
    """Connected parts of which no vertex stands still."""
    mesh = ms.TriangleMesh(np.random.default_rng(0).uniform(size=(len(still), 3)), faces)  # for its labels alone
    return len(np.setdiff1d(mesh.components, mesh.components[still]))


def _plain(text: str, stranger: Stranger) -> str:
    """A message without the folder of the mesh, and on one line of a table."""
    return shortened(text.replace(str(stranger.path), stranger.path.name).replace("|", "/"), 400)


def table(result: StudyResult) -> str:
    """Every mesh with its outcome, and the files that are no meshes."""
    rows = []
    for row in result.findings["rows"]:
        plain, mended = row["plain"], row["mended"]
        moved = (mended if mended["film"] else plain)["moved"]
        repair = ["nothing", "the same", "-"]
        if row["repair"]:
            repair = ["; ".join(row["repair"]), mended["message"], f"{mended['seconds']:.0f}"]
        rows.append({**row, "after": repair, "moved": moved})
    return paragraphs(
        markdown(
            "mesh | triangles | parts | without `--repair` | CPU [s] | what `--repair` does | with it | CPU [s] "
            "| moves [%]",
            "{name} | {triangles:,} | {parts} | {plain[message]} | {plain[seconds]:.0f} | {after} | {moved:100*.2g}",
            rows,
        ),
        "Files of packages that are no meshes, whatever their suffix says:",
        markdown("file | message", "{name} | {message}", result.findings["unread"]),
    )


def finding(result: StudyResult) -> str:
    """How many give a film, with and without repair, and how long the slowest took."""
    rows = result.findings["rows"]
    plain, mended = (sum(row[way]["film"] for row in rows) for way in ("plain", "mended"))
    others = [row["name"] for row in rows if not row["plain"]["film"] and not row["mended"]["film"]]
    slowest = max(row[way]["seconds"] for row in rows for way in ("plain", "mended"))
    packages = len({row["name"].partition(":")[0] for row in rows})
    left = f"; none comes of {', '.join(others)}" if others else ""
    return (
        f"One command without options makes a sensible film of {plain} of {len(rows)} meshes of {packages} other "
        f"packages, with `--repair` of {mended}, one of the two or both of {len(rows) - len(others)}{left}. The "
        f"slowest took {slowest:.0f} s of one core; the largest mesh has {max(row['triangles'] for row in rows):,} "
        "triangles."
    )
