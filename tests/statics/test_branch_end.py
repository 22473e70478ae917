"""Where margins fall to zero, from their values at a few loads."""

import numpy as np
import pytest

from modalshell.statics.branch_end import extrapolated


@pytest.mark.parametrize("power", [1.0, 1.3, 2.0])
def test_a_power_of_the_margin_that_falls_in_proportion_is_found(power):
    points = [(load, (1.0 - load / 3.0) ** (1.0 / power)) for load in (1.0, 1.3, 1.9)]
    assert extrapolated(points) == pytest.approx(3.0, rel=1e-6)


def test_beyond_the_two_kinds_of_ends_the_nearer_one_is_taken():
    faster, slower = ([(f, (1.0 - f / 3.0) ** p) for f in (1.0, 1.5, 2.0)] for p in (0.2, 2.0))
    (a, high), (b, low) = faster[1:]
    assert extrapolated(faster) == pytest.approx(b + (b - a) * low**2 / (high**2 - low**2))
    (a, high), (b, low) = slower[1:]
    assert extrapolated(slower) == pytest.approx(b + (b - a) * low / (high - low))


def test_margins_that_do_not_fall_have_no_end():
    assert extrapolated([(0.0, 1.0)]) == np.inf
    assert extrapolated([(0.0, 0.9), (1.0, 0.9)]) == np.inf
    assert extrapolated([(0.0, 0.5), (1.0, 0.2), (2.0, 0.4)]) == np.inf
