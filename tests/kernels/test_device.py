"""Sheets stepped by Warp: on its processor device everywhere it is installed, and on a GPU where there is one."""

import subprocess
import sys

import numpy as np
import pytest

from modalshell.core.errors import LoadError, OptionError, SolverError
from modalshell.kernels.device import checked_device, devices, warp
from modalshell.springs import GridVerlet, SheetGrid
from modalshell.springs.device import DeviceVerlet

pytest.importorskip("warp", reason="Warp is not installed: pip install 'modalshell[gpu]'")

DEVICES = [pytest.param(name, id=name) for name in devices()]
STEP = 2e-4


def sheet(**more):
    """An uneven grid, so that rows and columns cannot be mixed up, held at two corners."""
    pinned = np.zeros((9, 14), bool)
    pinned[0, [0, -1]] = True
    stiffness = {"structural": 50.0, "shear": 30.0, "flexion": 10.0}
    gravity = np.array([0.3, -0.2, -9.81])
    return SheetGrid(
        shape=(9, 14), spacing=0.01, particle_mass=1e-3, drag=0.5, pinned=pinned, gravity=gravity, **stiffness, **more
    )


def crumpled(grid):
    return grid.rest_positions() + np.random.default_rng(3).normal(scale=0.1 * grid.spacing, size=(grid.count, 3))


def spring_by_spring(grid, start, count, dt):
    """The same steps summed over the list of springs, with none of the grid's structure."""
    springs, free = grid.springs(), ~grid.pinned.ravel()[:, None]
    first, second = springs.pairs.T

    def acceleration(positions):
        offset = positions[second] - positions[first]
        length = np.linalg.norm(offset, axis=1)
        pull = (springs.stiffness * (1.0 - springs.rest_lengths / length))[:, None] * offset
        force = np.zeros_like(positions)
        np.add.at(force, first, pull)
        np.subtract.at(force, second, pull)
        return free * (force / grid.particle_mass + grid.gravity)

    half = 0.5 * grid.drag * dt
    before, now = start + 0.5 * dt**2 * acceleration(start), start
    for _ in range(count):
        moved = ((1.0 - half) * free * (now - before) + dt**2 * acceleration(now)) / (1.0 + half)
        before, now = now, now + moved
    return now


def rounding(dtype, count, positions):
    """Bound of the distance of two runs: each rounding of a coordinate is a push that all later steps repeat."""
    return 0.5 * count * (count + 1) * np.finfo(dtype).eps * np.ptp(positions)


@pytest.mark.slow
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_device_takes_the_steps_of_the_springs_one_by_one(device, dtype):
    grid = sheet()
    start = crumpled(grid)
    verlet = DeviceVerlet(grid, dtype, start, device)
    verlet.step(50, STEP)
    verlet.step(51, STEP)
    truth = spring_by_spring(grid, start, 101, STEP)
    assert verlet.positions.dtype == dtype
    assert np.abs(truth - start).max() > 0.1 * grid.spacing
    assert np.abs(verlet.positions - truth).max() < rounding(dtype, 101, truth)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_devices_and_kernels_take_the_same_steps(device, dtype):
    """With velocities at the start and another length of step on the way."""
    grid = sheet()
    start, velocity = crumpled(grid), np.random.default_rng(4).normal(scale=0.1, size=(grid.count, 3))
    answers = []
    for sheet_of in (
        GridVerlet(grid, dtype, start, velocity=velocity),
        DeviceVerlet(grid, dtype, start, device, velocity=velocity),
    ):
        sheet_of.step(7, STEP)
        sheet_of.step(10, 0.5 * STEP)
        answers.append((sheet_of.positions, sheet_of.velocities))
    (expected, rates), (positions, velocities) = answers
    assert np.abs(positions - expected).max() < rounding(dtype, 17, start)
    assert np.abs(velocities - rates).max() < 17 * np.finfo(dtype).eps * np.ptp(start) / (0.5 * STEP)


@pytest.mark.parametrize("device", DEVICES)
def test_a_sheet_that_blows_up_is_told(device):
    verlet = DeviceVerlet(sheet(), start=crumpled(sheet()), device=device, allow_unstable_step=True)
    with pytest.raises(SolverError, match="left the finite numbers"):
        verlet.step(2000, 0.1)


@pytest.mark.parametrize("device", DEVICES)
def test_without_start_and_forces_nothing_moves(device):
    grid = SheetGrid(shape=(3, 5), spacing=0.1, particle_mass=1.0, structural=1.0, shear=1.0, flexion=1.0)
    verlet = DeviceVerlet(grid, device=device)
    verlet.step(10, 0.01)
    assert np.abs(verlet.positions - grid.rest_positions()).max() < 1e-15


def test_positions_are_a_copy():
    verlet = DeviceVerlet(sheet(), device="cpu")
    verlet.positions[:] = 1.0
    assert np.abs(verlet.positions - sheet().rest_positions()).max() == 0.0


def test_without_a_name_the_gpu_is_taken_if_there_is_one():
    assert checked_device(None) == ("cuda:0" if "cuda:0" in devices() else "cpu")


@pytest.mark.parametrize("name", ["cuda:64", "gpu"])
def test_devices_that_are_not_here(name):
    words = "no GPU is here" if name == "cuda:64" and devices() == ["cpu"] else "there is no such device"
    with pytest.raises(OptionError, match=f"{words}: device must be one of cpu.*got '{name}'"):
        DeviceVerlet(sheet(), device=name)


def test_bad_input():
    with pytest.raises(OptionError, match="float64 or float32"):
        DeviceVerlet(sheet(), dtype=np.int32, device="cpu")
    with pytest.raises(LoadError, match="start must have shape"):
        DeviceVerlet(sheet(), start=np.zeros((3, 3)), device="cpu")
    with pytest.raises(OptionError, match="dt must be"):
        DeviceVerlet(sheet(), device="cpu").step(1, -1.0)
    with pytest.raises(OptionError, match="step of at most"):
        DeviceVerlet(sheet(), device="cpu").step(1, 1.0)
    with pytest.raises(OptionError, match="no dashpots"):
        DeviceVerlet(sheet(spring_damping=1e-3), device="cpu")


@pytest.mark.slow
def test_warp_is_silent():
    script = "from modalshell.kernels.device import devices; print(devices())"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout == f"{devices()}\n"


def test_missing_warp_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(OptionError, match=r"pip install 'modalshell\[gpu\]'"):
        warp()
