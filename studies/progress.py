"""Cases of a study, counted while they are worked through."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

from modalshell.core.typing import Progress

Case = TypeVar("Case")


def counted(cases: Sequence[Case], on_step: Progress | None) -> Iterator[Case]:
    """Each of ``cases``; after each, ``on_step`` takes how many are done, and of how many."""
    for done, case in enumerate(cases, start=1):
        yield case
        if on_step is not None:
            on_step(done, len(cases))
