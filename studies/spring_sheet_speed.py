"""Steps of a sheet of masses and springs: NumPy, compiled kernels, threads and devices, from 64^2 to 1024^2 masses.

Every way takes the same Verlet steps of the same crumpled sheet (structural, shear and flexion springs, 12 a mass). How
far each ends from NumPy's float64, over the largest displacement, is reported. The ways take turns, so that all are
timed under the same conditions.
The streaming bound is what the machine would do if springs cost nothing: two states read and one written a step, at the
speed at which one core copies a large array. Small sheets stay in the caches and may pass it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np

from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.kernels.device import device_names, devices
from modalshell.springs import GridVerlet, SheetGrid
from modalshell.springs.device import DeviceVerlet
from studies.benchmarks.devices import missing_devices
from studies.benchmarks.numpy_verlet import NumpyVerlet
from studies.benchmarks.timing import interleaved
from studies.pages import counted, markdown, paragraphs, result_of

FIGURES = ("spring_sheet_speed",)

SIZES = (64, 128, 256, 512, 1024)
PRECISIONS = ("float64", "float32")
BASE, FREE = "numba, one thread", "numba, free threads"
ONE_CORE = ("NumPy", BASE, "Warp, one core")
"""Timed by the processor's clock, which stands still while others run; the other ways by the wall's."""
PUBLISHED = {"OpenMP": (2.24, 3.40), "GPU": (4.20, 35.25)}
"""Published speed-ups over one core of a CPU, at 64^2 and at 1024^2 masses."""
CHECKED_STEPS = 10
COPIED = 2**26
"""Bytes of the array that is copied for the bandwidth of memory."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Every way at every size; ``quick`` stops at 128^2."""
    sizes = SIZES[:2] if quick else SIZES
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    bandwidth = copy_bandwidth()
    rows: list[dict[str, Any]] = []
    sheets: list[dict[str, Any]] = []
    for size in counted(sizes, on_step):
        sheet, timed = timings(size, 1 if quick else 5)
        sheets.append(sheet)
        rows += timed
    findings = {
        "rows": rows,
        "sheets": sheets,
        "bandwidth": bandwidth,
        "missing": missing_devices(),
        "devices": {} if "Warp" in missing_devices() else device_names(),
        "published": PUBLISHED,
    }
    findings["load"] = load
    findings["streaming_bound"] = {kind: bandwidth / bytes_of_a_mass(kind) for kind in PRECISIONS}
    return result_of("spring_sheet_speed", findings, {"sizes": np.array(sizes)})


def bytes_of_a_mass(precision: str) -> int:
    """Bytes that one step moves for a mass: two states of three numbers read, one written."""
    return 9 * np.dtype(precision).itemsize


