"""What a motion says of its steps' cost, and steps that are divided to a tolerance."""

import re
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import modalshell as ms
from modalshell.motion import Motion
from modalshell.motion.step_error import Tolerance
from modalshell.supports.constraints import jumps
from studies import motion_scenes

ISOTROPIC = ms.Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=100.0)


def held_at_left(mesh, material, depth=1e-9):
    x = mesh.vertices[:, 0]
    return ms.Shell(mesh, material, clamped=x < x.min() + depth)


@pytest.fixture(scope="module")
def strip():
    return held_at_left(ms.flat_beam(length=1.0, width=0.2, cells=(10, 3)), ISOTROPIC)


@pytest.fixture(scope="module")
def basis(strip):
    return ms.solve_modes(strip, 6)


def motion(model, steps, gravity, *, damping=0.0, periods=1.5, every=1, frequency=None):
    period = 1.0 / frequency
    return ms.simulate(
        model, duration=periods * period, dt=period / steps, gravity=gravity, damping=(damping / period, 0.0),
        store_every=every,
    )  # fmt: skip


def v_shell():
    mesh = ms.v_beam(cells=(10, 2))
    return held_at_left(mesh, ms.Material(stretch=3e4, shear=3e4, flexure=3.0, density=1.0), 0.11)


def arch():
    mesh = ms.cylinder_panel(cells=(6, 6))
    y = mesh.vertices[:, 1]
    return ms.Shell(mesh, ISOTROPIC, clamped=y < y.min() + 1e-9)


RULES = ((0.0, "implicit"), (0.3, "bdf2"), (0.0, "bdf2"), (0.3, "sdirk2"), (0.2, "exponential"))


@pytest.mark.slow
def test_the_stated_error_is_right_within_two_on_shells_it_was_not_fitted_to():
    """Ten motions; at worst what stiff modes add, which SDIRK2 damps, is counted, too."""
    ratios = []
    for build, gravity in ((v_shell, 20.0), (arch, 3.0)):
        shell, pull = build(), (0.0, 0.0, -gravity)
        modes = ms.solve_modes(shell, 6)
        frequency = float(np.sqrt(modes.eigenvalues[0]) / (2 * np.pi))
        exact = {}  # fine motions, which rules of one damping share
        for damping, rule in RULES:
            modal = rule == "exponential"
            model = ms.RotationStrain(modes) if modal else ms.DiscreteShell(shell, integrator=rule)
            options = {"damping": damping, "frequency": frequency}
            run = motion(model, 40, pull, **options)
            if (damping, modal) not in exact:
                truth, finer = (model, 16) if modal else (ms.DiscreteShell(shell), 8)
                exact[damping, modal] = motion(truth, 40 * finer, pull, every=finer, **options).positions
            true = np.linalg.norm(run.positions - exact[damping, modal], axis=2).max() / shell.size
            assert true > 1e-9
            ratios.append(run.step_error / true)
            print(f"{build.__name__} {rule}: true {true:.2e}, stated {ratios[-1]:.2f} of it")
    off = np.exp(np.abs(np.log(ratios)))
    assert off.max() <= 2.0


