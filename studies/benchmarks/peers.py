"""Sparse factors of other packages on the Hessians of implicit steps: CHOLMOD by cvxopt, PARDISO by pypardiso.

Neither is a dependency: ``pip install cvxopt pypardiso``. Packages that are not here have no rows.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.sparse as sps

from modalshell.core.typing import Array
from modalshell.linalg import CholeskyAnalysis
from studies.benchmarks.discrete_shell import ENERGIES
from studies.benchmarks.factorisation import step_matrix
from studies.benchmarks.timing import interleaved

Ways = tuple[Callable[[], object], Callable[[], object], Callable[[Array], Array]]
"""Symbolic analysis, numeric factor, and solution with that factor."""


def own(matrix: sps.csc_array) -> Ways:
    """Of modalshell; each analysis is a new one."""
    analysis = CholeskyAnalysis(matrix)
    factor = analysis.factorise(matrix)
    return partial(CholeskyAnalysis, matrix), partial(analysis.factorise, matrix), factor.solve


def cholmod(matrix: sps.csc_array) -> Ways:
    """CHOLMOD, supernodal, by its default ordering."""
    from cvxopt import cholmod as package
    from cvxopt import matrix as dense
    from cvxopt import spmatrix

    package.options["supernodal"] = 2
    lower = sps.coo_array(sps.tril(matrix))
    entries = spmatrix(lower.data.tolist(), lower.row.tolist(), lower.col.tolist(), matrix.shape)
    factor = package.symbolic(entries)
    package.numeric(entries, factor)

    def solve(right_side: Array) -> Array:
        x = dense(right_side)
        package.solve(factor, x)
        return np.array(x).ravel()

    return partial(package.symbolic, entries), partial(package.numeric, entries, factor), solve


def pardiso(matrix: sps.csc_array) -> Ways:
    """PARDISO of MKL for positive definite matrices, ordered by METIS."""
    from pypardiso import PyPardisoSolver

    upper = sps.csr_matrix(sps.triu(matrix))
    upper.sort_indices()
    solver = PyPardisoSolver(mtype=2)

    def phase(number: int, right_side: Array) -> Array:
        solver.set_phase(number)
        return np.asarray(solver._call_pardiso(upper, right_side))

    none = np.zeros(matrix.shape[0])
    for number in (11, 22):
        phase(number, none)
    return partial(phase, 11, none), partial(phase, 22, none), partial(phase, 33)


PACKAGES: dict[str, Callable[[sps.csc_array], Ways]] = {"modalshell": own, "CHOLMOD": cholmod, "PARDISO": pardiso}


def peers(sides: tuple[int, ...] = (50, 100, 200), repeats: int = 7) -> list[dict[str, Any]]:
    """CPU milliseconds of an analysis, a factor and a solution by each package, and a factor's over ours.

    ``residual`` is that of the solution, relative to its right side.
    """
    rows = []
    for side, energy in itertools.product(sides, ENERGIES):
        matrix = sps.csc_array(step_matrix(side, energy))
        ways: dict[str, Ways] = {}
        for name, make in PACKAGES.items():
            try:
                ways[name] = make(matrix)
            except ImportError:
                continue
        right_side = np.random.default_rng(0).standard_normal(matrix.shape[0])
        residuals = {
            name: float(np.linalg.norm(matrix @ solve(right_side) - right_side) / np.linalg.norm(right_side))
            for name, (_, _, solve) in ways.items()
        }
        factors: dict[str, Callable[[], object]] = {name: factor for name, (_, factor, _) in ways.items()}
        solves: dict[str, Callable[[], object]] = {
            name: partial(solve, right_side) for name, (_, _, solve) in ways.items()
        }
        seconds = interleaved(factors, repeats, clock=time.process_time)
        solved = interleaved(solves, repeats, clock=time.process_time)
        analysed = {name: _once(analyse) for name, (analyse, _, _) in ways.items()}
        for name in ways:
            row = {"vertices": side**2, "energy": energy, "package": name, "analysis [ms]": 1e3 * analysed[name]}
            row |= {"factor [ms]": 1e3 * seconds[name], "solve [ms]": 1e3 * solved[name]}
            row |= {"factor_over_ours": seconds[name] / seconds["modalshell"]}
            row |= {"solve_over_ours": solved[name] / solved["modalshell"], "residual": residuals[name]}
            rows.append(row)
    return rows


def _once(function: Callable[[], object]) -> float:
    """CPU seconds of one call."""
    start = time.process_time()
    function()
    return time.process_time() - start
