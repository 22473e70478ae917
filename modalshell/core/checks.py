"""Validation of user input: each check states the value it got and the values that are allowed."""

from __future__ import annotations

import os
import re
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from modalshell.core.errors import LoadError, ModalShellError, OptionError, SolverError
from modalshell.core.thread_safety import read_only
from modalshell.core.typing import Progress, unheard

T = TypeVar("T")

LARGEST = 1e50
"""Numbers above this overflow when raised to powers in the energies; numbers below its inverse underflow."""
_APART = 1e-15
"""Shortest time [s] between keyframes; splines divide by its third power."""
_STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Control characters, and those that turn the direction of writing."""
_SHOWN = 80
"""Characters of a refused value shown in a message."""
_PLAIN = (str, bytes, int, float, complex, list, tuple, dict, type(None), np.ndarray, np.generic)


def shortened(text: str, most: int = 300) -> str:
    """``text`` on one line of at most ``most`` characters."""
    line = " ".join(text.split())
    return line if len(line) <= most else line[: most - 3] + "..."


def printable(text: str) -> str:
    """``text`` for a terminal: characters that steer it as escapes; line ends and tabs stay."""
    return _STEERING.sub(lambda match: ascii(match[0])[1:-1], text)


def shown(value: Any) -> str:
    """A value for a message: its ``repr`` on one line, shortened, or its type if it has no plain ``repr``."""
    if not isinstance(value, _PLAIN):
        return f"an object of type {type(value).__name__}"
    if isinstance(value, np.ndarray) and value.ndim and value.size <= _SHOWN and (value.size or value.ndim == 1):
        value = value.tolist()
    elif isinstance(value, np.generic) and value.dtype.kind in "iufc":  # of others the type may be what is wrong
        value = value.item()
    try:
        text = shortened(repr(value), _SHOWN)
    except ValueError:  # Python writes out no integer of thousands of digits
        text = f"{type(value).__name__} with too many digits"
    if " at 0x" in text:
        return f"a {type(value).__name__} of objects"
    return text


def checked_number(
    name: str,
    value: Any,
    error: type[ModalShellError] = OptionError,
    *,
    above: float = -np.inf,
    at_least: float = -np.inf,
    at_most: float = np.inf,
    unit: str = "",
) -> float:
    """Return ``value`` as a float if it is a finite real number within its bounds, else raise ``error``."""
    number = np.nan
    if isinstance(value, Real) and not isinstance(value, bool | np.timedelta64):
        try:
            number = float(value)
        except OverflowError:
            number = np.inf
    if not (np.isfinite(number) and number > above and at_least <= number <= at_most):
        bounds = [f"above {above:g}"] if above > -np.inf else []
        bounds += [f"at least {at_least:g}"] if at_least > -np.inf else []
        bounds += [f"at most {at_most:g}"] if at_most < np.inf else []
        allowed = " and ".join(bounds)
        text = " ".join(part for part in ("a finite number", allowed, f"[{unit}]" if unit else "") if part)
        raise error(f"{name} must be {text} (got {shown(value)})")
    if abs(number) > LARGEST or (above == 0.0 and number < 1.0 / LARGEST):
        raise error(
            f"{name} must be between {1.0 / LARGEST:g} and {LARGEST:g} in size, where its powers neither overflow nor "
            f"underflow (got {number:g})"
        )
    return number


def checked_count(name: str, value: Any, *, at_least: int = 1, at_most: int = 2**31 - 1) -> int:
    """Return ``value`` as an int if it is an integer within its bounds, else raise OptionError."""
    whole = isinstance(value, Integral) and not isinstance(value, bool | np.timedelta64)
    if not whole or int(value) < at_least:
        allowed = "a positive integer" if at_least == 1 else f"an integer of at least {at_least}"
        raise OptionError(f"{name} must be {allowed} (got {shown(value)})")
    if int(value) > at_most:
        raise OptionError(f"{name} must be at most {at_most} (got {shown(value)})")
    return int(value)


def checked_choice(name: str, value: Any, choices: tuple[str, ...]) -> str:
    """Return ``value`` if it is one of the words ``choices``, else raise OptionError."""
    if not isinstance(value, str) or value not in choices:
        raise OptionError(f"{name} must be one of {', '.join(map(repr, choices))} (got {shown(value)})")
    return value


def checked_switch(name: str, value: Any) -> bool:
    """Return ``value`` as a bool if it is True or False, else raise OptionError."""
    if not isinstance(value, bool | np.bool_):
        raise OptionError(f"{name} must be True or False (got {shown(value)})")
    return bool(value)


def checked_kind(name: str, value: Any, kind: type[T], advice: str = "") -> T:
    """Return ``value`` if it is an instance of ``kind``, else raise OptionError, with ``advice`` on how to make one."""
    if not isinstance(value, kind):
        raise OptionError(f"{name} must be a {kind.__name__} (got {shown(value)})" + (advice and f": {advice}"))
    return value


def checked_callback(name: str, value: Progress | None) -> Progress:
    """Return ``value`` if it is a function, one that nobody hears for None, else raise OptionError."""
    if value is None:
        return unheard
    if not callable(value):
        raise OptionError(f"{name} must be a function, called with what is done and the total (got {shown(value)})")
    return value


def checked_precision(dtype: DTypeLike) -> np.dtype[Any]:
    """Return float64 or float32 as a dtype, else raise OptionError."""
    try:
        precision = np.dtype(dtype)
    except (TypeError, ValueError):
        precision = np.dtype(bool)
    if precision not in (np.dtype(np.float64), np.dtype(np.float32)):
        raise OptionError(f"dtype must be float64 or float32 (got {shown(dtype)})")
    return precision


def checked_output(out: Any, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return ``out`` if it is a writable C-ordered array to write into, a new one for None, else raise OptionError."""
    if out is None:
        return np.empty(shape, dtype)
    like = isinstance(out, np.ndarray) and (out.shape, out.dtype) == (shape, dtype)
    if not (like and out.flags.c_contiguous and out.flags.writeable):
        got = f"{out.dtype} {out.shape}" if isinstance(out, np.ndarray) else type(out).__name__
        raise OptionError(f"out must be a writable C-ordered {dtype} array of shape {shape} (got {got})")
    return out


