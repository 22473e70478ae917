"""``[model]``: a registered model and its options, the keys being the parameters of its builder."""

from __future__ import annotations

import inspect
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, cast, get_args, get_origin, get_type_hints

import msgspec

from modalshell.models import Model
from modalshell.models.factory import MODE_COUNT, ModelFactory
from modalshell.models.registry import ModelSpec, models
from modalshell.scene.tables import Count, Table

Cells = tuple[Count, Count]


class ModelTable(Table, frozen=True, tag_field="name"):
    """``[model]``: its name and options."""

    spec: ClassVar[ModelSpec]

    @property
    def options(self) -> dict[str, Any]:
        """The options, defaults filled in."""
        return {name: getattr(self, name) for name in self.__struct_fields__}

    def build(self, factory: ModelFactory) -> Model:
        """The model with all that it precomputes."""
        return factory.build(self.spec, self.options)


def model_tables() -> dict[str, type[ModelTable]]:
    """The table of every model, by its key."""
    return {key: _table(spec) for key, spec in models().items()}


@cache
def _table(spec: ModelSpec) -> type[ModelTable]:
    builder: Any = spec.builder
    hints = get_type_hints(builder.__init__ if inspect.isclass(builder) else builder, include_extras=True)
    fields: dict[str, tuple[Any, Any]] = {"modes": (Count, MODE_COUNT)} if spec.on_modes else {}
    if spec.needs == "coarse mesh":
        fields["cells"] = (Cells | None, None)
    for name, parameter in list(inspect.signature(builder).parameters.items())[spec.given :]:
        if name == "count":
            fields["modes"] = (Count, parameter.default)
        elif _in_toml(hints[name]):
            fields[name] = (hints[name], parameter.default)
    made = msgspec.defstruct(
        spec.key, [(name, *field) for name, field in fields.items()], bases=(ModelTable,), namespace={"spec": spec},
        frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="name", tag=spec.key,
    )  # fmt: skip
    return cast(type[ModelTable], made)


def _in_toml(hint: Any) -> bool:
    """Whether TOML can state values of a type."""
    if hint in (bool, int, float, str, NoneType):
        return True
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _in_toml(arguments[0])
    return origin is Literal or (origin in (Union, UnionType, tuple) and all(_in_toml(part) for part in arguments))
