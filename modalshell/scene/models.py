"""``[model]``: a registered model and its options; the keys are the parameters of its builder."""

from __future__ import annotations

import inspect
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, cast, get_args, get_origin

import msgspec

from modalshell.models import Model
from modalshell.models.factory import MODE_COUNT, ModelFactory
from modalshell.models.registry import ModelSpec, models
from modalshell.scene.signatures import parameters_of
from modalshell.scene.tables import Count, Table

Cells = tuple[Count, Count]


class ModelTable(Table, frozen=True, tag_field="name"):
    """``[model]``: its name and options."""

    spec: ClassVar[ModelSpec]

    @property
    def options(self) -> dict[str, Any]:
        """The options, defaults filled in."""
        return {name: getattr(self, name) for name in self.__struct_fields__}

    @property
    def given(self) -> dict[str, Any]:
        """The options that are not their defaults."""
        defaults = {field.name: field.default for field in msgspec.structs.fields(self)}
        return {name: value for name, value in self.options.items() if value != defaults[name]}

    def build(self, factory: ModelFactory) -> Model:
        """The model with all that it precomputes."""
        return factory.build(self.spec, self.options)


def model_tables() -> dict[str, type[ModelTable]]:
    """The table of every model, by its key."""
    return {key: _table(spec) for key, spec in models().items()}


@cache
def _table(spec: ModelSpec) -> type[ModelTable]:
    builder: Any = spec.builder
    fields: dict[str, tuple[Any, Any]] = {"modes": (Count, MODE_COUNT)} if spec.on_modes else {}
    if spec.on_coarse_mesh:
        fields["cells"] = (Cells | None, None)
        fields["triangles"] = (Count | None, None)
    for name, (hint, default) in list(parameters_of(builder).items())[spec.given :]:
        if name == "count":
            fields["modes"] = (Count, default)
        elif (kind := _in_toml(hint)) is not None:
            fields[name] = (kind, default)
    made = msgspec.defstruct(
        spec.key, [(name, *field) for name, field in fields.items()], bases=(ModelTable,),
        namespace={"spec": spec, "__doc__": inspect.getdoc(builder)}, frozen=True, kw_only=True,
        forbid_unknown_fields=True, tag_field="name", tag=spec.key,
    )  # fmt: skip
    return cast(type[ModelTable], made)


def _in_toml(hint: Any) -> Any:
    """The part of a type that TOML can express; None if there is none."""
    if hint in (Any, bool, int, float, str, NoneType):
        return hint
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        parts = [part for part in map(_in_toml, arguments) if part not in (None, NoneType)]
        return Union[(*parts, *([NoneType] if NoneType in arguments else []))] if parts else None
    known = origin is Literal or (origin is Annotated and _in_toml(arguments[0]) is not None)
    return hint if known or (origin is tuple and all(_in_toml(part) is not None for part in arguments)) else None
