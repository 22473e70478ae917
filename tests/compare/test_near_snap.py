"""Next to a snap: where rungs are compared with DS, and which loads the advised one does not serve."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import timed

import modalshell as ms
from modalshell.compare.advise import choose
from modalshell.compare.candidates import case_factory
from modalshell.compare.path import NEXT_TO_SNAP, Marks, follow_loads


def across(mesh):
    """A shell held along the straight edges of a panel."""
    aside = np.abs(mesh.vertices[:, 1])
    return ms.Shell(mesh, ms.Material(150.0, 150.0, 0.05, 0.2), aside > aside.max() - 1e-9)


@pytest.fixture(scope="module")
def pushed():
    """A shallow panel, held along both straight edges and pushed through its plane by its weight."""
    shell = across(ms.cylinder_panel(angle=40.0, cells=(4, 8)))
    return ms.tradeoff(shell, gravity=(0, 0, -320), modes=(6, 8))


@pytest.mark.slow
def test_the_snap_of_a_panel_pushed_through_is_located(pushed):
    path, shell = pushed.path, pushed.case.shell
    moves = [np.abs(b.positions - a.positions).max() for a, b in zip(path.answers[:-1], path.answers[1:], strict=True)]
    assert max(moves) < 0.1 * shell.size  # less than a cantilever moves without any snap
    assert path.snap.low == path.snap.high
    whole = ms.equilibrium_path(shell, force=pushed.case.load, steps=40, branches=1)
    assert path.snap.low == pytest.approx(Marks.of(whole).snap, rel=1e-5)
    assert f"The shell snaps at {path.snap.low:.4g} of the load" in pushed.table()


@pytest.mark.slow
def test_rungs_are_compared_just_below_and_just_above_a_snap(pushed):
    path, shell = pushed.path, pushed.case.shell
    snap = path.snap.low
    np.testing.assert_allclose(path.near, [(1.0 - NEXT_TO_SNAP) * snap, (1.0 + NEXT_TO_SNAP) * snap])
    below, above = path.near_answers
    size = np.linalg.norm(below.positions - shell.rest_positions)
    assert np.linalg.norm(above.positions - below.positions) > 3.0 * size
    for row in pushed.rows:
        if row.is_truth:
            assert row.near_errors == [0.0, 0.0]
        elif row.key == "md-rom":
            model = row.candidate.build(case_factory(pushed.case))[0]
            for share, exact, error in zip(path.near, path.near_answers, row.near_errors, strict=True):
                answer = model.equilibrium(force=share * pushed.case.load)
                assert error == ms.measure.displacement_error(answer.positions, exact.positions, shell)
    assert f"errors at {path.near[0]:.4g} and {path.near[1]:.4g} of the load" in pushed.table()


def test_no_rung_is_advised_that_snaps_elsewhere(pushed):
    """Its answers between both snaps are on the other branch, whatever it measures at the other loads."""
    row = next(row for row in pushed.rows if row.label == "MD-ROM 8")
    wanted = 1.01 * max(row.worst_error, row.near_error)

    def advised(*near):
        rows = [replace(one, near_errors=list(near)) if one is row else one for one in pushed.rows]
        return choose(timed(replace(pushed, rows=rows)), wanted, 60.0)

    assert advised(*row.near_errors).chosen.label == row.label
    late = advised(0.01, 0.9)
    assert late.chosen.label == "DS"
    assert f"but not next to the snap: MD-ROM 8 ({100 * row.worst_error:.3g} %, 90 % there)" in late.explanation
    assert "without an answer there" in advised(None, 0.01).explanation
    assert "without an answer there" not in advised(*row.near_errors).explanation


def test_advice_says_where_next_to_a_snap_its_rung_is_on_another_branch(pushed):
    """MD-ROM 6 meets the error half a per cent below and above the snap, but snaps a quarter of a per cent late."""
    shell, load, snap = pushed.case.shell, pushed.case.load, pushed.path.snap.low
    advice = choose(timed(pushed), 0.1, 60.0)
    assert advice.chosen.label == "MD-ROM 6"
    assert advice.chosen.largest_error < 0.1
    ((low, high),) = advice.missed_loads
    assert (1.0 - NEXT_TO_SNAP) * snap < low < snap < high < (1.0 + NEXT_TO_SNAP) * snap
    assert f"Not between {low:.4g} and {high:.4g} of the load" in advice.explanation
    exact, model = ms.DiscreteShell(shell), advice.chosen.model

    def apart(share):
        answers = (one.equilibrium(force=share * load).positions for one in (model, exact))
        return ms.measure.displacement_error(*answers, shell)

    assert apart(1.001 * snap) > 0.7
    for share in (0.9999 * low, 1.0001 * high, 0.99 * snap, 1.01 * snap):
        assert apart(share) <= 0.1
    assert choose(timed(pushed), 1e-6, 60.0).missed_loads == []  # of DS


def test_two_snaps_between_two_loads_are_both_located():
    """Two panels in one mesh, of which the flatter snaps first: rungs are compared next to either snap."""
    panels = [ms.cylinder_panel(angle=angle, cells=(4, 8)) for angle in (40.0, 38.0)]
    loads = []
    for mesh in panels:
        path = ms.equilibrium_path(across(mesh), gravity=(0, 0, -1), until=340.0, steps=20, branches=1)
        loads.append(Marks.of(path).snap / 340.0)
    vertices = np.vstack([mesh.vertices + np.array([0.0, 3.0 * place, 0.0]) for place, mesh in enumerate(panels)])
    faces = np.vstack([mesh.faces + place * len(panels[0].vertices) for place, mesh in enumerate(panels)])
    held = np.concatenate([across(mesh).clamped for mesh in panels])
    both = ms.Shell(ms.TriangleMesh(vertices, faces), ms.Material(150.0, 150.0, 0.05, 0.2), held)
    path = follow_loads(both, both.gravity_force((0.0, 0.0, -340.0)), (0.25, 0.5, 1.0))
    assert [snap.low for snap in path.snaps] == pytest.approx(sorted(loads), rel=1e-4)
    assert len(path.near) == 4


def test_reduced_models_that_follow_a_shallow_panel_are_not_refused(pushed):
    """Modal derivatives hold the snap of a panel, which no energy quadratic in rest modes does."""
    advice = choose(timed(pushed), 0.02, 60.0)
    assert advice.chosen.label == "MD-ROM 8"
    assert {row.label for row in pushed.rows if row.candidate.spec.quadratic} <= set(advice.refused)
