"""Selection of vertices by an expression such as ``x < 0.01 and abs(y) > 0.2``, by a mask, or by indices.

Texts compare the coordinates ``x``, ``y``, ``z`` [m] at rest, and ``angle(nx, ny, nz)``, the angle [deg] between the
surface's normal at a vertex and a direction. ``boundary`` selects all boundary vertices, ``boundary(k)`` those
of one boundary loop, numbered from 0 in order of decreasing length, ``component(k)`` those of one connected part,
numbered from 0 in order of decreasing area, ``nearest(x, y, z)`` the vertex nearest to a point, and
``box(x0, y0, z0, x1, y1, z1)`` those in a box.
They are parsed, never evaluated as code.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import LARGEST, as_array, shortened, shown
from modalshell.core.errors import ModalShellError, OptionError, SupportError
from modalshell.core.thread_safety import read_only_copy
from modalshell.core.typing import Mask
from modalshell.mesh import TriangleMesh
from modalshell.mesh.parts import parts_by_area
from modalshell.mesh.topology import connected_parts

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
_ALLOWED = (
    "comparisons (<, <=, >, >=) of x, y, z, numbers, + - * /, abs(...), angle(nx, ny, nz), and boundary, boundary(k), "
    "component(k), nearest(x, y, z), box(x0, y0, z0, x1, y1, z1), joined by and, or, not"
)
_LONGEST = 1000
"""Longest selection [characters]; Python's parser ends without a message on longer ones."""


_ON_MESH: dict[str, tuple[int, Callable[..., Mask]]] = {
    "boundary": (1, lambda mesh, number: _boundary_loop(mesh, number)),
    "component": (1, lambda mesh, number: _component(mesh, number)),
}
"""Functions of a mesh that select vertices, and how many numbers they take."""
_ON_POINTS: dict[str, tuple[int, Callable[..., Mask]]] = {
    "nearest": (3, lambda points, *at: np.arange(len(points)) == np.argmin(np.linalg.norm(points - at, axis=1))),
    "box": (6, lambda points, *box: ((points >= box[:3]) & (points <= box[3:])).all(axis=1)),
}
"""Functions of points that select vertices, and how many numbers they take."""

Selection = str | Sequence[int] | Mask | NDArray[np.int64]
"""Vertices by an expression, by indices, or by a mask."""


class _NoSuchPartError(OptionError):
    """The mesh has fewer parts than a selection asks for."""


def checked_selection(name: str, selection: Selection) -> Selection:
    """A read-only copy of a selection, checked before a mesh is known; OptionError about ``name`` if invalid."""
    if isinstance(selection, str):
        try:
            select_vertices(selection, _SAMPLE)
        except _NoSuchPartError:
            return selection
        except OptionError as error:
            raise OptionError(f"{name} {error}") from error
        return selection
    entries = _entries(name, selection, "n", OptionError)
    entries = entries.ravel() if entries.dtype != bool and entries.ndim == 2 else entries  # (k, 2) of edges, too
    if entries.ndim > 1:
        raise OptionError(f"{name} must be a mask (n,) or a list of vertex indices (got shape {entries.shape})")
    return read_only_copy(np.atleast_1d(entries))


def selected(name: str, selection: Selection, surface: TriangleMesh | NDArray[np.float64]) -> Mask:
    """Mask (n,) of the selected vertices of a mesh, or points (n, 3), at least one; else OptionError about ``name``."""
    vertices = np.asarray(surface.vertices if isinstance(surface, TriangleMesh) else surface)
    count = len(vertices)
    if isinstance(selection, str):
        try:
            mask = select_vertices(selection, surface)
        except OptionError as error:
            raise OptionError(f"{name} {error}") from error
    else:
        entries = _entries(name, selection, count, OptionError)
        entries = entries if entries.dtype == bool else entries.ravel()  # (k, 2) of edges, too
        mask = vertex_mask(name, entries, count, OptionError)
    if not mask.any():
        low, high = vertices.min(axis=0).round(6).tolist(), vertices.max(axis=0).round(6).tolist()
        raise OptionError(f"{name} selects no vertex (got {shown(selection)}); the mesh reaches from {low} to {high}")
    return mask


def mixes_masks(given: Any) -> bool:
    """Whether a list, or one within it, has true or false in it, which among numbers NumPy takes for 1 and 0."""
    return isinstance(given, list | tuple) and any(
        isinstance(one, bool | np.bool_) or mixes_masks(one) for one in given
    )