def drawn(seed, count):
    """Shells of a drawn kind, size and sheet, with a weight of drawn size and direction, frequency [Hz] and damping."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        kind = random.choice(["strip", "sheet", "panel", "v"])
        length, width = random.uniform(0.6, 1.6), random.uniform(0.2, 0.5)
        if kind == "strip":
            mesh = ms.flat_beam(length=length, width=width, cells=(10, 3))
        elif kind == "sheet":
            mesh = ms.sheet(length=length, width=2.0 * width, cells=(7, 5), family="union-jack")
        else:
            mesh = ms.cylinder_panel(cells=(6, 5)) if kind == "panel" else ms.v_beam(cells=(9, 2))
        thickness, young = 10.0 ** random.uniform(-2.3, -1.8), 10.0 ** random.uniform(5.5, 7.5)
        sheet = ms.Isotropic(young=young, poisson=0.3, thickness=thickness, density=10.0 ** random.uniform(2, 3))
        x = mesh.vertices[:, int(random.integers(2)) if kind == "sheet" else int(kind == "panel")]
        shell = ms.Shell(mesh, sheet, clamped=x < x.min() + 1e-9)
        frequency = float(ms.solve_modes(shell, 1).frequencies[0])
        gravity = random.uniform(0.03, 0.4) * shell.size * (2.0 * np.pi * frequency) ** 2
        way = random.standard_normal(3)
        yield shell, gravity * way / np.linalg.norm(way), frequency, random.uniform(0.0, 0.5)


@pytest.mark.slow
def test_the_stated_error_is_right_within_two_on_drawn_motions():
    """Eight motions of two shells that a seed draws, by each rule that knows its error."""
    for shell, gravity, frequency, damping in drawn(11, 2):
        modes = ms.solve_modes(shell, 6)
        options = {"damping": damping, "frequency": frequency}
        full = motion(ms.DiscreteShell(shell), 160, gravity, every=4, **options)
        for rule in ("implicit", "bdf2", "sdirk2", "exponential"):
            if rule == "exponential":
                model = ms.RotationStrain(modes)
                fine = motion(model, 320, gravity, every=8, **options)
            else:
                model, fine = ms.DiscreteShell(shell, integrator=rule), full
            run = motion(model, 40, gravity, **options)
            true = np.linalg.norm(run.positions - fine.positions, axis=2).max() / shell.size
            assert true > 1e-6
            assert 0.5 <= run.step_error / true <= 2.0, rule


TURNED = ms.SupportPath([0.0, 0.5, 1.0], np.zeros((3, 3)), [[0.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 1.5, 0.0]])


@pytest.mark.slow
@pytest.mark.parametrize("moves", [{"gravity": (0.0, 0.0, -3.0)}, {"supports": TURNED}], ids=["falls", "is turned"])
@pytest.mark.parametrize("steps", [40, 80])
def test_one_linearisation_a_step_states_what_it_costs_where_a_sheet_turns(strip, moves, steps):
    """Its steps stretch what turns, which holds the motion up: up to 14 times as far off as was said."""
    options = {"duration": 1.0} | moves
    fine = {"dt": 0.5 / steps, "store_every": 2}
    true = ms.simulate(ms.DiscreteShell(strip, integrator="sdirk2"), **fine, **options).positions
    run = ms.simulate(ms.DiscreteShell(strip, integrator="linear_implicit"), dt=1.0 / steps, **options)
    ratio = run.step_error * strip.mesh.moment_length / np.linalg.norm(run.positions - true, axis=2).max()
    assert 0.5 <= ratio <= 3.5


def test_linear_motion_has_no_error(basis):
    run = ms.simulate(ms.LinearModal(basis), duration=2.0, gravity=(0, 0, -0.5), damping=(0.3, 0.0))
    assert run.step_error <= 1e-12
    assert abs(run.damping_error) < 1e-6


def test_explicit_steps_know_none(strip):
    model = ms.DiscreteShell(strip, integrator="verlet")
    dt = 0.5 * model.stable_step()
    run = ms.simulate(model, duration=20 * dt, dt=dt, gravity=(0, 0, -1.0), damping=(0.3, 0.0))
    assert run.step_error is None
    assert run.damping_error is None
    with pytest.raises(ms.OptionError, match=r"^tolerance .* does not know its steps' errors"):
        ms.simulate(model, duration=20 * dt, dt=dt, gravity=(0, 0, -1.0), tolerance=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("key", ["implicit", "linear_implicit", "bdf2", "sdirk2"])
def test_the_damping_that_steps_add_is_theirs_in_linear_theory(strip, basis, key):
    """Small free motion of the first mode at 20 steps a period, whose decay is measured."""
    omega, asked = float(np.sqrt(basis.eigenvalues[0])), 0.03
    dt, shape = 2 * np.pi / omega / 20, basis.modes[:, 0].reshape(-1, 3)
    start = strip.rest_positions + 1e-4 * shape / np.abs(shape).max()
    model = ms.DiscreteShell(strip, integrator=key, step_tolerance=1e-9)
    run = ms.simulate(model, duration=100 * dt, dt=dt, damping=(2 * asked * omega, 0.0), start=start)
    tip = int(np.argmax(np.abs(shape[:, 2])))
    z = run.positions[:, tip, 2] - strip.rest_positions[tip, 2]
    # A damped sinusoid obeys z+ = a z + b z-, with r^2 = -b and r cos(phi) = a / 2.
    (a, b), *_ = np.linalg.lstsq(np.column_stack([z[20:-1], z[19:-2]]), z[21:], rcond=None)
    size, angle = 0.5 * np.log(-b), np.arccos(0.5 * a / np.sqrt(-b))
    measured = -size / np.hypot(size, angle)
    assert run.damping_error == pytest.approx(measured / asked - 1.0, rel=0.06, abs=0.003)
    assert ("steps add a damping ratio" in run.message) == ("implicit" in key)


def test_rules_of_second_order_are_not_told_to_take_one(strip, basis):
    omega = float(np.sqrt(basis.eigenvalues[0]))
    for key in ("implicit", "bdf2"):
        model = ms.DiscreteShell(strip, integrator=key)
        run = ms.simulate(model, duration=8.0 / omega, dt=0.8 / omega, gravity=(0, 0, -0.1))
        assert "steps add a damping ratio" in run.message
        assert ("an integrator of second order" in run.message) == (key == "implicit")


def test_modes_too_fast_for_frames_are_named(strip):
    modes = ms.solve_modes(strip, 12)
    run = ms.simulate(ms.LinearModal(modes), duration=2.0, dt=0.2, loads=[ms.PointForce([5], (0, 0, 0.05))])
    assert "steps a period: it moves faster than frames can show" in run.message
    run = ms.simulate(ms.LinearModal(modes), duration=2.0, dt=0.002, loads=[ms.PointForce([5], (0, 0, 0.05))])
    assert run.message == ""


@pytest.mark.slow
@pytest.mark.parametrize("build", [ms.RotationStrain, ms.DiscreteShell])
def test_a_tolerance_is_kept_at_the_frames(strip, basis, build):
    path = ms.SupportPath([0, 0.5, 1.0], [[0, 0, 0], [0, 0.1, 0.2], [0, 0, 0]])
    options = {"gravity": (0, 0, -0.5), "supports": path, "damping": (0.2, 0.001), "duration": 1.0}
    model = build(basis if build is ms.RotationStrain else strip)
    fine = ms.simulate(model, dt=1 / 480, store_every=16, **options)
    coarse = ms.simulate(model, **options)
    errors = []
    for tolerance in (1e-2, 1e-3):
        run = ms.simulate(model, tolerance=tolerance, **options)
        np.testing.assert_array_equal(run.times, coarse.times)
        errors.append(np.linalg.norm(run.positions - fine.positions, axis=2).max())
        assert run.step_error <= tolerance
        assert errors[-1] <= 2.0 * tolerance
    assert errors[1] < errors[0] < np.linalg.norm(coarse.positions - fine.positions, axis=2).max()


@pytest.mark.by_default("RotationStrain")
@pytest.mark.parametrize("build", [ms.RotationStrain, ms.DiscreteShell, partial(ms.Auto, error=0.3)])
def test_a_step_before_which_nothing_is_known_is_divided_too(strip, basis, build):
    """A weight that comes at once: the first frame is as near as the later ones."""
    period = 2.0 * np.pi / np.sqrt(basis.eigenvalues[0])
    model, tolerance = build(basis if build is ms.RotationStrain else strip), 1e-4
    options = {"gravity": (0, 0, -0.1), "damping": (0.3 / period, 0.0), "duration": 0.6 * period}
    fine = ms.simulate(model, dt=period / 960, store_every=64, **options)
    run = ms.simulate(model, dt=period / 15, tolerance=tolerance, **options)
    off = np.linalg.norm(run.positions - fine.positions, axis=2).max(axis=1) / strip.mesh.moment_length
    assert off.max() <= tolerance
    assert run.step_error <= tolerance


def to_target(strip, target):
    """A constraint that leads the strip's free end."""
    tip = np.flatnonzero(strip.rest_positions[:, 0] > 0.999)
    place = strip.rest_positions[tip].mean(axis=0)
    return [ms.PositionConstraint(tip, lambda time: place + target(time) * np.array([0.0, 0.0, 1.0]))]


