"""Steps of a hanging sheet over MPI ranks, timed: see :mod:`studies.benchmarks.ranked_springs` for what it needs.

``mpiexec -n 2 python -m studies.benchmarks.ranks --rows 256 --columns 256``; rank 0 prints JSON.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import cyclopts
import numpy as np

from modalshell.core.checks import checked_count
from modalshell.files.atomic_io import write_npz
from modalshell.springs.implicit import TASKS
from modalshell.springs.sheet_grid import SheetGrid
from studies.benchmarks.ranked_springs import RankedSprings


def hanging_sheet(rows: int, columns: int) -> SheetGrid:
    """A cloth 1 m wide, 0.2 kg/m^2, held along its first row, that falls from the level."""
    spacing = 1.0 / (columns - 1)
    pinned = np.zeros((rows, columns), bool)
    pinned[0] = True
    return SheetGrid(
        shape=(rows, columns),
        spacing=spacing,
        particle_mass=0.2 * spacing**2,
        structural=100.0,
        shear=50.0,
        flexion=1.0,
        drag=0.5,
        spring_damping=1e-4,
        pinned=pinned,
        gravity=np.array([0.0, 0.0, -9.81]),
    )


def main(
    *,
    rows: int = 64,
    columns: int = 64,
    steps: int = 10,
    step: float = 1.0 / 60.0,
    tolerance: float = 1e-12,
    iterations: int = 1000,
    out: Path | None = None,
) -> None:
    """Step :func:`hanging_sheet` over the ranks; rank 0 prints what the steps took as JSON.

    Parameters
    ----------
    rows, columns : int
        Masses along and across the sheet.
    steps : int
        Number of steps.
    step : float
        Length of a step [s].
    tolerance : float
        Residual over load and momentum.
    iterations : int
        Most iterations of conjugate gradients a step.
    out : Path, optional
        File .npz for positions and velocities.
    """
    grid = hanging_sheet(rows, columns)
    start = time.perf_counter()
    masses = np.full(grid.count, grid.particle_mass)
    sheet = RankedSprings(grid.springs(), masses, grid.rest_positions(), grid.pinned.ravel())
    setup = time.perf_counter() - start
    taken, seconds = [], []
    for _ in range(checked_count("steps", steps)):
        start = time.perf_counter()
        taken.append(sheet.step(step, grid.gravity, drag=grid.drag, iterations=iterations, tolerance=tolerance))
        seconds.append(time.perf_counter() - start)
    positions, velocities = sheet.positions(), sheet.velocities()
    if positions is None or velocities is None:  # rank 0 has them
        return
    found = {
        "ghosts": len(sheet.block.ghosts),
        "owned": sheet.block.owned,
        "converged": all(one.converged for one in taken),
        "iterations": [one.iterations for one in taken],
        "seconds_setup": setup,
        "seconds_step": float(np.median(seconds)),
        "seconds_tasks": {task: float(np.median([one.seconds[task] for one in taken])) for task in TASKS},
    }
    print(json.dumps(found))
    if out is not None:
        write_npz(out, positions=positions, velocities=velocities)


if __name__ == "__main__":
    cyclopts.run(main)
