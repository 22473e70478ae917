"""Machine-independent cost: counts of element evaluations, linear solves and bytes of model data read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from math import log2
from typing import final

_ELEMENT = 0.06
"""Reference time of one element's energy and derivatives, its place in a sparse matrix included [microseconds]."""
_BYTE = 4e-5
"""Reference time of a byte of model data that a matrix product or a frame reads [microseconds]: 25 GB/s."""
_PRODUCT = 1e-4
"""Reference time of a multiplication and addition in a dense matrix product [microseconds]."""
_FACTORISED = 0.07
"""Reference time of a factorisation over ``N^1.5``, N unknowns [microseconds]: nested dissection [george1973]."""
_SOLVED = 0.003
"""Reference time of a solution with a factor over ``N log2 N`` [microseconds]: the entries of such a factor."""


@final
@dataclass
class Work:
    """Counted work."""

    elements: float = 0.0
    """Evaluations of an element's energy, with or without its derivatives."""
    factorisations: float = 0.0
    solves: float = 0.0
    """Sparse factorisations, and right sides that were solved for with one, or with the dense Hessian of a reduced
    energy."""
    bytes_read: float = 0.0
    """Bytes of model data (modes, modal rotations, turns and strains of triangles, reduced energies, prolongations)
    that were read."""
    cost: float = 0.0
    """All of it in time on a reference machine [microseconds], from the constants of this module: for ranking only."""

    def per(self, count: int) -> Work:
        """The mean over ``count`` repetitions."""
        return Work(*(getattr(self, name) / count for name in self.__dataclass_fields__))


_open: ContextVar[Work | None] = ContextVar("work", default=None)


@contextmanager
def counted() -> Iterator[Work]:
    """Count the work done inside the block; an enclosing count does not include it."""
    token = _open.set(work := Work())
    try:
        yield work
    finally:
        _open.reset(token)


def count_elements(number: int) -> None:
    """Count evaluations of elements."""
    if (work := _open.get()) is not None:
        work.elements += number
        work.cost += _ELEMENT * number


def count_read(number: int) -> None:
    """Count bytes of model data that are read."""
    if (work := _open.get()) is not None:
        work.bytes_read += number
        work.cost += _BYTE * number


def count_products(number: float) -> None:
    """Count multiplications of dense matrix products, which enter only the cost."""
    if (work := _open.get()) is not None:
        work.cost += _PRODUCT * number


def count_factorisation(unknowns: int, number: int = 1, products: float | None = None) -> None:
    """Count sparse factorisations; known numbers of multiplications enter the cost."""
    if (work := _open.get()) is not None:
        work.factorisations += number
        work.cost += number * (_FACTORISED * unknowns**1.5 if products is None else _PRODUCT * products)


def count_solves(unknowns: int, right_sides: int) -> None:
    """Count solutions with a factor."""
    if (work := _open.get()) is not None:
        work.solves += right_sides
        work.cost += _SOLVED * right_sides * unknowns * log2(unknowns + 1)
