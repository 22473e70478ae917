"""Checks of what a user hands in: one place that says what was got and what is allowed."""

from __future__ import annotations

from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.errors import LoadError, ModalShellError, OptionError


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
    good = isinstance(value, Real) and not isinstance(value, bool) and np.isfinite(float(value))
    if not (good and float(value) > above and at_least <= float(value) <= at_most):
        bounds = [f"above {above:g}"] if above > -np.inf else []
        bounds += [f"at least {at_least:g}"] if at_least > -np.inf else []
        bounds += [f"at most {at_most:g}"] if at_most < np.inf else []
        allowed = " and ".join(bounds)
        text = " ".join(part for part in ("a finite number", allowed, f"[{unit}]" if unit else "") if part)
        raise error(f"{name} must be {text} (got {value!r})")
    return float(value)


def checked_count(name: str, value: Any) -> int:
    """Return ``value`` as an int if it is a positive integer, else raise OptionError."""
    if not isinstance(value, Integral) or isinstance(value, bool) or int(value) < 1:
        raise OptionError(f"{name} must be a positive integer (got {value!r})")
    return int(value)


def checked_vectors(
    name: str, values: Any, shape: tuple[int, ...], error: type[ModalShellError] = LoadError
) -> NDArray[np.float64]:
    """Return ``values`` as a contiguous float64 array of one vector a vertex, else raise ``error``."""
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as fault:
        raise error(f"{name} must be numbers of shape {shape} (got {type(values).__name__}: {fault})") from fault
    if array.shape != shape:
        raise error(f"{name} must have shape {shape} (got {array.shape})")
    finite = np.isfinite(array)
    if not finite.all():
        bad = int(np.flatnonzero(~finite.reshape(len(array), -1).all(axis=1))[0])
        raise error(f"{name} must be finite (got {array[bad]} at entry {bad}, counted from 0)")
    return array
