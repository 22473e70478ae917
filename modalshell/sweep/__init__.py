"""Sweeps: a grid of scenes over worker processes or a cluster, each finished case stored at once."""

from modalshell.sweep.grid import Sweep, load_sweep
from modalshell.sweep.run_sweep import SweepResult, run_sweep

__all__ = ["Sweep", "SweepResult", "load_sweep", "run_sweep"]
