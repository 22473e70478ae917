r"""The discrete-shell energies as SymPy expressions on their stencils [choi2007, eq. 1-4; grinspun2003].

Every energy is :math:`E = w (g - g_0)^2` with a geometric measure :math:`g` and a weight :math:`w` = stiffness over
rest size, so that

.. math:: \nabla E = 2 w (g - g_0) \nabla g, \qquad
          \nabla^2 E = 2 w \nabla g \nabla g^T + 2 w (g - g_0) \nabla^2 g .

See theory 3, eq. 2.

Measures are written in edge-relative unknowns :math:`p_k = x_k - x_0`: translation is then divided out, and a hinge has
nine unknowns in place of twelve.

:math:`\nabla^2 g` is indefinite for areas and angles. Its second variation splits in closed form into squares and
products of linear forms of the step d,

.. math:: d^T \nabla^2 g\, d = \sum_j a_j (r_j \cdot d)^2 + 2 \sum_k (m_k \cdot d)(n_k \cdot d),

and each product into a square to keep and a square to drop, so that a positive semi-definite Hessian costs no
eigenvalue problem: see :attr:`Energy.squares` and :attr:`Energy.products`.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp

LinearForm = tuple[sp.Expr, ...]
"""A linear form of the step: one coefficient an unknown."""


@dataclass(frozen=True)
class Energy:
    """One quadratic energy of a geometric measure."""

    name: str
    """Name of the generated module."""
    measure_name: str
    """What ``g`` is, with its unit."""
    stencil: str
    """The vertices of one element, in their order."""
    formula: str
    """The energy as the docstring of the generated module prints it."""
    unknowns: tuple[sp.Symbol, ...]
    """The components of x_1 - x_0, x_2 - x_0, ..."""
    measure: sp.Expr
    """``g`` in the unknowns."""
    gradient: tuple[sp.Expr, ...]
    """``dg/dp``, one entry an unknown."""
    squares: tuple[tuple[sp.Expr, LinearForm], ...] = ()
    """The positive factors a_j and forms r_j of the split above."""
    products: tuple[tuple[LinearForm, LinearForm], ...] = ()
    """The pairs m_k, n_k of the split above; m_k and n_k are orthogonal."""
    periodic: bool = False
    """Whether ``g - g0`` is an angle to be taken in (-pi, pi]."""

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


def _row(*blocks: sp.Matrix) -> LinearForm:
    return tuple(entry for block in blocks for entry in block)


def shear() -> Energy:
    """Edge length, E_h = k_h (l - l0)^2 / l0 [choi2007, eq. 2]."""
    e = _vector("e")
    measure = sp.sqrt(e.dot(e))
    # d.Hess l.d = |d x e|^2 / l^3
    squares = tuple((measure**-3, _row(e.cross(sp.Matrix(axis)))) for axis in sp.eye(3).tolist())
    return Energy(
        name="shear",
        measure_name="edge length l [m]",
        stencil="x0, x1: the edge",
        formula="E_h = k_h (l - l0)^2 / l0",
        unknowns=tuple(e),
        measure=measure,
        gradient=tuple(sp.diff(measure, unknown) for unknown in e),
        squares=squares,
    )


def stretch() -> Energy:
    """Triangle area, E_s = k_s (A - A0)^2 / A0 [choi2007, eq. 1]."""
    a, b = _vector("a"), _vector("b")
    normal = a.cross(b)
    twice_area = sp.sqrt(normal.dot(normal))
    # grad |n| = (b x n, n x a) / |n|: the gradient in closed form keeps the Hessian short.
    gradient = tuple(b.cross(normal) / twice_area / 2) + tuple(normal.cross(a) / twice_area / 2)
    # Out of the plane an area grows by |z_a b - z_b a|^2 / (8 A); in the plane it is a product of coordinates,
    # d.Hess A.d = da_u db_v - da_v db_u.
    unit = normal / twice_area
    along = a / sp.sqrt(a.dot(a))
    across = unit.cross(along)
    none = sp.zeros(3, 1)
    factor = 1 / (2 * twice_area)
    squares = tuple((factor, _row(unit * b.dot(axis), -unit * a.dot(axis))) for axis in (along, across))
    products = ((_row(along / 2, none), _row(none, across)), (_row(-across / 2, none), _row(none, along)))
    return Energy(
        name="stretch",
        measure_name="triangle area A [m^2]",
        stencil="x0, x1, x2: the triangle, in its winding",
        formula="E_s = k_s (A - A0)^2 / A0",
        unknowns=(*a, *b),
        measure=twice_area / 2,
        gradient=gradient,
        squares=squares,
        products=products,
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

    # Each triangle adds 2 (n.c)(m.c)/h^2 + 2 (n.de)/l (t.c/h + m.de/(2 l)), with c the apex's step past its foot on the
    # edge, n the normal, t the edge and m across it towards the apex, h the height and l the edge's length.
    tangent = e / length
    products = []
    for normal, apex, place in ((normal_1, a, 0), (normal_2, b, 1)):
        size = sp.sqrt(normal.dot(normal))
        unit, height, foot = normal / size, size / length, apex.dot(e) / length_squared
        across = (apex - foot * e) / height

        def apex_step(
            vector: sp.Matrix, foot: sp.Expr = foot, height: sp.Expr = height, place: int = place
        ) -> LinearForm:
            blocks = [sp.zeros(3, 1), sp.zeros(3, 1)]
            blocks[place] = vector / height
            return _row(-foot * vector / height, *blocks)

        def edge_step(vector: sp.Matrix) -> LinearForm:
            return _row(vector / length, sp.zeros(3, 1), sp.zeros(3, 1))

        slide = tuple(p + q / 2 for p, q in zip(apex_step(tangent), edge_step(across), strict=True))
        products += [(apex_step(unit), apex_step(across)), (edge_step(unit), slide)]
    return Energy(
        name="flexure",
        measure_name="fold angle theta [rad], 0 where flat",
        stencil="x0, x1: the edge; x2: opposite vertex of triangle (x0, x1, x2); x3: of triangle (x1, x0, x3)",
        formula="E_f = k_f (theta - theta0)^2 l0 / h0",
        unknowns=(*e, *a, *b),
        measure=measure,
        gradient=(*gradient_e, *gradient_a, *gradient_b),
        products=tuple(products),
        periodic=True,
    )


def all_energies() -> tuple[Energy, ...]:
    """The energies in the order in which the shell adds them up."""
    return stretch(), shear(), flexure()
