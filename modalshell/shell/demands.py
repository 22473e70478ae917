"""Memory that a shell needs, asked for before it is built."""

from __future__ import annotations

from modalshell.core.memory import demand_memory

_VERTEX_BYTES, _SPLIT_VERTEX_BYTES = 2_700, 6_200
"""Memory of the assembly of the stiffness pattern, and of that with fold shares [bytes]."""


def demand_shell(vertices: int, *, split: bool) -> None:
    """OptionError if there is no memory for a shell of that many vertices; ``split``: of :class:`Isotropic`."""
    each = _SPLIT_VERTEX_BYTES if split else _VERTEX_BYTES
    demand_memory(f"a shell of {vertices} vertices", each * vertices, "take a coarser mesh")
