"""The classical grid stepped by Verlet: against the general path, its limit, its order, and what it conserves."""

from contextlib import nullcontext

import numpy as np
import pytest
from scenes import grid_model, grid_of, shaken

import modalshell as ms
from modalshell.core.errors import OptionError, SolverError
from modalshell.springs import GridVerlet, SheetGrid
from modalshell.springs.threads import ThreadChoice


@pytest.mark.by_default("3-shape0-double")
@pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 1e-13), (np.float32, 1e-5)], ids=["double", "single"])
@pytest.mark.parametrize(
    "shape",
    [
        (3, 3),
        (4, 19),
        pytest.param((33, 48), marks=pytest.mark.slow),
        (3, 1030),
    ],
)
@pytest.mark.parametrize("threads", [1, 3])
def test_grid_kernel_is_the_general_path(shape, threads, dtype, bound, monkeypatch):
    """Verlet on the grid against Verlet on SpringSheet, pinned corners, drag and gravity, to rounding."""
    monkeypatch.setattr("modalshell.springs.threads.numba.config.NUMBA_NUM_THREADS", threads)
    monkeypatch.setattr("modalshell.springs.threads.limited_to", nullcontext)
    pull = (0.3, 1.0, -9.81)
    grid = grid_of(shape, [(0, 0), (0, -1)], drag=0.5, gravity=pull)
    start, dt = shaken(grid, 0.01), 0.3 * grid.stable_step()
    model = grid_model(grid, integrator="verlet")
    general = ms.simulate(model, duration=40 * dt, dt=dt, gravity=pull, damping=(0.5, 0.0), start=start)
    assert general.status == "completed"
    sheet = GridVerlet(grid, dtype, start, threads)
    assert sheet.threads.most == threads
    sheet.step(17, dt)
    np.testing.assert_allclose(sheet.positions, general.positions[17], rtol=0, atol=bound * max(shape) * 0.1)
    sheet.step(23, dt)
    assert sheet.positions.dtype == dtype
    np.testing.assert_allclose(sheet.positions, general.positions[40], rtol=0, atol=bound * max(shape) * 0.1)


@pytest.mark.slow
def test_grid_results_do_not_depend_on_the_threads(monkeypatch):
    monkeypatch.setattr("modalshell.springs.threads.numba.config.NUMBA_NUM_THREADS", 5)
    monkeypatch.setattr("modalshell.springs.threads.limited_to", nullcontext)
    grid = grid_of((40, 37), [(0, 0)], gravity=(0.0, 0.0, -9.81))
    ends = []
    for threads in (1, 2, 5, None):
        sheet = GridVerlet(grid, start=shaken(grid, 0.01), threads=threads)
        assert threads is None or sheet._work.shape[0] == threads
        sheet.step(50, 0.3 * grid.stable_step())
        ends.append(sheet.positions)
    np.testing.assert_array_equal(ends[0], ends[1])
    for end in ends[2:]:
        np.testing.assert_array_equal(ends[0], end)


def test_threads_are_those_that_were_faster(monkeypatch):
    """Trials first, then the faster; the slower is tried again ever more rarely, and taken once it is the faster."""
    monkeypatch.setattr("modalshell.springs.threads.numba.config.NUMBA_NUM_THREADS", 4)
    monkeypatch.setattr("modalshell.springs.threads.limited_to", nullcontext)
    clock = [0.0]
    monkeypatch.setattr("modalshell.springs.threads.perf_counter", lambda: clock[0])
    choice, speed, taken = ThreadChoice(10_000, 1000), {1: 1.0, 4: 3.0}, []
    for step in range(3000):
        if step == 1000:
            speed = {1: 1.0, 4: 0.3}
        with choice.steps() as threads:
            clock[0] += speed[threads]
        taken.append(threads)
    assert taken[:6] == [4, 1, 4, 1, 4, 1]
    assert taken[6:1000].count(4) < 10
    assert taken[-500:].count(1) < 10
    assert ThreadChoice(1500, 1000).most == 1
    assert ThreadChoice(10, 1000, 3).most == 3
    with pytest.raises(OptionError, match="threads"):
        ThreadChoice(10, 1000, 0)


def test_another_step_goes_on_from_the_same_velocities():
    grid = grid_of(drag=0.3, gravity=(0.0, 0.0, -9.81))
    sheet = GridVerlet(grid, start=shaken(grid, 0.005), velocity=np.ones((grid.count, 3)))
    np.testing.assert_array_equal(sheet.velocities, 1.0)
    sheet.step(30, 0.2 * grid.stable_step())
    before = sheet.velocities
    sheet._set_step(0.1 * grid.stable_step())
    np.testing.assert_allclose(sheet.velocities, before, rtol=0, atol=1e-11)


