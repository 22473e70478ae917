"""Error bars along motions: against DS's motion, past snaps, under supports that move, in files."""

from dataclasses import replace

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.motion_check import balancing_load, instant_of

DT = 1.0 / 60.0


@pytest.fixture(scope="module")
def beam():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    return ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.051")


@pytest.fixture(scope="module")
def rung(beam):
    return ms.ModalWarping(ms.solve_modes(beam, 6))


def growing(most):
    return [ms.Scaled(ms.SelfWeight((0.0, 0.26, -0.97)), ([0.0, 1.2, 2.0], [0.0, most, 0.0]))]


def move(model, most, **further):
    return ms.simulate(model, **{"duration": 2.0, "dt": DT, "loads": growing(most), "damping": (2.0, 0.001)} | further)


def norm(shell, displacement):
    return np.sqrt(np.sum(shell.mass[:, None] * displacement**2, axis=(1, 2)))


def test_a_motion_shorter_than_the_first_check_is_checked_at_its_end(rung):
    """No frame was, and the summary said just that."""
    run = move(rung, 25.0, duration=9 * DT, bars=15)
    assert run.bars.times == pytest.approx([8 * DT])
    assert run.bars.valid.all()
    none = move(rung, 25.0, duration=DT, bars=15)
    assert str(none.bars) == "no frame was checked: bars take three frames"


@pytest.mark.slow
def test_they_follow_the_error_of_a_slow_motion(beam, rung):
    dt = DT / 4  # of steps as long as DT the differences err more than bars do where little has moved
    run, exact = (
        move(model, 25.0, dt=dt, **more) for model, more in ((rung, {"bars": 40}), (ms.DiscreteShell(beam), {}))
    )
    largest = np.maximum.accumulate(norm(beam, exact.positions - beam.rest_positions))
    frames = np.round(run.bars.times / dt).astype(int)
    error = (norm(beam, run.positions - exact.positions)[1:] / largest[1:])[frames - 1]
    assert run.bars.valid.all()
    loaded = run.bars.times < 1.3
    assert np.abs(run.error[loaded] / error[loaded] - 1.0).max() < 0.15
    assert run.error.max() == pytest.approx(error.max(), rel=0.1)
    assert str(run.bars).startswith("up to ")
    assert run.margin is run.bars.margin


def test_they_are_void_before_a_snap_and_stay_so(rung):
    run = move(rung, 60.0, bars=6)
    first = int(np.argmin(run.bars.valid))
    load = 60.0 * run.bars.times[first] / 1.2
    assert 20.0 < load < 41.5  # where DS leaves its branch, with 60 at 1.2 s
    assert not run.bars.valid[first:].any()
    # Back under a small load the rung's own state looks right; DS is elsewhere still.
    assert run.margin[-1] > 0.3
    assert run.error[-1] < 0.3
    assert f"void from {run.bars.void_from:.4g} s on" in str(run.bars)


@pytest.mark.slow
def test_ds_itself_has_small_ones(beam):
    run = move(ms.DiscreteShell(beam), 25.0, bars=20)
    assert run.bars.valid.all()
    assert run.error.max() < 0.02


@pytest.mark.parametrize("damped", ["stiffness", "modes", "dashpots"])
def test_damping_of_strains_is_no_error(damped):
    """Of a strip that swings, its stresses are ahead of its shape; what is left is of accelerations by differences."""
    shell = ms.Shell(
        ms.flat_beam(length=1.0, width=0.2, cells=(10, 2)), ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.101"
    )
    basis = ms.solve_modes(shell, 2)
    model, omega = ms.LinearModal(basis), 2.0 * np.pi * basis.frequencies[0]
    start, dt = model.equilibrium(gravity=(0.0, 0.0, -0.2)).positions, 2.0 * np.pi / omega / 60
    damping = {"stiffness": ms.Damping(0.0, 0.1 / omega), "modes": ms.Damping(ratios=(0.05,)), "dashpots": ms.Damping()}
    if damped == "dashpots":
        hinged = shell.with_elements([replace(e, viscosity=0.01 * e.weight) for e in shell.elements])
        model = ms.DiscreteShell(hinged)
    run = ms.simulate(model, duration=60 * dt, dt=dt, start=start, damping=damping[damped], bars=5)
    assert run.error.max() < 0.01


def test_a_load_that_balances_a_motion_is_one_under_which_it_rests(beam):
    """Of a shell that turns with its supports and does not move in their frame: the load undoes the inertia."""
    times = np.array([0.0, 0.5, 1.0])
    path = ms.SupportPath(times, np.zeros((3, 3)), [(0, 0, 0), (0, 0, 1.0), (0, 0, 2.0)])
    still = np.stack([beam.rest_positions] * 3)
    now = instant_of(np.array([0.49, 0.5, 0.51]), still)
    turn_rate = path.at(0.5).turn_rate[2]
    load = balancing_load(now, beam, beam.loading(gravity=(0.0, 0.0, -1.0)), ms.Damping(), path)
    outwards = turn_rate**2 * np.asarray(beam.rest_positions) * [1.0, 1.0, 0.0]
    expected = beam.mass[:, None] * np.add(outwards, [0.0, 0.0, -1.0])
    assert load == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.fixture(scope="module")
