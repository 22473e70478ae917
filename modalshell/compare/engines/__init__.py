"""Other engines on the shells of this package: each in a process of its own, counted once its conversion has held."""

from modalshell.compare.engines.answer import EngineAnswer, answered
from modalshell.compare.engines.engine import ENGINES, Engine

__all__ = ["ENGINES", "Engine", "EngineAnswer", "answered"]
