"""What the hybrid says of its error: that of its coarse shell against DS next to its own, and none next to a snap."""

import re
import warnings

import numpy as np
import pytest
from snaps import coarse_beam, snapping_beam

import modalshell as ms


@pytest.fixture(scope="module")
def fine():
    return snapping_beam(135.0, (40, 8))


@pytest.fixture(scope="module")
def hybrid(fine):
    with warnings.catch_warnings():  # motions through its snap are far off; these tests are of states at rest
        warnings.filterwarnings("ignore", "no basis of up to", ms.ModalShellWarning)
        return ms.HybridStress.trained(fine, gravity=(0, 0, -100), coarse=coarse_beam(fine, 135.0, (20, 4)))


@pytest.mark.slow
def test_the_coarse_shells_own_error_is_measured_against_ds_and_stated(fine, hybrid):
    shares, errors = hybrid.coarse_errors.T
    assert shares.tolist() == [0.25, 0.5, 0.75, 1.0]
    truth = ms.DiscreteShell(fine)
    for share, error in hybrid.coarse_errors[[0, 1, 3]]:
        load = {"gravity": (0, 0, -100 * share)}
        exact, coarse = truth.equilibrium(**load), hybrid.coarse.equilibrium(**load)
        assert error == pytest.approx(ms.measure.displacement_error(coarse.positions, exact.positions, fine), rel=1e-3)
    assert errors.max() > 0.02  # more than the small loads alone would show
    said = hybrid.equilibrium(gravity=(0, 0, -20)).message
    assert re.search(rf"coarse shell's own .*{100 * errors[errors < 1.0].max():.2g} % against DS at rest", said)


@pytest.mark.slow
def test_next_to_a_snap_no_error_is_stated(fine, hybrid):
    """Wherever the answer is more than a tenth off DS, the error of a few percent is not claimed."""
    truth, wrong, claimed = ms.DiscreteShell(fine), 0, 0
    for aside in (0.0, np.radians(15.0)):
        for size in (20.0, 40.0, 65.0, 80.0, 140.0):
            gravity = size * np.array([0.0, np.sin(aside), -np.cos(aside)])
            exact, answer = truth.equilibrium(gravity=gravity), hybrid.equilibrium(gravity=gravity)
            off = ms.measure.displacement_error(answer.positions, exact.positions, fine)
            void = "next to a snap" in answer.message or "answered by coarse DS" in answer.message
            assert off < 0.1 or void, (gravity, off, answer.message)
            assert void == ("% on held-out loads" not in answer.message)
            wrong, claimed = wrong + (off > 0.1), claimed + (not void)
    assert wrong >= 3
    assert claimed >= 4


def test_a_strip_that_only_bends_is_next_to_no_snap():
    """Its stiffness grows with the load; straight steps strain the membrane, which must not look like a loss of it."""
    mesh = ms.sheet(length=0.5, width=0.2, cells=(6, 2))
    sheet = ms.Isotropic(young=1e9, poisson=0.3, thickness=1e-3, density=900.0)
    shell = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 1e-9)
    hybrid, truth = ms.HybridStress.trained(shell, gravity=(0, 0.5, -5), motions=24), ms.DiscreteShell(shell)
    for share in (0.2, 0.6, 1.2):
        gravity = (0, 0.5 * share, -5 * share)
        answer, exact = hybrid.equilibrium(gravity=gravity), truth.equilibrium(gravity=gravity)
        assert exact.stable
        assert ms.measure.displacement_error(answer.positions, exact.positions, shell) < hybrid.held_out_error
        assert "next to a snap" not in answer.message
        assert f"error {100 * hybrid.held_out_error:.1f} % on held-out loads" in answer.message


@pytest.mark.slow
def test_a_shell_that_is_its_own_coarse_one_has_no_error_of_that_kind(fine):
    hybrid = ms.HybridStress.trained(fine, gravity=(0, 0, -20), modes=8, motions=4)
    assert hybrid.coarse_errors.shape == (0, 2)
    assert "coarse shell's own" not in hybrid.equilibrium(gravity=(0, 0, -5)).message


def test_the_errors_are_kept_in_the_archive(fine, tmp_path):
    coarse = coarse_beam(fine, 135.0, (20, 4))
    hybrid = ms.HybridStress.trained(fine, gravity=(0, 0, -20), coarse=coarse, modes=8, motions=4)
    assert hybrid.coarse_errors.size > 0
    hybrid.save(tmp_path / "trained.npz")
    read = ms.HybridStress.load(tmp_path / "trained.npz", fine, hybrid.coarse.coarse.shell)
    np.testing.assert_array_equal(read.coarse_errors, hybrid.coarse_errors)
