"""Every table and key of a scene file, as text, from the types that read them."""

from __future__ import annotations

import difflib
import inspect
import json
import re
from collections.abc import Callable, Mapping
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import msgspec

from modalshell.core.errors import OptionError
from modalshell.core.registry import load_features, load_plugins
from modalshell.scene import tables
from modalshell.scene.kinds import KINDS
from modalshell.scene.models import model_tables
from modalshell.scene.parts import SHAPES
from modalshell.scene.rest import CreaseTable, RestTable
from modalshell.scene.sheets import SHEET_TABLES
from modalshell.scene.signatures import LoadTable, energies_table, loads_table, support_tables
from modalshell.shell import Crease

_NAMES = {float: "number", int: "whole number", str: "text", bool: "true or false", Any: "anything"}
_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


class Key(NamedTuple):
    """A key: its ``name``, what it ``takes``, its ``default``, and what it is ``about``."""

    name: str
    takes: str
    default: str
    about: str


class KeyTable(NamedTuple):
    """A table: its ``heading``, what it is ``about``, and its ``keys``."""

    heading: str
    about: str
    keys: list[Key]


_OWN = (
    Key("name", "text", "", "Name of the results' files; by default that of the scene's file."),
    Key("bar", "true or false", "false", "Whether the equilibrium, or some frames of a motion, get error bars."),
)


def scene_keys(table: str | None = None) -> list[KeyTable]:
    """The tables of a scene file, or those of one name such as ``contacts``; OptionError for another name."""
    load_features()
    load_plugins()
    made = _tables()
    if table is not None and table not in made:
        known = ", ".join(name for name in made if name != "scene")
        near = difflib.get_close_matches(table, made, 1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise OptionError(f"a scene has the tables {known}, and 'scene' before them (got {table!r:.60}){hint}")
    return [one for name in (made if table is None else [table]) for one in made[name]()]


def _tables() -> dict[str, Callable[[], list[KeyTable]]]:
    """What lists the tables of each name."""

    def plain(kind: type[msgspec.Struct], heading: str) -> Callable[[], list[KeyTable]]:
        return lambda: [_table(kind, heading)]

    def contacts() -> list[KeyTable]:
        from modalshell.contact import Contact  # not without contacts
        from modalshell.scene.contacts import collider_tables

        return _kinds(collider_tables(), "[[contacts]]", "kind", _documented(Contact)[1])

    def nested(kind: type[msgspec.Struct], name: str) -> Callable[[], list[KeyTable]]:
        held = {field.encode_name: _held(field.type) for field in msgspec.structs.fields(kind)}
        within = {f"[{name}.{key}]": table for key, table in held.items() if table is not None}
        return lambda: [_table(table, heading) for heading, table in {f"[{name}]": kind, **within}.items()]

    further = {key: nested(kind.table, key) for key, kind in KINDS.items()}
    none = KeyTable("[energies]", "A table for each energy that an installed package registers; none does.", [])
    sheets: list[type[tables.Table]] = [tables.Stiffnesses, tables.PhysicalSheet]
    return {
        "scene": lambda: [KeyTable("before the first table", "", list(_OWN))],
        "mesh": lambda: [_table(tables.MeshFile, "[mesh]"), *_kinds(SHAPES, "[mesh]", "shape")],
        "material": lambda: [
            *(_table(kind, "[material]") for kind in sheets),
            *_kinds(SHEET_TABLES, "[material]", "kind"),
        ],
        "supports": lambda: [
            _table(tables.Supports, "[supports]"),
            *_kinds(support_tables(), "[[supports]]", "kind"),
        ],
        "loads": lambda: _with_lists(loads_table(), "loads", LoadTable.__doc__ or ""),
        "energies": lambda: _with_lists(energies_table(), "energies") or [none],
        "constraints": plain(tables.Constrained, "[[constraints]]"),
        "contacts": contacts,
        "creases": lambda: [_table(CreaseTable, "[[creases]]", shared=_documented(Crease)[1])],
        "rest": plain(RestTable, "[rest]"),
        "model": lambda: _kinds(model_tables(), "[model]", "name"),
        "motion": plain(tables.MotionTable, "[motion]"),
        "path": plain(tables.PathTable, "[path]"),
        "output": plain(tables.Output, "[output]"),
        "units": plain(tables.Units, "[units]"),
        **further,
    }


def _kinds(
    kinds: Mapping[str, type[msgspec.Struct]], heading: str, chosen_by: str, shared: Mapping[str, str] | None = None
) -> list[KeyTable]:
    """A table of each kind; ``shared`` says what keys are about that all have."""
    return [_table(kind, f'{heading} with {chosen_by} = "{key}"', chosen_by, shared) for key, kind in kinds.items()]


def _with_lists(kind: type[msgspec.Struct], name: str, about: str = "") -> list[KeyTable]:
    """A table and, one after the other, those that its keys hold."""
    own, inner = [], []
    for field in msgspec.structs.fields(kind):
        held = _held(field.type)
        if held is None:
            own.append(field)
        else:
            brackets = ("[[", "]]") if get_origin(field.type) is list else ("[", "]")
            inner.append(_table(held, f"{brackets[0]}{name}.{field.encode_name}{brackets[1]}"))
    listed = [_key(field, {}) for field in own]
    return ([KeyTable(f"[{name}]", plain_text(about), listed)] if listed else []) + inner


def _table(
    kind: type[msgspec.Struct], heading: str, chosen_by: str = "", shared: Mapping[str, str] | None = None
) -> KeyTable:
    about, own = _documented(kind)
    parameters = {**(shared or {}), **own}
    fields = [field for field in msgspec.structs.fields(kind) if field.encode_name != chosen_by]
    return KeyTable(heading, about, [_key(field, parameters) for field in fields])


def _documented(kind: type) -> tuple[str, dict[str, str]]:
    """The summary of a table, and its parameters, from the docstring of what it builds."""
    whole = inspect.cleandoc(kind.__doc__ or "")
    summary, _, rest = whole.partition("Parameters\n----------\n")
    parameters: dict[str, list[str]] = {}
    names: list[str] = []
    for line in re.split(r"\n\n\w+\n-+\n", rest)[0].splitlines():
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.partition(":")[0].split(",")]
        else:
            for name in names:
                parameters.setdefault(name, []).append(line.strip())
    texts = {name: plain_text(" ".join(lines)) for name, lines in parameters.items()}
    return plain_text(summary if not rest else summary.split("\n\n")[0]), texts


