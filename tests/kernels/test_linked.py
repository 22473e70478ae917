"""Functions that only kernels call are linked into them, and have no machine code that Python could call."""

import ast
import contextlib
import importlib
import pkgutil
import types
from pathlib import Path

import numpy as np
import pytest
from numba.core.registry import CPUDispatcher

import modalshell
from modalshell.kernels.compiler import njit


def modules():
    """Every module of the package that this machine can import; others need an extra."""
    for found in pkgutil.walk_packages(modalshell.__path__, "modalshell."):
        if not found.name.endswith("__main__"):
            with contextlib.suppress(ImportError):
                yield importlib.import_module(found.name)


def is_linked(value):
    return isinstance(value, CPUDispatcher) and value.targetoptions.get("no_cpython_wrapper", False)


def is_compiled(module, node):
    """Whether a function's body is for numba: a kernel, or the choice of one by its arguments' types."""
    texts = [ast.unparse(decorator) for decorator in node.decorator_list]
    return isinstance(getattr(module, node.name, None), CPUDispatcher) or any(
        text.startswith(("overload", "operation_of", "intrinsic", "_jitable")) for text in texts
    )


def calls_by_python(module):
    """Linked functions that Python code of a module would call."""
    waiting = [ast.parse(Path(module.__file__).read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef) and is_compiled(module, node):
            continue
        waiting += ast.iter_child_nodes(node)
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name):
            called = getattr(module, node.func.id, None)
        elif isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.Name):
            owner = getattr(module, node.func.value.id, None)
            called = getattr(owner, node.func.attr, None) if isinstance(owner, types.ModuleType) else None
        else:
            continue
        if is_linked(called):
            yield f"{module.__name__}:{node.lineno}: {ast.unparse(node.func)}"


@pytest.mark.slow
def test_python_calls_no_function_that_has_no_code_of_its_own():
    seen = [value for module in modules() for value in vars(module).values() if is_linked(value)]
    assert len(seen) > 100  # the walk finds them
    assert [call for module in modules() for call in calls_by_python(module)] == []


def test_kernels_give_what_their_linked_functions_say():
    inner = njit(entry=False, error_model="numpy")(lambda a, b: a / b + 1.0)

    @njit(entry=True, error_model="numpy")
    def outer(a, b, out):
        for k in range(len(out)):
            out[k] = inner(a[k], b[k])

    a, b, out = np.arange(5.0), np.array([1.0, 2.0, 0.0, -4.0, 0.5]), np.empty(5)
    with np.errstate(divide="ignore"):
        exact = a / b + 1.0
    outer(a, b, out)
    np.testing.assert_array_equal(out, exact)
    assert is_linked(inner)
    assert not is_linked(outer)
    (compiled,) = inner.overloads.values()
    assert compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name) == (
        compiled.library.get_pointer_to_function("any other")
    )


def test_calls_by_python_are_refused(capsys):
    inner = njit(entry=False)(lambda a: a + 1.0)
    for _ in range(2):  # as it is compiled, and afterwards
        with pytest.raises(SystemError):
            inner(1.0)
        assert "only kernels can call this function" in capsys.readouterr().err


def test_errors_of_linked_functions_reach_python():
    @njit(entry=False)
    def inner(a):
        if a < 0.0:
            raise ValueError("negative")
        return a

    @njit(entry=True)
    def outer(a):
        return inner(a)

    assert outer(2.0) == 2.0
    with pytest.raises(ValueError, match="negative"):
        outer(-1.0)


@pytest.mark.parametrize("entry", [None, False, True])
def test_names_say_whether_python_calls_a_kernel_unless_that_is_said(entry):
    def _private(a):
        return a

    _private.__module__ = "modalshell.kernels.toy"
    options = njit(entry=entry)(_private).targetoptions
    assert options.get("no_cpython_wrapper", False) == (entry is not True)
    _private.__module__ = "plugin"  # others know nothing of underscores
    options = njit(entry=entry)(_private).targetoptions
    assert options.get("no_cpython_wrapper", False) == (entry is False)


def test_parallel_kernels_are_entries():
    def _private(a):
        return a

    _private.__module__ = "modalshell.kernels.toy"
    assert not is_linked(njit(parallel=True)(_private))
