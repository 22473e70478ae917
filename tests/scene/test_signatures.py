"""Parameters of what scenes build."""

import inspect

from modalshell.models.registry import models
from modalshell.scene.signatures import parameters_of


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
    assert parameters_of(lambda width, name=2.0: (width, name)) == {
        "width": (None, inspect.Parameter.empty),
        "name": (None, 2.0),
    }


def test_no_model_takes_parameters_without_a_type():
    for spec in models().values():
        assert all(kind is not None for kind, _ in parameters_of(spec.builder).values()), spec.key
