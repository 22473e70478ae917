"""Sheets over MPI ranks: how particles are split, and PETSc's answer on 1, 2 and 4 ranks against one process.

The runs over ranks need ``mpiexec`` and a Python that has petsc4py: this one, or the one that the environment variable
``MODALSHELL_MPI_PYTHON`` names (see ``studies/benchmarks/ranked_springs.py`` for how to make it).
"""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from modalshell.core.errors import MeshError, OptionError
from modalshell.springs import ImplicitSprings, Springs
from modalshell.springs.implicit import rank_block
from studies.benchmarks.ranked_springs import petsc
from studies.benchmarks.ranks import hanging_sheet

PYTHON = os.environ.get("MODALSHELL_MPI_PYTHON", sys.executable)
ROOT = Path(__file__).resolve().parents[2]
# Open MPI starts neither as root nor with more ranks than cores unless it is told to.
MPI = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1", "OMPI_MCA_rmaps_base_oversubscribe": "1"}
SHAPE, STEPS, STEP = (20, 33), 8, 1.0 / 60.0


@pytest.mark.parametrize("size", [1, 2, 3, 7])
def test_blocks_hold_every_particle_once_and_every_spring_at_both_ends(size):
    grid = hanging_sheet(9, 11)
    springs = grid.springs()
    blocks = [rank_block(springs, grid.count, size, rank) for rank in range(size)]
    owned = np.concatenate([block.particles[: block.owned] for block in blocks])
    assert sorted(owned) == list(range(grid.count))
    assert max(block.owned for block in blocks) - min(block.owned for block in blocks) <= 1
    ends = []
    for block in blocks:
        rows = np.repeat(np.arange(block.owned), np.diff(block.starts))
        ends.append(np.column_stack([block.particles[rows], block.particles[block.others], block.springs]))
        # Nothing is kept that no own spring ends at.
        assert set(block.others[block.others >= block.owned]) == set(range(block.owned, len(block.particles)))
    found = np.concatenate(ends)
    numbers = np.arange(len(springs))
    first, second = springs.pairs.T
    expected = np.concatenate([np.column_stack([first, second, numbers]), np.column_stack([second, first, numbers])])
    assert {tuple(row) for row in found} == {tuple(row) for row in expected}
    assert len(found) == len(expected)


def test_blocks_of_a_shuffled_sheet_are_strips():
    """A rank reads about two rows of particles at each of its two borders, whatever the numbers it got them in."""
    grid = hanging_sheet(60, 20)
    places = np.random.default_rng(0).permutation(grid.count)
    pairs = np.sort(places[grid.springs().pairs], axis=1)
    shuffled = Springs(pairs, 1.0, 1.0, 0.0)
    ghosts = [len(rank_block(shuffled, grid.count, 4, rank).ghosts) for rank in range(4)]
    assert max(ghosts) <= 2 * 2 * 20 * 1.2


def test_bad_splits():
    springs = Springs([[0, 1], [1, 2]], 1.0, 1.0, 0.0)
    with pytest.raises(OptionError, match="more ranks than particles"):
        rank_block(springs, 3, 4, 0)
    with pytest.raises(MeshError, match="particles 0 to 1"):
        rank_block(springs, 2, 1, 0)


def test_missing_petsc_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "petsc4py", None)
    with pytest.raises(OptionError, match="need PETSc and petsc4py"):
        petsc()


def answer(folder, ranks, options=""):
    """Positions, velocities and the report of the hanging sheet's steps on so many ranks."""
    if shutil.which("mpiexec") is None:
        pytest.skip("mpiexec is not installed")
    environment = os.environ | MPI | {"PYTHONPATH": str(ROOT), "PETSC_OPTIONS": options}
    probe = subprocess.run([PYTHON, "-c", "import petsc4py"], env=environment, capture_output=True, text=True)
    if probe.returncode != 0:
        pytest.skip(f"{PYTHON} has no petsc4py; name one that has in MODALSHELL_MPI_PYTHON")
    out = folder / f"ranks_{ranks}.npz"
    command = ["mpiexec", "-n", str(ranks), PYTHON, "-m", "studies.benchmarks.ranks", "--out", str(out)]
    command += ["--rows", str(SHAPE[0]), "--columns", str(SHAPE[1]), "--steps", str(STEPS), "--step", repr(STEP)]
    run = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr
    with np.load(out) as stored:
        return stored["positions"], stored["velocities"], json.loads(run.stdout)


@pytest.fixture(scope="module")
def serial():
    grid = hanging_sheet(*SHAPE)
    sheet = ImplicitSprings(grid.springs(), np.full(grid.count, grid.particle_mass), grid.pinned.ravel(), threads=1)
    sheet.place(grid.rest_positions())
    steps = [sheet.step(STEP, grid.gravity, drag=grid.drag, iterations=2000, tolerance=1e-12) for _ in range(STEPS)]
    assert all(step.converged for step in steps)
    assert np.abs(sheet.positions - grid.rest_positions()).max() > 0.05
    return sheet.positions, sheet.velocities, [step.iterations for step in steps]


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2, 4])
def test_ranks_give_the_serial_answer(ranks, serial, tmp_path):
    positions, velocities, report = answer(tmp_path, ranks)
    assert report["converged"]
    assert report["owned"] == SHAPE[0] * SHAPE[1] // ranks
    assert (report["ghosts"] > 0) == (ranks > 1)
    for got, expected in zip((positions, velocities), serial[:2], strict=True):
        assert np.abs(got - expected).max() < 1e-10 * np.abs(expected).max()


@pytest.mark.slow
def test_petsc_and_numba_take_the_same_iterations_with_the_same_preconditioner(serial, tmp_path):
    """Blocks of single particles know nothing of ranks; the last iteration may fall on either side of the tolerance."""
    positions, _, report = answer(tmp_path, 2, "-pc_type pbjacobi")
    assert report["converged"]
    assert np.abs(np.subtract(report["iterations"], serial[2])).max() <= 2
    assert np.abs(positions - serial[0]).max() < 1e-10 * np.abs(serial[0]).max()
