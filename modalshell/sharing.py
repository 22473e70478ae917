"""Objects that threads may share and that may be copied and pickled: read-only arrays, working state per thread."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar, final

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")
_Scalar = TypeVar("_Scalar", bound=np.generic)


def read_only(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """``array`` itself, writeable no more: for arrays that the caller owns."""
    array.flags.writeable = False
    return array


def read_only_copy(array: NDArray[_Scalar]) -> NDArray[_Scalar]:
    """``array`` itself if nobody can write to it, else a copy of it that nobody can write to."""
    return array if not array.flags.writeable and array.flags.owndata else read_only(array.copy())


class ReadOnlyArrays:
    """Base of classes whose arrays are read-only: a copy or a pickle of NumPy's forgets that."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        for value in state.values():
            for array in value if isinstance(value, tuple) else (value,):
                if isinstance(array, np.ndarray):
                    read_only(array)
        self.__dict__.update(state)


@final
class PerThread(Generic[T]):
    """One value for every thread that asks, made when it first does; copies and pickles start without any.

    Parameters
    ----------
    make : callable
        Makes a value; can be pickled.
    """

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
