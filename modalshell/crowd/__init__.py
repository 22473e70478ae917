"""Flocks of boids, and crowds of instances of one shell: their scenes, runs, films and pages, too."""

from modalshell.crowd.crowd import Crowd
from modalshell.crowd.flap import Flap
from modalshell.crowd.flight import Flight
from modalshell.crowd.flock import Flock
from modalshell.crowd.run import FlightResult
from modalshell.crowd.scene import FlockScene
from modalshell.crowd.shell_crowd import LEVELS

__all__ = ["LEVELS", "Crowd", "Flap", "Flight", "FlightResult", "Flock", "FlockScene"]
