"""Motion: time stepping of any rung, with moving supports."""

from modalshell.motion.simulate import Trajectory, simulate
from modalshell.motion.supports import SupportPath

__all__ = ["SupportPath", "Trajectory", "simulate"]