def plain_text(marked: str) -> str:
    """A docstring's text on one line, without its marks."""
    named = re.sub(r":(?:meth|attr):`(\w+)`", r"\1", marked)  # of the class that it stands in
    return " ".join(re.sub(r":\w+:`~?(?:modalshell\.)?([^`]*)`", r"ms.\1", named).replace("``", "").split())


def _key(field: Any, parameters: Mapping[str, str]) -> Key:
    default = field.default
    if default is msgspec.NODEFAULT:
        shown = "" if field.default_factory is not msgspec.NODEFAULT else "required"
    else:
        shown = "" if default is None else json.dumps(msgspec.to_builtins(default))
    return Key(field.encode_name, _as_text(field.type), shown, parameters.get(field.encode_name, ""))


def _held(hint: Any) -> type[msgspec.Struct] | None:
    """The table that a key holds, or a list of."""
    for part in (hint, *get_args(hint)):
        if isinstance(part, type) and issubclass(part, msgspec.Struct):
            return part
    return None


def _as_text(hint: Any) -> str:
    """A type as text."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return " ".join([_as_text(arguments[0]), *(text for meta in arguments[1:] if (text := _bounds(meta)))])
    if origin is Literal:
        return " or ".join(repr(value) for value in arguments)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(_as_text(part) for part in arguments if part is not NoneType))
    if origin is tuple:
        return f"[{', '.join(_as_text(part) for part in arguments)}]"
    if origin is list:
        held = _as_text(arguments[0])
        return f"list of: ({held})" if " or " in held else f"list of: {held}"
    if origin is dict:
        return "table"
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return "table: " + ", ".join(field.encode_name for field in msgspec.structs.fields(hint))
    return _NAMES.get(hint, getattr(hint, "__name__", str(hint)))


def _bounds(meta: Any) -> str:
    """The bounds of a number, as text."""
    given = ((sign, getattr(meta, name, None)) for name, sign in _SIGNS.items())
    return " and ".join(f"{sign} {bound:g}" for sign, bound in given if bound is not None)
