"""Tables of a scene derived from the parameters of functions: shapes, loads and energies."""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Callable, Iterator
from types import UnionType
from typing import Annotated, Any, Union, cast, get_args, get_origin, get_type_hints

import msgspec
from numpy.typing import ArrayLike

from modalshell.core.errors import OptionError
from modalshell.loads import LOADS, Load, Scaled
from modalshell.mesh.selection import Selection
from modalshell.scene import tables
from modalshell.scene.tables import Table
from modalshell.shell.elements import ENERGIES
from modalshell.supports import SUPPORTS

_GATHERED = inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD
"""Parameters that gather others, which have no names here."""


class Built(Table, frozen=True):
    """A table whose keys are the parameters of the object it builds."""

    @abstractmethod
    def build(self) -> Any:
        """What the table declares."""


def parameters_of(function: Callable[..., Any]) -> dict[str, tuple[Any, Any]]:
    """Type, anything where none is stated, and default of each named parameter; of a class those of its ``__init__``.

    Some Pythons (3.11.2) take the signature of a class from a ``__new__`` that it inherits before its ``__init__``.
    """
    called = function.__init__ if inspect.isclass(function) else function
    hints, parameters = get_type_hints(called, include_extras=True), inspect.signature(called).parameters
    named = list(parameters.values())[called is not function :]
    return {one.name: (hints.get(one.name, Any), one.default) for one in named if one.kind not in _GATHERED}


def signature_table(
    function: Callable[..., Any], base: type[Any] = Built, tag_field: str | None = None, tag: str | None = None
) -> type[Any]:
    """The table of a function, a subclass of ``base``, with the function's parameters and defaults as its keys."""
    fields: list[Any] = []
    for name, (hint, default) in parameters_of(function).items():
        kind = _of_scenes(tuple[int, int] if name == "cells" else hint)
        fields.append((name, kind) if default is inspect.Parameter.empty else (name, kind, default))

    names = [name for name, *_ in fields]

    def build(table: Built) -> Any:
        return function(**{name: getattr(table, name) for name in names})

    return msgspec.defstruct(
        function.__name__, fields, bases=(base,), frozen=True,
        namespace={"build": build, "__doc__": inspect.getdoc(function)}, kw_only=True,
        forbid_unknown_fields=True, tag_field=tag_field, tag=tag,
    )  # fmt: skip


def _of_scenes(hint: Any) -> Any:
    """The type of a scene's key: selections as text or indices, without callables."""
    if hint == ArrayLike:
        return list[list[float]]
    if hint in (Selection, Selection | None):
        return tables.Selection if hint == Selection else tables.Selection | None
    if get_origin(hint) in (Union, UnionType):
        kept = [part for part in get_args(hint) if get_origin(part) is not Callable]
        return Union[tuple(kept)]  # noqa: UP007 (of types that are only known here)
    return hint


class LoadTable(Built, frozen=True):
    """A table of ``[[loads.KEY]]``: a load's own keys, and its factor in time if it has one.

    ``factors`` at ``times`` [s], joined by straight lines, constant before and after.
    """

    times: tables.Times | None = None
    factors: Annotated[list[float], msgspec.Meta(min_length=2)] | None = None

    def load(self) -> Load:
        """The load, times its factor."""
        if (self.times is None) != (self.factors is None):
            raise OptionError("times and factors go together: give both or neither")
        load: Load = self.build()
        return load if self.times is None or self.factors is None else Scaled(load, (self.times, self.factors))


def loads_table() -> type[tables.Loads]:
    """``[loads]`` with a list of tables for every load that is registered."""
    lists: list[Any] = [
        (key, list[signature_table(kind, LoadTable)], msgspec.field(default_factory=list))  # type: ignore[misc]
        for key, kind in LOADS.items()
    ]
    made = msgspec.defstruct(
        "Loads", lists, bases=(tables.Loads,), frozen=True, kw_only=True, forbid_unknown_fields=True
    )
    return cast(type[tables.Loads], made)


def energies_table() -> type[Table]:
    """``[energies]`` with a table for every energy that is registered."""
    further = [(key, signature_table(kind) | None, None) for key, kind in ENERGIES.items()]
    made = msgspec.defstruct("Energies", further, bases=(Table,), frozen=True, kw_only=True, forbid_unknown_fields=True)
    return cast(type[Table], made)


def support_tables() -> dict[str, type[Any]]:
    """The tables of ``[[supports]]`` by their kinds."""
    kinds = {key: signature_table(kind, tag_field="kind", tag=key) for key, kind in SUPPORTS.items()}
    return kinds | {"path": tables.Path}


def load_entries(loads: tables.Loads | None) -> Iterator[tuple[str, LoadTable]]:
    """Each table of a registered load in ``[loads]``, with its path."""
    for key in LOADS:
        for index, entry in enumerate(getattr(loads, key, ())):
            yield f"loads.{key}[{index}]", entry


def energy_entries(energies: Table | None) -> Iterator[tuple[str, Built]]:
    """Each table in ``[energies]``, with its path."""
    for key in ENERGIES:
        if (entry := getattr(energies, key, None)) is not None:
            yield f"energies.{key}", entry
