"""Flocks of boids, and crowds of instances of one shell."""

from modalshell.crowd.crowd import Crowd
from modalshell.crowd.flap import Flap
from modalshell.crowd.flight import Flight
from modalshell.crowd.flock import Flock
from modalshell.crowd.shell_crowd import LEVELS

__all__ = ["LEVELS", "Crowd", "Flap", "Flight", "Flock"]
