"""Records that kernels take by their place in memory."""

import copy
import pickle
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError

from modalshell.core.thread_safety import read_only
from modalshell.kernels.by_reference import Placed, by_reference
from modalshell.kernels.compiler import UNCOUNTED, njit


class Pair(NamedTuple):
    first: Any
    second: Any


class Whole(NamedTuple):
    size: float
    grid: Any
    inner: Pair
    count: int
    cube: Any


@njit(**UNCOUNTED)
def _sum(pair):
    total = 0.0
    for k in range(pair.first.size):
        total += pair.first[k] * pair.second[k]
    return total


@njit(**UNCOUNTED)
def read(whole, out):
    """Numbers of all parts, and of a record that is made here of one that is in memory."""
    both = by_reference(Pair(whole, whole.grid))
    out[0], out[1], out[2], out[3] = whole.size, whole.count, whole.grid[1, 2], whole.cube[1, 0, 1]
    out[4], out[5], out[6] = _sum(whole.inner), both.first.cube.shape[2], _sum(both.first.inner)
    whole.grid[0, 0] = both.second[0, 1]


@njit(**UNCOUNTED)
def write(whole):
    whole.cube[0, 0, 0] = 1.0


def record(**parts):
    inner = Pair(np.arange(3.0), np.array([4, 5, 6], dtype=np.int32))
    return Whole(0.25, np.arange(6.0).reshape(2, 3), inner, 7, read_only(np.arange(8.0).reshape(2, 2, 2)))._replace(
        **parts
    )


def parts_of(placed):
    out = np.full(7, np.nan)
    read(placed, out)
    return out.tolist()


def test_kernels_read_every_part_and_write_to_its_arrays():
    given = record()
    assert parts_of(Placed(given)) == [0.25, 7.0, 5.0, 5.0, 17.0, 2.0, 17.0]
    assert given.grid[0, 0] == 1.0
    assert len(read.signatures) == 1


def test_copies_and_pickles_have_arrays_of_their_own():
    given = record()
    placed = Placed(given)
    for other in (placed.copied(), copy.deepcopy(placed), pickle.loads(pickle.dumps(placed))):
        assert other.kind == placed.kind
        assert parts_of(other) == [0.25, 7.0, 5.0, 5.0, 17.0, 2.0, 17.0]
        assert other.record.grid[0, 0] == 1.0
        assert given.grid[0, 0] == 0.0


def test_arrays_that_differ_are_taken_over():
    given = record()
    placed, other = Placed(given), Placed(given).copied()
    other.take(given._replace(inner=Pair(np.full(3, 2.0), given.inner.second)), placed)
    assert parts_of(other)[4] == 30.0
    assert parts_of(placed)[4] == 17.0
    with pytest.raises(ValueError, match="broadcast"):
        other.take(record(grid=np.zeros((3, 3))), placed)


def test_a_kernel_does_not_write_to_what_is_read_only():
    with pytest.raises(TypingError, match="readonly"):
        write(Placed(record()))


def test_records_of_one_name_are_told_apart():
    one, other = (namedtuple("Pair", names) for names in ("first second", "second first"))
    assert Placed(one(np.zeros(1), np.zeros(1))).kind != Placed(other(np.zeros(1), np.zeros(1))).kind
