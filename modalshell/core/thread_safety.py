"""Thread-safe objects that can be copied and pickled: read-only arrays, and working state per thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar, final

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
_Scalar = TypeVar("_Scalar", bound=np.generic)


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Make ``array`` read-only and return it: for arrays that the caller owns."""
    array.flags.writeable = False
    return array


def read_only_copy(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """Return ``array`` if it is read-only throughout, else a read-only copy."""
    return array if not array.flags.writeable and array.flags.owndata else read_only(array.copy())


def read_only_view(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """A contiguous, read-only view of ``array``, whoever owns it, or of a copy.

    Numba compiles a kernel for each kind of argument: what can be written to, and what is not contiguous, are two more.
    """
    return read_only(np.ascontiguousarray(array).view())


def writeable(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """``array`` if it can be written to, else a copy, for kernels that are compiled for such ones."""
    return array if array.flags.writeable else array.copy()


class ReadOnlyArrays:
    """Base of classes whose arrays stay read-only when copied or pickled, which NumPy does not ensure."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            for array in value if isinstance(value, tuple) else (value,):
                if isinstance(array, np.ndarray):
                    read_only(array)
        self.__dict__.update(state)


@final
class PerThread(Generic[T]):
    """One value per thread, which ``make`` makes on first use; copies and pickles start empty."""

    def __init__(self, make: Callable[[], T]) -> None:
        self._make = make
        self._local = threading.local()

    def __call__(self) -> T:
        """The calling thread's value."""
        try:
            value: T = self._local.value
        except AttributeError:
            value = self._local.value = self._make()
        return value

    def __reduce__(self) -> tuple[Any, ...]:
        return PerThread, (self._make,)
