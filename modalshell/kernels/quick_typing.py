"""Numba's inference of types with less work: the same types, and the same machine code.

For each call in a kernel numba tries one rule after another until one takes the arguments' types, and writes of each
that does not why. Which rule took the same types before is known here, and is tried alone. And the names in a statement
are found without a call for each word of it. Both together are a sixth of the time that kernels take to compile.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from numba.core import errors, ir, target_extension, types, utils

_unliteral: Any = types.unliteral
_by_target: Any = getattr(utils, "order_by_target_specificity", None)
_target: Any = getattr(target_extension, "get_local_target", None)
_PLAIN = frozenset(
    {types.Float, types.Integer, types.IntegerLiteral, types.Boolean, types.Array, types.UniTuple, types.Tuple}
)
"""Kinds of arguments of which equal ones are taken by the same rules."""
_WORDS = frozenset({str, int, float, bool, type(None), type(abs), ir.Loc, type(getattr(ir, "UNDEFINED", None))})
"""What a statement holds that names nothing."""
_taken: dict[Any, tuple[Any, bool]] = {}
"""The rule that took a call, and whether it took constants for such."""


def _tried(rule: Any, literal: bool, args: tuple[Any, ...]) -> Any:
    """Signature by one rule, or None."""
    with suppress(errors.NumbaError):
        return rule.apply(args if literal else tuple(_unliteral(argument) for argument in args), {})
    return None


def _ordered(function: Any, context: Any) -> Any:
    """Rules for a function's calls, in the order in which numba tries them."""
    return _by_target(_target(context), function.templates, fnkey=function.key[0])


def quicker(found: Any) -> Any:
    """A search for the type of a call that ends as ``found``, numba's own; this says why where no rule takes it."""

    def get_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
        if kws or not all(type(argument) in _PLAIN for argument in args):
            return found(self, context, args, kws)
        asked = context, self.typing_key, self.templates, tuple(args)
        known = _taken.get(asked)
        if known is not None:
            tries = [known]
        else:
            made = ((kind, kind(context).prefer_literal) for kind in _ordered(self, context))
            tries = [(kind, literal) for kind, first in made for literal in (first, not first)]
        for kind, literal in tries:
            rule = kind(context)
            signature = _tried(rule, literal, args)
            if signature is not None:
                _taken[asked] = kind, literal
                self._impl_keys[signature.args] = rule.get_impl_key(signature)
                return signature
        return found(self, context, args, kws)

    return get_call_type


def flatter(found: Any) -> Any:
    """A search for the variables of a part of a statement that finds those of ``found``, numba's own, as ordered."""

    def list_variables(self: Any, value: Any) -> list[Any]:
        kind = type(value)
        if kind is dict:
            parts = value.values()
        elif kind is list or kind is tuple:
            parts = value
        else:
            return found(self, value)
        names: list[Any] = []
        for part in parts:
            kind = type(part)
            if kind is ir.Var:
                names.append(part)
            elif kind not in _WORDS:
                names += list_variables(self, part)
        return names

    return list_variables


def apply(calls: Any = types.Function, statements: Any = ir.Inst) -> None:
    """Let numba search so; other versions of numba, which search otherwise, are left alone."""
    if _by_target is None or _target is None:
        return
    with suppress(AttributeError):
        search, names = calls.get_call_type, statements._rec_list_vars
        calls.get_call_type = quicker(search)
        statements._rec_list_vars = flatter(names)
