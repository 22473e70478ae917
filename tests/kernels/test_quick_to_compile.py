"""Kernels are written in loops over numbers: what takes numba seconds to compile is kept out of them."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "modalshell"
MAKERS = {"njit", "operation_of", "register_jitable", "overload"}
"""What makes a kernel of a function, itself or by a name that a module gives its result."""
PLAIN = {"empty", "zeros", "full", "sqrt", "arctan2", "copysign", "isfinite", "rint", "float32", "float64"} | {
    "int64", "uint64", "uintp"
}  # fmt: skip
"""Functions of NumPy that compile in a tenth of a second; others sort, reduce or broadcast, in up to eight seconds."""
REDUCTIONS = {"all", "any", "argmax", "argmin", "argsort", "dot", "max", "mean", "min", "sort", "sum"}
LISTED = {
    "models/hybrid/assumed_stress_step.py: np.linalg.eigh",  # the way off a saddle: an own solver takes as long
    "statics/mixed_newton.py: out[k] = values[k]",  # of one axis
}


def names_of(node):
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def kernels_of(tree):
    made = {
        target.id
        for line in tree.body
        if isinstance(line, ast.Assign) and isinstance(line.value, ast.Call) and names_of(line.value.func) & MAKERS
        for target in line.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any(names_of(one) & (MAKERS | made) for one in node.decorator_list):
            yield node


def is_slow(node):
    """Whether a part of a kernel is a product of matrices, a reduction, or writes an array to a slice."""
    match node:
        case ast.BinOp(op=ast.MatMult()):
            return True
        case ast.Call(func=ast.Attribute(value=ast.Name("np"), attr=name)):
            return name not in PLAIN
        case ast.Call(func=ast.Attribute(value=ast.Attribute(value=ast.Name("np")))):
            return True
        case ast.Call(func=ast.Attribute(attr=name)):
            return name in REDUCTIONS
        case ast.Assign(targets=[*targets], value=value) if not isinstance(value, ast.Constant):
            written = [part for target in targets for part in getattr(target, "elts", [target])]
            slots = [part.slice for part in written if isinstance(part, ast.Subscript)]
            return any(isinstance(part, ast.Slice) for slot in slots for part in ast.walk(slot))
    return False


def rows_of(kernel):
    """What writes a row at once, of an array that the kernel indexes by more numbers elsewhere."""
    axes = {}
    for part in ast.walk(kernel):
        if isinstance(part, ast.Subscript):
            name, count = ast.unparse(part.value), len(getattr(part.slice, "elts", [part.slice]))
            axes[name] = max(count, axes.get(name, 0))
    for line in ast.walk(kernel):
        match line:
            case ast.Assign(targets=[ast.Subscript(value=array, slice=slot)], value=ast.Name() | ast.Subscript()):
                if len(getattr(slot, "elts", [slot])) < axes[ast.unparse(array)]:
                    yield line


def slow_parts(source):
    found = []
    if not any(maker in source for maker in MAKERS):
        return found  # a tree of every file would take three times as long
    for kernel in kernels_of(ast.parse(source)):
        found += [*filter(is_slow, ast.walk(kernel)), *rows_of(kernel)]
    return [ast.unparse(node.func if isinstance(node, ast.Call) else node) for node in found]


@pytest.mark.parametrize(
    ("line", "slow"),
    [
        ("y = a @ b", True),
        ("y = np.cross(a, b)", True),
        ("y = np.linalg.solve(a, b)", True),
        ("y = a[:, 0].sum()", True),
        ("a[:] = b", True),
        ("a[:], b[2:] = x, y", True),
        ("a[:] = 0.0", False),
        ("a[i] = b[i]", False),
        ("a[0, 0] = 0.0; a[i] = b", True),
        ("y = np.zeros(3)", False),
    ],
)
def test_slow_parts_are_found(line, slow):
    for decorator in ("@njit(fastmath=False)", "@kernel"):
        source = f"kernel = njit(fastmath=False)\n{decorator}\ndef f(a, b):\n    {line}\n"
        assert (slow_parts(source) != []) is slow
    assert slow_parts(f"def f(a, b):\n    {line}\n") == []


def test_kernels_are_quick_to_compile():
    found = {
        f"{path.relative_to(PACKAGE).as_posix()}: {part}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for part in slow_parts(path.read_text(encoding="utf-8"))
    }
    assert found == LISTED