def test_targets_that_jump_are_named_and_tolerances_that_are_not_kept(strip):
    """Damping that takes away the error of a step within it lets no step make more than the tolerance."""
    options = {"duration": 0.2, "dt": 1 / 30, "damping": (0.0, 1e-3)}
    model, named = ms.DiscreteShell(strip), r"from 0\.133333 s on .* target of constraint 0 has jumped"
    jump = to_target(strip, lambda time: 0.02 * (time > 0.1))
    run = ms.simulate(model, constraints=jump, tolerance=1e-2, **options)
    assert run.step_error <= 1e-2
    assert re.search(named, run.message)
    close = ms.simulate(model, constraints=jump, tolerance=1e-3, **options)
    assert close.step_error > 3e-3
    assert "beyond the tolerance of 0.001" in close.message
    assert re.search(named, ms.simulate(model, constraints=jump, **options).message)
    for gradual in (lambda time: 0.5 * time, lambda time: 0.02 * min(max(time - 0.11, 0.0) / 0.003, 1.0)):
        moved = ms.simulate(model, constraints=to_target(strip, gradual), **options)
        assert "jumped" not in moved.message


@pytest.mark.by_default("LinearModal")
@pytest.mark.parametrize("build", [ms.LinearModal, ms.ModalWarping])
def test_modal_steps_onto_constraints_state_no_error(strip, basis, build):
    """LMA by the exponential rule is exact without constraints, and would state an error of 0."""
    led = to_target(strip, lambda time: 0.05 * np.sin(12.0 * time) ** 2)
    options = {"duration": 0.2, "constraints": led, "damping": (2.0, 0.0), "gravity": (0, 0, -0.1)}
    run = ms.simulate(build(basis), dt=1 / 30, **options)
    fine = ms.simulate(build(basis), dt=1 / 480, store_every=16, **options)
    assert np.abs(run.positions - fine.positions).max() > 4e-5
    assert run.step_error is None
    assert "half as long" in ms.simulate(build(basis), dt=1 / 30, tolerance=1e-3, **options).message


