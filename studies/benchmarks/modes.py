"""What the modes of a large mesh cost: with each back end, against SciPy's ``eigsh`` as it comes."""

from __future__ import annotations

import itertools
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sps
import scipy.sparse.linalg as spla

import modalshell as ms
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


def benchmark(sizes: tuple[int, ...] = (13000,), count: int = 4, repeats: int = 3) -> list[dict[str, Any]]:
    """Rows of seconds, ratio to plain eigsh, peak memory and its share, for each size and way."""
    rows = []
    for n, energy in itertools.product(sizes, ENERGIES):
        shell = large_shell(n, energy)
        ways = solvers(shell, count)
        values: dict[str, Any] = {}
        samples: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(repeats if n < 50000 else 1):  # in turn, so that all see the same weather
            for name, solve in ways.items():
                forget_analyses()
                start = time.perf_counter()
                values[name] = solve()
                samples[name].append(time.perf_counter() - start)
        seconds = {name: float(np.median(times)) for name, times in samples.items()}
        memory = {name: peak_memory((n, energy), count, name) for name in ways}
        for name in ways:
            rows.append(
                {
                    "n": len(shell.rest_positions),
                    "energy": energy,
                    "modes": count,
                    "way": name,
                    "seconds": seconds[name],
                    "times_faster": seconds[PLAIN] / seconds[name],
                    "megabytes": memory[name],
                    "memory_share": memory[name] / memory[PLAIN],
                    "difference": float(np.abs(values[name] / values[PLAIN] - 1.0).max()),
                }
            )
    return rows


def peak_memory(shell: tuple[int, str], count: int, way: str) -> float:
    """Megabytes by which one solve raises the resident memory of a process of its own at its peak (Linux)."""
    program = (
        "from studies.benchmarks import modes as bench\n"
        f"bench.solvers(bench.large_shell(400, {shell[1]!r}), {count})[{way!r}]()\n"
        f"solve = bench.solvers(bench.large_shell(*{shell}), {count})[{way!r}]\n"
        "open('/proc/self/clear_refs', 'w').write('5')\n"
        "before = bench.resident('VmRSS')\n"
        "solve()\n"
        "print(bench.resident('VmHWM') - before)\n"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return float(answer.stdout.split()[-1])


def resident(field: str) -> float:
    """A field of this process's memory status [megabytes]."""
    with open("/proc/self/status", encoding="ascii") as file:
        line = next(line for line in file if line.startswith(field))
    return int(line.split()[1]) / 1024.0
