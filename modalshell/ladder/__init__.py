"""What accuracy costs: every rung on one scene, measured, and advice which one to take."""

from modalshell.ladder.advise import Advice, advise
from modalshell.ladder.candidates import MODES
from modalshell.ladder.case import Case
from modalshell.ladder.path import LoadPath, Snap
from modalshell.ladder.runs import Row
from modalshell.ladder.tradeoff import Tradeoff, tradeoff

__all__ = ["MODES", "Advice", "Case", "LoadPath", "Row", "Snap", "Tradeoff", "advise", "tradeoff"]
