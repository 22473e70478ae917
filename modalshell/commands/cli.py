"""Command line: figures, scenes, benchmarks, and motion and modes of meshes of your own."""

from __future__ import annotations

import io
import sys
import warnings
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter
from rich.markup import escape
from rich.table import Table

import modalshell as ms
from modalshell.commands import meshes, reports, results, scenes
from modalshell.commands.doctor import examine
from modalshell.commands.licences import show_licences
from modalshell.commands.listings import cards, keys
from modalshell.commands.pages import write_pages
from modalshell.commands.terminal import CONSOLE, converted, progress, say, show_markdown
from modalshell.compare import MODES
from modalshell.core.checks import printable, shortened
from modalshell.core.errors import ModalShellError
from modalshell.core.interruption import collect_again
from modalshell.core.memory import available_memory, gigabytes
from modalshell.files.atomic_io import make_folder
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.files.provenance import repository_module

_HELP = """Simulate thin shells: leaves, paper, sheet metal, cloth.

Models: LMA (linear modal analysis), MWTS (modal warping for thin shells), RSW (rotation-strain warping), MD-ROM
(modal-derivative reduced-order model), DS (discrete shells, the reference). A rung is one model of this ladder.

Example: modalshell simulate meshes/leaf.obj
"""
app = App(
    name="modalshell",
    help=_HELP,
    version=ms.__version__,
    default_parameter=Parameter(converter=converted, negative_iterable=()),
)
app.register_install_completion_command(
    help="Install completion of commands and options for this shell.\n\n"
    "Example: modalshell --install-completion --shell bash"
)
for _command in (scenes.run, scenes.view, scenes.sweep, scenes.path, scenes.fit, scenes.page, reports.report):
    app.command(_command)
for _further in (meshes.simulate, meshes.modes, meshes.repair, results.export, cards, keys):
    app.command(_further)
app.command(results.open_result, name="open")
_LONGEST_MESSAGE = 1000
"""Characters of an error that the command line prints."""


@app.command
def reproduce(
    *,
    only: Annotated[list[str] | None, Parameter(help="Names of the studies to run.")] = None,
    everything: Annotated[bool, Parameter(name="--all", help="All studies, not only those of the paper.")] = False,
    out: Annotated[Path, Parameter(help="Folder of the results; pictures go to 'figures' in it.")] = Path("results"),
    figures: Annotated[Path | None, Parameter(help="Another folder for the pictures.")] = None,
    quick: Annotated[bool, Parameter(help="Coarser meshes and fewer loads, to try things out.")] = False,
    pages: Annotated[bool, Parameter(help="Write a web page of each scene into 'pages' instead.")] = False,
) -> None:
    """Run the studies and draw the paper's figures.

    Example: modalshell reproduce --only flat_vs_v_beam --quick
    """
    if pages:
        with progress("pages") as on_step:
            written = write_pages(out / "pages", on_step)
        say(*written, sep="\n")
        return
    studies = repository_module("studies.reproduce")
    names = studies.chosen_studies(only, everything)
    make_folder(out)
    for name in names:
        with progress(name) as on_step:
            written = studies.reproduce(name, out, figures or out / "figures", quick=quick, on_step=on_step)
        say(*written, sep="\n")


def _spare_measurements(scene: Path, out: Path) -> None:
    """OptionError, before any work, where the measurements of a scene would replace files of others."""
    stem = out / f"{ms.load_scene(scene).name}_tradeoff"
    refuse_foreign(stem.with_suffix(".npz"), stem.with_suffix(".json"))


@app.command
def tradeoff(
    scene: Annotated[Path, Parameter(help="TOML file.")],
    *,
    truth: Annotated[
        Path | None, Parameter(help="Outside solution under the whole load: .npz with 'positions', or a mesh file.")
    ] = None,
    modes: Annotated[tuple[int, ...], Parameter(help="Mode counts.")] = MODES,
    engines: Annotated[bool, Parameter(help="Ask other engines, too: CalculiX, MuJoCo, Newton.", negative="")] = False,
    quick: Annotated[
        bool, Parameter(negative="", help="By error bars: DS is solved only where one is void, and nothing is trained.")
    ] = False,
    out: Annotated[Path, Parameter(help="Folder of tables and pictures.")] = Path("results"),
) -> None:
    """Measure every model that a scene allows: its error against DS (discrete shells) and its cost per frame.

    Rows in bold have the least error at their cost.

    Example: modalshell tradeoff studies/scenes/flat_beam.toml --modes 4 --modes 8
    """
    _spare_measurements(scene, out)
    make_folder(out)
    with progress(f"{scene.stem} rungs") as on_step:
        measured = ms.tradeoff(scene, truth=truth, modes=modes, engines=engines, quick=quick, on_step=on_step)
    say(measured.table(), *measured.save(out), sep="\n")


