"""The summary of a sweep: a row for each case, in the order of the grid."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from modalshell.atomic_io import replacing, write_text
from modalshell.errors import ModalShellError, OptionError
from modalshell.measure import displacement_error
from modalshell.sweep.case import Measures, Outcome
from modalshell.sweep.plan import Plan

Row = dict[str, Any]

MEASURES = Measures.__struct_fields__
"""Columns of every summary; with a truth comes "error"."""


def summary_rows(plan: Plan, keys: Sequence[str], found: Mapping[str, Outcome]) -> list[Row]:
    """What each case found: its number from 1, the values of its axes, outcome, status, measures, error, digest.

    The error is the relative displacement error of the last frame against the truth's, vertices weighted by their
    mass; None, with the truth's status beside it, where one of both has no positions or the truth does not move.
    """
    rows = []
    for number, case in enumerate(plan.cases, start=1):
        outcome = found[case.digest]
        measures = dict.fromkeys(MEASURES) if outcome.measures is None else msgspec.structs.asdict(outcome.measures)
        row = {"case": number, **{key: _plain(value) for key, value in zip(keys, case.values, strict=True)}}
        row |= {"outcome": outcome.outcome, "status": outcome.status} | measures
        if case.truth is not None:
            truth = found[case.truth]
            row |= {"error": _error(outcome, truth, case.mesh), "truth_status": truth.status}
        rows.append(row | {"digest": case.digest})
    return rows


def run_rows(plan: Plan, found: Mapping[str, Outcome]) -> list[Row]:
    """What differs from run to run, for each computed case, truths too: seconds, machine, versions, warnings."""
    rows = []
    for digest in plan.tasks:
        made = msgspec.structs.asdict(found[digest].made)
        rows.append({"digest": digest} | made | {"warnings": " | ".join(found[digest].made.warnings)})
    return rows


def _error(outcome: Outcome, truth: Outcome, mesh: Any) -> float | None:
    if outcome.measures is None or truth.measures is None:
        return None
    try:
        return displacement_error(outcome.final_positions(), truth.final_positions(), mesh)
    except ModalShellError:
        return None


def _plain(value: Any) -> Any:
    """A table or list as compact JSON: one cell."""
    return json.dumps(value, separators=(",", ":")) if isinstance(value, dict | list) else value


def write_csv(path: Path, rows: Sequence[Row]) -> Path:
    """Rows as CSV: floats in full, nothing for None."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: str(cell).lower() if isinstance(cell, bool) else cell for key, cell in row.items()})
    return write_text(path, text.getvalue())


def refuse_parquet_without_pyarrow() -> None:
    """OptionError before any work, if Parquet cannot be written here."""
    if importlib.util.find_spec("pyarrow") is None:
        raise OptionError("Parquet needs pyarrow: pip install 'modalshell[parquet]', or leave it out of output.formats")


def write_parquet(path: Path, rows: Sequence[Row]) -> Path:
    """Rows as Parquet, columns typed; an axis that mixes types is written as JSON."""
    import pyarrow
    import pyarrow.parquet

    columns = {key: [row[key] for row in rows] for key in rows[0]}
    for key, cells in columns.items():
        kinds = {type(cell) for cell in cells if cell is not None}
        if len(kinds) > 1 and kinds != {int, float}:
            columns[key] = [json.dumps(cell) for cell in cells]
        elif kinds == {int, float}:
            columns[key] = [None if cell is None else float(cell) for cell in cells]
    with replacing(path) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns), temporary)
    return path
