"""Functions that only kernels call: numba links them into their callers and makes no machine code of their own.

Numba optimises each function with all that it calls, and makes machine code of both, at every level of calls. What
only kernels call is met again in the kernel, and is optimised there once: that saves nearly half of the seconds that an
implicit step takes to compile, for the same machine code.
"""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from typing import Any

from numba.core import codegen, compiler

_Library: Any = codegen.JITCodeLibrary
_Compiler: Any = compiler.Compiler


@ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
def _refuse(*_: Any) -> None:
    """What a call by Python runs, or the process would end: of no result Python makes a SystemError."""
    with suppress(Exception):  # one that left this function would not reach Python
        print("modalshell: only kernels can call this function; njit(entry=True) lets Python do so", file=sys.stderr)


class _LinkedLibrary(_Library):  # type: ignore[misc]
    """LLVM code of one function, linked with what it calls, for the libraries of its callers."""

    def _optimize_final_module(self) -> None:
        """Nothing: each caller would do it once more."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int | None:  # noqa: ARG002
        """Address of the function for Python."""
        return ctypes.cast(_refuse, ctypes.c_void_p).value

    @property
    def codegen(self) -> Any:
        """What numba tells of the environment of a function, which has no address here."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Nothing: only conversions to Python's objects need an environment."""


class _LinkedCompiler(_Compiler):  # type: ignore[misc]
    """Numba's compiler with such a library for the function."""

    def define_pipelines(self) -> Any:
        """Numba's passes, after the library has been made."""
        self.state.library = _LinkedLibrary(self.state.targetctx.codegen(), self.state.func_id.func_qualname)
        return super().define_pipelines()


LINKED: dict[str, Any] = {"no_cfunc_wrapper": True, "no_cpython_wrapper": True, "pipeline_class": _LinkedCompiler}
"""Options of a function that only kernels call. Such functions are not kept in the cache: their callers are."""
