"""While a command is imported, Ctrl-C ends it with one line, and the search for cyclic garbage is off.

The package imports this module first.
"""

from __future__ import annotations

import gc
import sys
from pathlib import Path
from types import TracebackType

_previous = sys.excepthook


def _hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if issubclass(kind, KeyboardInterrupt):
        print("modalshell: stopped", file=sys.stderr)
    else:
        _previous(kind, error, trace)


def is_command(arguments: list[str]) -> bool:
    """Whether a process with these arguments is the package's own command, by its script or by ``-m``."""
    for place, argument in enumerate(arguments[1:], start=1):
        if argument == "-m":
            return arguments[place + 1 : place + 2] == ["modalshell"]
        if not argument.startswith("-") and arguments[place - 1] not in ("-X", "-W"):
            break  # the script: what follows are its own arguments
    return any(Path(argument).stem == "modalshell" for argument in arguments[:2])


def collect_again() -> None:
    """Look for cyclic garbage from now on, among what is made from now on, if this process is the command."""
    if is_command(sys.orig_argv):
        gc.freeze()  # what was imported stays
        gc.enable()


if is_command(sys.orig_argv):
    sys.excepthook = _hook
    gc.disable()  # imports make objects by the hundred thousand: to look for cycles is a twentieth of their time