def test_turns_by_whole_turns_are_no_jumps():
    turned = ms.OrientationConstraint(0, lambda time: (0.0, 0.0, time if time < np.pi else time - 2.0 * np.pi))
    assert not jumps(turned, 3.1, 3.2, 1e-3)
    jumping = ms.OrientationConstraint(0, lambda time: (0.0, 0.0, float(time > 3.14)))
    assert jumps(jumping, 3.1, 3.2, 1e-3)


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 2.0, float("nan"), "small"])
def test_tolerances_out_of_range_are_refused(basis, tolerance):
    with pytest.raises(ms.OptionError, match="tolerance"):
        ms.simulate(ms.LinearModal(basis), duration=1.0, tolerance=tolerance)


@pytest.mark.by_default("RotationStrain", "Auto")
@pytest.mark.parametrize("build", [ms.RotationStrain, ms.DiscreteShell, ms.Auto])
def test_divided_steps_resume_to_the_last_bit(strip, basis, build):
    def made():
        model = build(basis if build is ms.RotationStrain else strip)
        loading = strip.loading((0, 0, -1.0), None, None)
        return Motion(model, loading, dt=1 / 15, damping=(0.2, 0.0), tolerance=Tolerance(1e-3, 1.0))

    whole, kept = made(), None
    for count in range(8):
        if count == 3:
            kept = whole.snapshot()
        whole.advance()
    resumed = made()
    resumed.restore(kept)
    for _ in range(5):
        resumed.advance()
    for name, array in whole.snapshot().items():
        np.testing.assert_array_equal(array, resumed.snapshot()[name], err_msg=name)


def test_what_steps_cost_is_stored(strip, tmp_path):
    run = ms.simulate(ms.DiscreteShell(strip), duration=0.3, gravity=(0, 0, -1.0), damping=(0.3, 0.0))
    run.save(tmp_path / "run.npz")
    again = ms.load_trajectory(tmp_path / "run.npz")
    assert again.step_error == run.step_error > 0.0
    assert again.damping_error == run.damping_error


@pytest.mark.slow
def test_steps_of_a_coarse_shell_that_takes_over_cost_what_its_own_do(strip):
    """A hybrid that does not hold the load hands over in its first step, to positions in place of coordinates."""
    small, large = (0.0, 0.0, -0.02), (0.0, 0.0, -1.0)
    hybrid = ms.HybridStress.trained(strip, gravity=small, coarse=strip, modes=6, motions=4)
    frequency = ms.solve_modes(strip, 1).frequencies[0]
    runs = [motion(model, 40, large, frequency=frequency) for model in (hybrid, ms.CoarseDiscreteShell(strip, strip))]
    assert "answered by coarse DS" in runs[0].message
    assert runs[0].step_error == pytest.approx(runs[1].step_error, rel=0.2)


