"""Motion: time stepping of any model, with moving supports and constraints."""

from modalshell.motion.simulate import simulate
from modalshell.motion.stepping import Motion
from modalshell.motion.trajectory import Trajectory
from modalshell.supports import SupportPath

__all__ = ["Motion", "SupportPath", "Trajectory", "simulate"]
