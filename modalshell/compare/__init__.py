"""Comparison of models on one scene: error against cost, and advice which model to take."""

from modalshell.compare.advise import Advice, advise
from modalshell.compare.candidates import MODES
from modalshell.compare.case import Case
from modalshell.compare.path import LoadPath, Snap
from modalshell.compare.quick_advice import QuickAdvice, quick_advice
from modalshell.compare.runs import Measurement
from modalshell.compare.tradeoff import Tradeoff, tradeoff

__all__ = [
    "MODES",
    "Advice",
    "Case",
    "LoadPath",
    "Measurement",
    "QuickAdvice",
    "Snap",
    "Tradeoff",
    "advise",
    "quick_advice",
    "tradeoff",
]