def _entries(name: str, given: ArrayLike, count: int | str, error: type[ModalShellError]) -> NDArray[Any]:
    """A mask or indices as an array, else ``error`` about ``name``; NumPy would take True in a list of numbers as 1."""
    allowed = f"bool ({count},) or vertex indices"
    entries = as_array(name, given, allowed, error, "biu")
    if entries.dtype != bool and mixes_masks(given):
        raise error(f"{name} must be {allowed}, not both in one list (got {shown(given)})")
    return entries


def vertex_mask(name: str, vertices: ArrayLike, count: int, error: type[ModalShellError]) -> Mask:
    """Mask (count,) from a mask or from indices, else ``error`` about ``name``."""
    entries = _entries(name, vertices, count, error)
    indices = entries.dtype != bool
    if entries.ndim > 1 or not (indices or entries.shape == (count,)):
        raise error(f"{name} must be a mask ({count},) or a list of vertex indices (got shape {entries.shape})")
    if indices and entries.shape == (count,) and count > 2 and np.isin(entries, (0, 1)).all():
        raise error(f"{name} looks like a mask of 0 and 1: pass it as bool, or pass vertex indices")
    outside = entries[(entries < 0) | (entries >= count)] if indices else entries[:0]
    if outside.size:
        raise error(f"{name} names vertex {outside.flat[0]}, but the mesh has vertices 0 to {count - 1}")
    mask = np.zeros(count, dtype=bool)
    mask[entries if entries.size else []] = True
    return mask


def held_vertices(clamped: ArrayLike | str | None, count: int, mesh: TriangleMesh | None = None) -> Mask:
    """Mask (count,) of held vertices from a mask, from indices, from an expression on ``mesh``, or from None.

    SupportError for a mask of another length, indices that are no integers or out of range, or a mask that holds every
    vertex.
    """
    if clamped is None:
        return np.zeros(count, dtype=bool)
    try:
        named = selected("clamped", clamped, mesh) if isinstance(clamped, str) and mesh is not None else clamped
    except OptionError as error:
        raise SupportError(str(error)) from error
    mask = vertex_mask("clamped", named, count, SupportError)
    if mask.all():
        raise SupportError(f"clamped holds all {count} vertices, so nothing can move: leave some free")
    return mask


def _fault(error: Exception) -> str:
    """What is wrong, without the place in a file that Python's parser makes up."""
    return str(error.msg if isinstance(error, SyntaxError) else error)


def select_vertices(expression: str, surface: TriangleMesh | NDArray[np.float64]) -> Mask:
    """Mask (n,) of the vertices for which ``expression`` holds.

    OptionError if the text is not such an expression, naming the part that is not.

    Parameters
    ----------
    expression : str
        What is selected, as :mod:`modalshell.mesh.selection` says, joined by ``and``, ``or``, ``not``.
    surface : TriangleMesh, or ndarray, shape (n, 3)
        The mesh, or positions [m], which have neither boundary nor normals.
    """
    if len(expression) > _LONGEST:
        raise OptionError(f"a selection may have at most {_LONGEST} characters (got {len(expression)})")
    try:
        tree = ast.parse(expression.strip(), mode="eval").body
        with np.errstate(divide="ignore", invalid="ignore"):
            mask = _mask(tree, expression.strip(), surface)
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError) as error:
        if isinstance(error, OptionError):
            raise
        raise OptionError(
            f"cannot read the selection {shown(expression)}: {shortened(_fault(error))}; allowed: {_ALLOWED}"
        ) from error
    count = len(surface.vertices) if isinstance(surface, TriangleMesh) else len(surface)
    return np.broadcast_to(np.asarray(mask, dtype=bool), (count,)).copy()


def _refuse(node: ast.AST, text: str) -> OptionError:
    part = ast.get_source_segment(text, node) or type(node).__name__
    return OptionError(f"cannot use {shown(part)} in the selection {shown(text)}; allowed: {_ALLOWED}")


def _mask(node: ast.expr, text: str, surface: TriangleMesh | NDArray[np.float64]) -> Any:
    if isinstance(node, ast.BoolOp):
        masks = [_mask(value, text, surface) for value in node.values]
        combine = np.logical_and if isinstance(node.op, ast.And) else np.logical_or
        return combine.reduce(np.broadcast_arrays(*masks))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return np.logical_not(_mask(node.operand, text, surface))
    if isinstance(node, ast.Compare):
        values = [_value(part, text, surface) for part in (node.left, *node.comparators)]
        result: Any = True
        for compare, left, right in zip(node.ops, values[:-1], values[1:], strict=True):
            if type(compare) not in _COMPARE:
                raise _refuse(node, text)
            result = np.logical_and(result, _COMPARE[type(compare)](left, right))
        return result
    if isinstance(node, ast.Name) and node.id == "boundary":
        mesh = _mesh(surface, node, text)
        return np.isin(np.arange(len(mesh.vertices)), mesh.boundary_vertices)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        name = node.func.id
        if name in _ON_MESH:
            count, select = _ON_MESH[name]
            return select(_mesh(surface, node, text), *_numbers(node, text, count))
        if name in _ON_POINTS:
            count, select = _ON_POINTS[name]
            numbers = _numbers(node, text, count)
            if name == "nearest" and not all(abs(number) <= LARGEST for number in numbers):
                raise OptionError(f"nearest must have finite numbers of at most {LARGEST:g} (got {shown(text)})")
            return select(_points(surface), *numbers)
    raise _refuse(node, text)


