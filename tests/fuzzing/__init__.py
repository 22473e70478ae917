"""Fuzzing of everything that takes input: mesh files, arrays, scene files, saved results, the command line."""

from fuzzing.harness import (
    DirtyExit,
    Escape,
    FuzzFinding,
    HalfRead,
    Hang,
    Input,
    SilentNonFinite,
    UncaughtException,
    UselessMessage,
    fuzz,
    outcome,
)

__all__ = [
    "DirtyExit",
    "Escape",
    "FuzzFinding",
    "HalfRead",
    "Hang",
    "Input",
    "SilentNonFinite",
    "UncaughtException",
    "UselessMessage",
    "fuzz",
    "outcome",
]
