"""Shares as text."""

import pytest

from modalshell.core.units import at_most, in_percent, in_two_digits
from modalshell.motion.bars import check_text


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (1.234e-5, "0.0012 %"),
        (0.0588, "5.9 %"),
        (0.994, "99 %"),
        (0.9951, "100 %"),
        (9.04, "900 %"),
        (-2.47, "-250 %"),
        (123.0, "12000 %"),
        (1e7, "1e+09 %"),
    ],
)
def test_shares_have_two_digits_and_no_power_of_ten_that_one_could_write_out(share, text):
    assert in_percent(share) == text
    assert in_two_digits(3312.0) == "3300"


def test_checks_far_off_are_said_in_plain_numbers():
    assert check_text(9.04, valid=True) == "900 % from DS"


def test_bounds_are_rounded_towards_zero():
    for value, digits, text in (
        (0.00496, 2, "0.0049"),
        (0.0051, 2, "0.0051"),
        (99.6, 2, "99"),
        (1.0, 3, "1"),
        (0.09996, 3, "0.0999"),
        (996.0, 2, "990"),
    ):
        assert at_most(value, digits) == text
