"""Types that are found with less work are those that numba finds, and what it says where there are none."""

import itertools
import operator

import numpy as np
import pytest
from numba.core import errors, ir, types
from numba.core.compiler import run_frontend
from numba.core.registry import cpu_target
from numba.core.types.functions import BaseFunction

from modalshell.kernels import quick_typing

VECTOR, FROZEN = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C", readonly=True)
ARGUMENTS = (types.float64, types.float32, types.int64, types.uint8, types.boolean, types.literal(3), VECTOR, FROZEN)
PLACES = (types.literal(1), types.int64, types.UniTuple(types.int64, 2), types.Tuple((types.int64, types.literal(0))))
BINARY = (operator.add, operator.mul, operator.truediv, operator.lt, operator.pow, operator.mod, max, np.hypot)
CALLS = [
    *((function, pair) for function in BINARY for pair in itertools.product(ARGUMENTS, ARGUMENTS)),
    *((function, (one,)) for function in (abs, operator.neg, np.sqrt, len, float) for one in ARGUMENTS),
    *((operator.getitem, pair) for pair in itertools.product((VECTOR, FROZEN, *PLACES[2:]), PLACES)),
]


@pytest.fixture(scope="module")
def context():
    found = cpu_target.typing_context
    found.refresh()
    return found


def answer(search, function, context, arguments):
    """The signature that a search finds, or the words of what it says where there is none."""
    try:
        return search(function, context, arguments, {})
    except errors.NumbaError as error:
        return type(error), str(error).split()  # numba indents it farther each time


def test_calls_have_the_types_that_numba_finds(context, monkeypatch):
    """When they are met first, and when the rule is known."""
    monkeypatch.setattr(quick_typing, "_taken", {})
    taken = 0
    for callee, arguments in CALLS:
        function = context.resolve_value_type(callee)
        expected = answer(BaseFunction.get_call_type, function, context, arguments)
        for _ in range(2):
            assert answer(type(function).get_call_type, function, context, arguments) == expected
        if not isinstance(expected, tuple):
            taken += 1
            assert function.get_impl_key(expected) is not None
    assert len(quick_typing._taken) >= taken  # rules call others
    assert len(CALLS) > taken > len(CALLS) // 2


def test_a_rule_that_is_known_is_tried_alone(context, monkeypatch):
    tries, tried = [], quick_typing._tried
    monkeypatch.setattr(quick_typing, "_taken", {})
    monkeypatch.setattr(quick_typing, "_tried", lambda *asked: (tries.append(asked), tried(*asked))[1])
    function = context.resolve_value_type(operator.add)
    counts = []
    for _ in range(2):
        tries.clear()
        function.get_call_type(context, (VECTOR, VECTOR), {})
        counts.append(len(tries))
    assert counts[0] > counts[1] == 1


def named(value):
    """Variables in a part of a statement, by numba's rule."""
    if isinstance(value, ir.Var):
        return [value]
    if isinstance(value, ir.Inst):
        return value.list_vars()
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    return [variable for part in parts for variable in named(part)]


def test_the_names_of_statements_are_found_in_order():
    def kernel(array, scale, *more):
        total = (0.0, 1)[0]
        for k in range(array.shape[0]):
            if array[k, 1:3].any() and not scale:
                total += max(array[k, 0], scale) * len(more)
            else:
                array[k] = abs(total)
        return {"a": total}, [scale, k]

    found = []
    for block in run_frontend(kernel).blocks.values():
        for statement in block.body:
            assert statement._rec_list_vars(vars(statement)) == named(vars(statement))
            assert statement._rec_list_vars([vars(statement)] * 2) == 2 * named(vars(statement))
            found += statement.list_vars()
    assert len({variable.name for variable in found}) > 20


def test_what_searches_otherwise_is_left_alone():
    class Kept:
        """As another version of numba might name it."""

        def get_call_type(self):
            return self

    before = Kept.get_call_type
    quick_typing.apply(Kept, Kept)
    assert Kept.get_call_type is before
    assert types.Function.get_call_type is not BaseFunction.get_call_type


@pytest.mark.parametrize("name", ["_by_target", "_target"])
def test_numba_without_a_name_that_is_its_own_is_left_alone(monkeypatch, name):
    """The package did not import with it: the names are private, and were asked for as the file was read."""

    class Kept:
        def get_call_type(self):
            return self

        _rec_list_vars = get_call_type

    before = Kept.get_call_type
    monkeypatch.setattr(quick_typing, name, None)
    quick_typing.apply(Kept, Kept)
    assert Kept.get_call_type is before
    assert Kept._rec_list_vars is before
