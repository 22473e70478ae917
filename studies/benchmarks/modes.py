"""What the modes of a large mesh cost: with each back end, against SciPy's ``eigsh`` as it comes."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

import modalshell as ms
from modalshell.core.typing import Array
from modalshell.files.provenance import repository_file
from modalshell.linalg.known_analyses import forget_analyses
from modalshell.modes import BACKENDS
from modalshell.modes.eigenpairs import eigenpairs
from studies.benchmarks.discrete_shell import ENERGIES
from studies.creature import make_creature

PLAIN = "eigsh(K, M=M, sigma=0)"


def large_shell(n: int, energy: str = "hinges") -> ms.Shell:
    """The creature with about ``n`` vertices, standing on its feet; a small sheet below 4,000."""
    theory = ms.Isotropic(young=1e6, poisson=0.3, thickness=1e-3, density=200.0)
    if n < 4000:
        mesh = ms.sheet(cells=(round(n**0.5) - 1,) * 2)
        material = theory if energy == "split folds" else ms.Material(1000.0, 20.0, 0.01, 0.2)
        return ms.Shell(mesh, material, mesh.vertices[:, 0] < 0.1)
    if n == 13000:
        mesh = ms.load_mesh(repository_file("meshes/creature.ply"))
    else:
        mesh = _remeshed(n)
    hinges = ms.Material(1000.0, 1000.0 * mesh.edge_lengths.mean(), 0.01, 0.2)
    return ms.Shell(mesh, theory if energy == "split folds" else hinges, mesh.vertices[:, 2] < 0.015)


def _remeshed(n: int) -> ms.TriangleMesh:
    """The creature at another resolution; it takes minutes, so it is kept for the session's child processes."""
    path = Path(tempfile.gettempdir()) / f"modalshell_creature_{n}.ply"
    if not path.is_file():
        ms.save_mesh(make_creature(vertices=n), path)
    return ms.load_mesh(path)


def solvers(shell: ms.Shell, count: int) -> dict[str, Any]:
    """Each way to the ``count`` lowest eigenpairs, ready to call."""

    def plain() -> Any:
        data = shell.energy_gradient_hessian(shell.rest_positions, 0)[2]
        stiffness = sps.csc_matrix(shell.pattern.free_matrix(data))
        own = np.repeat(shell.mass[shell.free], 3)
        none = np.zeros(stiffness.shape[0] - own.size)  # that of internal unknowns
        mass = sps.diags(np.concatenate([own, none]), format="csc")
        return spla.eigsh(stiffness, k=count, M=mass, sigma=0)[0]

    ways: dict[str, Any] = {PLAIN: plain}
    for backend in BACKENDS:
        ways[backend] = lambda backend=backend: eigenpairs(shell, count, backend)[0]
    return ways


def benchmark(
    sizes: tuple[int, ...] = (13000,), count: int = 4, repeats: int = 3, most_seconds: float = 600.0
) -> list[dict[str, Any]]:
    """Rows of seconds, ratio to plain eigsh, peak memory and its share, for each size and way.

    From 50,000 vertices on each way is solved once, and stopped after ``most_seconds``: its seconds and its memory are
    then lower bounds, and where it is the plain way so are the ratios to it.
    """
    rows = []
    for n, energy in itertools.product(sizes, ENERGIES):
        shell = large_shell(n, energy)
        ways = solvers(shell, count)
        samples: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(repeats if n < 50000 else 0):  # in turn, so that all see the same weather
            for name, solve in ways.items():
                forget_analyses()
                start = time.perf_counter()
                solve()
                samples[name].append(time.perf_counter() - start)
        alone = {name: solved_alone((n, energy), count, name, most_seconds) for name in ways}
        seconds = {name: float(np.median(samples[name] or [alone[name].seconds])) for name in ways}
        found = [one.values for one in alone.values() if one.values is not None]
        for name, one in alone.items():
            rows.append(
                {
                    "n": len(shell.rest_positions),
                    "energy": energy,
                    "modes": count,
                    "way": name,
                    "ended": one.values is not None,
                    "seconds": seconds[name],
                    "times_faster": seconds[PLAIN] / seconds[name],
                    "megabytes": one.megabytes,
                    "memory_share": one.megabytes / alone[PLAIN].megabytes,
                    "difference": _difference(one.values, found[0]) if found else None,
                }
            )
    return rows


def _difference(values: Array | None, reference: Array) -> float | None:
    return None if values is None else float(np.abs(values / reference - 1.0).max())


class Solved(NamedTuple):
    """A solve in a process of its own.

    Attributes
    ----------
    seconds
        Time that it took, or after which it was stopped or failed.
    megabytes
        By which it raised the resident memory at its peak (Linux); not a number where it failed.
    values
        The eigenvalues; None of a solve that did not end.
    """

    seconds: float
    megabytes: float
    values: Array | None


def solved_alone(shell: tuple[int, str], count: int, way: str, most_seconds: float) -> Solved:
    """Solve once in a process of its own, which is stopped after ``most_seconds``."""
    program = (
        "import json, time\n"
        "from studies.benchmarks import modes as bench\n"
        f"bench.solvers(bench.large_shell(400, {shell[1]!r}), {count})[{way!r}]()\n"
        f"solve = bench.solvers(bench.large_shell(*{shell}), {count})[{way!r}]\n"
        "open('/proc/self/clear_refs', 'w').write('5')\n"
        "before, start = bench.resident('VmRSS'), time.perf_counter()\n"
        "print(before, flush=True)\n"
        "values = solve()\n"
        "print(json.dumps([time.perf_counter() - start, bench.resident('VmHWM'), list(values)]))\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        before, start = float(process.stdout.readline()), time.perf_counter()
        try:
            answer, _ = process.communicate(timeout=most_seconds)
        except subprocess.TimeoutExpired:
            peak = resident("VmHWM", process.pid)
            process.kill()
            return Solved(most_seconds, peak - before, None)
    if process.returncode:  # out of memory
        return Solved(time.perf_counter() - start, np.nan, None)
    seconds, peak, values = json.loads(answer)
    return Solved(seconds, peak - before, np.array(values))


def resident(field: str, process: int | str = "self") -> float:
    """A field of the memory status of this process, or of one by its number [megabytes]."""
    with open(f"/proc/{process}/status", encoding="ascii") as file:
        line = next(line for line in file if line.startswith(field))
    return int(line.split()[1]) / 1024.0