def _value(node: ast.expr, text: str, surface: TriangleMesh | NDArray[np.float64]) -> Any:
    if isinstance(node, ast.Name) and node.id in ("x", "y", "z"):
        return _points(surface)[:, "xyz".index(node.id)]
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return np.float64(node.value)
    if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
        return _ARITHMETIC[type(node.op)](_value(node.left, text, surface), _value(node.right, text, surface))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -_value(node.operand, text, surface)
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "abs"
        and len(node.args) == 1
        and not node.keywords
    ):
        return np.abs(_value(node.args[0], text, surface))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "angle":
        return _angles(_mesh(surface, node, text), np.array(_numbers(node, text, 3)))
    raise _refuse(node, text)


def _points(surface: TriangleMesh | NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(surface.vertices if isinstance(surface, TriangleMesh) else surface)


def _mesh(surface: TriangleMesh | NDArray[np.float64], node: ast.AST, text: str) -> TriangleMesh:
    if not isinstance(surface, TriangleMesh):
        part = ast.get_source_segment(text, node)
        raise OptionError(f"cannot use {shown(part)} in the selection {shown(text)} of points without a mesh")
    return surface


def _numbers(node: ast.Call, text: str, count: int) -> list[float]:
    """The arguments of a call, which must be ``count`` numbers."""
    if node.keywords or len(node.args) != count:
        raise OptionError(
            f"{ast.get_source_segment(text, node)!r:.60} must have {count} numbers in the selection {shown(text)}"
        )
    values = []
    for argument in node.args:
        number = argument.operand if isinstance(argument, ast.UnaryOp) else argument
        sign = -1.0 if isinstance(argument, ast.UnaryOp) and isinstance(argument.op, ast.USub) else 1.0
        value = number.value if isinstance(number, ast.Constant) else None
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise _refuse(argument, text)
        values.append(sign * float(value))
    return values


def _boundary_loop(mesh: TriangleMesh, number: float) -> Mask:
    """Vertices of one boundary loop; loops that meet in a vertex count as one."""
    rim = mesh.edges[mesh.edge_faces[:, 1] < 0]
    labels = connected_parts(rim, len(mesh.vertices))
    lengths = np.bincount(labels[rim[:, 0]], weights=np.linalg.norm(np.diff(mesh.vertices[rim], axis=1)[:, 0], axis=1))
    return np.asarray(
        labels == _numbered("boundary", np.argsort(-lengths, kind="stable")[: np.sum(lengths > 0)], number)
    )


def _component(mesh: TriangleMesh, number: float) -> Mask:
    """Vertices of one connected part."""
    return np.asarray(mesh.components == _numbered("component", parts_by_area(mesh), number))


def _numbered(name: str, labels: NDArray[np.int64], number: float) -> int:
    if not 0 <= number < len(labels) or number != int(number):
        raise _NoSuchPartError(
            f"{name} must be a whole number below {len(labels)}, the number of them (got {number:g})"
        )
    return int(labels[int(number)])


def _angles(mesh: TriangleMesh, direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angle [deg] between a direction and the normal at each vertex, the mean of its triangles' by area."""
    if not (length := float(np.linalg.norm(direction))) > 0.0:
        raise OptionError("angle must be that to a direction (got zero)")
    normals = np.zeros((len(mesh.vertices), 3))
    np.add.at(normals, mesh.faces, (mesh.face_areas[:, None] * mesh.face_normals)[:, None])
    # Sheets that cross may leave a vertex on the junction without a mean normal: it is at right angles to all.
    sizes = np.linalg.norm(normals, axis=1)
    cosines = normals @ (direction / length) / np.where(sizes > 0.0, sizes, 1.0)
    return np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))


_SAMPLE = TriangleMesh([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[0, 1, 2]])
"""A mesh on which expressions are checked before the actual mesh is known."""