@pytest.mark.by_default("<lambda>")
@pytest.mark.parametrize("build", [lambda shell: ms.ModalWarping(ms.solve_modes(shell, 9)), ms.ModalDerivatives])
def test_the_error_of_a_free_shell_does_not_depend_on_numbers(build):
    """Of corners that move alike one alone was looked at, the first."""
    mesh = ms.v_beam(length=0.6, width=0.2, fold=130.0, cells=(6, 2))
    order = np.random.default_rng(2).permutation(len(mesh.vertices))
    found = []
    for chosen in (np.arange(order.size), order):
        other = ms.TriangleMesh(mesh.vertices[chosen], np.argsort(chosen)[mesh.faces])
        shell = ms.Shell(other, ISOTROPIC)
        push = np.where(other.vertices[:, :1] > 0.599, [0.5, 0.2, 2.0], 0.0)
        found.append(ms.simulate(build(shell), duration=0.3, dt=0.02, force=push).step_error)
    assert found[1] == pytest.approx(found[0], rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "least", "most"), [("sdirk2", 0.15, 0.5), ("bdf2", 0.0, 0.03), ("composite", 0.0, 3e-4)]
)
def test_energy_that_steps_take_from_a_stiff_swing_is_told(integrator, least, most):
    """A stiff panel falls from level about its pinned edge; its error estimate sees nothing of what SDIRK2 takes."""
    model = ms.DiscreteShell(motion_scenes.swinging_panel(), integrator=integrator)
    run = ms.simulate(model, duration=1.0, dt=1 / 120, gravity=(0.0, 0.0, -9.81))
    energies = run.energies.sum(axis=1)
    lost = (energies[0] - energies[-1]) / np.ptp(run.energies[:, 2])
    assert least <= lost <= most
    told = f"steps have taken {lost:.2g} of the energy that start and load put in: take shorter ones, or integrator"
    assert (told in run.message) == (integrator == "sdirk2")
    still = ms.simulate(model, duration=0.1, dt=1 / 120, gravity=(0.0, 0.0, -9.81), damping=(1.0, 0.0))
    assert "have taken" not in still.message


