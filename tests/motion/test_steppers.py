"""Steppers: a model with no more than the four methods that every model must have moves as one that knows better."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.base.model import Model
from modalshell.motion import Motion

PATH = ms.SupportPath([0.0, 0.1], [[0.0, 0.0, 0.0], [0.1, 0.0, 0.2]], [[0.0, 0.0, 0.0], [0.3, 0.2, -0.1]])


class Bare(Model):
    """Explicit Euler of a discrete shell, and nothing else of it."""

    name = "bare"

    def __init__(self, inner):
        self.inner, self.shell = inner, inner.shell

    def _solve(self, load, start):
        return self.inner._solve(load, start)

    def start_motion(self, positions=None):
        return self.inner.start_motion(positions)

    def step(self, state, dt, load, damping, held=None):
        return self.inner.step(state, dt, load, damping, held)

    def positions(self, state):
        return state.coordinates.copy()


@pytest.fixture(scope="module")
def models():
    mesh = ms.v_beam(cells=(8, 4))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.13)
    inner = ms.DiscreteShell(shell, integrator="explicit")
    return Bare(inner), inner


@pytest.mark.by_default("dead-resting", "wind-moving")
@pytest.mark.parametrize("further", [{}, {"supports": PATH}], ids=["resting", "moving"])
@pytest.mark.parametrize("loads", [[], [ms.Wind((0.5, 1.0, 0.3))]], ids=["dead", "wind"])
def test_a_model_of_four_methods_moves_as_its_full_model(models, further, loads):
    dt = 0.5 * models[1].stable_step()
    run = {"duration": 60 * dt, "dt": dt, "gravity": (0.0, 0.0, -3.0), "loads": loads, "damping": (3.0, 0.0)} | further
    found, exact = (ms.simulate(model, **run) for model in models)
    moved = np.abs(exact.positions[-1] - exact.positions[0]).max()
    assert found.outcome is exact.outcome
    np.testing.assert_allclose(found.positions, exact.positions, rtol=0.0, atol=1e-9 * moved)


def test_a_model_of_four_methods_refuses_constraints(models):
    tip = ms.PositionConstraint([40], (0.9, 0.0, 0.1))
    with pytest.raises(ms.OptionError, match="bare takes no position or orientation constraints"):
        Motion(models[0], models[0].shell.loading(), dt=0.1, constraints=[tip])
    with pytest.raises(ms.OptionError, match="bare takes no position or orientation constraints"):
        models[0].equilibrium(gravity=(0.0, 0.0, -1.0), constraints=[tip])


@pytest.mark.by_default("MWTS-moving", "DS-resting", "bare-resting")
@pytest.mark.parametrize("further", [{}, {"supports": PATH}], ids=["resting", "moving"])
@pytest.mark.parametrize("kind", ["MWTS", "DS", "bare"])
def test_a_restored_motion_goes_on_to_the_last_bit(models, kind, further):
    shell = models[1].shell
    model = {"MWTS": lambda: ms.ModalWarping(ms.solve_modes(shell, 4)), "DS": lambda: ms.DiscreteShell(shell)}
    body, dt = model.get(kind, lambda: models[0])(), 0.5 * models[1].stable_step()
    loading = shell.loading((0.0, 0.0, -3.0), None, [ms.Wind((0.5, 1.0, 0.3))])
    one, other = (Motion(body, loading, dt=dt, **further) for _ in range(2))
    for _ in range(4):
        one.advance()
    other.restore({name: array.copy() for name, array in one.snapshot().items()})
    for _ in range(3):
        one.advance()
        other.advance()
    np.testing.assert_array_equal(one.positions(), other.positions())


def reduced(basis):
    return ms.ReducedRotationStrain.trained(ms.RotationStrain(basis), [(0.0, 0.0, -2.0), (0.0, 1.0, 1.0)], mixtures=16)


@pytest.mark.parametrize("kind", [ms.LinearModal, ms.ModalWarping, reduced], ids=["LMA", "MWTS", "reduced RSW"])
def test_the_potential_of_a_load_is_that_of_where_the_shell_is(kind):
    """Some models know it by their coordinates; a load that was replaced acts from the next step on."""
    mesh = ms.flat_beam(cells=(8, 2))
    shell = ms.Shell(mesh, ms.Material(200.0, 200.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.2)
    motion = Motion(kind(ms.solve_modes(shell, 4)), shell.loading((0.0, 0.0, -1.0)), dt=0.01)
    for step in range(6):
        if step == 3:
            motion.load = shell.gravity_force((0.0, 1.0, 2.0))
        work = np.vdot(motion.load, motion.positions() - shell.rest_positions)
        np.testing.assert_allclose(motion.energies()[2], -work, rtol=1e-12, atol=1e-300)
        motion.advance()
