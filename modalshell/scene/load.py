"""Scenes from TOML files."""

from __future__ import annotations

import copyreg
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec

from modalshell.core.checks import checked_folder
from modalshell.core.errors import SceneError
from modalshell.core.registry import load_features, load_plugins
from modalshell.core.units import SI, UnitSystem
from modalshell.scene import tables
from modalshell.scene.index_files import with_index_files
from modalshell.scene.kinds import KINDS
from modalshell.scene.models import model_tables
from modalshell.scene.parts import SHAPES, Shape
from modalshell.scene.read import checked_name, checked_table, chosen, listed_tables, read_toml, refuse_unknown_keys
from modalshell.scene.rest import CreaseTable, RestTable
from modalshell.scene.scene import Scene, ShellScene
from modalshell.scene.sheets import SHEET_TABLES
from modalshell.scene.signatures import energies_table, loads_table, support_tables

_REQUIRED = ("mesh", "material", "model")
_LISTS = ("supports", "constraints", "contacts", "creases")
"""Tables of which there may be several."""
_MOVED = {"times", "translations", "rotations", "pivot"}
"""Keys of the path along which supports move."""


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene file.

    Parameters
    ----------
    path : path
        A TOML file with the tables of :mod:`modalshell.scene.tables`.

    Returns
    -------
    Scene
        A scene of one shell, or of another kind, as a flock is.

    Raises
    ------
    SceneError
        For a file that cannot be read, unknown keys, wrong types and values out of range: names the file and the
        key's path, the value and what is allowed. What depends on the mesh, and options of models, are checked by
        :meth:`ShellScene.build`.
    """
    file = checked_folder("path", path)
    return parse_scene(file, read_toml(file))


def parse_scene(file: Path, raw: dict[str, Any]) -> Scene:
    """The scene of plain tables as :func:`~modalshell.scene.read.read_toml` returns them; ``file`` is named in errors.

    SceneError as :func:`load_scene`.
    """
    load_features()
    load_plugins()
    raw = with_index_files(file, raw)
    single = single_tables()
    if "axes" in raw:
        raise SceneError(f"{file}: axes: a sweep is not a scene: `modalshell sweep` and `report` take sweeps")
    refuse_unknown_keys(file, "", raw, ("name", "bar", *_REQUIRED, *_LISTS, *single))
    for name in _REQUIRED:
        if name not in raw:
            raise SceneError(f"{file}: {name}: missing; every scene needs the tables {', '.join(_REQUIRED)}")
    name = checked_name(file, raw)
    optional: dict[str, Any] = {
        key: checked_table(file, key, raw[key], kind) for key, kind in single.items() if key in raw and key != "loads"
    }
    system = optional["units"].system if "units" in optional else SI
    if "loads" in raw:
        optional["loads"] = checked_table(file, "loads", _with_defaults(raw["loads"], system), single["loads"])
    if "supports" in raw:
        optional["supports"] = _supports_table(file, raw["supports"])
    motion = optional.get("motion")
    if motion is not None and motion.duration < motion.dt:
        least = f"{motion.dt:g} {system.time}"
        raise SceneError(f"{file}: motion.duration: must be at least one step of {least} (got {motion.duration:g})")
    followed = optional.get("path")
    if followed is not None and (followed.watch is None) != (followed.direction is None):
        given, lacking = ("watch", "direction") if followed.direction is None else ("direction", "watch")
        raise SceneError(
            f"{file}: path.{lacking}: is missing (got {given} alone): give vertices to watch and a direction"
        )
    model, sheet = chosen(file, "model", raw["model"], "name", model_tables()), raw["material"]
    declared: dict[str, Any] = optional | {
        "name": name,
        "file": file,
        "mesh": _mesh_table(file, raw["mesh"]),
        "material": checked_table(file, "material", sheet, _material_kind(file, sheet)),
        "model": checked_table(file, "model", raw["model"], model),
    }
    declared["constraints"] = listed_tables(file, "constraints", raw.get("constraints", []), tables.Constrained)
    declared["creases"] = listed_tables(file, "creases", raw.get("creases", []), CreaseTable)
    if "contacts" in raw:
        from modalshell.scene.contacts import collider_tables  # not without contacts

        declared["contacts"] = listed_tables(file, "contacts", raw["contacts"], collider_tables())
    own = next((kind for key, kind in KINDS.items() if key in declared), None)
    if _wants_bar(file, raw):
        if own is not None:
            raise SceneError(f"{file}: bar: only scenes of one shell have error bars; leave it out")
        declared["bar"] = True
    return ShellScene(**declared) if own is None else own.builder(declared)


def _with_defaults(loads: Any, system: UnitSystem) -> Any:
    """The table with those numbers that are left out and have a default in SI, in a scene's own units."""
    if system == SI or not isinstance(loads, dict):
        return loads
    known: dict[str, dict[str, Any]] = {
        "wind": {"density": system.air},
        "weight": {"gravity": [0.0, 0.0, -system.earth]},
    }
    filled = {
        kind: [own | one if isinstance(one, dict) else one for one in loads[kind]]
        for kind, own in known.items()
        if isinstance(loads.get(kind), list)
    }
    return loads | filled


