"""Reading of scene files into typed tables; every refusal names the file and the key's path."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import msgspec

from modalshell.core.checks import shortened
from modalshell.core.errors import ModalShellError, SceneError
from modalshell.files.regular import read_text
from modalshell.mesh.files import READABLE

T = TypeVar("T", bound=msgspec.Struct)

_WORDS = {"float": "a number", "int": "an integer", "str": "a text", "bool": "true or false"}
_WORDS |= {"array": "a list", "object": "a table"}
_BOUNDS = {">": "above", ">=": "at least", "<": "below", "<=": "at most"}
_NAME = r"[^\W_][\w-]{0,99}"
_DEEPEST = 50
"""Largest nesting depth of keys in a scene file."""
_KEY = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_LONG_KEY = re.compile(rf"(?:^|[\[{{,])[ \t]*({_KEY}(?:\.[ \t]*{_KEY}){{{_DEEPEST},}}[=\]])", re.MULTILINE)
"""A key of more parts than are read, for which the parser takes a time that grows as their square."""
_PARAMETERS = {"count": "modes", "rotation_vectors": "rotations", "ratios": "modal_damping", "card": "name"}
"""Parameters that the package names otherwise than scenes do."""
_JOINED = ("and", "that", "about")
"""Second words after which the first one is no subject by itself: the message is kept whole."""


def read_toml(file: Path) -> dict[str, Any]:
    """Read the file as plain tables of finite numbers; else SceneError."""
    try:
        text = read_text(file)
        if long := _LONG_KEY.search(text):
            raise _too_deep(file, long[1])
        document = tomllib.loads(text)
    except FileNotFoundError as error:
        meant = file.with_name(f"{file.name}.toml")
        advice = f"take {meant}" if meant.is_file() else f"check the path (working folder: {Path.cwd()})"
        raise SceneError(f"{file}: no such file; {advice}") from error
    except OSError as error:
        raise SceneError(f"{file}: cannot be read ({error.strerror}); give a readable scene file") from error
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: not UTF-8 text ({error.reason} at byte {error.start}){_instead(file)}") from error
    except SceneError:
        raise
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise SceneError(f"{file}: not TOML: {error}{_instead(file)}") from error
    for path, value in _numbers(file, document):
        if not (isinstance(value, int) or math.isfinite(value)) or abs(value) > 1e300:
            raise SceneError(f"{file}: {path}: must be a finite number below 1e300 (got {value!r:.40})")
    return document


def _instead(file: Path) -> str:
    """What to do with a file of another kind that was given for a scene."""
    suffix = file.suffix.lower()
    if suffix in READABLE:
        return "; a mesh is not a scene: `modalshell simulate` takes meshes"
    if suffix in (".npz", ".clip"):
        return "; a result is not a scene: `modalshell open`, `export` and `report` take results"
    return "" if suffix == ".toml" else f"; scenes and sweeps are .toml files (got {file.name})"


def _too_deep(file: Path, path: str) -> SceneError:
    return SceneError(f"{file}: {shortened(path, 80)}: nested deeper than {_DEEPEST} levels; no scene has such keys")


def _numbers(file: Path, value: Any, path: str = "", depth: int = 0) -> Iterator[tuple[str, float]]:
    if depth > _DEEPEST:
        raise _too_deep(file, path)
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _numbers(file, inner, f"{path}.{key}" if path else key, depth + 1)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _numbers(file, inner, f"{path}[{index}]", depth + 1)
    elif isinstance(value, float | int):
        yield path, value


def checked_table(file: Path, path: str, raw: Any, kind: type[T]) -> T:
    """Convert ``raw`` to a table of ``kind``, else SceneError with the path of the offending key."""
    _refuse_unknown_keys(file, path, raw, kind)
    try:
        return msgspec.convert(raw, kind)
    except msgspec.ValidationError as error:
        raise SceneError(f"{file}: {_explained(str(error), path, raw, kind)}") from error


def _refuse_unknown_keys(file: Path, path: str, raw: Any, kind: type[msgspec.Struct]) -> None:
    if not isinstance(raw, dict):
        raise SceneError(f"{file}: {path}: must be a table{_not_listed(raw, path, kind)} (got {raw!r:.60})")
    tag = kind.__struct_config__.tag_field
    refuse_unknown_keys(file, path, raw, [*([tag] if tag else []), *kind.__struct_encode_fields__])
    for field in msgspec.structs.fields(kind):
        inner = _tables_in(field.type)
        entries = raw.get(field.name)
        if len(inner) == 1 and isinstance(entries, dict):
            _refuse_unknown_keys(file, f"{path}.{field.name}", entries, inner[0])
        if inner and isinstance(entries, list):
            for index, entry in enumerate(entries):
                _refuse_unknown_keys(file, f"{path}.{field.name}[{index}]", entry, inner[0])


def _not_listed(raw: Any, path: str, kind: type[msgspec.Struct] | None = None) -> str:
    """What to write for a list that was given in place of one table, of a ``kind``; "" of what is no list."""
    if not isinstance(raw, list):
        return ""
    fields = () if kind is None else msgspec.structs.fields(kind)
    inner = [f"[[{path}.{one.encode_name}]]" for one in fields if _tables_in(one.type)]
    return f", [{path}], and not a list of them" + (f"; its lists are {', '.join(inner)}" if inner else "")


def _tables_in(annotation: Any) -> list[type[msgspec.Struct]]:
    """The kinds of tables in a type, however deep."""
    if isinstance(annotation, type) and issubclass(annotation, msgspec.Struct):
        return [annotation]
    return [kind for part in get_args(annotation) for kind in _tables_in(part)]


def checked_name(file: Path, raw: dict[str, Any]) -> str:
    """The name of the results' files: ``name`` in the file, or the file's own."""
    name = raw.get("name", file.stem)
    if not isinstance(name, str) or not (re.fullmatch(_NAME, name) and len(name.encode()) <= 200):
        allowed = "1 to 100 letters, digits, _ and -, a letter or digit first: it names the results' files"
        own = "" if "name" in raw else ", the file's own: rename it, or begin it with a line name = ..."
        raise SceneError(f"{file}: name: must be {allowed} (got {name!r:.60}{own})")
    return name


def refuse_unknown_keys(file: Path, path: str, raw: dict[str, Any], allowed: Iterable[str]) -> None:
    """Raise SceneError for the first key that is not ``allowed``, with the most similar allowed one."""
    names = list(allowed)
    for key in raw:
        if key not in names:
            near = difflib.get_close_matches(key, names, 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            if path and key in ("bar", "bars"):
                hint = "error bars are asked for by bar = true before the first table; "
            place = shortened(f"{path}.{key}" if path else key, 80)
            raise SceneError(f"{file}: {place}: unknown key; {hint}allowed: {', '.join(names)}")


def chosen(file: Path, path: str, raw: Any, key: str, kinds: dict[str, type[T]]) -> type[T]:
    """The kind of table that ``raw[key]`` names."""
    if not isinstance(raw, dict):
        raise SceneError(f"{file}: {path}: must be a table{_not_listed(raw, path)} (got {raw!r:.60})")
    if key not in raw:
        raise SceneError(f"{file}: {path}.{key}: missing; choose from {', '.join(kinds)}")
    name = raw[key]
    if not isinstance(name, str) or name not in kinds:
        near = difflib.get_close_matches(name.lower(), kinds, 1) if isinstance(name, str) else []
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise SceneError(f"{file}: {path}.{key}: must be one of {', '.join(kinds)} (got {name!r:.60}){hint}")
    return kinds[name]


def listed_tables(file: Path, key: str, raw: Any, kinds: type[T] | dict[str, type[T]]) -> tuple[T, ...]:
    """The tables of a list, ``[[key]]``: of one kind, or each of that which its ``kind`` names."""
    if not isinstance(raw, list):
        raise SceneError(f"{file}: {key}: must be a list of tables, [[{key}]] (got {raw!r:.60})")
    made = []
    for index, entry in enumerate(raw):
        path = f"{key}[{index}]"
        kind = chosen(file, path, entry, "kind", kinds) if isinstance(kinds, dict) else kinds
        made.append(checked_table(file, path, entry, kind))
    return tuple(made)


def _explained(message: str, path: str, raw: dict[str, Any], kind: type[msgspec.Struct]) -> str:
    """A message of msgspec as ``path: what is allowed (what was got)``."""
    text, _, place = message.partition(" - at `$")
    place = place.rstrip("`")
    if missing := re.fullmatch(r"Object missing required field `(\w+)`", text):
        return f"{path}{place}.{missing[1]}: missing; it must be given"
    keys = re.findall(r"\.(\w+)|\[(\d+)\]", place)
    got: Any = raw
    for name, index in keys:
        got = got[name] if name else got[int(index)]
    if text.startswith("Invalid enum value"):
        names = next(field.type for field in msgspec.structs.fields(kind) if field.name == keys[0][0])
        allowed = "must be one of " + ", ".join(_literals(names))
    else:
        allowed = text.partition(", got ")[0].replace("Expected", "must be")
        allowed = re.sub(r"`([\w |]+)`", lambda types: _in_words(types[1]), allowed)
        allowed = re.sub(r">=|<=|>|<", lambda sign: _BOUNDS[sign[0]], allowed)
        if allowed == "must be a list" and len(keys) == 1:
            hint = next(field.type for field in msgspec.structs.fields(kind) if field.encode_name == keys[0][0])
            allowed += _of_what(hint, f"{path}{place}")
    return f"{path}{place}: {allowed} (got {got!r:.60})"


def _of_what(annotation: Any, path: str) -> str:
    """What a list at ``path`` holds: tables, which are written in a way of their own, or a fixed number of entries."""
    if _tables_in(annotation):
        return f" of tables, [[{path}]]"
    lengths = {len(get_args(part)) for part in (annotation, *get_args(annotation)) if get_origin(part) is tuple}
    return f" of length {lengths.pop()}" if len(lengths) == 1 else ""


def _in_words(types: str) -> str:
    """Type names such as ``float | null`` in plain words, without null."""
    return " or ".join(_WORDS[name] for name in types.split(" | ") if name != "null")


def _literals(annotation: Any) -> list[str]:
    """The values of the Literal in a type, however deep."""
    if get_origin(annotation) is Literal:
        return [str(value) for value in get_args(annotation)]
    return [value for part in get_args(annotation) for value in _literals(part)]


@contextmanager
def located(file: Path, path: str, table: msgspec.Struct, contacts: Sequence[Any] = ()) -> Iterator[None]:
    """Prefix errors raised while building from ``table`` with the file and the key's path.

    Messages about one of the ``contacts`` of a scene, by its number among those with colliders, have its path.
    """
    try:
        yield
    except ModalShellError as error:
        if isinstance(error, SceneError) or not isinstance(error, ValueError):
            raise
        named, said = getattr(table, "file", None), str(error)
        if contacts and (numbered := re.search(r"\bcontact (\d+)\b", said)):
            with_collider = [place for place, one in enumerate(contacts) if hasattr(one, "collider")]
            place = f"contacts[{with_collider[int(numbered[1])]}]"
            rest = f"{said[: numbered.start()]}the contact{said[numbered.end() :]}"
            raise SceneError(f"{file}: {place}: {rest}") from error
        if isinstance(named, str) and (said.startswith(f"{named} ") or said.partition(": ")[0].endswith(named)):
            raise SceneError(f"{file}: {path}.file: {error}") from error
        name, _, rest = str(error).partition(" ")  # most messages begin with the parameter, or an entry of it
        parameter, bracket, index = name.partition("[")
        key = _PARAMETERS.get(parameter, parameter)
        if key not in table.__struct_fields__ or rest.partition(" ")[0] in _JOINED:
            raise SceneError(f"{file}: {path}: {error}") from error
        raise SceneError(f"{file}: {path}.{key}{bracket}{index}: {rest}") from error
