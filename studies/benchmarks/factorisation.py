"""What factors cost and what waits for them: refactorisation, statics of a cantilever, and building a large shell."""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Literal

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

import modalshell as ms
from modalshell.linalg import CholeskyAnalysis
from studies.benchmarks.discrete_shell import ENERGIES, STEP, hanging_sheet
from studies.benchmarks.modes import resident
from studies.benchmarks.timing import interleaved
from studies.cantilever_master_curve import LENGTH, SHEET, WIDTH

GAMMA = 20.0
"""Weight of the cantilever times its length cubed over its bending stiffness and width."""


def step_matrix(side: int, energy: str) -> Any:
    """Hessian of an implicit step of a hanging sheet of ``side`` squared vertices at rest."""
    shell = hanging_sheet(side, energy)
    data = shell.energy_gradient_hessian(shell.rest_positions, 0)[2]
    data[shell.pattern.diagonal] += np.repeat(shell.mass, 3) / STEP**2
    return shell.pattern.free_matrix(data)


def refactorisation(sides: tuple[int, ...] = (50, 100, 115), repeats: int = 7) -> list[dict[str, Any]]:
    """CPU milliseconds of a factor of an implicit step's Hessian: SuperLU in symmetric mode, and ours."""
    rows = []
    for side, energy in itertools.product(sides, ENERGIES):
        matrix = step_matrix(side, energy)
        analysis = CholeskyAnalysis(matrix)
        factor, right_side = analysis.factorise(matrix), np.ones(matrix.shape[0])
        order = np.argsort(_superlu(sps.csc_matrix(matrix), "MMD_AT_PLUS_A").perm_c)
        ways: dict[str, Callable[[], object]] = {
            "superlu": partial(_superlu, sps.csc_matrix(matrix[order][:, order]), "NATURAL"),
            "cholesky": partial(analysis.factorise, matrix),
            "analysis": partial(CholeskyAnalysis, matrix),
            "solve": partial(factor.solve, right_side),
        }
        seconds = interleaved(ways, repeats, clock=time.process_time)
        rows.append(
            {
                "vertices": side**2,
                "energy": energy,
                **{f"{name} [ms]": 1e3 * value for name, value in seconds.items()},
                "times_faster": seconds["superlu"] / seconds["cholesky"],
                "entries": analysis.entries,
            }
        )
    return rows


def _superlu(matrix: sps.csc_matrix, order: Literal["MMD_AT_PLUS_A", "NATURAL"]) -> Any:
    return spla.splu(matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def statics(cells: tuple[int, int] = (245, 40)) -> list[dict[str, Any]]:
    """CPU seconds of a heavy cantilever's equilibrium from rest, with both energies."""
    rigidity = SHEET["young"] * SHEET["thickness"] ** 3 / 12.0
    weight = GAMMA * rigidity / (SHEET["density"] * SHEET["thickness"] * LENGTH**3)
    rows = []
    for name in ("hinges", "split folds"):
        for size in ((30, 10), cells):  # the small one compiles
            mesh = ms.flat_beam(length=LENGTH, width=WIDTH, cells=size)
            held = mesh.vertices[:, 0] < (1.1 * LENGTH / size[0] if name == "hinges" else 1e-9)
            material = ms.Isotropic(**SHEET) if name != "hinges" else ms.Material.from_physical(**SHEET, mesh=mesh)
            model = ms.DiscreteShell(ms.Shell(mesh, material, held))
            start = time.process_time()
            answer = model.equilibrium(gravity=(0.0, 0.0, -weight))
            seconds = time.process_time() - start
        row = {"vertices": len(mesh.vertices), "energy": name, "seconds": seconds, "iterations": answer.iterations}
        rows.append(row | {"status": answer.status, "residual": answer.residual})
    return rows


def building(cells: int = 999) -> list[dict[str, Any]]:
    """Seconds and memory at its peak of building a shell, in a process of its own (Linux)."""
    rows = []
    for energy in ENERGIES:
        program = f"from studies.benchmarks import factorisation as bench\nprint(*bench.built({cells}, {energy!r}))\n"
        answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        seconds, megabytes = (float(word) for word in answer.stdout.split()[-2:])
        row = {"vertices": (cells + 1) ** 2, "energy": energy, "seconds": seconds}
        rows.append(row | {"peak_gigabytes": megabytes / 1024.0})
    return rows


def built(cells: int, energy: str) -> tuple[float, float]:
    """CPU seconds of a square shell of ``cells`` a side, and this process's megabytes at their peak."""
    for side in (8, cells):
        start = time.process_time()
        mesh = ms.sheet(cells=(side, side))
        theory = ms.Isotropic(young=1e6, poisson=0.3, thickness=1e-3, density=200.0)
        material = theory if energy == "split folds" else ms.Material(1000.0, 20.0, 0.01, 0.2)
        ms.Shell(mesh, material, mesh.vertices[:, 0] < 1e-9)
    return time.process_time() - start, resident("VmHWM")
