"""Modal models with contacts and constraints together, and error bars under both: as discrete shells have them."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.motion.stepping import Motion

GRAVITY = (0.0, 0.0, -9.81)
FLOOR, ROD = ms.Contact(ms.Plane((0, 0, 1), -0.01)), ms.Contact(ms.Cylinder((0.5, -1, -0.11), (0.5, 1, -0.11), 0.1))


@pytest.fixture(scope="module")
def shell():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 2))
    return ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0), clamped="x < 1e-6")


@pytest.fixture(scope="module")
def rung(shell):
    return ms.RotationStrain(ms.solve_modes(shell, 8))


def led(shell, move, whole=1.0):
    """The free end, led by ``move`` at once, or within 1 s."""
    end = np.flatnonzero(shell.rest_positions[:, 0] > 1.0 - 1e-6)
    place = shell.rest_positions[end].mean(axis=0)
    return [ms.PositionConstraint(end, lambda t: place + min(1.0, whole + t) * np.array(move))]


@pytest.mark.by_default("rod")
@pytest.mark.parametrize("contact", [FLOOR, ROD], ids=["floor", "rod"])
def test_both_hold_at_rest_and_bars_are_the_true_errors(shell, rung, contact):
    """They were refused."""
    given = {"gravity": GRAVITY, "contacts": [contact], "constraints": led(shell, (-0.004, 0.0, 0.04))}
    truth, answer = ms.DiscreteShell(shell).equilibrium(**given), rung.equilibrium(**given, bar=True)
    error = ms.measure.displacement_error(answer.positions, truth.positions, shell)
    assert truth.in_contact.any()
    assert answer.converged
    assert answer.in_contact.any()
    assert answer.deepest <= 1e-9
    assert (answer.constraint_residuals <= 1e-7).all()
    np.testing.assert_allclose(answer.constraint_reactions[0], truth.constraint_reactions[0], rtol=0, atol=2.5)
    assert error < 0.1
    assert answer.bar.valid
    assert answer.bar.displacement == pytest.approx(error, rel=0.1)
    again = ms.error_bar(shell, answer.positions, **given)
    assert again.displacement == answer.bar.displacement
    own = ms.error_bar(shell, truth)
    assert own.displacement < 1e-6


def test_linear_modes_on_a_floor_bear_loads_and_reactions_in_balance(shell):
    """Of modes that are straight both are linear: a quadratic problem by itself."""
    basis, given = ms.solve_modes(shell, 8), {"contacts": [FLOOR], "constraints": led(shell, (0.0, 0.0, 0.02))}
    answer = ms.LinearModal(basis).equilibrium(gravity=GRAVITY, **given)
    assert answer.converged
    assert answer.in_contact.any()
    force = answer.contact_forces + shell.mass[:, None] * GRAVITY
    end = given["constraints"][0].vertices
    force[end] += answer.constraint_reactions[0] / end.size
    modal = basis.modes.T @ force.ravel() - basis.eigenvalues * answer.coordinates
    assert np.abs(modal).max() <= 1e-6 * np.abs(basis.modes.T @ (shell.mass[:, None] * GRAVITY).ravel()).max()


@pytest.mark.by_default("LinearModal", "RotationStrain")
@pytest.mark.parametrize("kind", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_both_hold_in_motion_and_resume_to_the_same_bits(shell, kind):
    setting = {"dt": 0.02, "damping": ms.Damping(4.0, 0.0), "contacts": [FLOOR]}
    setting["constraints"] = led(shell, (0.0 if kind is ms.LinearModal else -0.005, 0.0, 0.08), whole=0.0)
    model, load = kind(ms.solve_modes(shell, 6)), shell.loading(GRAVITY, None, None)
    motion, resumed = Motion(model, load, **setting), Motion(model, load, **setting)
    touched = 0
    for step in range(20):
        motion.advance()
        found, target = motion.touched(), setting["constraints"][0].at(motion.time)
        touched += int(found.touches.any())
        assert found.deepest <= 1e-9
        mean = motion.positions()[setting["constraints"][0].vertices].mean(axis=0)
        np.testing.assert_allclose(mean, target, rtol=0, atol=1e-6)
        if step == 10:
            resumed.restore(motion.snapshot())
    assert touched >= 5
    while resumed.count < motion.count:
        resumed.advance()
    kept = resumed.snapshot()
    assert all(np.array_equal(kept[name], part) for name, part in motion.snapshot().items())


@pytest.mark.slow
def test_a_motion_over_a_rod_is_as_that_of_discrete_shells_and_so_says_its_bar(shell, rung):
    given = {"duration": 1.0, "dt": 0.02, "gravity": GRAVITY, "damping": (4.0, 0.001), "contacts": [ROD]}
    given["constraints"] = led(shell, (-0.006, 0.0, 0.06), whole=0.0)
    run, exact = ms.simulate(rung, **given, bars=10), ms.simulate(ms.DiscreteShell(shell), **given)
    assert run.outcome is ms.Outcome.COMPLETED
    assert run.in_contact.any()
    sizes = np.sqrt(np.sum(shell.mass[:, None] * (exact.positions - shell.rest_positions) ** 2, axis=(1, 2)))
    off = np.sqrt(np.sum(shell.mass[:, None] * (run.positions - exact.positions) ** 2, axis=(1, 2)))
    assert off.max() <= 0.1 * sizes.max()
    true = (off / np.maximum.accumulate(np.maximum(sizes, 1e-12)))[10:-1:10]
    assert run.bars.valid.all()
    assert run.bars.displacement == pytest.approx(true, rel=0.3)


def test_a_vertex_that_is_led_into_a_collider_is_refused(shell, rung):
    inside = [ms.PositionConstraint(20, shell.rest_positions[20] - (0.0, 0.0, 0.1))]
    given = {"gravity": GRAVITY, "contacts": [FLOOR], "constraints": inside}
    for refused in (lambda: rung.equilibrium(**given), lambda: ms.error_bar(shell, shell.rest_positions, **given)):
        with pytest.raises(ms.OptionError, match=r"leads vertex 20 to 0\.09 m inside contact 0 \(Plane\)"):
            refused()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "move", "duration"), [(ms.ModalWarping, (-0.006, 0.0, 0.06), 0.1), (ms.RotationStrain, (0, 0, -0.1), 0.24)]
)
def test_steps_that_do_not_meet_both_keep_the_shell_above_the_floor(shell, kind, move, duration):
    """Passes ran away: numpy met a singular matrix, and a vertex was thrown 2e6 m away."""
    given = {"damping": (4.0, 0.001), "contacts": [FLOOR], "constraints": led(shell, move, whole=0.0)}
    run = ms.simulate(kind(ms.solve_modes(shell, 8)), duration=duration, dt=0.02, gravity=GRAVITY, **given)
    assert run.outcome is ms.Outcome.CONSTRAINTS_MISSED
    assert "did not converge" in run.message
    assert run.positions[:, :, 2].min() > -0.0101
    assert np.abs(run.positions).max() < 1.1
