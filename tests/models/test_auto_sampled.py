"""Checks of the model that switches itself on large shells: on a coarse one where that agrees, and by fewer factors."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.core.cost import counted
from modalshell.models.auto.at_rest import AtRest
from modalshell.models.auto.auto import Auto
from modalshell.models.auto.sampled import SampledCheck, linear_gaps, lowest_gap
from modalshell.models.warping import consistent_warping
from modalshell.modes import Factoriser
from modalshell.motion.stepping import Motion
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator

SHEET = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
PULL = (0.1, 0.3, -1.0)


def plate(cells):
    mesh = ms.sheet(cells=(cells, cells))
    return ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 1e-6)


@pytest.fixture(scope="module")
def fine():
    return plate(24)


@pytest.fixture(scope="module")
def coarse(fine):
    return ms.CoarseDiscreteShell(fine, plate(12))


@pytest.fixture
def large(monkeypatch):
    """Shells are taken for so large that no compiled check serves them."""
    monkeypatch.setattr(Auto, "_quick_check", None)


def force_of(shell, basis, size):
    """A weight under which the linear answer is ``size`` of the shell."""
    force = np.array(shell.gravity_force(PULL))
    moved = ms.LinearModal(basis).equilibrium(force=force).positions - shell.rest_positions
    return size * shell.size / float(np.linalg.norm(moved, axis=1).max()) * force


def swinging(shell, size, steps, second=0.0):
    """Motion under a weight that swings, and under another one of a ``second`` size and period."""
    basis = ms.solve_modes(shell, 8)
    omega = float(np.sqrt(basis.eigenvalues[0]))
    dt, count = 2.0 * np.pi / omega / 30, np.arange(steps + 2)
    loads = []
    for part, pull, period in ((size, PULL, 39), (second, (0.0, 1.0, 0.5), 53)):
        if part:
            most = part * np.linalg.norm(force_of(shell, basis, 1.0)) / np.linalg.norm(shell.gravity_force(PULL))
            factors = most * np.sin(2.0 * np.pi / period * count)
            loads.append(ms.Scaled(ms.SelfWeight(pull), ((dt * count).tolist(), factors.tolist())))
    return {"duration": steps * dt, "dt": dt, "loads": loads, "damping": (0.2 * omega, 0.0)}


def worst(shell, run, exact):
    off, moved = (
        np.sqrt(np.sum(shell.mass[:, None] * part**2, axis=(1, 2)))
        for part in (run.positions - exact.positions, exact.positions - shell.rest_positions)
    )
    return off.max() / moved.max()


def fine_checks(monkeypatch, shell, model, setting):
    """The run, and how many bars were found on the shell itself."""
    count, found = [0], ErrorEstimator.bar

    def seen(self, *given, **options):
        count[0] += len(self.shell.mass) == len(shell.mass)
        return found(self, *given, **options)

    with monkeypatch.context() as patch:
        patch.setattr(ErrorEstimator, "bar", seen)
        run = ms.simulate(model, **setting)
    return run, count[0]


@pytest.mark.by_default("0.5-3")
@pytest.mark.parametrize(("size", "factors"), [(0.02, 2), (0.5, 3)])
def test_a_margin_is_found_by_the_second_factor_where_that_step_is_short(fine, size, factors):
    basis = ms.solve_modes(fine, 8)
    force = force_of(fine, basis, size)
    x = ms.ModalWarping(basis).equilibrium(force=force).positions
    whole = ErrorEstimator(fine).bar(x, force)
    estimator = ErrorEstimator(fine, early=True)
    with counted() as work:
        early = estimator.bar(x, force)
    assert work.factorisations == factors
    assert np.array_equal(early.corrected, whole.corrected)
    assert early.margin == pytest.approx(whole.margin, abs=0.01)


def test_one_factor_serves_both_steps_and_the_margin_of_a_large_shell(fine):
    """Those of small shells have no iterations with a factor near by: here they get that of large ones."""
    basis = ms.solve_modes(fine, 8)
    force = force_of(fine, basis, 0.1)
    x = ms.ModalWarping(basis).equilibrium(force=force).positions
    whole, estimator = ErrorEstimator(fine).bar(x, force), ErrorEstimator(fine, early=True)
    estimator._factoriser = Factoriser("cholesky")
    with counted() as work:
        early = estimator.bar(x, force)
    assert work.factorisations == 1
    assert whole.displacement > 1e-3
    assert early.displacement == pytest.approx(whole.displacement, rel=0.03)  # residuals of a tenth serve here
    assert early.margin == pytest.approx(whole.margin, abs=0.01)


def test_a_coarse_check_less_the_linear_gaps_is_the_fine_one():
    fine, rough = (
        ms.Shell(ms.v_beam(length=1.0, width=0.25, fold=150.0, cells=cells), SHEET, "x < 1e-6")
        for cells in ((48, 8), (24, 4))
    )
    coarse, basis = ms.CoarseDiscreteShell(fine, rough), ms.solve_modes(fine, 8)
    gaps, mass = linear_gaps(coarse, basis), fine.mass[:, None]
    force = force_of(fine, basis, 0.01)
    answer = consistent_warping(basis).equilibrium(force=force)
    x, q = answer.positions, answer.coordinates
    bar = ErrorEstimator(fine).bar(x, force)
    added = bar.corrected - x

    def missed(found):
        return float(np.sqrt(np.sum(mass * (found.added - added) ** 2) / np.sum(mass * added**2)))

    found = SampledCheck(coarse, gaps, None).found(x, q, force)
    assert missed(found) < 0.08
    assert missed(SampledCheck(coarse, 0.0 * gaps, None).found(x, q, force)) > 0.4
    assert found.margin == pytest.approx(bar.margin, abs=0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("large")
def test_a_large_shell_is_checked_on_a_coarse_one(fine, coarse, monkeypatch):
    setting = swinging(fine, 0.05, 90)
    shells = {"none": None, "coarse": coarse.coarse_shell}
    runs = {key: fine_checks(monkeypatch, fine, ms.Auto(fine, coarse=shell), setting) for key, shell in shells.items()}
    (alone, many), (run, few) = runs["none"], runs["coarse"]
    assert few < 0.5 * many
    assert "coarse DS" not in run.levels
    exact = ms.simulate(ms.DiscreteShell(fine), **setting)
    assert worst(fine, run, exact) < max(0.03, 1.1 * worst(fine, alone, exact))


@pytest.mark.slow
@pytest.mark.usefixtures("large")
def test_statics_under_a_weight_that_comes_at_once_says_how_right_the_coarse_shell_is(fine, coarse, monkeypatch):
    """The rise of the motion needs no fine check of each displacement by half as large again."""
    basis = ms.solve_modes(fine, 8)
    dt = 2.0 * np.pi / float(np.sqrt(basis.eigenvalues[0])) / 60
    setting = {"duration": 40 * dt, "dt": dt, "force": force_of(fine, basis, 0.06)}
    run, few = fine_checks(monkeypatch, fine, ms.Auto(fine, coarse=coarse.coarse_shell), setting)
    assert run.levels.count("MWTS") == len(run.levels)
    assert few <= 2  # statics, and the highest point
    alone, many = fine_checks(monkeypatch, fine, ms.Auto(fine), setting)
    assert many >= 2 * few
    assert np.array_equal(run.positions, alone.positions)


@pytest.mark.usefixtures("large")
def test_a_coarse_shell_that_does_not_agree_is_not_believed(monkeypatch):
    """One of another curvature errs by more than linear answers tell."""
    mesh = ms.cylinder_panel(length=1.0, radius=0.8, angle=72.0, cells=(16, 16))
    panel = ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 1e-6)
    rough = ms.cylinder_panel(length=1.0, radius=0.8, angle=72.0, cells=(4, 4))
    coarse = ms.Shell(rough, SHEET, rough.vertices[:, 0] < rough.vertices[:, 0].min() + 1e-6)
    setting = swinging(panel, 0.003, 24)
    alone, many = fine_checks(monkeypatch, panel, ms.Auto(panel), setting)
    run, few = fine_checks(monkeypatch, panel, ms.Auto(panel, coarse=coarse), setting)
    assert few >= many
    assert run.levels == alone.levels
    assert np.array_equal(run.positions, alone.positions)


@pytest.mark.slow
def test_trust_ends_where_states_grow_or_fine_checks_differ(fine, coarse):
    basis = ms.solve_modes(fine, 8)
    check = SampledCheck(coarse, linear_gaps(coarse, basis), None)
    force = force_of(fine, basis, 0.02)
    answer = consistent_warping(basis).equilibrium(force=force)
    x, q = answer.positions, answer.coordinates
    bar, found = ErrorEstimator(fine).bar(x, force), check.found(x, q, force)
    known = check.compared(found, bar, x, 1.0, 0.02, check.nothing())
    assert not check.trusts(check.nothing(), 0.0)
    assert check.trusts(known, 1.4)
    assert not check.trusts(known, 1.6)
    assert not check.trusts(known + np.array([0.0, 0.0, 12.0]), 1.0)
    off, margin = check.surely(found, known)
    assert off > 1.05 * found.off
    assert margin < found.margin
    assert not check.trusts(check.compared(found._replace(added=2.0 * found.added), bar, x, 1.0, 0.0, known), 1.0)
    assert not check.trusts(check.compared(found._replace(margin=0.5), bar, x, 1.0, 0.02, known), 1.0)
    assert not check.trusts(check.compared(None, bar, x, 1.0, 0.02, known), 1.0)
    lost = ErrorBar(np.inf, -np.inf, 0.0, False, x, 0.0, "lost")
    assert np.isfinite(check.compared(found, lost, x, 1.0, 0.02, known)).all()


@pytest.mark.slow
@pytest.mark.usefixtures("large")
def test_a_motion_checked_on_a_coarse_shell_resumes_to_the_same_bits(fine, coarse):
    setting = swinging(fine, 0.05, 60)
    loading = fine.loading(None, None, setting["loads"])
    model = ms.Auto(fine, coarse=coarse.coarse_shell)
    whole, resumed = (Motion(model, loading, dt=setting["dt"]) for _ in range(2))
    for step in range(60):
        whole.advance()
        if step >= 20 and not resumed.count and whole.state.memory["agreed"][2] > 0.0:
            resumed.restore(whole.snapshot())
    assert resumed.count
    while resumed.count < whole.count:
        resumed.advance()
    found = resumed.snapshot()
    assert all(np.array_equal(found[name], part) for name, part in whole.snapshot().items())


@pytest.mark.slow
def test_a_coarse_shell_that_misses_the_lowest_mode_is_no_level():
    mesh = ms.leaf(cells=(16, 6))
    leaf = ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 0.07)
    rough = ms.leaf(cells=(8, 4))
    held = rough.vertices[:, 0] < rough.vertices[:, 0].min() + 0.14
    auto = ms.Auto(leaf, coarse=ms.Shell(rough, SHEET, held))
    gap = lowest_gap(*auto._gaps, auto.basis)
    assert gap > 0.05
    assert auto.unfit == (2,)
    assert ms.Auto(leaf, coarse=ms.Shell(rough, SHEET, held), error=0.3).unfit == ((2,) if gap > 0.3 else ())
    run = ms.simulate(auto, **swinging(leaf, 0.05, 30))
    assert "DS" in run.levels
    assert "coarse DS" not in run.levels


@pytest.mark.slow
def test_statics_of_loads_among_known_states_is_not_looked_at(monkeypatch):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 4))
    strip = ms.Shell(mesh, SHEET, "x < 1e-6")
    setting, looked, of = swinging(strip, 0.05, 150, second=0.03), [0], AtRest.of

    def counted_of(self, *given):
        looked[0] += 1
        return of(self, *given)

    monkeypatch.setattr(AtRest, "of", counted_of)
    run = ms.simulate(ms.Auto(strip), **setting)
    assert 0 < looked[0] < 10
    assert worst(strip, run, ms.simulate(ms.DiscreteShell(strip), **setting)) < 0.05
