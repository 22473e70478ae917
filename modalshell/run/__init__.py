"""Running scenes: every stored frame goes to disk at once, so that a killed run goes on where it was."""

from modalshell.run.flight_film import FlightReport
from modalshell.run.results import write_results
from modalshell.run.run_flock import FlightResult
from modalshell.run.run_scene import SceneResult, run_scene

__all__ = ["FlightReport", "FlightResult", "SceneResult", "run_scene", "write_results"]
