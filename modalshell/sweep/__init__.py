"""Sweeps: a grid of scenes on worker processes or a cluster; each finished case is stored at once.

A sweep file names a scene, the values of some of its keys (``[axes]``), and optionally a model to compare with
(``[truth]``). After a stop or a kill the same command computes only the missing cases, and the summary is bit-identical
to that of an uninterrupted sweep. Cases that are refused, crash or exceed the time limit are rows too.
"""

from modalshell.sweep.driver import SweepResult, run_sweep
from modalshell.sweep.grid import Sweep, load_sweep

__all__ = ["Sweep", "SweepResult", "load_sweep", "run_sweep"]