@app.command
def advise(
    scene: Annotated[Path, Parameter(help="TOML file.")],
    *,
    error: Annotated[float, Parameter(help="Largest relative displacement error against DS.")] = 0.02,
    fps: Annotated[float, Parameter(help="Least frame rate [1/s].")] = 60.0,
    modes: Annotated[tuple[int, ...], Parameter(help="Mode counts.")] = MODES,
    write: Annotated[Path | None, Parameter(help="Write the scene with the named model to this file.")] = None,
    out: Annotated[Path, Parameter(help="Folder of tables and pictures.")] = Path("results"),
    quick: Annotated[
        bool, Parameter(negative="", help="At rest, by error bars instead of measured runs: seconds; no files.")
    ] = False,
) -> None:
    """Name the cheapest model that meets an error and a frame rate on a scene, from measured runs.

    Errors are of displacement, against DS (discrete shells).

    Example: modalshell advise studies/scenes/flat_beam.toml --error 0.02 --fps 60
    """
    if write is not None:
        checked_target("--write", write, (".toml",), scene)
    if quick:
        with progress(f"{scene.stem} rungs") as on_step:
            found = ms.quick_advice(scene, error=error, modes=modes, on_step=on_step)
        show_markdown(found.explanation)
        if write is not None:
            say(found.write_scene(scene, write))
        return
    _spare_measurements(scene, out)
    make_folder(out)
    with progress(f"{scene.stem} rungs") as on_step:
        advice = ms.advise(scene, error=error, fps=fps, modes=modes, on_step=on_step)
    show_markdown(advice.explanation)
    say(*advice.save(out), sep="\n")
    if write is not None:
        say(advice.write_scene(scene, write))


@app.command
def bench(
    *,
    only: Annotated[str | None, Parameter(help="One benchmark instead of all.")] = None,
    out: Annotated[Path, Parameter(help="Folder of the tables and the picture.")] = Path("results"),
    quick: Annotated[bool, Parameter(help="Without the largest sizes.")] = False,
) -> None:
    """Measure this machine: frames, modes, assembly, implicit steps and flocks against plain NumPy and SciPy.

    Example: modalshell bench --quick --only assembly
    """
    with progress("benchmarks") as on_step:
        written = repository_module("studies.benchmarks.run").main(out, quick, only, on_step)
    show_markdown(next(path for path in written if path.suffix == ".md").read_text(encoding="utf-8"))
    say(*written, sep="\n")


@app.command
def doctor() -> None:
    """List versions, solvers, threads, renderers and missing extras of this machine.

    Example: modalshell doctor
    """
    table = Table("what", "found", "how to improve it")
    for reading in examine():
        table.add_row(reading.name, escape(reading.value), escape(reading.hint))
    CONSOLE.print(table)


@app.command
def licences() -> None:
    """List the licence of every dependency and extra, and say which are copyleft.

    Example: modalshell licences
    """
    if show_licences():
        sys.exit(1)


def main(arguments: list[str] | None = None) -> None:
    """Entry point: 0 is success, 1 work that did not converge or complete, 2 a refusal, one line on standard error."""
    collect_again()
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given
    if debug:
        given.remove("--debug")
    for stream in (sys.stdout, sys.stderr):  # names of files need not be text that the terminal can show
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    shown: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if (text := printable(str(message))) not in shown:  # a mesh that is read twice warns twice
            shown.add(text)
            print(f"modalshell: warning: {text}", file=sys.stderr)

    warnings.showwarning = show
    try:
        app(given, exit_on_error=False, print_error=False)
    except (ModalShellError, CycloptsError, OSError) as error:
        if debug:
            raise
        print(f"modalshell: {printable(shortened(str(error), _LONGEST_MESSAGE))}", file=sys.stderr)
        sys.exit(2)
    except MemoryError as error:
        if debug:
            raise
        known = f"{shortened(str(error))}; " if str(error) else ""
        advice = f"{known}{gigabytes(available_memory())} are free: take a coarser mesh, fewer modes or frames"
        print(f"modalshell: out of memory: {printable(advice)}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("modalshell: stopped", file=sys.stderr)
        sys.exit(130)
