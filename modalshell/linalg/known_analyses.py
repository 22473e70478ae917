"""Symbolic analyses of the patterns met last, shared by all that factorise them in one process.

An analysis depends on the pattern alone and takes as long as several factorisations. A shell of other constants,
another model of it and its error bar have matrices of one pattern.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sps

Analysis = TypeVar("Analysis")

_KEPT = 8
"""Analyses that are kept."""
_ENTRIES = 10_000_000
"""Entries of all their matrices, at most: an analysis takes four to thirteen bytes for each."""

_known: OrderedDict[tuple[str, bytes], tuple[int, Any]] = OrderedDict()
_lock = Lock()


def known_analysis(kind: str, matrix: sps.csc_array, make: Callable[[], Analysis]) -> Analysis:
    """The analysis of a ``kind`` of a matrix's pattern, made by ``make`` where it is not known yet; thread-safe."""
    if matrix.nnz > _ENTRIES:
        return make()
    digest = hashlib.blake2b(repr((matrix.shape, matrix.indices.dtype.str)).encode(), digest_size=16)
    for part in (matrix.indptr, matrix.indices):
        digest.update(np.ascontiguousarray(part).data)
    key = kind, digest.digest()
    with _lock:
        if key in _known:
            _known.move_to_end(key)
            made: Analysis = _known[key][1]
            return made
    made = make()
    with _lock:
        _known[key] = matrix.nnz, made
        _known.move_to_end(key)
        while len(_known) > _KEPT or sum(entries for entries, _ in _known.values()) > _ENTRIES:
            _known.popitem(last=False)
    return made


def forget_analyses() -> None:
    """Forget all that is known, as timings from the start ask for."""
    with _lock:
        _known.clear()
