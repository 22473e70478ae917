"""An integrator of another package takes one file: a class with a key, which scenes then know."""

import json
import sys

import numpy as np
import pytest
from guide import source

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.integrators.full import FullIntegrator
from modalshell.integrators.modal import ModalIntegrator
from modalshell.shell.damping import Damping
from studies import stability_limits

MODULE = source("toy_rule.py")

SOFT = ("-9.81", "-2.0")
DAMPED = ("duration = 1", "duration = 1\ndamping = [0.5, 0]")


@pytest.fixture
def toy(install_modules):
    """A package of one file, found as an installed one is."""
    install_modules("rule = toy_rule", toy_rule=MODULE)
    yield
    ModalIntegrator.known.pop("exponential_euler", None)
    FullIntegrator.known.pop("frozen", None)


def command(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code


@pytest.mark.usefixtures("toy")
def test_an_integrator_of_another_package_runs_by_scene(scene_file, tmp_path):
    """Linear motion from rest under gravity has a closed form, which the toy steps exactly."""
    file = scene_file(SOFT, DAMPED, ('"mwts"', '"lma"\nintegrator = "exponential_euler"'))
    assert command("run", file, "--out", tmp_path / "out") == 0
    run = ms.load_trajectory(tmp_path / "out" / "scene.npz")
    basis = ms.load_scene(file).build().model.basis
    stiffness = basis.eigenvalues
    rest = basis.modes.T @ basis.shell.gravity_force((0.0, 0.0, -2.0)).ravel() / stiffness
    omega, t = np.sqrt(stiffness - 0.0625), run.times[:, None]
    q = rest * (1.0 - np.exp(-0.25 * t) * (np.cos(omega * t) + 0.25 / omega * np.sin(omega * t)))
    expected = basis.shell.rest_positions + (q @ basis.modes.T).reshape(len(t), -1, 3)
    np.testing.assert_allclose(run.positions, expected, rtol=0, atol=1e-12)
    assert np.abs(run.positions - basis.shell.rest_positions).max() > 0.01


@pytest.mark.slow
@pytest.mark.usefixtures("toy")
def test_the_frames_of_a_tradeoff_are_stepped_by_it(scene_file, tmp_path):
    file = scene_file(SOFT, ('"mwts"', '"mwts"\nintegrator = "exponential_euler"'))
    assert command("tradeoff", file, "--modes", "4", "--out", tmp_path / "out") == 0
    rows = json.loads((tmp_path / "out" / "scene_tradeoff.json").read_text())["findings"]["rows"]
    on_modes = [row["motion"] for row in rows if row["label"] in ("LMA 4", "MWTS 4", "MWTS, consistent 4", "RSW 4")]
    assert on_modes == ["completed"] * 4
    # At least four frames each, and two that are not timed.
    assert sys.modules["toy_rule"].ExponentialEuler.steps >= 6 * len(on_modes)


@pytest.mark.usefixtures("toy")
def test_theory_and_statics_know_it(scene_file):
    model = ms.load_scene(scene_file(SOFT, ('"mwts"', '"mwts"\nintegrator = "exponential_euler"'))).build().model
    basis, damping = model.basis, Damping(0.5, 0.0)
    assert type(model.integrator).__name__ == "ExponentialEuler"
    assert model.decay_rate(0.1, damping) == pytest.approx(0.5)
    frequency = model.integrator.frequency(basis.eigenvalues[:1], 0.5, 0.01)
    assert frequency[0] == pytest.approx(np.sqrt(basis.eigenvalues[0] - 0.0625))
    load = basis.shell.gravity_force((0.0, 0.0, -2.0))
    q = model.equilibrium(gravity=(0.0, 0.0, -2.0)).coordinates
    assert stability_limits.step_radius(model, q, load, 1e-3, damping) < 1.0
    led = ms.PositionConstraint(len(basis.shell.rest_positions) - 1, basis.shell.rest_positions[-1])
    run = ms.simulate(model, duration=0.5, gravity=(0.0, 0.0, -2.0), damping=(0.5, 0.0), constraints=[led])
    assert run.constraint_residuals.max() < 1e-6


@pytest.mark.usefixtures("toy")
def test_full_models_take_a_rule_of_another_package_as_well(scene_file, tmp_path):
    file = scene_file(SOFT, ('"mwts"', '"ds"\nintegrator = "frozen"'))
    assert command("run", file, "--out", tmp_path / "out") == 0
    run = ms.load_trajectory(tmp_path / "out" / "scene.npz")
    np.testing.assert_array_equal(run.positions[-1], run.positions[0])


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("name", "rule"), [("mwts", "frozen"), ("ds", "exponential_euler"), ("mwts", "exponential_eluer")]
)
def test_a_rule_of_another_kind_is_refused(scene_file, tmp_path, capsys, name, rule):
    file = scene_file(('"mwts"', f'"{name}"\nintegrator = "{rule}"'))
    assert command("run", file, "--out", tmp_path / "out") == 2
    message = capsys.readouterr().err
    assert "scene.toml: model.integrator: must be one of " in message
    assert f"(got '{rule}')" in message
