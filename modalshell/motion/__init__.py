"""Motion: time stepping of any rung."""

from modalshell.motion.simulate import Trajectory, simulate

__all__ = ["Trajectory", "simulate"]
