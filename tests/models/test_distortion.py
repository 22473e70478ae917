"""Modal models say where a state is beyond what they can describe, all by the same criteria."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.distortion import distortion


@pytest.fixture(scope="module")
def basis():
    mesh = ms.v_beam(cells=(16, 4))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.07)
    return ms.solve_modes(shell, 6)


@pytest.mark.parametrize("model", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_small_motion_has_no_fault(model, basis):
    run = ms.simulate(model(basis), duration=0.5, dt=1 / 30, gravity=(0, 0, -2.0), damping=(1.0, 0.0))
    assert run.outcome is ms.Outcome.COMPLETED


def test_linear_modes_that_inflate_the_surface_are_distorted(basis):
    run = ms.simulate(ms.LinearModal(basis), duration=3.0, dt=1 / 30, gravity=(0, 0, -80.0), damping=(1.0, 0.0))
    assert run.outcome is ms.Outcome.DISTORTED
    assert "stretched or folded over" in run.message
    answer = ms.LinearModal(basis).equilibrium(gravity=(0, 0, -80.0))
    assert "surface area" in answer.message


@pytest.mark.parametrize("model", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_every_modal_model_names_a_state_outside_its_reach(model, basis):
    chosen = model(basis)
    q = 3.0 * np.ones(basis.count) / np.sqrt(basis.eigenvalues) * np.sqrt(basis.eigenvalues[0])
    state = chosen.start_motion()
    assert chosen.fault(state) is None
    state.coordinates[:] = q * 20.0
    assert chosen.fault(state) in (ms.Outcome.WOUND_UP, ms.Outcome.DISTORTED)


def test_distortion_sees_stretch_collapse_and_folds():
    mesh = ms.flat_beam(cells=(20, 4))
    rest = np.asarray(mesh.vertices)
    assert distortion(rest, mesh) == ""
    bent = rest.copy()
    bent[:, 0], bent[:, 2] = np.sin(2.0 * rest[:, 0]) / 2.0, (1.0 - np.cos(2.0 * rest[:, 0])) / 2.0
    assert distortion(bent, mesh) == ""
    assert "area is 2.2" in distortion(rest * [1.5, 1.5, 1.0], mesh)
    assert "area is 0.25" in distortion(rest * [0.5, 0.5, 1.0], mesh)
    crumpled = rest.copy()
    crumpled[:, 0] += np.where(np.round(rest[:, 0] * 20.0) % 2 == 0, 0.06, 0.0)
    assert "fold over" in distortion(crumpled, mesh)
