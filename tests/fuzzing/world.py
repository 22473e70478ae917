"""A few small objects of the package, and what is later made of them: names are known before anything is built."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import modalshell as ms
from modalshell.models import CoarseMesh
from modalshell.models.factory import ModelFactory
from modalshell.scene.models import model_tables


def model_names() -> list[str]:
    """Names of the models of the world, which are built elsewhere."""
    return ["rigid, free", "mwts, free", "springs, cg", *model_tables()]


@cache
def world() -> dict[str, Any]:
    """A few small objects of the package."""
    mesh = ms.v_beam(cells=(4, 2))
    material = ms.Material(20.0, 20.0, 0.05, 0.2)
    shell = ms.Shell(mesh, material, mesh.vertices[:, 0] < 0.3)
    basis = ms.solve_modes(shell, 3)
    free = ms.Shell(mesh, material)
    path = ms.SupportPath([0.0, 0.1], [[0, 0, 0], [0, 0, 0.1]], [[0, 0, 0], [0, 0.2, 0]])
    coarse = CoarseMesh(ms.v_beam(cells=(4, 2)), "4x2", material)
    models = {
        "rigid, free": ms.RigidShell(free),
        "mwts, free": ms.ModalWarping(ms.solve_modes(free, 8)),
        "springs, cg": ms.SpringSheet(shell, integrator="linear_implicit", solver="cg", iterations=30),
    }
    factory = ModelFactory(shell, lambda: shell.gravity_force((0.0, 0.0, -2.0)), lambda *_: coarse)
    for key, table in model_tables().items():
        few = {"modes": 2 if key == "md-rom" else 3, "rank": 4}
        with warnings.catch_warnings():  # training warns that three modes are few
            warnings.simplefilter("ignore", ms.ModalShellWarning)
            models[key] = table(**{name: few[name] for name in table.__struct_fields__ if name in few}).build(factory)
    assert list(models) == model_names()
    return {"mesh": mesh, "material": material, "shell": shell, "basis": basis, "path": path, "models": models}


class Later:
    """What is made once it is asked for, and kept: calls are listed where nothing may be built, as in collection."""

    def __init__(self, make: Callable[[], Any]) -> None:
        self.make = cache(make)

    def then(self, change: Callable[[Any], Any]) -> Later:
        """What follows from it, as late."""
        return Later(lambda: change(self.make()))


def part(*path: str) -> Later:
    """An object of the world, or an attribute of it: ``part("shell", "energy")``."""
    return Later(lambda: functools.reduce(getattr, path[1:], world()[path[0]]))


def model(name: str, *path: str) -> Later:
    """A model of the world, or an attribute of it."""
    return Later(lambda: functools.reduce(getattr, path, world()["models"][name]))


def resolved(value: Any) -> Any:
    """The value, made if it is Later."""
    return value.make() if isinstance(value, Later) else value
