"""Sweeps: a grid of scenes over worker processes or a cluster, each finished case stored at once."""

from modalshell.sweep.driver import SweepResult, run_sweep
from modalshell.sweep.grid import Sweep, load_sweep

__all__ = ["Sweep", "SweepResult", "load_sweep", "run_sweep"]
