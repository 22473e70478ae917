"""Running the studies and drawing the paper's figures from their results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from modalshell.atomic_io import write_text
from modalshell.errors import OptionError
from modalshell.study import load_script

FIGURES: dict[str, tuple[str, ...]] = {
    "cloth_scaling": ("cloth_scaling",),
    "dancing_character": ("figure_8",),
    "flat_vs_v_beam": ("figure_4",),
    "flock_scaling": ("flock_scaling",),
    "held_out_advice": (),
    "integrator_drift": ("integrator_drift",),
    "large_mesh": ("figure_3",),
    "manipulation": ("figure_7",),
    "spring_sheet_speed": ("spring_sheet_speed",),
    "sheet_vs_shell": ("sheet_vs_shell",),
    "stability_atlas": ("stability_atlas",),
    "tradeoff": ("tradeoff",),
    "validity_map": ("validity_map",),
    "v_beam_accuracy": ("figure_5", "figure_6a", "figure_6b"),
}
"""Which figure scripts read which study's result."""


def chosen_studies(only: Sequence[str] | None, everything: bool = False) -> list[str]:
    """Names of the studies to run: the paper's, ``only`` some, or all; OptionError for a name that is none."""
    if everything and not only:
        return list(FIGURES)
    if not only:
        return [name for name, figures in FIGURES.items() if any(figure.startswith("figure_") for figure in figures)]
    for name in only:
        if name not in FIGURES:
            raise OptionError(f"there is no study {name!r}; choose from {', '.join(FIGURES)}")
    return [name for name in FIGURES if name in only]


def reproduce(
    name: str, results: Path, figures: Path, *, quick: bool = False, on_step: Callable[[int, int], None] | None = None
) -> list[Path]:
    """Run one study, save its result into ``results`` and draw its figures into ``figures``.

    Returns
    -------
    list of Path
        The files written.
    """
    study = load_script("studies", name)
    result = study.main(quick=quick, on_step=on_step)
    written: list[Path] = result.save(results)
    title = (study.__doc__ or name).strip().splitlines()[0]
    command = f"modalshell reproduce --only {name}" + (" --quick" if quick else "")
    page = f"# {name}\n\n{title}\n\nMade by `{command}`.\n\n{study.table(result)}\n"
    written.append(write_text(results / f"{name}.md", page))
    for script in FIGURES[name]:
        drawn = load_script("paper_figures", script).draw(results, figures)
        written += drawn if isinstance(drawn, list) else [drawn]
    return written