def _wants_bar(file: Path, raw: dict[str, Any]) -> bool:
    given = raw.get("bar", False)
    if not isinstance(given, bool):
        raise SceneError(f"{file}: bar: must be true or false (got {given!r:.60})")
    return given


def single_tables() -> dict[str, type[tables.Table]]:
    """The tables of which a scene may have one, by their names."""
    return {
        "energies": energies_table(),
        "loads": loads_table(),
        "rest": RestTable,
        "motion": tables.MotionTable,
        "path": tables.PathTable,
        "output": tables.Output,
        "units": tables.Units,
        **{key: kind.table for key, kind in KINDS.items()},
    }


def pickled_scene(scene: Scene) -> tuple[Any, ...]:
    """What a scene is pickled as: its tables as plain dicts and lists, whose types are made as the scene is read."""
    raw = {field.name: getattr(scene, field.name) for field in fields(scene) if field.name != "file"}
    plain = {name: msgspec.to_builtins(value) for name, value in raw.items() if value is not None}
    for key in ("constraints", "contacts", "creases"):
        if key in plain:
            plain[key] = list(plain[key])
    if not plain.get("contacts"):
        plain.pop("contacts", None)
    if isinstance(scene.supports, tables.SupportList):
        plain["supports"] = plain["supports"]["entries"]
    return parse_scene, (scene.file, plain)


copyreg.pickle(ShellScene, pickled_scene)


def _material_kind(file: Path, raw: Any) -> type[tables.Table]:
    """The kind of table that a material is, by its key ``kind`` or, without it, by its other keys."""
    if not isinstance(raw, dict):
        return tables.Stiffnesses
    if "kind" in raw:
        if raw["kind"] == "isotropic":
            raise SceneError(
                f"{file}: material.kind: an isotropic sheet has no kind: leave it out, and give young, poisson, "
                f"thickness, density (other sheets have one: {', '.join(SHEET_TABLES)})"
            )
        return chosen(file, "material", raw, "kind", SHEET_TABLES)
    return tables.Stiffnesses if {"young", "poisson", "thickness"}.isdisjoint(raw) else tables.PhysicalSheet


def _mesh_table(file: Path, raw: Any) -> tables.MeshFile | Shape:
    if isinstance(raw, dict) and ("file" in raw) == ("shape" in raw):
        raise SceneError(f"{file}: mesh: must have either file or shape ({', '.join(SHAPES)}), and not both")
    if isinstance(raw, dict) and "file" in raw:
        return checked_table(file, "mesh", raw, tables.MeshFile)
    return checked_table(file, "mesh", raw, chosen(file, "mesh", raw, "shape", SHAPES))


def _supports_table(file: Path, raw: Any) -> tables.Supports | tables.SupportList:
    if not isinstance(raw, list):
        if isinstance(raw, dict) and "kind" in raw:
            raise SceneError(f"{file}: supports.kind: supports of a kind are a list of tables, [[supports]]")
        return checked_table(file, "supports", raw, tables.Supports)
    for index, entry in enumerate(raw):
        if isinstance(entry, dict) and entry.get("kind") != "path" and (moved := entry.keys() & _MOVED):
            raise SceneError(
                f"{file}: supports[{index}].{min(moved)}: supports move together, along one [[supports]] of kind = "
                '"path"; single vertices are led by [[constraints]]'
            )
    entries = listed_tables(file, "supports", raw, support_tables())
    paths = [index for index, entry in enumerate(entries) if isinstance(entry, tables.Path)]
    if len(paths) > 1:
        raise SceneError(f"{file}: supports[{paths[1]}]: supports move along one path (got another at {paths[0]})")
    return tables.SupportList(entries=list(entries))
