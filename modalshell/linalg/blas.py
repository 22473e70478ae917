"""BLAS and LAPACK of SciPy inside compiled functions that numba can still cache.

A function pointer that is a global constant would keep a function out of numba's cache: :data:`BLAS` is an argument.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba.core.types as nt
import numpy as np
from llvmlite import ir
from numba.extending import get_cython_function_address, intrinsic

from modalshell.kernels.compiler import njit


class Blas(NamedTuple):
    """Addresses of functions, of the letters of their options, and of factors."""

    potrf: int
    trsm: int
    syrk: int
    gemm: int
    lower: int
    no: int
    transposed: int
    right: int
    one: int
    minus: int
    zero: int


_LETTERS = np.frombuffer(b"LNTR", np.uint8)
_FACTORS = {kind: np.array([1.0, -1.0, 0.0], kind) for kind in ("f8", "f4")}


def _functions(letter: str, factors: Any) -> Blas:
    """Those of one precision."""
    return Blas(
        get_cython_function_address("scipy.linalg.cython_lapack", f"{letter}potrf"),
        *(get_cython_function_address("scipy.linalg.cython_blas", letter + name) for name in ("trsm", "syrk", "gemm")),
        *(_LETTERS.ctypes.data + k for k in range(_LETTERS.size)),
        *(factors.ctypes.data + factors.itemsize * k for k in range(factors.size)),
    )


BLAS, SINGLE_BLAS = _functions("d", _FACTORS["f8"]), _functions("s", _FACTORS["f4"])


@njit(inline="always")
def address(array: Any) -> Any:
    """Address of an array's first number; signed, since numba adds signed to unsigned integers as floats.

    The array must be an argument of the compiled function: numba frees an array of its own after its last use by name.
    """
    return np.int64(array.ctypes.data)


def _call(_typing_context: Any, address: Any, arguments: Any) -> Any:
    """Call the C function ``void f(...)`` at ``address`` with pointers, each an integer of the tuple ``arguments``."""
    signature = nt.void(address, arguments)

    def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
        pointer, packed = values
        word = ir.IntType(64)
        unpacked = [builder.extract_value(packed, k) for k in range(len(arguments))]
        function_type = ir.FunctionType(ir.VoidType(), [word] * len(unpacked))
        function = builder.inttoptr(pointer, function_type.as_pointer())
        builder.call(function, unpacked)
        return context.get_dummy_value()

    return signature, generate


call: Any = intrinsic(_call)
