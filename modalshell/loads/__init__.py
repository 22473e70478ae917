"""Loads on a shell: forces at points, along lines, and the base of further ones."""

from modalshell.loads.base import LOADS, Load
from modalshell.loads.forces import LineForce, PointForce

__all__ = ["LOADS", "LineForce", "Load", "PointForce"]
