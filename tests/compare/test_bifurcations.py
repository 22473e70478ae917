"""Bifurcations are named beside snaps: models on the first branch answer, far off, that they converged."""

import pytest

import modalshell as ms
from modalshell.compare.advise import choose


def v_beam(material):
    mesh = ms.v_beam(fold=110.0, cells=(20, 4))
    return ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6)


@pytest.fixture(scope="module")
def buckled():
    """A V-beam that buckles sideways at less than half its load, and then bears all of it."""
    shell = v_beam(ms.Isotropic(1e9, 0.3, 1e-3, 1000.0))
    load = 2.1 * ms.buckling_factors(shell, gravity=(0.0, 0.0, -9.81)).factors[0]
    return ms.tradeoff(shell, gravity=(0.0, 0.0, -9.81 * load), modes=(4,), loads=(0.25, 1.0))


def test_a_bifurcation_without_a_snap_is_named(buckled):
    assert buckled.path.snap is None
    rows = {row.label: row for row in buckled.rows}
    assert rows["RSW 4"].statuses == ["converged", "converged"]
    assert rows["RSW 4"].errors[0] < 0.2
    assert rows["RSW 4"].errors[1] > 0.5
    path = ms.equilibrium_path(buckled.case.shell, force=buckled.case.load)
    kind, _, factor = path.events[0]
    assert kind == "bifurcation"
    assert 0.25 < factor < 0.75
    assert buckled.bifurcation == pytest.approx(factor, rel=1e-9)
    sentence = f"The shell buckles at {factor:.4g} of the load"
    assert sentence in buckled.table()
    assert buckled.findings()["bifurcation"] == buckled.bifurcation
    advice = choose(buckled, 0.02, 60.0)
    assert advice.bifurcation == buckled.bifurcation
    assert sentence in advice.explanation


@pytest.mark.slow
def test_a_shell_that_bends_away_from_its_linear_buckling_load_does_not_buckle():
    mesh = ms.v_beam(fold=110.0, cells=(12, 4))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.1)
    with pytest.warns(ms.ModalShellWarning, match="bends and does not buckle"):
        load = 1.5 * ms.buckling_factors(shell, gravity=(0.0, 0.0, -9.81)).factors[0]
    found = ms.tradeoff(shell, gravity=(0.0, 0.0, -9.81 * load), modes=(2,), loads=(1.0,))
    assert found.bifurcation is None
    assert "buckles" not in found.table() + choose(found, 0.02, 60.0).explanation
