import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modalshell.errors import OptionError
from modalshell.selection import select_vertices

POINTS = np.array([[0.0, 0.0, 0.0], [0.5, -1.0, 2.0], [1.0, 1.0, -3.0]])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x < 0.1", [True, False, False]),
        ("x <= 0.5 and y < 0", [False, True, False]),
        ("not (x < 0.1) or z > 5", [False, True, True]),
        ("0.2 < x < 0.7", [False, True, False]),
        ("abs(z) >= 2", [False, True, True]),
        ("x + 2*y - z/2 < -2", [False, True, False]),
        ("-x > -0.2", [True, False, False]),
        ("1 < 2", [True, True, True]),
    ],
)
def test_selects_what_the_text_says(text, expected):
    assert select_vertices(text, POINTS).tolist() == expected


@pytest.mark.parametrize(
    "text",
    [
        "",
        "x",
        "x <",
        "w < 1",
        "x == 1",
        "__import__('os').system('true')",
        "x.real < 1",
        "x[0] < 1",
        "(lambda: 1)() < x",
        "x < 'a'",
        "x < True",
        "x ** 9 < 1",
        "abs(x, y) < 1",
        "x < 1; y < 2",
        "x < " + "(" * 500 + "1" + ")" * 500,
        "x <" + " 1" * 2000,
    ],
)
def test_refuses_what_is_no_comparison_of_coordinates(text):
    with pytest.raises(OptionError):
        select_vertices(text, POINTS)


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet="xyz<>=+-*/()0123456789. andort_abs[]'", max_size=40))
def test_any_text_selects_or_is_refused(text):
    try:
        mask = select_vertices(text, POINTS)
    except OptionError:
        return
    assert mask.shape == (3,)
    assert mask.dtype == bool
