"""Running a scene, or resuming a run that was stopped."""

from __future__ import annotations

import os
import tempfile
import warnings
from dataclasses import replace
from functools import singledispatch
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from modalshell.core.checks import checked_callback, checked_choice
from modalshell.core.errors import ModalShellWarning
from modalshell.core.typing import Progress, unheard
from modalshell.export import check_formats
from modalshell.models.factory import SolveModes
from modalshell.motion import Trajectory
from modalshell.motion.colouring import DISPLACEMENT
from modalshell.run.protocol import RunResult, SceneRun
from modalshell.run.run_shell import ShellRun
from modalshell.scene import Scene, ShellScene, load_scene
from modalshell.scene.tables import Format
from modalshell.shell import Shell
from modalshell.shell.fields import FIELDS


def run_scene(
    scene: Scene | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    color: str | None = None,
    restart: bool = False,
    on_step: Progress | None = None,
) -> RunResult:
    """Run a scene and write its results; a stopped or killed run resumes after its last stored frame.

    Stored frames are kept in ``NAME.frames`` until the results are complete; :class:`RunFollower` shows them to other
    processes. However often a run was stopped, its results are those of an uninterrupted one to the last bit. A scene
    whose results are complete is not run again.

    Parameters
    ----------
    scene : Scene or path
        The scene or its file.
    out : path, optional
        Folder for the results; by default the scene's.
    color : str, optional
        Field that colours the film and the picture, such as "curvature"; by default the scene's. The film, or the
        picture of an equilibrium, is then written even if the scene does not request it.
    restart : bool
        Drop what an earlier run has left and start at time 0.
    on_step : callable, optional
        Called after each step with the steps done and their total.

    Returns
    -------
    SceneResult
        Trajectory and files: ``NAME.npz``, ``NAME.json`` with the record of the run, and the requested formats.
    FlightResult
        The same of a flock, with a report on its levels of detail instead of a trajectory.

    Raises
    ------
    SceneError
        Where the scene is refused.
    OptionError
        If the folder holds frames of another run under this name, or another process is running there.
    """
    on_step = checked_callback("on_step", on_step)
    declared = scene if isinstance(scene, Scene) else load_scene(scene)
    if color is not None:
        declared = _coloured(declared, color)
    check_formats(declared.output.formats)
    if isinstance(declared, ShellScene) and declared.motion is None and "mp4" in declared.output.formats:
        warnings.warn(
            f"{declared.file}: output.formats: the film (mp4) of an equilibrium is one picture: give [motion] with a "
            "duration for a film, or take png",
            ModalShellWarning,
            stacklevel=2,
        )
    folder = Path(declared.output.folder if out is None else out)
    shell = declared.build_shell()
    result: RunResult = new_run(declared, shell, folder).run(restart, on_step)
    return result


def run_in_memory(
    scene: ShellScene, on_step: Progress = unheard, shell: Shell | None = None, solve: SolveModes | None = None
) -> Trajectory:
    """The motion or equilibrium that :func:`run_scene` gives, of which no file is kept.

    On the scene's ``shell``, if that is built already, with modes by ``solve``.
    """
    plain = replace(scene, output=msgspec.structs.replace(scene.output, formats=[]))
    with tempfile.TemporaryDirectory() as folder:
        run = ShellRun(plain, shell or plain.build_shell(), Path(folder), solve=solve).run(False, on_step).trajectory
        fields = {name: np.array(values) for name, values in run.fields.items()}
        return replace(run, positions=np.array(run.positions), fields=fields)


@singledispatch
def new_run(scene: Scene, shell: Shell, folder: Path) -> SceneRun[Any]:
    """The run of a scene, by its kind; other kinds of scenes register theirs."""
    return ShellRun(scene.require_shell(), shell, folder)


def _coloured(scene: Scene, color: str) -> Scene:
    """The scene with another field for the colours of its film and picture."""
    checked_choice("color", color, (*FIELDS, DISPLACEMENT))
    shown: Format = "png" if scene.motion is None else "mp4"
    formats = list(dict.fromkeys([*scene.output.formats, shown]))
    return replace(scene, output=msgspec.structs.replace(scene.output, color=color, formats=formats))
