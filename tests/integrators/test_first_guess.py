"""Where Newton's method begins in an implicit step, and the factor that the stages of a rule share."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.core.cost import counted
from modalshell.integrators.full import implicit_rule
from modalshell.motion import Motion

SHEET = ms.Isotropic(young=1e9, poisson=0.3, thickness=2e-3, density=1000.0)


def stiff_strip(ratio: float = 1e5) -> ms.Shell:
    """A strip whose membrane is ``ratio`` times as stiff as its bending."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    material = ms.Material(0.05 * ratio, 0.05 * ratio, 0.05, 0.2)
    return ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 0.075)


def let_fall(shell: ms.Shell, rule: str, gamma: float, steps: int, dt: float) -> tuple[np.ndarray, float, float]:
    """Where a shell is after steps under a weight; solves and factorisations a step."""
    gravity = np.array([0.0, 0.0, -gamma / ms.measure.gamma_per_gravity(shell)])
    run = Motion(ms.DiscreteShell(shell, integrator=rule), shell.loading(gravity), dt=dt)
    with counted() as work:
        for _ in range(steps):
            run.advance()
    assert run.unconverged == 0
    return run.positions(), work.solves / steps, work.factorisations / steps


@pytest.mark.by_default("bdf2")
@pytest.mark.parametrize("rule", ["implicit_euler", "bdf2", "composite"])
def test_a_stiff_sheet_that_swings_is_solved_in_few_iterations(rule):
    solutions = 2 if rule == "composite" else 1
    # With the stresses that the straight way predicts BDF2 takes 8.1.
    assert let_fall(stiff_strip(), rule, 100.0, 30, 1.0 / 30.0)[1] <= 4.2 * solutions


@pytest.mark.by_default("None-bdf2", "material1-composite")
@pytest.mark.parametrize("rule", ["bdf2", "composite"])
@pytest.mark.parametrize("material", [None, SHEET])
def test_compiled_steps_of_a_stiff_sheet_take_few_iterations(rule, material):
    shell = stiff_strip()
    if material is not None:
        shell = ms.Shell(shell.mesh, material, clamped=shell.mesh.vertices[:, 0] < 1e-9)
    gravity = np.array([0.0, 0.0, -100.0 / ms.measure.gamma_per_gravity(shell)])
    run = Motion(ms.CoarseDiscreteShell(shell, shell, integrator=rule), shell.loading(gravity), dt=1.0 / 30.0)
    with counted() as work:
        for _ in range(30):
            run.advance()
    assert run.unconverged == 0
    # With the stresses that the straight way predicts: 5.6 and 9.7 by BDF2, 9.1 and 11.8 by SDIRK2.
    assert work.factorisations / 30 <= {"bdf2": 4.6, "composite": 7.5}[rule]


@pytest.mark.by_default("0.0-bdf2", "0.0-composite", "inf-implicit_euler")
@pytest.mark.parametrize("rule", ["implicit_euler", "bdf2", "composite"])
@pytest.mark.parametrize("limit", [0.0, np.inf])
def test_the_first_guess_leaves_the_answer_alone(monkeypatch, rule, limit):
    shell = stiff_strip(1e3)
    usual = let_fall(shell, rule, 10.0, 8, 1.0 / 30.0)[0]
    monkeypatch.setattr(implicit_rule, "STRAIGHT_TURN", limit)
    other = let_fall(shell, rule, 10.0, 8, 1.0 / 30.0)[0]
    np.testing.assert_allclose(usual, other, atol=2e-6)
    assert np.abs(usual - shell.rest_positions).max() > 0.1


@pytest.mark.slow
def test_both_parts_of_a_step_share_a_factor(monkeypatch):
    mesh = ms.flat_beam(length=1.0, width=0.3, cells=(40, 12))
    shell = ms.Shell(mesh, SHEET, clamped=mesh.vertices[:, 0] < 1e-9)
    whole, _, shared = let_fall(shell, "composite", 5.0, 6, 1.0 / 120.0)
    find = implicit_rule.solve
    monkeypatch.setattr(implicit_rule, "solve", lambda *given: find(*given[:5]))
    apart, _, own = let_fall(shell, "composite", 5.0, 6, 1.0 / 120.0)
    assert own >= 2.0
    assert shared < 0.9 * own
    np.testing.assert_allclose(whole, apart, atol=1e-8)
