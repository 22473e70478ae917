"""Base class of all time integrators, and their registry."""

from __future__ import annotations

from abc import ABC
from typing import Any, ClassVar, Self

from modalshell.core.checks import checked_choice
from modalshell.core.registry import Registry


class Integrator(ABC):
    """A rule that steps a motion; one with a key, ``class Rule(ModalIntegrator, key="rule")``, is known by it."""

    key: ClassVar[str]
    """As written in ``integrator=`` and in scenes."""
    name: ClassVar[str]
    """For tables and messages."""
    known: ClassVar[Registry[type[Any]]]
    """Every rule of the same kind by its key."""

    def __init_subclass__(cls, *, key: str = "", alias: str = "") -> None:
        if key:
            cls.key, cls.known[key] = key, cls
        if alias:
            cls.known[alias] = cls

    @classmethod
    def chosen(cls, choice: str | Self) -> Self:
        """The integrator of a key, or ``choice`` itself if it is one of this kind; else OptionError."""
        if isinstance(choice, cls):
            return choice
        rule: Self = cls.known[checked_choice("integrator", choice, tuple(cls.known))]()
        return rule
