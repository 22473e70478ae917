"""Both readings of the paper's eq. 16 over closed cycles: the sum leaves something behind, the closed form does not."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.files.study_result import StudyResult
from modalshell.kernels import rotations
from studies import integrator_drift as study


@pytest.fixture(scope="module", params=[pytest.param("integrator_drift", marks=pytest.mark.slow)])
def result(quick_study, request):
    return StudyResult.load(quick_study(request.param), request.param)


@pytest.fixture(scope="module")
def basis():
    return study.scene_basis("strip", (12, 4))


@pytest.mark.parametrize("scene", study.LOADS)
def test_closed_form_returns_to_rest(result, scene):
    found = result.findings[scene]
    for path in study.PATHS:
        assert found[path]["largest_displacement"] > 0.05
        for run in found[path]["cycled"].values():
            assert np.max(run["closed_form"]) < 1e-12
    assert all(row["closed_form"] < 1e-12 for row in found["motion"])


@pytest.mark.parametrize("scene", study.LOADS)
def test_drift_on_a_line_falls_with_the_step_at_first_order(result, scene):
    line = result.findings[scene]["line"]
    orders = -np.diff(np.log(line["drift"])) / np.diff(np.log(line["steps"]))
    np.testing.assert_allclose(orders[2:], 1.0, atol=0.02)
    assert line["path_part"] < 1e-2 * line["drift"][-1]


@pytest.mark.parametrize("scene", study.LOADS)
def test_drift_on_a_loop_has_a_limit(result, scene):
    loop = result.findings[scene]["loop"]
    assert loop["path_part"] > 0.01
    assert loop["drift"][-1] == pytest.approx(loop["path_part"], rel=0.1)
    assert loop["order"] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("scene", study.LOADS)
def test_drift_adds_up_from_cycle_to_cycle(result, scene):
    for path in study.PATHS:
        for run in result.findings[scene][path]["cycled"].values():
            drift = np.array(run["sum"])
            np.testing.assert_allclose(drift, drift[0] * np.arange(1, drift.size + 1), rtol=1e-9)


def test_limit_of_a_small_loop_is_its_area_times_the_curl(basis):
    """Stokes on ``R(Psi q) Phi dq`` near rest: drift = area (psi_a x phi_b - psi_b x phi_a) for a loop from a to b."""
    a, b, radius = 0, 1, 1e-5
    phase = np.linspace(0.0, 2.0 * np.pi, 2001)
    path = np.zeros((phase.size, basis.count))
    path[:, a], path[:, b] = radius * (1.0 - np.cos(phase)), -radius * np.sin(phase)
    left = study.carry(study.SummedWarp(basis), path, 1)[0]
    modes, turns = (matrix.reshape(-1, 3, basis.count) for matrix in (basis.modes, basis.rotations))
    curl = np.cross(turns[:, :, a], modes[:, :, b]) - np.cross(turns[:, :, b], modes[:, :, a])
    area = np.pi * radius**2
    np.testing.assert_allclose(left, area * curl, atol=5e-3 * area * np.abs(curl).max())


def test_sum_up_and_down_a_line_leaves_what_telescoping_says(basis):
    """Up and down in even steps, ``R(w) - I`` telescopes: the drift is ``(R(w_end) - I) Phi dq`` exactly."""
    end = np.zeros(basis.count)
    end[:2] = 0.05, 0.02
    rise = np.linspace(0.0, 1.0, 17)[:, None] * end
    left = study.carry(study.SummedWarp(basis), np.vstack([rise, rise[-2::-1]]), 1)[0]
    model = ms.ModalWarping(basis)
    step = (basis.modes @ end).reshape(-1, 3) / 16
    turned = np.empty_like(step)
    rotations.rotate(model.rotation_vectors(end), step, 1.0, turned)
    # Up takes R at the upper end of each step, down at the lower.
    np.testing.assert_allclose(left, turned - step, atol=1e-14)


def test_table_names_every_case(result):
    page = study.table(result)
    assert page.count("\n| v_beam | ") == page.count("\n| strip | ") == 4
