"""Loads on a shell: point, line and edge loads, pressure, wind, weight, inertia, and their base class."""

from modalshell.loads.applied import AppliedLoad
from modalshell.loads.base import LOADS, LiveLoad, Load
from modalshell.loads.body import FrameInertia, SelfWeight
from modalshell.loads.forces import LineForce, PointForce
from modalshell.loads.loading import Loading
from modalshell.loads.scaled import Scaled
from modalshell.loads.surface import Pressure, Wind
from modalshell.loads.turning import EdgeMoment, FollowerForce

__all__ = [
    "LOADS",
    "AppliedLoad",
    "EdgeMoment",
    "FollowerForce",
    "FrameInertia",
    "LineForce",
    "LiveLoad",
    "Load",
    "Loading",
    "PointForce",
    "Pressure",
    "Scaled",
    "SelfWeight",
    "Wind",
]
