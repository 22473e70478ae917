"""Where a walk along a branch says that it ends, from points on it."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.statics.branch_end import _Point, end_between, predicted, way_to_end

NOWHERE = np.zeros((1, 3))


def points(*rows):
    """Of factor, margin, speed and way along the branch."""
    return [_Point(NOWHERE, factor, margin, NOWHERE[0], speed, along) for factor, margin, speed, along in rows]


@pytest.mark.parametrize("before", [0.1, 0.7])
def test_a_limit_point_is_found_between_two_points(before):
    """``f = 3 - 2 (s - 1)^2``, and a margin in proportion to ``1 - s``."""
    ends = points(*((3.0 - 2.0 * (s - 1.0) ** 2, 1.0 - s, 4.0 * (1.0 - s), s) for s in (before, 1.2)))
    assert end_between(ends) == pytest.approx(3.0, rel=1e-12)
    assert predicted([*points((0.0, 1.0, 4.0, 0.0)), *ends])


def test_a_bifurcation_is_found_where_the_margin_passes_zero():
    """``f = 2 s``, zero at ``s = 1.5``."""
    ends = points(*((2.0 * s, 1.5 - s, 2.0, s) for s in (1.0, 1.6)))
    assert end_between(ends) == pytest.approx(3.0, rel=1e-12)
    assert way_to_end(points((1.0, 1.0, 2.0, 0.5), *((2.0 * s, 1.5 - s, 2.0, s) for s in (1.0,)))) == pytest.approx(0.5)


def test_the_end_is_the_last_point_where_the_load_falls_and_the_margin_does_not():
    assert end_between(points((1.0, 0.5, 1.0, 0.0), (1.5, 0.1, -1.0, 1.0))) == pytest.approx(1.5)


def test_margins_that_do_not_fall_have_no_end():
    assert way_to_end(points((0.0, 1.0, 1.0, 0.0))) == np.inf
    assert way_to_end(points((0.0, 0.5, 1.0, 0.0), (1.0, 0.5, 1.0, 1.0))) == np.inf
    assert way_to_end(points((0.0, 0.5, 1.0, 0.0), (1.0, 0.7, 1.0, 1.0))) == np.inf


def test_a_margin_that_jumps_below_zero_was_not_foretold():
    near = [(0.6, 0.07, 1.0, 0.6), (0.64, 0.04, 1.0, 0.64)]
    assert predicted(points(*near, (0.7, -0.005, 1.0, 0.7)))
    assert not predicted(points(*near, (0.66, -0.02, 1.0, 0.66)))
    assert predicted(points(*near, (0.66, -0.02, -1.0, 0.66)))  # a limit point: the load falls
    assert predicted(points(*near, (0.66, 0.02, 1.0, 0.66)))


def test_an_end_is_no_lower_than_the_branch_before_it_and_no_higher_than_its_tangents():
    crossed = points((0.0, 1.0, 0.1, 0.0), (0.2, -6.4, 3.2, 1.0))
    assert 0.0 <= end_between(crossed) <= 3.2


@pytest.mark.slow
@pytest.mark.parametrize("strain", [{}, {"prestrain": -1e-3}, {"rest_curvature": 1.0}])
def test_walks_of_arches_end_where_paths_do_under_stress_too(strain):
    mesh = ms.cylinder_panel(length=1.0, radius=0.5, angle=50.0, cells=(8, 16))
    side = np.abs(mesh.vertices[:, 1])
    material = ms.Isotropic(1e8, 0.3, 0.01, 200.0)
    shell = ms.Shell(mesh, material, supports=[ms.Clamp(side > side.max() - 1e-9)], **strain)
    weight = shell.gravity_force((0.0, 0.0, -1.0))
    force = weight * 2e3 / np.abs(weight).sum()
    events = ms.equilibrium_path(shell, force=2.0 * force, steps=60, points=100).events
    limit = 2.0 * next(float(event.factor) for event in events if event.kind == "limit")
    for bar in (
        ms.error_bar(shell, ms.DiscreteShell(shell).equilibrium(force=0.6 * force), walk=True),
        ms.error_bar(shell, shell.rest_positions, force=3.0 * force, walk=True),
    ):
        share = 0.6 if bar.valid else 3.0
        assert bar.walked
        assert share * bar.critical_load == pytest.approx(limit, rel=0.01)


def test_a_step_from_rest_that_crosses_to_another_state_is_no_end():
    """A thin strip that bends far has no end; its first step, of a quarter of the load, leads astray."""
    mesh = ms.flat_beam(length=1.0, width=0.3, cells=(12, 4))
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 1e-3, 200.0), mesh.vertices[:, 0] < 1e-6)
    answer = ms.LinearModal(ms.solve_modes(shell, 6)).equilibrium(gravity=(7.0, 0.0, -7.0))
    assert ms.error_bar(shell, answer, walk=True).critical_load == np.inf
