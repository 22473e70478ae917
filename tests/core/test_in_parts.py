"""Array expressions a part at a time."""

import numpy as np
import pytest

from modalshell.core.in_parts import fill_in_parts


@pytest.mark.parametrize("rows", [0, 1, 10_000, 25_001])
def test_every_row_is_filled_once(rows):
    first, second, out = np.arange(rows), np.arange(2.0 * rows).reshape(-1, 2), np.full((rows, 2), np.nan)
    fill_in_parts(out, lambda a, b: a[:, None] + b, first, second)
    np.testing.assert_array_equal(out, first[:, None] + second)
