"""Fields of the frames of a motion, chosen by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from modalshell.core.checks import checked_choice
from modalshell.core.errors import OptionError
from modalshell.motion.trajectory import Trajectory
from modalshell.shell import Isotropic, Shell
from modalshell.shell.fields import FIELDS
from modalshell.supports import SupportPath


def checked_fields(names: Sequence[str], shell: Shell) -> tuple[str, ...]:
    """The names, each once; OptionError for one that is no field, or none of this shell."""
    if isinstance(names, str):
        raise OptionError(f"fields must be a list of names (got {names!r}); these are {', '.join(FIELDS)}")
    chosen = tuple(dict.fromkeys(checked_choice("each of fields", name, tuple(FIELDS)) for name in names))
    if chosen and not isinstance(shell.material, Isotropic):
        shell.fields(shell.rest_positions).require(*chosen)
    return chosen


def shell_at(shell: Shell, run: Trajectory, frame: int) -> Shell:
    """The shell of a motion with what its creases have kept by a frame."""
    return shell.creased(run.crease_angles[frame]) if run.crease_angles.size else shell


def with_fields(run: Trajectory, shell: Shell, names: Sequence[str], supports: SupportPath | None = None) -> Trajectory:
    """The motion with further fields of the shell in every frame.

    Parameters
    ----------
    run : Trajectory
        A motion of the shell.
    shell : Shell
        The shell.
    names : sequence of str
        Of :data:`modalshell.shell.fields.FIELDS`.
    supports : SupportPath, optional
        How its supports moved: edges are clamped in their frame.

    Raises
    ------
    OptionError
        For another name, or one that needs a thickness which the material has not.
    LoadError
        If a triangle has collapsed in a frame.
    """
    missing = [name for name in checked_fields(names, shell) if name not in run.fields]
    if not missing:
        return run
    frames = []
    for frame, (time, positions) in enumerate(zip(run.times, run.positions, strict=True)):
        x = np.asarray(positions, dtype=np.float64)
        frames.append(
            shell_at(shell, run, frame).fields(x if supports is None else supports.at(float(time)).to_shell(x))
        )
    found = {name: np.stack([fields.values(name) for fields in frames]) for name in missing}
    return replace(run, fields={**run.fields, **found})
