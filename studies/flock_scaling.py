"""How a flock of shells grows: boids and instances a second against their number and their vertices, on one thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from modalshell.crowd import LEVELS
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult, Table
from studies.benchmarks import crowd
from studies.benchmarks.devices import missing_devices
from studies.pages import number

FIGURES = ("flock_scaling",)

BOIDS = (100, 300, 1000, 3000, 10000, 30000, 100000)
PAIRS = (100, 300, 1000, 3000, 10000)
"""Flocks that every pair is tried in."""
INSTANCES = (1, 8, 64, 512, 4096)
CELLS = ((6, 5), (11, 10), (16, 14), (32, 28), (64, 56))
"""Meshes of the bird, from 72 to 7,385 vertices."""
TOTAL = 2_000_000
"""Vertices of a crowd whose mesh changes."""
DEVICE_BOIDS, DEVICE_INSTANCES = (300, 10000, 100000), (8, 512, 4096)
"""Flocks and crowds on devices, timed side by side."""


def main(quick: bool = False, on_step: Callable[[int, int], None] | None = None) -> StudyResult:
    """Measure; ``quick`` takes the small sizes alone."""
    boids, pairs = (BOIDS[:3], PAIRS[:3]) if quick else (BOIDS, PAIRS)
    batches, cells = (INSTANCES[:3], CELLS[:2]) if quick else (INSTANCES, CELLS)
    total, repeats, steps = (20_000, 3, 3) if quick else (TOTAL, 15, 40)
    jobs: list[tuple[str, Callable[[], Any]]] = [
        ("flock", partial(crowd.flock, (count,), steps=steps)) for count in boids
    ]
    jobs += [("flock", partial(crowd.flock, (count,), steps=steps, search="all_pairs")) for count in pairs]
    bird = crowd.bird_basis()
    jobs += [("instances", partial(crowd.reconstruction, count, bird, repeats=repeats)) for count in batches]
    for size in cells:
        basis = crowd.bird_basis(cells=size)
        count = total // len(basis.shell.rest_positions)
        jobs.append(("vertices", partial(crowd.reconstruction, count, basis, repeats=repeats)))
    missing = missing_devices()
    if "Warp" not in missing:
        sizes = (DEVICE_BOIDS[:1], DEVICE_INSTANCES[:1]) if quick else (DEVICE_BOIDS, DEVICE_INSTANCES)
        jobs += [
            ("devices", partial(crowd.on_devices, near, placed, bird, repeats=repeats))
            for near, placed in zip(*sizes, strict=True)
        ]
    rows: dict[str, list[dict[str, Any]]] = {"flock": [], "instances": [], "vertices": [], "devices": []}
    for done, (name, job) in enumerate(jobs, start=1):
        rows[name] += job()
        if on_step is not None:
            on_step(done, len(jobs))
    grid = [row for row in rows["flock"] if row["search"] == "grid"]
    thousand = next(row for row in grid if row["boids"] == 1000)
    findings = {
        **rows,
        "missing": missing,
        "boid_growth": grid[-1]["microseconds_boid"] / thousand["microseconds_boid"],
        "neighbour_growth": grid[-1]["neighbours"] / thousand["neighbours"],
        "pairs_exponent": _exponent([row for row in rows["flock"] if row["search"] == "all_pairs"]),
    }
    return StudyResult("flock_scaling", findings, {"boids": np.array(boids)}, run_record({"quick": quick}))


def _exponent(rows: list[dict[str, Any]]) -> float:
    """Slope of log seconds a step over log N between the two largest flocks."""
    last = rows[-2:]
    seconds, counts = (np.log([row[key] for row in last]) for key in ("steps_per_second", "boids"))
    return float(-np.diff(seconds)[0] / np.diff(counts)[0])


def table(result: StudyResult) -> str:
    """The findings as Markdown tables."""
    found = result.findings
    by = {(row["boids"], row["search"]): row for row in found["flock"]}
    lines = ["Steps of a flock a second of the processor, 20 boids in a cube of the neighbour distance:", ""]
    lines += ["| boids | neighbours of each | grid of cells | all pairs | times faster |", "|---|---|---|---|---|"]
    for row in (row for row in found["flock"] if row["search"] == "grid"):
        pairs = by.get((row["boids"], "all_pairs"))
        rest = "| |"
        if pairs:
            ratio = row["steps_per_second"] / pairs["steps_per_second"]
            rest = f"{pairs['steps_per_second']:,.3g} | {ratio:.1f} |"
        lines.append(f"| {row['boids']:,} | {row['neighbours']:.1f} | {row['steps_per_second']:,.3g} | {rest}")
    lines += [
        "",
        f"A boid costs {found['boid_growth']:.2f} times as much in the largest flock as among 1,000, where more fly at "
        f"the edge and each has {found['neighbour_growth']:.2f} times fewer neighbours. Trying all pairs "
        f"grows with N to the power {found['pairs_exponent']:.2f} at the end.",
        "",
        "Thousands of instances of the paper bird a second, eight modes. The bounds: the products Phi q and Psi q over "
        "the whole batch by BLAS, and writing the positions alone. Placed instances have a rotation and translation "
        "each; the last column is MWTS over the products.",
        "",
        "| instances | vertices | precision | rigid | LMA | MWTS | MWTS placed | steps | products | writing | ratio |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    names = (*(name.lower() for name in LEVELS), "placed", "step", "products", "writing")
    for row in [*found["instances"], *found["vertices"]]:
        rates = " | ".join(f"{row[f'per_second_{name}'] / 1e3:,.3g}" for name in names)
        lines.append(
            f"| {row['instances']:,} | {row['vertices']:,} | {row['dtype']} | {rates} | {row['ratio_products']:.2f} |"
        )
    lines += [
        "",
        "By Warp, over one thread of the kernels above (sums: the kernels' in float64): the sums over the neighbours, "
        "placed MWTS, the same left on the device, and steps. Its cpu device takes one core.",
        "",
        "| device | precision | boids | million boids a second | sums, times faster | instances "
        "| thousands a second, left there | placed, times faster | left there, times faster | steps, times faster |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| Warp, {row['device']} | {row['dtype']} | {row['boids']:,} | {row['boids_per_second'] / 1e6:.3g} "
        f"| {row['ratio_sums']:.2f} | {row['instances']:,} | {row['instances_per_second'] / 1e3:,.3g} "
        f"| {row['ratio_placed']:.2f} | {row['ratio_left']:.2f} | {row['ratio_step']:.2f} |"
        for row in found["devices"]
    ]
    lines += [f"| {name} | {reason} | | | | | | | | |" for name, reason in found["missing"].items()]
    return "\n".join(lines)


def finding(tables: list[Table]) -> str:
    """What the grid of cells gains, and how fast a crowd is."""
    flock, instances, *_ = tables
    faster = next(row for row in reversed(flock) if row["times faster"])
    double = [row for row in instances if row["precision"] == "float64"]
    large = max(double, key=lambda row: number(row["instances"]) * (number(row["vertices"]) == 493))
    return (
        f"Among {faster['boids']} boids a grid of cells finds neighbours {faster['times faster']} times as fast as "
        f"trying all pairs. Of {large['instances']} birds of {large['vertices']} vertices one thread computes "
        f"{number(large['MWTS']):.0f} thousand MWTS shapes a second in float64, {large['ratio']} times as many as the "
        f"two matrix products alone allow."
    )