def copy_bandwidth() -> float:
    """Bytes a second, read and written, of one core that copies a large array: the best of several."""
    source, target = np.ones(COPIED // 8), np.zeros(COPIED // 8)
    seconds = []
    for _ in range(10):
        start = time.perf_counter()
        np.copyto(target, source)
        seconds.append(time.perf_counter() - start)
    return 2.0 * COPIED / min(seconds)


def crumpled_sheet(size: int) -> tuple[SheetGrid, np.ndarray]:
    """A sheet of cloth held along one side, and places [m] to start from, a little off its rest."""
    pinned = np.zeros((size, size), bool)
    pinned[0] = True
    stiffness = {"structural": 50.0, "shear": 30.0, "flexion": 10.0}
    gravity = np.array([0.0, 0.0, -9.81])
    grid = SheetGrid(
        shape=(size, size), spacing=0.01, particle_mass=1e-3, drag=0.5, pinned=pinned, gravity=gravity, **stiffness
    )
    noise = np.random.default_rng(0).normal(scale=0.02 * grid.spacing, size=(grid.count, 3))
    return grid, grid.rest_positions() + noise


def steppers(grid: SheetGrid, start: np.ndarray) -> dict[tuple[str, str], Any]:
    """Every way to step the sheet that is here, by its name and precision."""
    most = int(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    found: dict[tuple[str, str], Any] = {}
    for precision in PRECISIONS:
        found["NumPy", precision] = NumpyVerlet(grid, precision, start)
        found[BASE, precision] = GridVerlet(grid, precision, start, threads=1)
        several = GridVerlet(grid, precision, start) if most > 1 else None
        if several is not None and several.threads.most > 1:
            found[FREE, precision] = several
        if "Warp" not in missing_devices():
            for device in devices():
                name = "Warp, one core" if device == "cpu" else f"Warp, {device}"
                found[name, precision] = DeviceVerlet(grid, precision, start, device)
    return found


def timings(size: int, repeats: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """A sheet of ``size``^2 and how far it moves; masses a second of every way, and how far it ends from NumPy."""
    grid, start = crumpled_sheet(size)
    dt = 0.5 * grid.stable_step()
    ways = steppers(grid, start)
    for way in ways.values():
        way.step(CHECKED_STEPS, dt)
    truth = ways["NumPy", "float64"].positions
    moved = float(np.abs(truth - start).max())
    places = {key: way.positions for key, way in ways.items()}
    # Many steps in a call, so that the state's check after them is not what is timed.
    count = max(4, 2**18 // grid.count)
    calls: dict[Any, Callable[[], object]] = {key: partial(way.step, count, dt) for key, way in ways.items()}
    alone = {key: call for key, call in calls.items() if key[0] in ONE_CORE}
    processor = interleaved(alone, repeats, clock=time.process_time)
    together = {key: call for key, call in calls.items() if key[0] not in ONE_CORE or key[0] == BASE}
    wall = interleaved(together, repeats) if len(together) > len(PRECISIONS) else {}
    rows = []
    for name, kind in ways:
        own = processor if name in ONE_CORE else wall
        seconds = own[name, kind]
        rows.append(
            {
                "size": size,
                "way": name,
                "precision": kind,
                "masses_per_second": count * grid.count / seconds,
                "over_numpy_float64": processor["NumPy", "float64"] / seconds,
                "over_numpy": processor["NumPy", kind] / seconds,
                "over_one_core": own[BASE, kind] / seconds,
                "distance_from_numpy": float(np.abs(places[name, kind] - truth).max()) / moved,
            }
        )
    return {"size": size, "stable_step": grid.stable_step(), "moved": moved}, rows


def table(result: StudyResult) -> str:
    """Table in Markdown: every way at every size, then the bounds, what is missing, and the published speed-ups."""
    found, machine, bound = result.findings, result.record["machine"], result.findings["streaming_bound"]
    ways = markdown(
        "masses | way | precision | million masses a second | over NumPy, float64 | over NumPy, same precision "
        "| over numba's one core | share of the streaming bound | distance from NumPy, float64",
        "{size}^2 | {way} | {precision} | {masses_per_second:1e-6*.1f} | {over_numpy_float64:.1f} | {over_numpy:.1f} "
        "| {over_one_core:.2f} | {share} | {distance_from_numpy:.0e}",
        [row | {"share": _share(row, bound)} for row in found["rows"]],
    )
    missing = [f"| all | {name} | {reason} | | | | | | |" for name, reason in found["missing"].items()]
    words = f"Machine: {machine['processor']}, {machine['cores']} cores"
    words += "".join(f"; {alias} is {name}" for alias, name in found["devices"].items() if alias != "cpu")
    if found["load"] is not None:
        words += f" ({found['load']:.1f} processes wanted to run when this began). Ways of one core are timed by the "
        words += "processor's clock; free threads and GPUs by the wall's, which on a busy machine says little"
    bounds = ", ".join(f"{most / 1e6:.0f} in {kind}" for kind, most in bound.items())
    published = "; ".join(f"{name} {low:.2f} to {high:.2f}" for name, (low, high) in found["published"].items())
    return paragraphs(
        "\n".join([ways, *missing]),
        f"{words}.",
        f"One core copies {found['bandwidth'] / 1e9:.1f} GB/s, read and written, which bounds a step's million "
        f"masses a second: {bounds}.",
        f"Published speed-ups over one core of a CPU, 64^2 to 1024^2: {published}.",
    )


def _share(row: dict[str, Any], bound: dict[str, float]) -> str:
    """Share of the streaming bound of one core, for ways of one core."""
    return f"{100 * row['masses_per_second'] / bound[row['precision']]:.0f} %" if row["way"] in ONE_CORE else ""


def finding(result: StudyResult) -> str:
    """Speed-ups of the largest sheet over NumPy."""
    rows, names = result.findings["rows"], result.findings["devices"]
    size = max(row["size"] for row in rows)
    over = {(row["way"], row["precision"]): row["over_numpy_float64"] for row in rows if row["size"] == size}
    places = {BASE: "on one thread", FREE: f"on threads of {result.record['machine']['cores']} cores"}
    places |= {f"Warp, {alias}": f"on a GPU ({name})" for alias, name in names.items() if alias != "cpu"}
    kinds = [
        ", ".join(f"{over[way, kind]:,.0f} times {words}" for way, words in places.items() if (way, kind) in over)
        for kind in PRECISIONS
    ]
    return f"Kernels step {size}^2 masses faster than NumPy: {kinds[0]}; in float32 {kinds[1]}."
