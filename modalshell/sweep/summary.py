"""Summary of a sweep: one row per case, in the order of the grid."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from modalshell.core.errors import ModalShellError, OptionError
from modalshell.core.units import UnitSystem
from modalshell.files.atomic_io import replacing, write_text
from modalshell.shell.measure import displacement_error
from modalshell.sweep.case import CaseResult, Measures
from modalshell.sweep.plan import Plan

SummaryRow = dict[str, Any]

_LOADS = ("weight", "frame", "pressure", "wind", "point", "follower", "forces", "moment", "line")
_UNITS = {
    "displacement": "m",
    "peak_displacement": "m",
    "kinetic_energy": "J",
    "elastic_energy": "J",
    "load_potential": "J",
    **{f"mesh.{name}": "m" for name in ("length", "width", "radius", "wing", "body", "join")},
    **{f"mesh.{name}": "deg" for name in ("fold", "angle", "curl", "opening", "dihedral")},
    **{f"material.{name}": "Pa" for name in ("young", "plies.young", "plies.shear")},
    **{f"material.{name}": "m" for name in ("thickness", "plies.thickness")},
    "material.plies.density": "kg/m^3",
    "material.plies.angle": "deg",
    "material.stretch": "N/m",
    **{f"material.{name}": "N m" for name in ("flexure", "bending")},
    "rest.rest_curvature": "1/m",
    **{f"rest.{name}": "K" for name in ("change", "through")},
    "rest.expansion": "1/K",
    **{f"loads.{name}": "m/s^2" for name in ("gravity", "weight.gravity", "frame.acceleration")},
    "loads.frame.angular_velocity": "1/s",
    "loads.frame.angular_acceleration": "1/s^2",
    "loads.frame.origin": "m",
    "loads.pressure.p": "Pa",
    "loads.wind.velocity": "m/s",
    "loads.wind.density": "kg/m^3",
    **{f"loads.{name}": "N" for name in ("point.force", "follower.force", "forces.total", "moment.m")},
    "loads.line.force": "N/m",
    **{f"contacts.{name}": "m" for name in ("offset", "radius", "center", "half", "rounding", "a", "b", "gap")},
    **{f"contacts.{name}": "m" for name in ("spacing", "origin", "path.translations", "path.pivot")},
    "contacts.push_out": "m/s",
    **{f"creases.{name}": "N" for name in ("yield_moment", "hardening")},
    "constraints.nearest": "m",
    "supports.translations": "m",
    "supports.pivot": "m",
    **{f"{name}.times": "s" for name in ("supports", "contacts.path", "constraints")},
    **{f"loads.{kind}.times": "s" for kind in _LOADS},
    "motion.duration": "s",
    "motion.dt": "s",
}
"""Units of measures and of axes, indices of lists left out; the rest are plain numbers or texts."""

MEASURES = Measures.__struct_fields__
"""Columns of every summary; "error" is added if there is a reference."""


def summary_rows(plan: Plan, keys: Sequence[str], results: Mapping[str, CaseResult]) -> list[SummaryRow]:
    """One row per case: its number from 1, the values of its axes, outcome, message, measures, error, digest.

    The error is the relative displacement error of the last frame against the truth's, vertices weighted by their
    mass; None where one of both has no positions or the truth does not move. The truth's outcome and message follow.
    """
    rows = []
    for number, case in enumerate(plan.cases, start=1):
        result = results[case.digest]
        measures = dict.fromkeys(MEASURES) if result.measures is None else msgspec.structs.asdict(result.measures)
        row = {"case": number, **{key: _plain(value) for key, value in zip(keys, case.values, strict=True)}}
        row |= {"outcome": str(result.outcome), "message": result.message} | measures
        if case.truth is not None:
            truth = results[case.truth]
            row |= {"error": _error(result, truth, case.mesh)}
            row |= {"truth_outcome": str(truth.outcome), "truth_message": truth.message}
        rows.append(row | {"digest": case.digest})
    return rows


def run_rows(plan: Plan, results: Mapping[str, CaseResult]) -> list[SummaryRow]:
    """What differs from run to run, for each computed case, truths too: seconds, machine, versions, warnings."""
    rows = []
    for digest in plan.tasks:
        info = results[digest].info
        rows.append({"digest": digest} | msgspec.structs.asdict(info) | {"warnings": " | ".join(info.warnings)})
    return rows


def unit_rows(rows: Sequence[SummaryRow], scenes: Iterable[Mapping[str, Any]]) -> list[SummaryRow]:
    """The unit of each column of the summary of the cases of ``scenes``; "1" for plain numbers and texts.

    "m or mm" where an axis changes the units, or the kind of material and with it what a number of it is.
    """
    kinds = dict.fromkeys(
        (UnitSystem(**scene.get("units", {})), "stretch" in scene["material"], "flexure" in scene["material"])
        for scene in scenes
    )
    columns = {key: re.sub(r"\.\d+(?=\.|$)", "", key) for key in rows[0]}
    units: dict[str, list[str]] = {key: [] for key in columns}
    for system, sheet, springs in kinds:
        known = _UNITS | {
            "material.density": "kg/m^2" if sheet else "kg/m^3",
            "material.shear": "N" if springs else "Pa",
        }
        for key, unit in system.labels({key: known.get(name, "") for key, name in columns.items()}).items():
            units[key].append(unit)
    return [{"column": key, "unit": " or ".join(dict.fromkeys(found))} for key, found in units.items()]


def _error(result: CaseResult, truth: CaseResult, mesh: Any) -> float | None:
    if result.measures is None or truth.measures is None:
        return None
    try:
        return displacement_error(result.final_positions(), truth.final_positions(), mesh)
    except ModalShellError:
        return None


def _plain(value: Any) -> Any:
    """A table or list as compact JSON: one cell."""
    return json.dumps(value, separators=(",", ":")) if isinstance(value, dict | list) else value


def write_csv(path: Path, rows: Sequence[SummaryRow]) -> Path:
    """Rows as CSV: floats with all digits, empty cells for None."""
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


def write_parquet(path: Path, rows: Sequence[SummaryRow]) -> Path:
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
