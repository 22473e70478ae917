"""Sweep files: a scene, values of some of its keys, and their grid."""

from __future__ import annotations

import copy
import itertools
import json
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from modalshell.core.checks import shortened, shown
from modalshell.core.errors import SceneError
from modalshell.core.short_repr import short_repr
from modalshell.scene.models import model_tables
from modalshell.scene.read import checked_name, checked_table, read_toml, refuse_unknown_keys
from modalshell.scene.tables import Table

_ENTRY, _DOTTED = re.compile(r"\[(\d+)\]"), r".\1"
"""An entry of a list as messages name it, contacts[0], and as a part of a dotted key."""
_KEYS = ("name", "scene", "axes", "truth", "output")
_LARGEST = 100_000
"""Cases of one sweep at most: more is a slip in an axis."""


class Range(Table, frozen=True):
    """Values of an axis: ``count`` of them ``from`` one number ``to`` another, at equal distance or equal ratio."""

    start: int | float = msgspec.field(name="from")
    stop: int | float = msgspec.field(name="to")
    count: Annotated[int, Meta(ge=1, le=_LARGEST)]
    spacing: Literal["linear", "log"] = "linear"

    def values(self) -> list[int | float]:
        """The values; integers where both ends are and all between."""
        space = np.geomspace if self.spacing == "log" else np.linspace
        values = space(float(self.start), float(self.stop), self.count)
        whole = np.round(values)
        integers = isinstance(self.start, int) and isinstance(self.stop, int)
        if integers and np.allclose(values, whole, rtol=1e-12, atol=0):
            return [int(value) for value in whole]
        return [float(value) for value in values]


class SweepOutput(Table, frozen=True):
    """``[output]``: ``folder`` (relative to the working folder), ``formats`` other than CSV, column of the picture."""

    folder: Annotated[str, Meta(min_length=1)] = "results"
    formats: tuple[Literal["png", "parquet"], ...] = ("png",)
    value: str | None = None


@dataclass(frozen=True)
class Axis:
    """A key of the scene, dotted, and its values."""

    key: str
    values: tuple[Any, ...]


@short_repr
@dataclass(frozen=True)
class Sweep:
    """What a sweep file declares."""

    name: str
    """Name of the results' files: ``name`` in the file, or the file's own."""
    file: Path
    scene_file: Path
    """Where the sweep and its scene were read from; the same for a scene written in the sweep file."""
    scene: dict[str, Any]
    """The scene's plain tables."""
    axes: tuple[Axis, ...]
    """In the file's order; the last one's values change first."""
    truth: dict[str, Any] | None
    """``[model]`` table of the model whose displacements are the reference of the error."""
    output: SweepOutput
    """Folder and formats."""

    @property
    def count(self) -> int:
        """Points of the grid."""
        return math.prod(len(axis.values) for axis in self.axes)

    def points(self) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
        """Each point of the grid: the values of its axes, and the plain tables of its scene."""
        named = any(axis.key == "model.name" for axis in self.axes)
        for values in itertools.product(*(axis.values for axis in self.axes)):
            raw = copy.deepcopy(self.scene)
            for axis, value in zip(self.axes, values, strict=True):
                self._put(raw, axis.key, copy.deepcopy(value))
            if named:
                raw["model"] = _own_options(raw["model"])
            yield values, raw

    def _put(self, raw: dict[str, Any], key: str, value: Any) -> None:
        """Set the value at a dotted key; a number in it is the index of a list's entry, from 0."""
        *tables, last = key.split(".")
        place: Any = raw
        for part in tables:
            place = place[self._index(key, part, place)] if isinstance(place, list) else place.setdefault(part, {})
            if not isinstance(place, dict | list):
                raise SceneError(f"{self.file}: axes.{key}: the scene has no table {part!r} (got {place!r:.60})")
        place[self._index(key, last, place) if isinstance(place, list) else last] = value

    def _index(self, key: str, part: str, entries: list[Any]) -> int:
        if not part.isdecimal() or len(part) > 9 or int(part) >= len(entries):
            allowed = f"a number from 0 to {len(entries) - 1}" if entries else "no entry, for the list is empty"
            raise SceneError(
                f"{self.file}: axes.{shortened(key)}: {shown(part)} must name an entry of a list, {allowed}"
            )
        return int(part)


