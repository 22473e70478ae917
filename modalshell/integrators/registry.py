"""The rules of one kind, by the names that users and scenes give them."""

from __future__ import annotations

from abc import ABC
from typing import ClassVar, Generic, TypeVar

from modalshell.checks import checked_choice
from modalshell.errors import OptionError


class Integrator(ABC):
    """A rule that steps a motion.

    Attributes
    ----------
    name : str
        As written in ``integrator=`` and in scenes.
    label : str
        For tables and messages.
    """

    name: ClassVar[str]
    label: ClassVar[str]


Rule = TypeVar("Rule", bound=Integrator)


class Registry(Generic[Rule]):
    """Rules of one kind; a class joins them by the decorator :meth:`add`, in whatever package it is."""

    def __init__(self, kind: type[Rule]) -> None:
        self._kind = kind
        self._rules: dict[str, type[Rule]] = {}

    def add(self, rule: type[Rule]) -> type[Rule]:
        """Register a class under its ``name``; OptionError if another class has that name."""
        other = self._rules.get(rule.name, rule)
        if (other.__module__, other.__qualname__) != (rule.__module__, rule.__qualname__):
            raise OptionError(
                f"the integrator {rule.name!r} exists already, as {other.__module__}.{other.__qualname__}"
            )
        self._rules[rule.name] = rule
        return rule

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all rules."""
        return tuple(self._rules)

    def choose(self, choice: str | Rule) -> Rule:
        """The rule of a name, or ``choice`` itself if it is a rule; else OptionError."""
        if isinstance(choice, self._kind):
            return choice
        return self._rules[checked_choice("integrator", choice, self.names)]()
