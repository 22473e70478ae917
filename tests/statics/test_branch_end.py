"""Where a walk along a branch says that it ends, from points on it."""

import numpy as np
import pytest

from modalshell.statics.branch_end import _Point, end_between, foretold, way_to_end

NOWHERE = np.zeros((1, 3))


def points(*rows):
    """Of factor, margin, speed and way along the branch."""
    return [_Point(NOWHERE, factor, margin, NOWHERE[0], speed, along) for factor, margin, speed, along in rows]


@pytest.mark.parametrize("before", [0.1, 0.7])
def test_a_limit_point_is_found_between_two_points(before):
    """``f = 3 - 2 (s - 1)^2``, and a margin in proportion to ``1 - s``."""
    ends = points(*((3.0 - 2.0 * (s - 1.0) ** 2, 1.0 - s, 4.0 * (1.0 - s), s) for s in (before, 1.2)))
    assert end_between(ends) == pytest.approx(3.0, rel=1e-12)
    assert foretold([*points((0.0, 1.0, 4.0, 0.0)), *ends])


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
    assert foretold(points(*near, (0.7, -0.005, 1.0, 0.7)))
    assert not foretold(points(*near, (0.66, -0.02, 1.0, 0.66)))
    assert foretold(points(*near, (0.66, -0.02, -1.0, 0.66)))  # a limit point: the load falls
    assert foretold(points(*near, (0.66, 0.02, 1.0, 0.66)))
