"""Parameters of what scenes build."""

import inspect
from typing import Any

import msgspec

from modalshell.models.registry import models
from modalshell.scene.models import _in_toml
from modalshell.scene.signatures import parameters_of, signature_table


class Kept:
    def __new__(cls, *args, **options):  # noqa: ARG004
        return super().__new__(cls)


class Made(Kept):
    def __init__(self, width: float, name: str = "sheet") -> None: ...


class Further(Made):
    pass


def test_parameters_of_a_class_are_those_of_its_constructor_whatever_new_it_inherits():
    """Python 3.11.2 says ``(*args, **options)`` of such a class, and no scene with a model could be read."""
    for kind in (Made, Further):
        assert parameters_of(kind) == {"width": (float, inspect.Parameter.empty), "name": (str, "sheet")}
    assert parameters_of(lambda width, name=2.0, **others: (width, name, others)) == {
        "width": (Any, inspect.Parameter.empty),
        "name": (Any, 2.0),
    }


def test_a_parameter_without_a_type_takes_what_the_scene_gives():
    """Of loads its key took nothing at all, and of models there was no key."""
    table = signature_table(lambda sel, total=1.0: (sel, total))
    assert msgspec.convert({"sel": "x > 0.5"}, table).build() == ("x > 0.5", 1.0)
    assert _in_toml(Any) is Any


def test_no_model_takes_parameters_without_a_type():
    for spec in models().values():
        assert all(kind is not Any for kind, _ in parameters_of(spec.builder).values()), spec.key