def as_array(name: str, values: Any, expected: str, error: type[ModalShellError], kinds: str = "iuf") -> NDArray[Any]:
    """``values`` as an array of real numbers (or other NumPy ``kinds`` of data), as they are; else ``error``.

    Text, dates, complex numbers and masked arrays are refused: NumPy would convert them with loss or drop the mask.
    """
    if np.ma.is_masked(values):
        raise error(f"{name} must be {expected} (got an array with masked entries: fill or drop them)")
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as fault:
        raise error(f"{name} must be {expected} (got {shown(values)}: rows of unequal length?)") from fault
    if array.size and array.dtype.kind not in kinds:
        raise error(f"{name} must be {expected} (got dtype {array.dtype}: {shown(values)})")
    return array


def checked_vectors(
    name: str, values: Any, shape: tuple[int, ...], error: type[ModalShellError] = LoadError
) -> NDArray[np.float64]:
    """Return ``values`` as a contiguous float64 array of one vector per vertex, else raise ``error``."""
    given = as_array(name, values, f"numbers of shape {shape}", error)
    if given.shape != shape:
        raise error(f"{name} must have shape {shape} (got {given.shape})")
    array = np.ascontiguousarray(given, dtype=np.float64)
    sound = np.abs(array) <= LARGEST  # false for NaN
    if not sound.all():
        bad = int(np.flatnonzero(~sound.reshape(len(array), -1).all(axis=1))[0])
        allowed = "finite" if not np.isfinite(array[bad]).all() else f"at most {LARGEST:g} in size"
        raise error(f"{name} must be {allowed} (got {array[bad]} at entry {bad}, counted from 0)")
    return array


def unit_vector(name: str, value: Any, error: type[ModalShellError]) -> NDArray[np.float64]:
    """Return ``value`` (3,) over its length, read-only, else raise ``error``; a direction along an axis is exact."""
    vector = checked_vectors(name, value, (3,), error)
    length = float(np.linalg.norm(vector))
    if length == 0.0:
        raise error(f"{name} must not be zero (got {vector.tolist()})")
    return read_only(vector / length)


def checked_times(times: Any) -> NDArray[np.float64]:
    """Return times of keyframes (k,) [s], at least two, each later than the one before, else raise OptionError."""
    moments = checked_vectors("times", times, (vector_count(times),), OptionError)
    if moments.size < 2 or (np.diff(moments) < _APART).any():
        raise OptionError(f"times must increase, by at least {_APART:g} s, and be at least two (got {shown(times)})")
    return moments


def checked_each(name: str, values: Any, count: int, error: type[ModalShellError]) -> NDArray[np.float64]:
    """Return ``count`` finite numbers from a list of that length or from one number, else raise ``error``."""
    given = as_array(name, values, f"one number or {count}", error)
    if given.shape not in ((), (count,)):
        raise error(f"{name} must be one number or {count} (got shape {given.shape})")
    return checked_vectors(name, np.array(np.broadcast_to(given, (count,))), (count,), error)


def checked_folder(name: str, value: Any) -> Path:
    """Return ``value`` as a path, else raise OptionError."""
    if not isinstance(value, str | os.PathLike):
        raise OptionError(f"{name} must be a path (got {shown(value)})")
    return Path(value)


def vector_count(values: Any) -> int:
    """Length of a list of vectors that is yet to be checked; 1 if it has no length."""
    try:
        return len(values)
    except TypeError:
        return 1


def finite_answer(name: str, *answers: Any) -> None:
    """Raise SolverError if a result is not finite, which extreme but allowed input may cause."""
    if not all(np.isfinite(answer).all() for answer in answers):
        raise SolverError(
            f"{name} left the finite numbers (got NaN or infinity): sizes, stiffnesses or loads are too many decades "
            "apart"
        )
