"""Running scenes: every stored frame goes to disk at once, so that a killed run goes on where it was.

Other processes may follow a run by what it has stored, and it does not notice them.
"""

from modalshell.run.flight_film import FlightReport
from modalshell.run.follow import RunFollower
from modalshell.run.results import write_results
from modalshell.run.run_flock import FlightResult
from modalshell.run.run_scene import run_scene
from modalshell.run.run_shell import SceneResult

__all__ = ["FlightReport", "FlightResult", "RunFollower", "SceneResult", "run_scene", "write_results"]
