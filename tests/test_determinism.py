"""The same input on the same machine gives the same bits on one thread, and nearly so on two.

This file is also the program that the tests run in fresh processes, with a path to write to and the cells of the mesh.
"""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import cantilever, held

import modalshell as ms
from modalshell.modes import BACKENDS

TWO_THREADS = 1e-10
"""What two threads may change, as a share of the largest number of an answer; found: 2e-14, in trained cubature."""


def answers(cells):
    """Modes by every back end, equilibrium and motion of every kind of model."""
    shell = cantilever(cells)
    found = {}
    for backend in BACKENDS:
        basis = ms.solve_modes(shell, 8, backend=backend)
        for name in ("eigenvalues", "modes", "rotations"):
            found[f"{backend}: {name}"] = getattr(basis, name)
        found[f"{backend}: modes of a free shell"] = ms.solve_modes(held(shell.mesh), 10, backend=backend).modes
    models = [ms.LinearModal(basis), ms.ModalWarping(basis), ms.RotationStrain(basis)]
    models += [ms.ModalDerivatives(shell, count=4), ms.ModalDerivatives(shell, count=3, cubature=True)]
    models += [ms.DiscreteShell(shell, backend=backend) for backend in BACKENDS]
    for number, model in enumerate(models):
        gravity = (0.0, 0.3, -1.0)
        rest = model.equilibrium(gravity=gravity)
        run = ms.simulate(model, duration=4 / 30, dt=1 / 30, gravity=gravity, damping=(0.1, 0.0))
        assert rest.converged
        assert run.status == "completed"
        found[f"{number} {model.name}: equilibrium"] = rest.positions - shell.rest_positions
        found[f"{number} {model.name}: motion"] = run.positions - shell.rest_positions
    return found


def in_fresh_processes(folder, threads, cells=(16, 4)):
    """Answers of one process for each number of threads, each with a hash seed of its own, at the same time."""
    runs = []
    for seed, count in enumerate(threads):
        path = folder / f"{seed}.npz"
        names = ("OPENBLAS", "OMP", "MKL", "NUMBA")
        environment = os.environ | {f"{name}_NUM_THREADS": str(count) for name in names}
        environment |= {"PYTHONHASHSEED": str(seed), "PYTHONPATH": str(Path(ms.__file__).parents[1])}
        command = [sys.executable, __file__, str(path), *map(str, cells)]
        runs.append((path, subprocess.Popen(command, env=environment)))
    results = []
    for path, process in runs:
        assert process.wait(timeout=300) == 0
        with np.load(path) as stored:
            results.append({name: stored[name] for name in stored.files})
    return results


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return in_fresh_processes(tmp_path_factory.mktemp("determinism"), (1, 1))


def test_one_thread_gives_the_same_bits(small):
    first, second = small
    assert list(first) == list(second)
    assert len(first) >= 4 + 2 * 6
    for name, array in first.items():
        assert np.isfinite(array).all(), name
        assert np.abs(array).max() > 0.0, name
    assert [name for name in first if first[name].tobytes() != second[name].tobytes()] == []


@pytest.mark.slow
def test_two_threads_stay_within_their_bound(tmp_path):
    """On a mesh that keeps them busy."""
    one, two = in_fresh_processes(tmp_path, (1, 2), (60, 16))
    for name, array in one.items():
        np.testing.assert_allclose(two[name], array, rtol=0, atol=TWO_THREADS * np.abs(array).max(), err_msg=name)


IMPLICIT_SHEET = """
import numpy as np
from modalshell.springs import ImplicitSprings, SheetGrid

grid = SheetGrid(shape=(30, 40), spacing=0.02, particle_mass=1e-3, structural=50.0, shear=10.0, flexion=5.0)
sheets = [ImplicitSprings(grid.springs(), np.full(grid.count, 1e-3), np.arange(40), threads=k) for k in (1, 2, 3)]
for sheet in sheets:
    assert sheet.threads.most == 1 + sheets.index(sheet)
    sheet.place(grid.rest_positions())
    for _ in range(3):
        sheet.step(0.01, (0.3, 1.0, -9.81), iterations=20)
assert len({sheet.positions.tobytes() for sheet in sheets}) == 1
"""


@pytest.mark.slow
def test_implicit_springs_give_the_same_bits_on_any_threads():
    """Which threads they take is chosen by the clock: sums of parts went by the number of threads."""
    environment = os.environ | {"NUMBA_NUM_THREADS": "3", "PYTHONPATH": str(Path(ms.__file__).parents[1])}
    subprocess.run([sys.executable, "-c", IMPLICIT_SHEET], env=environment, check=True, timeout=300)


if __name__ == "__main__":
    np.savez(sys.argv[1], **answers((int(sys.argv[2]), int(sys.argv[3]))))
