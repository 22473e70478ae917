"""What is committed of a study, its page ``studies/NAME.md`` and findings ``studies/NAME.json``; tables of pages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from string import Formatter
from typing import Any

from modalshell.files.atomic_io import checked_record
from modalshell.files.study_result import StudyResult

FOLDER = Path(__file__).resolve().parent


def committed(name: str) -> StudyResult:
    """The committed result of a study, without its arrays."""
    document = checked_record(FOLDER / f"{name}.json")
    return StudyResult(name, document["findings"], {}, document["record"])


class _Cells(Formatter):
    """Python's format strings, for cells of tables: see :func:`markdown`."""

    def format_field(self, value: Any, format_spec: str) -> str:
        """One cell, or one of each number of a list."""
        if isinstance(value, list | tuple):
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
