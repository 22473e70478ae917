"""Position and orientation constraints on patches of vertices, and how modal models meet them."""

from modalshell.constraints.constraints import Constraint, OrientationConstraint, PositionConstraint

__all__ = ["Constraint", "OrientationConstraint", "PositionConstraint"]