@cache
def turned_in_long_steps(kind, integrator, parts):
    """A strip that turns under its weight, and its motion in steps of 0.2 s / parts, damped by its stiffness."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(12, 2))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=500.0)
    if kind == "edges":
        sheet = ms.Material(stretch=2e5, shear=2e5, flexure=0.07, density=1.0)
    shell = held_at_left(mesh, sheet, depth=0.1 if kind == "edges" else 1e-9)
    own = {"integrator": integrator}
    models = {
        "coarse": lambda: ms.CoarseDiscreteShell(shell, shell, **own),
        "reduced": lambda: ms.ModalDerivatives(shell, 8, **own),
    }
    model = models.get(kind, lambda: ms.DiscreteShell(shell, **own))()
    options = {"gravity": (0, 0, -0.5), "damping": (0.0, 0.05), "store_every": parts}
    return shell, ms.simulate(model, duration=1.0, dt=0.2 / parts, **options)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rule", "most"), [("composite", 0.004), ("bdf2", 0.02), ("sdirk2", 0.005), ("implicit", 0.05)]
)
@pytest.mark.parametrize("kind", ["sheet", "edges", "coarse", "reduced"])
def test_damping_by_the_stiffness_lets_stiff_sheets_turn_in_long_steps(rule, most, kind):
    """The straight way of a turning triangle has a strain that is none; it held this strip back by 0.08 to 0.26."""
    (shell, fine), (_, found) = turned_in_long_steps(kind, "composite", 32), turned_in_long_steps(kind, rule, 1)
    exact = fine.positions
    assert np.ptp(exact[:, :, 2], axis=0).max() > 0.2
    off = np.linalg.norm(found.positions - exact, axis=2).max()
    assert off < most * shell.size
    assert off < 2.5 * found.step_error
    assert (np.diff(found.energies.sum(axis=1)) < 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["implicit", "composite"])
@pytest.mark.parametrize("sheet", ["Isotropic", "Material"])
@given(viscosity=st.floats(1e-3, 1.0), steps=st.integers(8, 40), fold=st.floats(90.0, 175.0))
@settings(max_examples=6, deadline=None)
def test_damping_by_the_stiffness_takes_energy_in_every_step(integrator, sheet, viscosity, steps, fold):
    mesh = ms.v_beam(length=1.0, width=0.3, fold=fold, cells=(6, 4))
    material = ms.Isotropic(1e8, 0.3, 2e-3, 500.0) if sheet == "Isotropic" else ms.Material(2e5, 2e5, 0.07, 1.0)
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 0.2)
    model, damping = ms.DiscreteShell(shell, integrator=integrator), (0.0, viscosity)
    run = ms.simulate(model, duration=1.0, dt=1.0 / steps, gravity=(0.0, 3.0, -9.81), damping=damping)
    total = run.energies.sum(axis=1)
    assert (np.diff(total) <= 1e-9 * np.abs(run.energies[:, 2]).max()).all()


@cache
def turned(kind, integrator, parts):
    """Angles [rad] of a flap that a pressure turns through half a turn, of one cell, in steps of 0.02 s / parts."""
    mesh = ms.flat_beam(length=1.0, width=0.5, cells=(2, 2))
    sheet = ms.Material(2e5, 2e5, 0.07, 1.0) if kind == "edges" else ms.Isotropic(1e8, 0.3, 2e-3, 500.0)
    shell, flap = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 0.51), mesh.vertices[:, 0] > 0.51
    folded = mesh.vertices.copy()
    folded[flap, 2] = 0.5 * np.sin(3.0)
    folded[flap, 0] = 0.5 + 0.5 * np.cos(3.0)
    own = ms.DiscreteShell(shell, integrator=integrator)
    model = ms.CoarseDiscreteShell(shell, shell, integrator=integrator) if kind == "coarse" else own
    options = {"loads": [ms.Pressure(30.0)], "damping": (1.0, 2.0), "store_every": parts, "start": folded}
    tips = ms.simulate(model, duration=0.4, dt=0.02 / parts, **options).positions[:, flap].mean(axis=1)
    return np.unwrap(np.arctan2(tips[:, 2], tips[:, 0] - 0.5))


@pytest.mark.by_default("coarse-bdf2", "coarse-sdirk2")
@pytest.mark.parametrize("rule", ["composite", "bdf2", "sdirk2"])
@pytest.mark.parametrize("kind", ["sheet", "edges", "coarse"])
def test_damped_folds_turn_through_half_a_turn(rule, kind):
    """The measure of a fold jumps there by a turn, which is no change that damping resists."""
    found, exact = turned(kind, rule, 1), turned(kind, "implicit", 8)
    assert exact.max() > np.pi + 0.05
    np.testing.assert_allclose(found, exact, atol=0.1)


@pytest.mark.by_default("free")
@pytest.mark.parametrize("sheet", ["free", "held"])
def test_a_tolerance_that_a_free_sheet_on_a_ball_may_miss_is_said_to_be_missed(sheet):
    """Errors of its speed go on: it was 0.085 of its size off where 0.05 was asked and 0.028 stated."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(8, 8))
    shell = ms.Shell(mesh, ms.Isotropic(1e6, 0.3, 5e-3, 300.0), "x < 1e-6" if sheet == "held" else None)
    ball = ms.Contact(ms.Sphere(mesh.vertices.mean(axis=0) + np.array([0.03, 0.02, -0.32]), 0.3))
    options = {"gravity": (0.0, 0.0, -9.81), "contacts": [ball], "damping": (0.5, 0.0)}
    run = ms.simulate(ms.DiscreteShell(shell), duration=0.25, dt=1 / 60, tolerance=0.05, **options)
    assert run.in_contact[-1].any()
    assert ("errors of its speed" in run.message) is (sheet == "free")
    assert sheet == "held" or f"may come to {3.0 * run.step_error:.2g} of the shell's size" in run.message


@pytest.mark.by_default("damping0-True")
@pytest.mark.parametrize(("damping", "many"), [((0.0, 0.0), True), ((0.1, 1e-3), False)])
def test_a_motion_says_where_a_tolerance_takes_many_parts_of_a_step(damping, many):
    """An undamped jump along a strip takes hundreds, at their cost."""
    shell = ms.Shell(
        ms.flat_beam(length=1.0, width=0.2, cells=(4, 1)), ms.Isotropic(1e8, 0.3, 5e-3, 1000.0), "x < 1e-6"
    )
    load = ms.Scaled(ms.PointForce("x > 0.999", (60.0, 0.0, 0.0)), ([0.03, 0.03 + 1e-9], [0.0, 1.0]))
    run = ms.simulate(
        ms.DiscreteShell(shell), duration=1 / 15, dt=1 / 30, loads=[load], damping=damping, tolerance=5e-4
    )
    assert ("parts each on average" in run.message) is many