def test_stable_step_of_the_grid():
    """The endless sheet's bound lies above every finite sheet's own limit, and near it."""
    small, large = grid_of((5, 5)), grid_of((16, 16))
    for grid, share in ((small, 0.9), (large, 0.99)):
        exact = grid_model(grid, integrator="verlet").stable_step()
        assert share * exact < grid.stable_step() <= exact * (1.0 + 2e-4)
    damped = grid_of((16, 16), spring_damping=0.5)
    exact = grid_model(damped, integrator="verlet").stable_step()
    assert damped.stable_step() <= exact * (1.0 + 2e-4)
    assert damped.stable_step() == pytest.approx(exact, rel=0.02)
    sheet = GridVerlet(large)
    with pytest.raises(OptionError, match="at most"):
        sheet.step(1, 1.01 * large.stable_step())


def grows(grid, dt, steps):
    sheet = GridVerlet(grid, start=shaken(grid, 1e-9), allow_unstable_step=True)
    try:
        sheet.step(steps, dt)
    except SolverError:
        return True
    return bool(np.abs(sheet.positions - grid.rest_positions()).max() > 1e-6)


@pytest.mark.slow
def test_verlet_blows_up_where_the_estimate_says():
    grid = grid_of((12, 12))
    low, high = 0.5 * grid.stable_step(), 2.0 * grid.stable_step()
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if grows(grid, middle, 5000) else (middle, high)
    assert low == pytest.approx(grid.stable_step(), rel=0.05)
    assert grows(grid, 1.1 * grid.stable_step(), 2000)
    with pytest.raises(SolverError, match="left the finite numbers"):
        GridVerlet(grid, start=shaken(grid, 1e-3), allow_unstable_step=True).step(5000, 1.5 * grid.stable_step())


@pytest.mark.slow
def test_energy_of_the_undamped_sheet_stays_bounded():
    """A symplectic method's energy swings but does not drift, in motion of a hundredth of the spacing.

    Large motion asks for shorter steps: the same sheet let go under gravity from two corners drifts at this share.
    """
    grid = grid_of((10, 10), [(0, 0), (0, -1), (-1, 0), (-1, -1)])
    shell = grid_model(grid).shell
    sheet = GridVerlet(grid, start=shaken(grid, 1e-3))
    energies = []
    for _ in range(400):
        sheet.step(250, 0.9 * grid.stable_step())
        kinetic = 0.5 * grid.particle_mass * np.sum(sheet.velocities**2)
        energies.append(kinetic + shell.energy(sheet.positions))
    energies = np.array(energies)
    # What Verlet conserves of one mode lies between 1 - (omega h / 2)^2 of the energy and all of it.
    assert energies.max() < energies.min() / (1.0 - 0.9**2)
    assert energies[-100:].mean() == pytest.approx(energies[:100].mean(), rel=0.05)


def test_verlet_is_of_second_order_with_drag():
    grid = grid_of((5, 6), [(0, 0), (0, -1)], drag=2.0, gravity=(0.0, 0.0, -9.81))
    start, longest = shaken(grid, 0.005), 0.2 * grid.stable_step()
    ends = []
    for refinement in (1, 2, 4, 16):
        sheet = GridVerlet(grid, start=start, velocity=np.full((grid.count, 3), 0.3))
        sheet.step(32 * refinement, longest / refinement)
        ends.append(np.concatenate([sheet.positions, 0.01 * sheet.velocities]))
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 2.0, atol=0.15)


def test_free_sheet_keeps_its_momenta():
    grid = grid_of((6, 6))
    start, rates = shaken(grid, 0.01), np.random.default_rng(5).standard_normal((grid.count, 3))
    sheet = GridVerlet(grid, start=start, velocity=rates)
    sheet.step(500, 0.5 * grid.stable_step())
    x, v = sheet.positions, sheet.velocities
    np.testing.assert_allclose(v.sum(axis=0), rates.sum(axis=0), rtol=0, atol=1e-10)
    # Verlet keeps x cross p of its staggered velocities.
    spin = [np.cross(a, b).sum(axis=0) for a, b in ((start, rates), (x, v))]
    np.testing.assert_allclose(spin[1], spin[0], rtol=0, atol=1e-10)


def test_large_whole_numbers_are_numbers():
    values = dict.fromkeys(("particle_mass", "structural", "shear", "flexion"), 1.0)
    grid = SheetGrid(shape=(3, 3), spacing=2**63, **values)
    assert grid.rest_positions().max() == 2.0**64
