"""BLAS and LAPACK of SciPy inside compiled functions that numba can still cache.

A function pointer that is a global constant would keep a function out of numba's cache. The addresses are arguments
here: :data:`BLAS` holds them in the order of the constants below.
"""

from __future__ import annotations

from typing import Any

import numba.core.types as nt
import numpy as np
from llvmlite import ir
from numba.extending import get_cython_function_address, intrinsic

from modalshell.kernels.compiler import njit

POTRF, TRSM, SYRK, GEMM, TRSV, GEMV = range(6)

_NAMES = ("lapack", "dpotrf"), *(("blas", name) for name in ("dtrsm", "dsyrk", "dgemm", "dtrsv", "dgemv"))
_ADDRESSES = [get_cython_function_address(f"scipy.linalg.cython_{library}", name) for library, name in _NAMES]
BLAS = np.array(_ADDRESSES, np.int64), np.frombuffer(b"LNTR", np.uint8), np.array([1.0, -1.0, 0.0])
"""What compiled functions take as ``addresses``, in the order of the constants, ``letters`` and ``scalars``.

The letters are options: left or lower, no transpose or no unit diagonal, transposed, right; the scalars are factors.
"""


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
