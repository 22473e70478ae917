"""Commands on results."""

from __future__ import annotations

import tempfile
import warnings
import webbrowser
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

import modalshell as ms
from modalshell.commands.terminal import progress, say
from modalshell.export import check_formats, compress, save_modal_body, save_modes_gltf
from modalshell.export.near_origin import centred
from modalshell.export.usd import save_usd
from modalshell.files.atomic_io import write_record, write_text
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.page import Page, clip_page
from modalshell.run.report_numbers import check_convergence, checked_run, report_numbers, texts_of
from modalshell.run.report_numbers import convergence as mesh_convergence
from modalshell.run.report_page import report_page
from modalshell.run.run_scene import run_in_memory
from modalshell.scene import ShellScene

_SUFFIXES = {"usd": ".usdc", "gltf": ".glb", "pc2": ".pc2", "mdd": ".mdd", "clip": ".clip", "page": ".html"}
_SUFFIXES |= {"vtkhdf": ".vtkhdf", "pvd": ".pvd", "body": ".npz"}
_SHOWN = (".html", ".htm", ".png", ".mp4", ".md", ".csv", ".json")


def export(
    result: Annotated[Path, Parameter(help="Trajectory (.npz), clip (.clip), basis (.npz), or the folder of a run.")],
    *,
    to: Annotated[
        Literal["usd", "gltf", "pc2", "mdd", "clip", "page", "vtkhdf", "pvd", "body"],
        Parameter(help="Format to write; 'body' is a basis as arrays for other engines, with a JSON file."),
    ],
    out: Annotated[Path | None, Parameter(help="File to write; if omitted, in the folder of RESULT.")] = None,
    up: Annotated[Literal["y", "z"], Parameter(help="Axis that points up in a USD file.")] = "z",
) -> None:
    """Convert a saved motion or basis to a format of other programs.

    Example: modalshell export results/leaf.npz --to usd
    """
    if up != "z" and to != "usd":
        raise ms.OptionError(f"--up goes with --to usd; {to} files have their own axis")
    result = _result_of(result)
    target = out or (result.with_name(f"{result.stem}_body.npz") if to == "body" else result.with_suffix(_SUFFIXES[to]))
    checked_target("--out", target, (_SUFFIXES[to],), result)
    rest = target.with_name(f"{target.stem}_rest.obj")
    if to in ("pc2", "mdd"):
        refuse_foreign(rest)
    if to == "body":
        refuse_foreign(target.with_suffix(".json"), *([target] if out is None else []))
        say(*save_modal_body(ms.Basis.load(result), target), sep="\n")
        return
    check_formats([target.suffix[1:]])
    try:
        run = ms.load_clip(result) if result.suffix == ".clip" else ms.load_trajectory(result, verify=True)
    except ms.FileFormatError:
        if (basis := _saved_basis(result)) is None:
            raise
        if to == "page":
            say(basis.page(title=result.stem).save(target))
        elif to == "gltf":
            say(save_modes_gltf(basis, target))
        else:
            raise ms.OptionError(f"{result} is a basis, which is written as gltf or page (got {to})") from None
        return
    if to == "page":
        say(_played(run, result.stem).save(target))
        return
    with progress(f"{result.stem} frames") as on_frame:
        if up == "y":
            say(save_usd(run, target, on_frame, up))
        else:
            say(ms.save_trajectory(run, target, on_frame=on_frame))
    if target.suffix in (".pc2", ".mdd"):
        ms.save_mesh(ms.TriangleMesh(run.rest_positions, run.faces), rest)
        say(rest)


def _played(run: ms.Trajectory, title: str) -> Page:
    """A page that plays a motion."""
    motion = compress(centred(run)[0])
    shapes = motion.displacements()
    return clip_page(
        motion.times, motion.rest_positions, motion.faces, shapes, motion.amplitudes, title=title, units=motion.units
    )


