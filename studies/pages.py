"""What studies share: counted cases, tables of pages, and what is committed, ``studies/NAME.md`` and ``NAME.json``."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import ROUND_CEILING, Context
from pathlib import Path
from string import Formatter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from modalshell.core.typing import Progress
from modalshell.files.atomic_io import checked_record
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult

Case = TypeVar("Case")
FOLDER = Path(__file__).resolve().parent


def counted(cases: Sequence[Case], on_step: Progress | None) -> Iterator[Case]:
    """Each of ``cases``; after each, ``on_step`` takes how many are done, and of how many."""
    for done, case in enumerate(cases, start=1):
        yield case
        if on_step is not None:
            on_step(done, len(cases))


def result_of(
    study: str,
    findings: dict[str, Any],
    arrays: dict[str, NDArray[Any]] | None = None,
    seed: int = 0,
    **chosen: Any,
) -> StudyResult:
    """A study's result; its record has the constants of its module, in lower case, and what the run has ``chosen``."""
    constants = vars(sys.modules[f"studies.{study}"]).items()
    parameters = {name.lower(): value for name, value in constants if name.isupper() and _is_data(value)}
    return StudyResult(study, findings, arrays or {}, run_record(parameters | chosen, seed))


def _is_data(value: Any) -> bool:
    """Whether a value is made of numbers, words and arrays alone."""
    if isinstance(value, dict):
        return all(isinstance(key, str | float) for key in value) and all(map(_is_data, value.values()))
    if isinstance(value, tuple | list):
        return all(map(_is_data, value))
    return isinstance(value, int | float | str | np.ndarray)


def committed(name: str) -> StudyResult:
    """The committed result of a study, without its arrays."""
    document = checked_record(FOLDER / f"{name}.json")
    return StudyResult(name, document["findings"], {}, document["record"])


class _Cells(Formatter):
    """Python's format strings, for cells of tables: see :func:`markdown`."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """One cell, or one of each number of a list."""
        if isinstance(value, list | tuple | np.ndarray):
            return " | ".join(self.format_field(one, format_spec) for one in value)
        form, given, missing = format_spec.partition("|")
        if value is None:
            return missing if given else "-"
        factor, _, form = form.rpartition("*")
        return format(float(factor) * value if factor else value, form)


def markdown(headings: str, cells: str, rows: Iterable[Mapping[str, Any]]) -> str:
    """A Markdown table of findings.

    Headings are parted by " | ", and so are the ``cells`` of a row, a format string of its findings such as
    ``"{mesh} | {errors:100*.2f} | {snap:.3g|none}"``: a number may be multiplied by a factor, a list takes a cell for
    each of its numbers, and None is a dash, or what stands after "|".
    """
    rule = "|" + "---|" * (headings.count(" | ") + 1)
    return "\n".join([f"| {headings} |", rule, *(f"| {_Cells().vformat(cells, (), row)} |" for row in rows)])


def at_most(value: float, digits: int = 2) -> str:
    """A bound as text, rounded up to some significant ``digits``; what is beyond nine of them is rounding."""
    return f"{float(Context(digits, ROUND_CEILING).create_decimal(f'{value:.9g}')):g}"


def paragraphs(*parts: str) -> str:
    """Texts and tables with an empty line between them."""
    return "\n\n".join(parts)