def coarse(beam):
    return ms.coarse_shell(beam, ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(14, 2)))


@pytest.mark.slow
def test_on_a_coarse_shell_they_are_near_those_on_the_shell_and_void_at_the_same_snap(rung, coarse, tmp_path):
    run, fine = (move(rung, 60.0, bars=bars) for bars in ((6, coarse), 6))
    assert np.array_equal(run.positions, fine.positions)
    assert np.array_equal(run.bars.times, fine.bars.times)
    assert abs(run.bars.void_from - fine.bars.void_from) <= 6 * DT + 1e-9
    held = fine.bars.valid & (fine.bars.displacement > 0.005)
    assert held.any()
    assert np.abs(run.error[held] - fine.error[held]).max() < 0.02
    assert (run.bars.on, fine.bars.on) == ("coarse", "shell")
    assert "found on a coarse shell" in str(run.bars)
    again = ms.load_trajectory(run.save(tmp_path / "run.npz"))
    assert again.bars.on == "coarse"
    assert str(again.bars) == str(run.bars)


def test_a_coarse_shell_may_move_with_the_supports(rung, coarse):
    path = ms.SupportPath([0.0, 0.4, 0.8], [(0, 0, 0), (0, 0.2, 0), (0, 0, 0)])
    run = ms.simulate(
        rung, duration=0.8, dt=DT, gravity=(0, 0, -8.0), damping=(1.0, 0.0), supports=path, bars=(6, coarse)
    )
    assert run.bars.valid.all()
    assert run.error.max() < 0.1


def test_supports_may_move(rung):
    path = ms.SupportPath([0.0, 0.4, 0.8], [(0, 0, 0), (0, 0.2, 0), (0, 0, 0)])
    run = ms.simulate(rung, duration=0.8, dt=DT, gravity=(0, 0, -8.0), damping=(1.0, 0.0), supports=path, bars=6)
    assert run.bars.valid.all()
    assert run.error.max() < 0.1
    wind = [ms.Wind((0.0, 2.0, 0.0))]
    run = ms.simulate(rung, duration=0.4, dt=DT, loads=wind, damping=(1.0, 0.0), supports=path, bars=6)
    assert run.bars.valid.all()
    assert run.error.max() < 0.1


def test_files_keep_them(rung, tmp_path):
    run = move(rung, 60.0, bars=15)
    again = ms.load_trajectory(run.save(tmp_path / "run.npz"))
    for name in ("times", "displacement", "margin", "valid"):
        assert np.array_equal(getattr(again.bars, name), getattr(run.bars, name))
    plain = move(rung, 5.0)
    assert plain.bars is None
    assert plain.error is None
    assert plain.margin is None
    assert ms.load_trajectory(plain.save(tmp_path / "plain.npz")).bars is None


def test_what_has_none_is_refused(beam, rung):
    with pytest.raises(ms.OptionError, match="bars must be"):
        move(rung, 5.0, bars=0)
    with pytest.raises(ms.OptionError, match='on must be "shell"'):
        move(rung, 5.0, bars=(5, "fine"))
    held = [ms.PositionConstraint(80, (0.5, 0.0, 0.1))]
    with pytest.raises(ms.OptionError, match="under constraints a bar is found on the shell itself"):
        move(rung, 5.0, bars=(5, beam), constraints=held)
    with pytest.raises(ms.OptionError, match="an orientation constraint needs a position constraint"):
        move(rung, 5.0, bars=5, constraints=[ms.OrientationConstraint(80, (0.0, 0.1, 0.0))])
    free = ms.Shell(beam.mesh, beam.material)
    with pytest.raises(ms.OptionError, match="an error bar needs a shell that its supports hold"):
        move(ms.RigidShell(free), 5.0, bars=5)


@pytest.mark.by_default("5.0-True", "8.0-False")
@pytest.mark.parametrize(("period", "told"), [(5.0, True), (8.0, False)])
def test_frames_too_far_apart_for_accelerations_are_told(period, told):
    """Of a free vibration, by frames in a period; of a rest under the same weight nothing is told."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(10, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 0.01, 200.0), "x < 0.001")
    basis = ms.solve_modes(shell, 1)
    dt, model = 1.0 / basis.frequencies[0] / period, ms.LinearModal(basis)
    bent = model.equilibrium(gravity=(0.0, 0.0, -5.0)).positions
    setting = {"duration": 20 * dt, "dt": dt, "start": bent, "bars": 2}
    assert ("its bars mean little: there are about " in ms.simulate(model, **setting).message) == told
    assert "bars mean" not in ms.simulate(model, gravity=(0.0, 0.0, -5.0), **setting).message
