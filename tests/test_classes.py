"""Every class of the package is abstract or final: none derives from one of the package that can be made."""

import contextlib
import importlib
import inspect
import pkgutil
from abc import ABC

import msgspec

import modalshell
from modalshell.core.drawn import Drawn
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.models.base.model import Model
from modalshell.supports.constraints import Constraint

BARE = (Exception, msgspec.Struct)
"""Roots whose branches may themselves be made: errors, which are caught by their root, and tables of scenes."""
MIXED = (ReadOnlyArrays, Constraint, Drawn)
"""Roots that nobody makes, though no method says so."""


def package_classes():
    found = set()
    for info in pkgutil.walk_packages(modalshell.__path__, "modalshell."):
        if not info.name.startswith(("modalshell.symbolic", "modalshell.kernels", "modalshell.__main__")):
            with contextlib.suppress(ImportError):  # of an extra that is not installed
                found |= {kind for _, kind in inspect.getmembers(importlib.import_module(info.name), inspect.isclass)}
    return sorted((kind for kind in found if kind.__module__.startswith("modalshell.")), key=lambda kind: kind.__name__)


def test_no_class_derives_from_a_concrete_one():
    wrong = [
        f"{kind.__name__}({base.__name__})"
        for kind in package_classes()
        for base in kind.__bases__
        if base.__module__.startswith("modalshell.")
        and not (inspect.isabstract(base) or ABC in base.__bases__ or issubclass(base, BARE) or base in MIXED)
    ]
    assert wrong == []


def test_every_model_that_can_be_made_is_final():
    models = [kind for kind in package_classes() if issubclass(kind, Model) and not inspect.isabstract(kind)]
    assert len(models) >= 9
    assert [kind.__name__ for kind in models if not getattr(kind, "__final__", False)] == []
