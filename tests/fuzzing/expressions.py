"""Selections of vertices, from sound to hostile."""

from __future__ import annotations

from hypothesis import strategies as st

_ATOMS = (
    "x",
    "y",
    "z",
    "0",
    "0.5",
    "1e300",
    "-1",
    "9" * 400,
    "1e999",
    "nan",
    "inf",
    "True",
    "None",
    "'x'",
    "x.y",
    "[]",
)
_BETWEEN = (" + ", " - ", " * ", " / ", " ** ", " < ", " >= ", " and ", " or ", " == ")
_LINES = """
boundary
boundary(0)
boundary(7)
boundary(1e400)
boundary(-1)
boundary(x)
boundary < 1
component(0) and nearest(0, 0, 0)
component(0.5)
nearest(1, 2)
nearest(9e999, -1, True)
box(0, 0, 0, 1, 1, 1)
box(*x)
angle(0, 0, 1) < 20
angle(0, 0, 0) < 20
angle(1e300, 1e300, 1e300) < 20
angle(0, 0, 1)
x <
x
x == 1
9**9**9 < x
x < 9**9**9
2**-1 < x
__import__('os').system('false')
x.__class__ < 1
lambda: 0
(y := x) < 1
[x for x in y]
x if y else z
f'{x}' < 'a'
abs(x, y) < 1
abs() < 1
abs(x=1) < 1
abs(*x) < 1
eval('1') < 2
open < 1
x < 1; y
x < 1 # no
x < 1e
...
x ＜ 1
é < 1
0x10 < x
1_0 < x
1j < x
x < y < z
not x < 1
x / 0 < 1
0 / 0 < x
-x < 1
+x < 1
~x < 1
x in y
x is y
x @ y < 1
0or x<1
x<1if y
"""
_ODD = (
    *_LINES.splitlines(),
    *("x < 1\n", "x\n< 1", "\0", "x < \ud800", "\t x<1", "x < " + "9" * 400, "x < -" + "9" * 990),
    *("(" * 300 + "x", "not " * 200 + "x < 1", "x < " + "-" * 900 + "1", "x<1" + " and x<1" * 120, "x" + "<x" * 400),
    *("x < " + "(" * 150 + "1" + ")" * 150, "x < " + "abs(" * 90 + "x" + ")" * 90, "x<1 or " * 500 + "x<1"),
    *("x < 1" + "+1" * 490, "x < 1" + "*9e9" * 240, "x < " + "[" * 900, "x < 0" + "_0" * 400),
)

_grown = st.recursive(
    st.sampled_from(_ATOMS),
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(_BETWEEN), inner).map("".join),
        st.sampled_from(("({})", "abs({})", "not {}", "-{}")).flatmap(lambda form: inner.map(form.format)),
    ),
    max_leaves=12,
)
expressions = st.one_of(
    st.sampled_from(_ODD),
    _grown,
    st.text(alphabet="xyz0123456789.+-*/<>=() andortbs_e", max_size=60),
    st.text(max_size=30),
)