def open_result(
    result: Annotated[
        Path,
        Parameter(help="Trajectory or basis (.npz), clip, page, picture, film, report, table, or the folder of a run."),
    ],
) -> None:
    """Show whatever a result is in the web browser; motions and bases as a page in a temporary folder.

    Example: modalshell open results/leaf.npz
    """
    shown = _result_of(result)
    if not shown.is_file():
        raise ms.OptionError(f"{shown} is no file: name a result, as 'results/leaf.npz', or the folder of a run")
    if shown.suffix in (".npz", ".clip"):
        page = Path(tempfile.mkdtemp(prefix="modalshell_")) / f"{shown.stem}.html"  # kept for the browser
        basis = _saved_basis(shown) if shown.suffix == ".npz" else None
        if basis is not None:
            shown = basis.page(title=shown.stem).save(page)
        else:
            run = ms.load_clip(shown) if shown.suffix == ".clip" else ms.load_trajectory(shown, verify=True)
            shown = _played(run, shown.stem).save(page)
    elif shown.suffix not in _SHOWN:
        raise ms.OptionError(
            f"{shown} is no result that a browser shows (got {shown.suffix or 'no suffix'}): name one of .npz, .clip, "
            f"{', '.join(_SHOWN)}; a scene is shown by 'modalshell view' or 'modalshell page'"
        )
    say(shown)
    if not webbrowser.open(shown.resolve().as_uri()):
        say("no browser was found: open the file in one yourself")


def report(
    result: Annotated[Path, Parameter(help="Scene file (.toml), or the trajectory (.npz) or folder of a run of one.")],
    *,
    scene: Annotated[Path | None, Parameter(help="Scene file of a run that is named by its trajectory.")] = None,
    out: Annotated[Path | None, Parameter(help="HTML file to write; if omitted, next to the run's results.")] = None,
    convergence: Annotated[bool, Parameter(help="Solve on two coarser meshes, too (of a shape with cells).")] = False,
) -> None:
    """Write a report on a run as one printable HTML file, and its numbers as JSON.

    It has the scene, a picture with supports and loads, peak displacement and stress with their places, reactions and
    their balance, natural frequencies, the factor of buckling, versions, and the command that made it. A scene that has
    not been run is run first.

    Example: modalshell report studies/scenes/v_beam.toml
    """
    file = result if result.suffix == ".toml" else scene
    if file is None or (result.suffix == ".toml" and scene is not None):
        raise ms.OptionError(f"name a scene file, or a run with --scene FILE (got {result}, --scene {scene})")
    declared = ms.load_scene(file).require_shell()
    if convergence:
        check_convergence(declared)
    if result.suffix == ".toml":
        with progress(f"{declared.name} steps") as on_step:
            archive = next(path for path in ms.run_scene(declared, on_step=on_step).files if path.suffix == ".npz")
    else:
        archive = _result_of(result)
    target = out or archive.with_name(f"{archive.stem}_report.html")
    checked_target("--out", target, (".html", ".htm"), archive, file)
    refuse_foreign(target.with_suffix(".json"))
    with warnings.catch_warnings(record=True, action="always", category=ms.ModalShellWarning) as given:
        shell = declared.build_shell()
    record = checked_run(declared, shell, archive.with_suffix(".json"))
    run = ms.load_trajectory(archive, verify=True)
    numbers = report_numbers(declared, shell, run)
    numbers["warnings"][:0] = texts_of(given)
    numbers["command"] = f"modalshell report {result}" + (f" --scene {scene}" if scene else "")
    if convergence:
        numbers["command"] += " --convergence"
        numbers["convergence"] = mesh_convergence(declared, numbers, _solved)
    say(write_text(target, report_page(declared, shell, run, record, numbers)))
    say(write_record(target.with_suffix(".json"), numbers))


def _solved(scene: ShellScene) -> ms.Trajectory:
    """The motion or equilibrium of a scene, in a folder that is not kept."""
    with progress(f"{scene.name} steps") as on_step:
        return run_in_memory(scene, on_step)


def _result_of(path: Path) -> Path:
    """The saved motion in the folder of a run, or ``path`` itself if it is no folder."""
    if not path.is_dir():
        return path
    saved = sorted(path.glob("*.npz"))
    if len(saved) != 1:
        names = ", ".join(file.name for file in saved[:5]) or "none"
        raise ms.OptionError(f"{path} must hold one .npz file (got {names}): name the file instead")
    return saved[0]


def _saved_basis(path: Path) -> ms.Basis | None:
    """The basis of a file; None if it holds none."""
    try:
        return ms.Basis.load(path)
    except ms.FileFormatError:
        return None


def register(app: App) -> None:
    """Add the commands to ``app``."""
    app.command(export)
    app.command(open_result, name="open")
    app.command(report)
