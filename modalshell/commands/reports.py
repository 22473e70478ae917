"""The command that writes reports: on a run, an equilibrium path or a sweep."""

from __future__ import annotations

import shlex
import warnings
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

import modalshell as ms
from modalshell.commands.results import result_of, scene_of
from modalshell.commands.terminal import end_with, progress, say
from modalshell.files.atomic_io import make_folder, write_record, write_text
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.run.path_files import scene_path, write_path
from modalshell.run.path_report import path_numbers, path_page
from modalshell.run.report_numbers import check_convergence, checked_run, report_numbers, texts_of
from modalshell.run.report_numbers import convergence as mesh_convergence
from modalshell.run.report_page import report_page
from modalshell.run.run_scene import run_in_memory
from modalshell.scene import ShellScene
from modalshell.scene.read import read_toml
from modalshell.sweep import load_sweep
from modalshell.sweep.report import sweep_numbers, sweep_page


def report(
    result: Annotated[
        Path, Parameter(help="Scene or sweep file (.toml), or the trajectory (.npz) or folder of a run of a scene.")
    ],
    *,
    scene: Annotated[
        Path | None, Parameter(help="Scene file of a run; if omitted, the one that its record names.")
    ] = None,
    path: Annotated[bool, Parameter(negative="", help="Follow the scene's equilibria, as 'path' does.")] = False,
    out: Annotated[Path | None, Parameter(help="HTML file to write; if omitted, next to the results.")] = None,
    convergence: Annotated[bool, Parameter(help="Solve on two coarser meshes, too (of a shape with cells).")] = False,
) -> None:
    """Write a report on a run, a path or a sweep as one printable HTML file, and its numbers as JSON.

    That of a run has the scene, a picture with supports and loads, peak displacement and stress with their places,
    reactions and their balance, natural frequencies, the factor of buckling, versions, and the command that made it.
    That of a path has its curve, shapes, limit points, bifurcations and stability, that of a sweep its picture and
    table. What has not been computed is computed first: the cases of a sweep that are missing, and always a path.

    Example: modalshell report studies/scenes/v_beam.toml
    """
    is_file = result.suffix == ".toml"
    of_sweep = is_file and "axes" in read_toml(result)
    if path and (not is_file or of_sweep):
        raise ms.OptionError(f"--path goes with a scene file (got {result})")
    if convergence and (path or of_sweep):
        raise ms.OptionError("--convergence is for the run of a scene: leave it out")
    if is_file and scene is not None:
        raise ms.OptionError(f"name a scene file, or a run with --scene FILE (got {result}, --scene {scene})")
    if not is_file and result.suffix != ".npz" and not result.is_dir():
        kinds = "a scene or sweep file (.toml), also for the report of a sweep that has run, or a run's .npz or folder"
        raise ms.OptionError(f"RESULT must be {kinds} (got {result})")
    if of_sweep:
        _report_sweep(result, out)
    elif path:
        _report_path(result, out)
    elif is_file:
        _report_run(result, None, out, convergence)
    else:
        result = result_of(result)
        _report_run(result, scene or scene_of(result), out, convergence)


def _report_run(result: Path, scene: Path | None, out: Path | None, convergence: bool) -> None:
    """The report on a run, which is computed if ``result`` is a scene that has none."""
    file = result if scene is None else scene
    declared = ms.load_scene(file).require_shell()
    if convergence:
        check_convergence(declared)
    if out is not None:
        _target(out, out, file)
    if scene is None:
        with progress(f"{declared.name} steps") as on_step:
            archive = next(path for path in ms.run_scene(declared, on_step=on_step).files if path.suffix == ".npz")
    else:
        archive = result
    target = _target(out, archive.with_name(f"{archive.stem}_report.html"), archive, file)
    with warnings.catch_warnings(record=True, action="always", category=ms.ModalShellWarning) as given:
        shell = declared.build_shell()
    record = checked_run(declared, shell, archive.with_suffix(".json"))
    run = ms.load_trajectory(archive, verify=True)
    numbers = report_numbers(declared, shell, run)
    numbers["warnings"][:0] = texts_of(given)
    own = () if scene is None else ("--scene", scene)
    numbers["command"] = _command(result, *own, *["--convergence"] * convergence)
    if convergence:
        numbers["convergence"] = mesh_convergence(declared, numbers, _solved)
    _write(target, report_page(declared, shell, run, record, numbers), numbers)


def _report_path(file: Path, out: Path | None) -> None:
    """The report on the equilibria of a scene, which are followed first; their files go where ``path`` puts them."""
    declared, folder = ms.load_scene(file).require_shell(), Path("results")
    refuse_foreign(folder / f"{declared.name}_path.npz")
    target = _target(out, folder / f"{declared.name}_path_report.html", file)
    make_folder(folder)
    with progress(f"{file.stem} points") as on_step:
        followed = scene_path(declared, on_step)
    written = write_path(followed, folder, declared.name, declared.unit_system)
    numbers = path_numbers(declared, declared.build_shell(), followed) | {"command": _command(file, "--path")}
    pictures = [one for one in written if one.suffix == ".png"]
    _write(target, path_page(declared, numbers, pictures, declared.unit_system), numbers)
    end_with(followed.outcome)


def _report_sweep(file: Path, out: Path | None) -> None:
    """The report on a sweep, whose missing cases are computed first."""
    declared = load_sweep(file)
    target = _target(out, Path(declared.output.folder) / f"{declared.name}_sweep_report.html", file)
    with progress(f"{file.stem} cases") as on_step:
        result = ms.run_sweep(declared, on_step=on_step)
    numbers = sweep_numbers(declared, result) | {"command": _command(file)}
    _write(target, sweep_page(declared, numbers), numbers)
    end_with(*result.counts())


def _command(*arguments: str | Path) -> str:
    """The command with these arguments, as a shell takes it."""
    return shlex.join(["modalshell", "report", *map(str, arguments)])


def _target(out: Path | None, default: Path, *inputs: Path) -> Path:
    """The HTML file to write, checked before any work."""
    target = out or default
    checked_target("--out", target, (".html", ".htm"), *inputs)
    refuse_foreign(target.with_suffix(".json"))
    return target


def _write(target: Path, text: str, numbers: dict[str, Any]) -> None:
    say(write_text(target, text))
    say(write_record(target.with_suffix(".json"), numbers))


def _solved(scene: ShellScene) -> ms.Trajectory:
    """The motion or equilibrium of a scene, in a folder that is not kept."""
    with progress(f"{scene.name} steps") as on_step:
        return run_in_memory(scene, on_step)