def _own_options(model: Any) -> Any:
    """``[model]`` without the options that other models have and the one named has not."""
    if not isinstance(model, dict) or not isinstance(model.get("name"), str) or model["name"] not in model_tables():
        return model  # refused when the scene is read
    known = model_tables()
    own = known[model["name"]].__struct_fields__
    others = {option for kind in known.values() for option in kind.__struct_fields__}.difference(own)
    return {key: value for key, value in model.items() if key not in others}


def load_sweep(path: str | os.PathLike[str]) -> Sweep:
    """Read a sweep file.

    Parameters
    ----------
    path : path
        A TOML file: ``scene`` (a scene file's path, relative to the sweep file, or a scene's own tables); ``[axes]``
        with dotted keys of the scene (``contacts.0.radius`` of its first contact) and for each a list of values or
        ``{from, to, count, spacing}``; optionally ``name``, ``[truth]`` (a ``[model]`` table) and ``[output]``.

    Raises
    ------
    SceneError
        For a file that cannot be read, unknown keys, wrong types and values out of range: names the file and the
        key's path, the value and what is allowed. The scenes of the grid are checked before the first one is run.
    """
    file = Path(path)
    raw = read_toml(file)
    if "mesh" in raw and "scene" not in raw:
        raise SceneError(f"{file}: mesh: a scene is not a sweep: `modalshell run` takes scenes, and a sweep names one")
    refuse_unknown_keys(file, "", raw, _KEYS)
    for key in ("scene", "axes"):
        if key not in raw:
            raise SceneError(f"{file}: {key}: missing; a sweep needs a scene and the table [axes]")
    name = checked_name(file, raw)
    scene, scene_file = raw["scene"], file
    if isinstance(scene, str):
        scene_file = file.parent / scene
        scene = read_toml(scene_file)
    if not isinstance(scene, dict):
        raise SceneError(f"{file}: scene: must be a scene file's path or a table (got {scene!r:.60})")
    truth = raw.get("truth")
    if truth is not None and not isinstance(truth, dict):
        raise SceneError(f'{file}: truth: must be a table such as {{name = "ds"}} (got {truth!r:.60})')
    output = checked_table(file, "output", raw.get("output", {}), SweepOutput)
    sweep = Sweep(name, file, scene_file, scene, tuple(_axes(file, raw["axes"], "")), truth, output)
    _refuse_bad_axes(sweep)
    return sweep


def _axes(file: Path, tables: Any, path: str) -> Iterator[Axis]:
    """Axes of ``[axes]``; nested tables are dotted keys, as TOML reads them without quotes."""
    if not isinstance(tables, dict):
        raise SceneError(f"{file}: axes: must be a table of keys and their values (got {tables!r:.60})")
    for key, given in tables.items():
        place = f"{path}{_ENTRY.sub(_DOTTED, key)}"
        if isinstance(given, dict) and not {"from", "to", "count"}.isdisjoint(given):
            table = checked_table(file, f"axes.{place}", given, Range)
            if table.spacing == "log" and min(table.start, table.stop) <= 0:
                raise SceneError(
                    f"{file}: axes.{place}: both ends must be above 0 for logarithmic spacing "
                    f"(got {table.start:g} and {table.stop:g})"
                )
            yield Axis(place, tuple(table.values()))
        elif isinstance(given, dict) and given:
            yield from _axes(file, given, f"{place}.")
        elif isinstance(given, list) and given:
            yield Axis(place, tuple(given))
        else:
            raise SceneError(
                f"{file}: axes.{place}: must be a list of values or {{from, to, count, spacing}} (got {given!r:.60})"
            )


def _refuse_bad_axes(sweep: Sweep) -> None:
    if not sweep.axes:
        raise SceneError(f"{sweep.file}: axes: must have at least one key with its values (got none)")
    for place, axis in enumerate(sweep.axes):
        for later in sweep.axes[place + 1 :]:
            if axis.key == later.key or axis.key.startswith(f"{later.key}."):
                raise SceneError(
                    f"{sweep.file}: axes.{later.key}: undoes axes.{axis.key}: put it first, or leave one out"
                )
        seen = set[str]()
        for index, value in enumerate(axis.values):
            text = json.dumps(value, sort_keys=True, default=str)
            if text in seen:
                raise SceneError(f"{sweep.file}: axes.{axis.key}[{index}]: is there twice (got {value!r:.60})")
            seen.add(text)
    if sweep.count > _LARGEST:
        raise SceneError(f"{sweep.file}: axes: span {sweep.count} cases; at most {_LARGEST} are allowed in one sweep")
