"""Sheets stepped by Warp: on its processor device everywhere it is installed, and on a GPU where there is one."""

import subprocess
import sys

import numpy as np
import pytest

from modalshell.errors import LoadError, OptionError
from modalshell.springs import SheetGrid
from modalshell.springs.device import DeviceVerlet, checked_device, devices, warp

pytest.importorskip("warp", reason="Warp is not installed: pip install 'modalshell[gpu]'")

DEVICES = [pytest.param(name, id=name) for name in devices()]
STEP = 2e-4


def sheet(spring_damping=0.0):
    """An uneven grid, so that rows and columns cannot be mixed up, held at two corners."""
    pinned = np.zeros((9, 14), bool)
    pinned[0, [0, -1]] = True
    return SheetGrid(
        shape=(9, 14),
        spacing=0.01,
        particle_mass=1e-3,
        structural=50.0,
        shear=30.0,
        flexion=10.0,
        drag=0.5,
        spring_damping=spring_damping,
        pinned=pinned,
        gravity=(0.3, -0.2, -9.81),
    )


def crumpled(grid):
    return grid.rest_positions() + np.random.default_rng(3).normal(scale=0.1 * grid.spacing, size=(grid.count, 3))


def spring_by_spring(grid, start, count, dt):
    """The same steps summed over the list of springs, with none of the grid's structure."""
    springs, free = grid.springs(), ~grid.pinned.ravel()
    first, second = springs.pairs.T
    before = now = start
    for _ in range(count):
        velocity = (now - before) / dt
        offset = now[second] - now[first]
        length = np.linalg.norm(offset, axis=1)
        direction = offset / length[:, None]
        rate = np.sum(direction * (velocity[second] - velocity[first]), axis=1)
        tension = springs.stiffness * (length - springs.rest_lengths) + springs.damping * rate
        force = np.zeros_like(now)
        np.add.at(force, first, tension[:, None] * direction)
        np.subtract.at(force, second, tension[:, None] * direction)
        acceleration = force / grid.particle_mass + grid.gravity - grid.drag * velocity
        before, now = now, np.where(free[:, None], 2.0 * now - before + acceleration * dt**2, now)
    return now


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("spring_damping", [0.0, 0.02])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_a_device_takes_the_steps_of_the_springs_one_by_one(device, spring_damping, dtype):
    grid = sheet(spring_damping)
    start = crumpled(grid)
    verlet = DeviceVerlet(grid, dtype, start, device)
    verlet.step(50, STEP)
    verlet.step(51, STEP)
    truth = spring_by_spring(grid, start, 101, STEP)
    moved = np.abs(truth - start).max()
    assert verlet.positions.dtype == dtype
    assert moved > 0.1 * grid.spacing
    # One rounding of a coordinate in every step.
    assert np.abs(verlet.positions - truth).max() < 101 * np.finfo(dtype).eps * np.ptp(truth)


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


def test_warp_is_silent_and_loaded_only_when_used():
    script = "import sys, modalshell, modalshell.springs; assert 'warp' not in sys.modules\n"
    script += "from modalshell.springs.device import devices; print(devices())"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout == f"{devices()}\n"


def test_missing_warp_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(OptionError, match=r"pip install 'modalshell\[gpu\]'"):
        warp()
