r"""The discrete-shell energies as SymPy expressions on their stencils [choi2007, eq. 1-4; grinspun2003].

Every energy is :math:`E = w (g - g_0)^2` with a geometric measure :math:`g` and a weight :math:`w` = stiffness over
rest size, so that

.. math:: \nabla E = 2 w (g - g_0) \nabla g, \qquad
          \nabla^2 E = 2 w \nabla g \nabla g^T + 2 w (g - g_0) \nabla^2 g .

Measures are written in edge-relative unknowns :math:`p_k = x_k - x_0`: translation is then divided out, and a hinge has
nine unknowns in place of twelve.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp


@dataclass(frozen=True)
class Energy:
    """One quadratic energy of a geometric measure.

    Attributes
    ----------
    name : str
        Name of the generated module.
    measure_name : str
        What ``g`` is, with its unit.
    stencil : str
        The vertices of one element, in their order.
    formula : str
        The energy as the docstring of the generated module prints it.
    unknowns : tuple of sympy.Symbol
        The components of x_1 - x_0, x_2 - x_0, ...
    measure : sympy.Expr
        ``g`` in the unknowns.
    gradient : tuple of sympy.Expr
        ``dg/dp``, one entry an unknown.
    periodic : bool
        Whether ``g - g0`` is an angle to be taken in (-pi, pi].
    """

    name: str
    measure_name: str
    stencil: str
    formula: str
    unknowns: tuple[sp.Symbol, ...]
    measure: sp.Expr
    gradient: tuple[sp.Expr, ...]
    periodic: bool = False

    @property
    def vertex_count(self) -> int:
        """Number of vertices of the stencil."""
        return len(self.unknowns) // 3 + 1

    def hessian(self) -> list[sp.Expr]:
        """Lower triangle of ``d2g/dp2``, row by row: (0,0), (1,0), (1,1), (2,0), ..."""
        return [
            sp.diff(self.gradient[row], self.unknowns[column])
            for row in range(len(self.unknowns))
            for column in range(row + 1)
        ]


def _vector(name: str) -> sp.Matrix:
    return sp.Matrix(sp.symbols(f"{name}_x {name}_y {name}_z", real=True))


def _differentiated(measure: sp.Expr, unknowns: tuple[sp.Symbol, ...]) -> tuple[sp.Expr, ...]:
    return tuple(sp.diff(measure, unknown) for unknown in unknowns)


def shear() -> Energy:
    """Edge length, E_h = k_h (l - l0)^2 / l0 [choi2007, eq. 2]."""
    e = _vector("e")
    measure = sp.sqrt(e.dot(e))
    return Energy(
        name="shear",
        measure_name="edge length l [m]",
        stencil="x0, x1: the edge",
        formula="E_h = k_h (l - l0)^2 / l0",
        unknowns=tuple(e),
        measure=measure,
        gradient=_differentiated(measure, tuple(e)),
    )


def stretch() -> Energy:
    """Triangle area, E_s = k_s (A - A0)^2 / A0 [choi2007, eq. 1]."""
    a, b = _vector("a"), _vector("b")
    normal = a.cross(b)
    twice_area = sp.sqrt(normal.dot(normal))
    # grad |n| = (b x n, n x a) / |n|: the gradient in closed form keeps the Hessian short.
    gradient = tuple(b.cross(normal) / twice_area / 2) + tuple(normal.cross(a) / twice_area / 2)
    return Energy(
        name="stretch",
        measure_name="triangle area A [m^2]",
        stencil="x0, x1, x2: the triangle, in its winding",
        formula="E_s = k_s (A - A0)^2 / A0",
        unknowns=(*a, *b),
        measure=twice_area / 2,
        gradient=gradient,
    )


def flexure() -> Energy:
    """Signed fold angle of a hinge, E_f = k_f (theta - theta0)^2 l0 / h0 [choi2007, eq. 3].

    ``theta = atan2((n1 x n2) . e/|e|, n1 . n2)`` with ``n1 = e x a`` and ``n2 = b x e``; its first argument equals
    ``-|e| n1 . b``, which needs no second cross product. The gradient is the known closed form (a vertex off the edge
    moves the fold along its triangle's normal by one over its height; the edge's ends share the reaction by the
    lever rule); a test holds it against SymPy's derivative of the atan2.
    """
    e, a, b = _vector("e"), _vector("a"), _vector("b")
    normal_1, normal_2 = e.cross(a), b.cross(e)
    length_squared = e.dot(e)
    length = sp.sqrt(length_squared)
    measure = sp.atan2(-length * normal_1.dot(b), normal_1.dot(normal_2))
    gradient_a = -length * normal_1 / normal_1.dot(normal_1)
    gradient_b = -length * normal_2 / normal_2.dot(normal_2)
    gradient_e = -(a.dot(e) * gradient_a + b.dot(e) * gradient_b) / length_squared
    return Energy(
        name="flexure",
        measure_name="fold angle theta [rad], 0 where flat",
        stencil="x0, x1: the edge; x2: opposite vertex of triangle (x0, x1, x2); x3: of triangle (x1, x0, x3)",
        formula="E_f = k_f (theta - theta0)^2 l0 / h0",
        unknowns=(*e, *a, *b),
        measure=measure,
        gradient=(*gradient_e, *gradient_a, *gradient_b),
        periodic=True,
    )


def all_energies() -> tuple[Energy, ...]:
    """The energies in the order in which the shell adds them up."""
    return stretch(), shear(), flexure()
