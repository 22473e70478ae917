"""Packages that few tests need, imported where one of them first uses them: collecting the tests does without."""

import importlib
import importlib.util

import pytest


class _Later:
    """A module that is imported when something of it is asked for."""

    def __init__(self, name):
        self._name = name

    def __getattr__(self, attribute):
        if attribute.startswith("_"):  # pytest asks everything in a test module for marks of its own
            raise AttributeError(attribute)
        return getattr(importlib.import_module(self._name), attribute)


def later(name, reason=None):
    """A module; where its package is not installed, the test module that asks for it is skipped."""
    package = name.partition(".")[0]
    if importlib.util.find_spec(package) is None:
        pytest.skip(reason or f"{package} is not installed", allow_module_level=True)
    return _Later(name)
