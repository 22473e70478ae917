"""Damage to bytes and to values, as hypothesis strategies."""

from __future__ import annotations

import re
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import strategies as st

Damage = Callable[[bytes], bytes]

TOKENS = (
    *(b"nan", b"inf", b"-inf", b"1e999", b"1e308", b"-1e308", b"1e160", b"1e-320", b"0", b"-0.0", b"-1", b"7", b"1e5"),
    *(b"2147483648", b"-2147483649", b"99999999999999999999", b"9" * 400, b"9" * 5000, b"1_0", b"0x1F", b"1,5", b"1/2"),
    *(
        b"\xd9\xa3",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\x00",
        b"",
        b" ",
        b"\n",
        b"\r",
        b"\\\n",
        b"#",
        b"'",
        b'"',
        b"[" * 3000,
    ),
    *(b"None", b"true", b"v 0 0 0\n", b"f 1 2 3\n", b"../../x", b"/etc/passwd", b"\xf0\x9f\x90\x9b", b"{}", b"[]"),
)
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_WHERE = st.integers(0, 1 << 16)


def _flip(at: int, bits: int) -> Damage:
    def damage(data: bytes) -> bytes:
        if not data:
            return data
        place = at % len(data)
        return data[:place] + bytes([data[place] ^ bits]) + data[place + 1 :]

    return damage


def _cut(at: int, length: int) -> Damage:
    return lambda data: data[: at % (len(data) + 1)] + data[at % (len(data) + 1) + length :]


def _truncate(at: int) -> Damage:
    return lambda data: data[: at % (len(data) + 1)]


def _repeat(at: int, length: int, times: int) -> Damage:
    def damage(data: bytes) -> bytes:
        place = at % (len(data) + 1)
        return data[:place] + data[place : place + length] * times + data[place + length :]

    return damage


def _insert(at: int, token: bytes) -> Damage:
    return lambda data: data[: at % (len(data) + 1)] + token + data[at % (len(data) + 1) :]


def _renumber(index: int, token: bytes) -> Damage:
    def damage(data: bytes) -> bytes:
        places = [match.span() for match in _NUMBER.finditer(data)]
        if not places:
            return data
        start, end = places[index % len(places)]
        return data[:start] + token + data[end:]

    return damage


def _swap_lines(first: int, second: int, keep: bool) -> Damage:
    def damage(data: bytes) -> bytes:
        lines = data.split(b"\n")
        a, b = first % len(lines), second % len(lines)
        if keep:
            lines[a], lines[b] = lines[b], lines[a]
        else:
            lines[a] = lines[b]
        return b"\n".join(lines)

    return damage


def _drop_line(index: int) -> Damage:
    def damage(data: bytes) -> bytes:
        lines = data.split(b"\n")
        del lines[index % len(lines)]
        return b"\n".join(lines)

    return damage


_TOKEN = st.sampled_from(TOKENS)
flips = st.builds(_flip, _WHERE, st.integers(1, 255))
byte_damage = st.one_of(
    flips,
    st.builds(_truncate, _WHERE),
    st.builds(_cut, _WHERE, st.integers(1, 40)),
    st.builds(_repeat, _WHERE, st.integers(1, 60), st.sampled_from((2, 3, 40))),
    st.builds(_insert, _WHERE, _TOKEN),
)
text_damage = st.one_of(
    st.builds(_renumber, _WHERE, _TOKEN),
    st.builds(_renumber, _WHERE, st.integers(-3, 9).map(lambda number: str(number).encode())),
    byte_damage,
    st.builds(_swap_lines, _WHERE, _WHERE, st.booleans()),
    st.builds(_drop_line, _WHERE),
)


def damaged(data: bytes, damages: list[Damage]) -> bytes:
    """``data`` after all the damages, held to a size that a test can read quickly."""
    for damage in damages:
        data = damage(data)[: 1 << 17]
    return data


class _Empty:
    """An object that is nothing that the package knows."""

    def __repr__(self) -> str:
        return "Empty()"


