"""Self-contact: shells of one mesh that pass neither through themselves nor through each other."""

from __future__ import annotations

from typing import Any, ClassVar, final

import numpy as np

from modalshell.core.checks import checked_number
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Mask
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, checked_selection, selected


@final
class SelfContact(ReadOnlyArrays):
    """Keeps triangles of a shell's mesh apart that share no vertex, by a barrier of incremental potential contact.

    Pairs of a vertex and a triangle, or of two edges, repel each other by the barrier potential
    ``kappa A gap b(d)`` of their distance d [li2020], from the ``gap`` on, with no bound as d vanishes. It is twice
    differentiable, and its stiffness kappa follows from the load, the mass and the step. Every step of Newton's method
    ends before the first pair would meet (continuous collision detection [li2021]). Layers come to rest at distances
    below the gap: take a gap about as large as the sheet is thick, or a small part of what is of interest. For DS with
    implicit steps. Needs ipctk, the extra ``contact``, which tells whether a start crosses itself. What a step costs
    over one without it, ``modalshell bench --only self_contact`` measures: 1.2 to 1.6 times on average on a strip of
    2,015 vertices that falls onto itself, and 3 to 7 times in the five steps in which it strikes: these need up to 23
    factorisations, where steps without it keep one.

    Parameters
    ----------
    gap : float, optional
        Distance [m] at which forces begin. It must be less than that of any two triangles, edges and vertices of the
        shell at rest that share no vertex; a quarter of it without a number.
    friction : float
        Coulomb's coefficient, smoothed, with the forces at the beginning of a step; for motions.
    sel : str, array_like of bool, shape (n,), or of int
        Vertices that may touch: triangles among them do, with their edges. ``"all"`` are all of them. Vertices that
        supports hold alone are refused.

    Raises
    ------
    OptionError
        For a gap that is not positive, a negative friction, or an invalid selection.
    """

    key: ClassVar = "self"
    has_surface: ClassVar = False
    """Whether it has a surface of its own to draw."""

    def __init__(self, gap: float | None = None, friction: float = 0.0, sel: Selection = "all") -> None:
        self.gap = None if gap is None else checked_number("gap", gap, above=0.0, unit="m")
        self.friction = checked_number("friction", friction, at_least=0.0)
        self.sel = sel if isinstance(sel, str) and sel == "all" else checked_selection("sel", sel)

    def __repr__(self) -> str:
        return f"SelfContact(gap={self.gap!r}, friction={self.friction!r}, sel={self.sel!r})"

    def vertices(self, mesh: TriangleMesh) -> Mask:
        """Mask (n,) of its vertices of a mesh; OptionError where it selects none."""
        if isinstance(self.sel, str) and self.sel == "all":
            return np.ones(len(mesh.vertices), dtype=bool)
        return selected("sel", self.sel, mesh)

    def plain(self) -> dict[str, Any]:
        """Its parameters, as texts and lists."""
        sel = self.sel.tolist() if isinstance(self.sel, np.ndarray) else self.sel
        return {"kind": self.key, "gap": self.gap, "friction": self.friction, "sel": sel}
