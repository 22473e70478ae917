"""Terminal, progress bar and exit status, shared by all commands."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, get_args

from cyclopts import Token, convert
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from modalshell.core.checks import printable
from modalshell.core.errors import FileFormatError
from modalshell.core.outcome import Outcome
from modalshell.core.timings import Stopwatch
from modalshell.files.provenance import repository_file

CONSOLE = Console()
ERRORS = Console(stderr=True)

LOG_EVERY = 60.0
"""Seconds between the lines of progress in a log."""


def log_line(text: str, done: int, total: int, seconds: float, first: tuple[int, float] = (0, 0.0)) -> str:
    """How far some work is after a number of seconds, and the time that is left at its rate since ``first``.

    That is the first step that was reported: it compiles kernels, or ends what a stopped run had already.
    """
    so_far = f"{text}: {done} of {total} after {seconds:.0f} s"
    if done >= total:
        return so_far
    known = done > first[0]
    left = (seconds - first[1]) / (done - first[0]) * (total - done) if known else 0.0
    return so_far + (f", {left:.0f} s left" if known else ", time left unknown")


def say(*lines: object, sep: str = " ") -> None:
    """Print what may hold names of files, without the control characters that would steer the terminal."""
    print(*(printable(str(line)) for line in lines), sep=sep)


def show_markdown(text: str) -> None:
    """Print a text in Markdown as terminals show it."""
    from rich.markdown import Markdown  # few commands need it, and its import takes long

    CONSOLE.print(Markdown(text))


_INPUTS = (None, "--scene", "--data")
"""Keywords of files that are read; what has none is, too."""


def converted(kind: Any, tokens: Sequence[Token]) -> Any:
    """The value of a parameter of some type.

    An input such as ``meshes/leaf.obj`` that is not in the working folder is the bundled one, as in scenes. ValueError
    for a fraction of a whole number, which would be rounded.
    """
    if Path in (kind, *get_args(kind)):
        tokens = [_bundled(token) if token.keyword in _INPUTS else token for token in tokens]
    if int in (kind, *get_args(kind)):
        for token in tokens:
            if _is_fraction(token.value):
                raise ValueError(f"must be a whole number (got {token.value})")
    return convert(kind, tokens)


def _is_fraction(text: str) -> bool:
    """Whether a text is a number, but no whole one."""
    try:
        return float(text) % 1.0 != 0.0  # so are infinity and NaN, whose rest is NaN
    except ValueError:
        return False


def _bundled(token: Token) -> Token:
    """The token, with the path of a bundled mesh or scene where it names one that is not in the working folder."""
    if Path(token.value).exists() or not token.value.startswith(("meshes/", "studies/")):
        return token
    with suppress(FileFormatError):
        return token.evolve(value=str(repository_file(token.value)))
    return token


@contextmanager
def progress(text: str, *, delay: float = 0.0) -> Iterator[Callable[[int, int], None]]:
    """A progress bar with the time left, as a callback of (done, total); it is shown after ``delay`` [s].

    Where standard error is no terminal, as in a log, it is one line every :data:`LOG_EVERY` seconds, and a last one.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    bar = Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=ERRORS)
    task, watch = bar.add_task(escape(printable(text)), total=None), Stopwatch()

    logged, first = 0.0, (-1, 0.0)

    def advance(done: int, total: int) -> None:
        nonlocal logged, first
        first = (done, watch()) if first[0] < 0 else first
        if not ERRORS.is_terminal:
            if watch() - logged >= LOG_EVERY or (done >= total and watch() >= delay):
                logged = watch()
                print(printable(log_line(text, done, total, logged, first)), file=sys.stderr, flush=True)
            return
        if watch() >= delay:
            bar.start()  # at the first step, so that refused options leave one line alone
        bar.update(task, completed=done, total=total)
        if done >= total and bar.live.is_started:  # room for the bar of what comes next
            bar.stop()

    stopped = None
    try:
        yield advance
    except KeyboardInterrupt as stop:  # cyclopts would end without a word
        stopped = printable(": ".join(["modalshell: stopped", *map(str, stop.args)]))
    finally:
        if bar.live.is_started:
            bar.stop()
    if stopped is not None:
        print(stopped, file=sys.stderr)
        sys.exit(130)


def end_with(*outcomes: Outcome) -> None:
    """End with exit status 1 if some work did not succeed; its files stay."""
    if not all(outcome.succeeded for outcome in outcomes):
        sys.exit(1)