SCALARS: tuple[Any, ...] = (
    *(float("nan"), float("inf"), -float("inf"), 0, -1, 0.5, 1, 2, 1e300, -1e300, 1e-320, 1e160, -1e-160, 1.5),
    *(10**400, -(10**5000), 2**31, 2**63, 2**64, True, False, None, "", "x", "1", "nan", "x" * 5000, b"x", 1j),
    *(Decimal(1), Decimal("nan"), Fraction(1, 3), _Empty(), _Empty, [], {}, (), {1.0}, [[]], [None], ["a", "b"]),
    *(np.float32("nan"), np.float64("inf"), np.int8(3), np.bool_(True), np.array(1.0), np.array([1.0]), np.array([])),
    *(np.datetime64("2020-01-01"), np.timedelta64(1, "s"), np.str_("a"), np.zeros((2, 2)), range(3), print, slice(3)),
    *(np.zeros((0, 3)), np.zeros((3, 0)), np.ones(3), [1, [2, 3]], np.array([1, "a", None], dtype=object), "é\ud800\0"),
)
scalars = st.sampled_from(SCALARS)

_DTYPES = ("f4", "f2", "i8", "i1", "u1", "u8", "c16", "O", "U8", "S8", "?", "M8[s]", ">f8", "g", "V8")
_NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e160, 1e-320, -1.0, 0.0, 2.0**53, 1e18, 0.5)


def _cast(array: Any, dtype: str) -> Any:
    with np.errstate(all="ignore"):
        return array.astype(dtype)


def _with_entry(array: Any, at: int, number: float) -> Any:
    changed = np.array(array, dtype=np.float64)
    if changed.size:
        changed.ravel()[at % changed.size] = number
    return changed


def _read_only(array: Any) -> Any:
    changed = array.copy()
    changed.flags.writeable = False
    return changed


def _shifted(array: Any) -> Any:
    """The same values, not aligned to their size."""
    raw = np.zeros(array.nbytes + 1, np.uint8)[1:].view(array.dtype).reshape(array.shape)
    raw[...] = array
    return raw


_SHAPES: tuple[Callable[[Any], Any], ...] = (
    lambda a: a[::-1],
    lambda a: a[::-1].copy()[::-1],
    lambda a: a[1:],
    lambda a: a[:0],
    lambda a: np.concatenate([a, a]),
    lambda a: a.T,
    lambda a: np.asfortranarray(a),
    lambda a: a[..., None],
    lambda a: a[None],
    lambda a: a.ravel(),
    lambda a: a[0],
    lambda a: a.tolist(),
    lambda a: tuple(map(tuple, np.atleast_2d(a).tolist())),
    lambda a: np.ma.masked_invalid(a),
    lambda a: np.ma.masked_less(a, 0.1),
    lambda a: np.ma.masked_all_like(a),
    lambda a: np.asmatrix(np.atleast_2d(a) if a.ndim < 3 else a[0]),
    lambda a: [*a.tolist(), "x"],
    lambda a: [*a.tolist(), [1.0]],
    lambda a: np.broadcast_to(a, (2, *a.shape)),
    lambda a: np.stack([a, a], axis=-1)[..., 0],
    lambda a: a * 1e200,
    lambda a: a * 1e-200,
    lambda a: -a,
    lambda a: a + 1e12,
    lambda a: np.zeros_like(a),
    lambda a: memoryview(np.ascontiguousarray(a)),
    lambda a: iter(a),
    lambda a: {"array": a},
    _read_only,
    _shifted,
)


def _reshaped(array: Any, change: Callable[[Any], Any]) -> Any:
    try:
        return change(np.asarray(array, dtype=np.float64) if np.asarray(array).dtype == bool else np.asarray(array))
    except (IndexError, ValueError, TypeError):
        return array


def array_like(valid: Any) -> st.SearchStrategy[Any]:
    """What a careless user might hand in where an array like ``valid`` is meant."""
    array = np.asarray(valid)
    if array.dtype.kind not in "biuf":
        return scalars
    return st.one_of(
        st.builds(_with_entry, st.just(array), _WHERE, st.sampled_from(_NUMBERS)),
        st.sampled_from(_SHAPES).map(lambda change: _reshaped(array, change)),
        st.sampled_from(_DTYPES).map(lambda dtype: _cast_or_not(array, dtype)),
        scalars,
    )


def _cast_or_not(array: Any, dtype: str) -> Any:
    try:
        return _cast(array, dtype)
    except (TypeError, ValueError):
        return array.tolist()
