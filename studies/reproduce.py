"""Running the studies, and drawing the paper's figures from their results."""

from __future__ import annotations

import pkgutil
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Protocol, cast

from modalshell.core.errors import OptionError
from modalshell.core.typing import Progress
from modalshell.files.atomic_io import write_text
from modalshell.files.outputs import refuse_foreign
from modalshell.files.provenance import repository_module
from modalshell.files.study_result import StudyResult


class Study(Protocol):
    """What a module of the package ``studies`` defines to be a study; its docstring's first line is the title.

    Attributes
    ----------
    FIGURES : tuple of str
        Modules of the package ``paper_figures`` that draw its result.
    """

    FIGURES: tuple[str, ...]

    def main(self, quick: bool = False, on_step: Progress | None = None) -> StudyResult:
        """Run it; ``quick`` takes coarser meshes and fewer cases."""

    def table(self, result: StudyResult) -> str:
        """The result in Markdown."""

    def finding(self, result: StudyResult) -> str:
        """What it found, in one or two sentences."""


@cache
def studies() -> dict[str, Study]:
    """Every study by its name: the modules of the package ``studies`` that define ``FIGURES``."""
    names = [entry.name for entry in pkgutil.iter_modules(repository_module("studies").__path__) if not entry.ispkg]
    modules = {name: repository_module(f"studies.{name}") for name in names}
    return {name: cast("Study", module) for name, module in modules.items() if hasattr(module, "FIGURES")}


def chosen_studies(only: Sequence[str] | None, everything: bool = False) -> list[str]:
    """Names of the studies to run: the paper's, ``only`` some, or all; OptionError for a name that is none."""
    known = studies()
    for name in only or ():
        if name not in known:
            raise OptionError(f"there is no study {name!r}; choose from {', '.join(known)}")
    if only:
        return [name for name in known if name in only]
    return [name for name, study in known.items() if everything or any("figure_" in each for each in study.FIGURES)]


def reproduce(
    name: str, results: Path, figures: Path, *, quick: bool = False, on_step: Progress | None = None
) -> list[Path]:
    """Run one study, save its result into ``results`` and draw its figures into ``figures``.

    Returns
    -------
    list of Path
        The files written.
    """
    study = studies()[name]
    refuse_foreign(*(results / f"{name}.{kind}" for kind in ("npz", "json")))  # before the work
    figures.mkdir(parents=True, exist_ok=True)
    result = study.main(quick=quick, on_step=on_step)
    written: list[Path] = result.save(results)
    title = (study.__doc__ or name).strip().splitlines()[0]
    command = f"modalshell reproduce --only {name}" + (" --quick" if quick else "")
    page = f"# {name}\n\n{title}\n\nMade by `{command}`.\n\n{study.table(result)}\n"
    written.append(write_text(results / f"{name}.md", page))
    for figure in study.FIGURES:
        drawn = repository_module(f"paper_figures.{figure}").draw(results, figures)
        written += drawn if isinstance(drawn, list) else [drawn]
    return written
