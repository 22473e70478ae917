"""Selection of vertices: by a text such as ``x < 0.01 and abs(y) > 0.2``, by a mask, or by indices.

Texts are parsed, never evaluated as code.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.checks import as_array, shortened, shown
from modalshell.errors import OptionError
from modalshell.sharing import read_only_copy

_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_ARITHMETIC: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_ALLOWED = "comparisons (<, <=, >, >=) of x, y, z, numbers, + - * /, abs(...), joined by and, or, not"
_LONGEST = 1000
"""Characters of a selection: the parser's own limits end in no message."""


Selection = str | Sequence[int] | NDArray[np.bool_] | NDArray[np.int64]
"""Vertices by a text, by indices, or by a mask."""


def checked_selection(name: str, selection: Selection) -> Selection:
    """A selection that no one can change, before there is a mesh; OptionError about ``name`` where it can be none."""
    if isinstance(selection, str):
        try:
            select_vertices(selection, np.zeros((1, 3)))
        except OptionError as error:
            raise OptionError(f"{name} {error}") from error
        return selection
    entries = as_array(name, selection, "bool (n,) or vertex indices", OptionError, "biu")
    if entries.ndim > 1:
        raise OptionError(f"{name} must be a mask (n,) or a list of vertex indices (got shape {entries.shape})")
    return read_only_copy(np.atleast_1d(entries))


def selected(name: str, selection: Selection, vertices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask (n,) of the selected ones of ``vertices`` (n, 3), at least one; else OptionError about ``name``."""
    count = len(vertices)
    if isinstance(selection, str):
        try:
            mask = select_vertices(selection, vertices)
        except OptionError as error:
            raise OptionError(f"{name} {error}") from error
    else:
        entries = as_array(name, selection, f"bool ({count},) or vertex indices", OptionError, "biu")
        if entries.dtype == bool and entries.shape != (count,):
            raise OptionError(f"{name} must be a mask ({count},) or vertex indices (got shape {entries.shape})")
        outside = entries[(entries < 0) | (entries >= count)] if entries.dtype != bool else entries[:0]
        if outside.size:
            raise OptionError(f"{name} names vertex {outside[0]}, but the mesh has vertices 0 to {count - 1}")
        mask = np.zeros(count, dtype=bool)
        if entries.size:
            mask[entries] = True
    if not mask.any():
        low, high = vertices.min(axis=0).round(6).tolist(), vertices.max(axis=0).round(6).tolist()
        raise OptionError(f"{name} selects no vertex (got {shown(selection)}); the mesh reaches from {low} to {high}")
    return mask


def select_vertices(expression: str, vertices: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mask (n,) of the vertices for which ``expression`` holds.

    Parameters
    ----------
    expression : str
        Comparisons of the coordinates ``x``, ``y``, ``z`` [m], joined by ``and``, ``or``, ``not``.
    vertices : ndarray, shape (n, 3)
        Positions [m].

    Raises
    ------
    OptionError
        If the text is not such an expression, naming the part that is not.
    """
    if len(expression) > _LONGEST:
        raise OptionError(f"a selection may have at most {_LONGEST} characters (got {len(expression)})")
    try:
        tree = ast.parse(expression.strip(), mode="eval").body
        with np.errstate(divide="ignore", invalid="ignore"):
            mask = _mask(tree, expression.strip(), np.asarray(vertices).T)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        if isinstance(error, OptionError):
            raise
        raise OptionError(
            f"cannot read the selection {shown(expression)}: {shortened(str(error))}; allowed: {_ALLOWED}"
        ) from error
    return np.broadcast_to(np.asarray(mask, dtype=bool), (len(vertices),)).copy()


def _refuse(node: ast.AST, text: str) -> OptionError:
    part = ast.get_source_segment(text, node) or type(node).__name__
    return OptionError(f"cannot use {shown(part)} in the selection {shown(text)}; allowed: {_ALLOWED}")


def _mask(node: ast.expr, text: str, axes: NDArray[np.float64]) -> Any:
    if isinstance(node, ast.BoolOp):
        masks = [_mask(value, text, axes) for value in node.values]
        combine = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
        return combine.reduce(np.broadcast_arrays(*masks))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return np.logical_not(_mask(node.operand, text, axes))
    if isinstance(node, ast.Compare):
        values = [_value(part, text, axes) for part in (node.left, *node.comparators)]
        result: Any = True
        for compare, left, right in zip(node.ops, values[:-1], values[1:], strict=True):
            if type(compare) not in _COMPARE:
                raise _refuse(node, text)
            result = np.logical_and(result, _COMPARE[type(compare)](left, right))
        return result
    raise _refuse(node, text)


def _value(node: ast.expr, text: str, axes: NDArray[np.float64]) -> Any:
    if isinstance(node, ast.Name) and node.id in ("x", "y", "z"):
        return axes["xyz".index(node.id)]
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return np.float64(node.value)
    if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
        return _ARITHMETIC[type(node.op)](_value(node.left, text, axes), _value(node.right, text, axes))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -_value(node.operand, text, axes)
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "abs"
        and len(node.args) == 1
        and not node.keywords
    ):
        return np.abs(_value(node.args[0], text, axes))
    raise _refuse(node, text)
