"""How a flock of shells grows: boids and instances a second against their number and their vertices, on one thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from modalshell.core.typing import Progress
from modalshell.crowd import LEVELS
from modalshell.files.study_result import StudyResult
from studies.benchmarks import crowd
from studies.benchmarks.devices import missing_devices
from studies.pages import counted, markdown, paragraphs, result_of

FIGURES = ("flock_scaling",)

BOIDS = (100, 300, 1000, 3000, 10000, 30000, 100000, 1000000)
PAIRS = (100, 300, 1000, 3000, 10000)
"""Flocks that every pair is tried in."""
INSTANCES = (1, 8, 64, 512, 4096)
CELLS = ((6, 5), (11, 10), (16, 14), (32, 28), (64, 56))
"""Meshes of the bird, from 72 to 7,385 vertices."""
TOTAL = 2_000_000
"""Vertices of a crowd whose mesh changes."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
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
        jobs += [
            ("devices", partial(crowd.on_devices, *sizes, repeats=repeats))
            for sizes in (crowd.DEVICES[:1] if quick else crowd.DEVICES)
        ]
    rows: dict[str, list[dict[str, Any]]] = {"flock": [], "instances": [], "vertices": [], "devices": []}
    for name, job in counted(jobs, on_step):
        rows[name] += job()
    grid = [row for row in rows["flock"] if row["search"] == "grid"]
    thousand = next(row for row in grid if row["boids"] == 1000)
    findings = {
        **rows,
        "missing": missing,
        "boid_growth": grid[-1]["microseconds_boid"] / thousand["microseconds_boid"],
        "neighbour_growth": grid[-1]["neighbours"] / thousand["neighbours"],
        "pairs_exponent": _exponent([row for row in rows["flock"] if row["search"] == "all_pairs"]),
    }
    return result_of("flock_scaling", findings, {"boids": np.array(boids)}, quick=quick)


def _exponent(rows: list[dict[str, Any]]) -> float:
    """Slope of log seconds a step over log N between the two largest flocks."""
    last = rows[-2:]
    seconds, counts = (np.log([row[key] for row in last]) for key in ("steps_per_second", "boids"))
    return float(-np.diff(seconds)[0] / np.diff(counts)[0])


def grid_and_pairs(rows: list[dict[str, Any]]) -> list[tuple[dict[str, Any], float | None]]:
    """Each flock by a grid of cells, and the steps a second of the same by all pairs, None where they are not tried."""
    pairs = {row["boids"]: row["steps_per_second"] for row in rows if row["search"] == "all_pairs"}
    return [(row, pairs.get(row["boids"])) for row in rows if row["search"] == "grid"]


def table(result: StudyResult) -> str:
    """The findings as Markdown tables."""
    found = result.findings
    names = (*(name.lower() for name in LEVELS), "placed", "step", "products", "writing")
    flocks = [
        row | {"pairs": pairs, "times": None if pairs is None else row["steps_per_second"] / pairs}
        for row, pairs in grid_and_pairs(found["flock"])
    ]
    missing = [f"| {name} | {reason} | | | | | | | | | |" for name, reason in found["missing"].items()]
    devices = markdown(
        "device | precision | boids | million boids a second | sums, times faster | instances | vertices "
        "| thousands a second, left there | placed, times faster | left there, times faster | steps, times faster",
        "Warp, {device} | {dtype} | {boids:,} | {boids_per_second:1e-6*.3g} | {ratio_sums:.2f} | {instances:,} "
        "| {vertices:,} | {instances_per_second:1e-3*,.3g} | {ratio_placed:.2f} | {ratio_left:.2f} | {ratio_step:.2f}",
        found["devices"],
    )
    return paragraphs(
        "Steps of a flock a second of the processor, 20 boids in a cube of the neighbour distance:",
        markdown(
            "boids | neighbours of each | grid of cells | all pairs | times faster | megabytes",
            "{boids:,} | {neighbours:.1f} | {steps_per_second:,.3g} | {pairs:,.3g|} | {times:.1f|} | {megabytes:,.3g}",
            flocks,
        ),
        f"A boid costs {found['boid_growth']:.2f} times as much in the largest flock as among 1,000, where more "
        f"fly at the edge and each has {found['neighbour_growth']:.2f} times fewer neighbours. Trying all pairs "
        f"grows with N to the power {found['pairs_exponent']:.2f} at the end.",
        "Thousands of instances of the paper bird a second, eight modes. For comparison: the products Phi q and Psi q "
        "over the whole batch by BLAS, and writing the positions alone. Placed instances have a rotation and "
        "translation each; the last column is MWTS over the products.",
        markdown(
            "instances | vertices | precision | rigid | LMA | MWTS | MWTS placed | steps | products | writing | ratio",
            "{instances:,} | {vertices:,} | {dtype} | {rates:1e-3*,.3g} | {ratio_products:.2f}",
            [
                row | {"rates": [row[f"per_second_{name}"] for name in names]}
                for row in [*found["instances"], *found["vertices"]]
            ],
        ),
        "By Warp, over one thread of the kernels above (sums: the kernels' in float64): the sums over the "
        "neighbours, placed MWTS, the same left on the device, and steps. Its cpu device takes one core.",
        "\n".join([devices, *missing]),
    )


def finding(result: StudyResult) -> str:
    """What the grid of cells gains, and how fast a crowd is."""
    found = result.findings
    grid, pairs = [pair for pair in grid_and_pairs(found["flock"]) if pair[1] is not None][-1]
    large = max((row for row in found["instances"] if row["dtype"] == "float64"), key=lambda row: row["instances"])
    return (
        f"Among {grid['boids']:,} boids a grid of cells finds neighbours {grid['steps_per_second'] / pairs:.1f} times "
        f"as fast as trying all pairs. Of {large['instances']:,} birds of {large['vertices']:,} vertices one thread "
        f"computes {large['per_second_mwts'] / 1e3:.0f} thousand MWTS shapes a second in float64, "
        f"{large['ratio_products']:.2f} times as many as BLAS computes the two matrix products of."
    )
