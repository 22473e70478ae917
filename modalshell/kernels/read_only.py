"""Arrays that a kernel passes on as read-only: what it calls is then compiled for one kind of argument, Python's."""

# ruff: noqa: ARG001 (numba calls code generators by position)

from __future__ import annotations

from typing import Any

from numba.core.imputils import impl_ret_borrowed
from numba.core.typing.templates import Signature, signature
from numba.extending import intrinsic


def _unwritten(context: Any, array: Any) -> tuple[Signature, Any]:
    """The same array (of any shape), of numba's type for those that are not written to."""

    def generate(target: Any, builder: Any, sig: Signature, args: Any) -> Any:
        # Counted, where the caller counts: it counts what it was given down again.
        return impl_ret_borrowed(target, builder, sig.return_type, args[0])  # type: ignore[no-untyped-call]

    return signature(array.copy(readonly=True), array), generate  # type: ignore[no-untyped-call]


unwritten: Any = intrinsic(_unwritten)
