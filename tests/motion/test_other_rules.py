"""Motions by another rule of time than the model's own: those of a model made with that rule."""

import numpy as np
import pytest

import modalshell as ms

OPTIONS = {"duration": 0.1, "dt": 1 / 60, "gravity": (0, 0, -2.0)}


@pytest.fixture(scope="module")
def shell():
    mesh = ms.flat_beam(cells=(8, 2))
    return ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 100.0), mesh.vertices[:, 0] < 1e-6)


@pytest.mark.by_default("DiscreteShell-bdf2", "<lambda>-composite")
@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda shell, **options: ms.ModalWarping(ms.solve_modes(shell, 4), **options), "implicit_euler"),
        (lambda shell, **options: ms.LinearModal(ms.solve_modes(shell, 4), **options), "implicit_midpoint"),
        (ms.DiscreteShell, "bdf2"),
        (lambda shell, **options: ms.CoarseDiscreteShell(shell, shell, **options), "composite"),
    ],
)
@pytest.mark.filterwarnings("ignore:.* fewer than 4 edges a half wave")
def test_a_motion_takes_another_rule(shell, make, rule):
    model = make(shell)
    found = ms.simulate(model, integrator=rule, **OPTIONS)
    wanted = ms.simulate(make(shell, integrator=rule), **OPTIONS)
    np.testing.assert_array_equal(found.positions, wanted.positions)
    own = ms.simulate(model, **OPTIONS)
    assert not np.array_equal(own.positions, found.positions)
    np.testing.assert_array_equal(own.positions, ms.simulate(make(shell), **OPTIONS).positions)


def test_unknown_rules_and_models_without_one_are_refused(shell):
    with pytest.raises(ms.OptionError, match="integrator"):
        ms.simulate(ms.DiscreteShell(shell), integrator="euler", **OPTIONS)
    with pytest.raises(ms.OptionError, match="no rule of time"):
        ms.simulate(ms.RigidShell(shell), integrator="bdf2", **OPTIONS)
