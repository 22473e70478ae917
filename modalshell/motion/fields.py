"""Fields of the frames of a motion, chosen by name."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from modalshell.core.checks import checked_choice
from modalshell.core.errors import OptionError
from modalshell.core.units import in_two_digits
from modalshell.motion.trajectory import Trajectory
from modalshell.shell import Isotropic, Shell
from modalshell.shell.fields import FIELDS
from modalshell.supports import SupportPath

_OF_MEMBRANE = {"membrane_strain", "membrane_force", "von_mises", "von_mises_faces", "energy_density"}
"""Fields that feel how a shell's positions stretch it."""
_UNLIKE = 1.5
"""Energy of positions, over that which their model has for them, from which these fields are reported as wrong."""


def checked_fields(names: Sequence[str], shell: Shell) -> tuple[str, ...]:
    """The names, each once; OptionError for one that is no field, or none of this shell."""
    if isinstance(names, str) or not isinstance(names, Iterable):
        raise OptionError(f"fields must be a list of names (got {names!r}); these are {', '.join(FIELDS)}")
    chosen = tuple(dict.fromkeys(checked_choice("each of fields", name, tuple(FIELDS)) for name in names))
    if chosen and not isinstance(shell.material, Isotropic):
        shell.fields(shell.rest_positions).require(*chosen)
    return chosen


def shell_at(shell: Shell, run: Trajectory, frame: int) -> Shell:
    """The shell of a motion with what its creases have kept by a frame."""
    return shell.creased(run.crease_angles[frame]) if run.crease_angles.size else shell


def with_fields(run: Trajectory, shell: Shell, names: Sequence[str], supports: SupportPath | None = None) -> Trajectory:
    """The motion with further fields of the shell, of :data:`modalshell.shell.fields.FIELDS`, in every frame.

    Edges are clamped in the frame of the ``supports``, which have moved. OptionError for another name, or one that
    needs a thickness which the material has not. LoadError if a triangle has collapsed in a frame.
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


def with_stretch_remark(
    run: Trajectory, shell: Shell, supports: SupportPath | None = None, own: float | None = None
) -> Trajectory:
    """The motion, with a remark where its model's positions stretch the shell otherwise than the model knows.

    Warped modes, and coarse shells drawn on finer ones, bend a sheet well and stretch it by what they leave out: its
    stresses are then many times too large.

    Parameters
    ----------
    run : Trajectory
        A motion of the shell, or an answer, with fields.
    shell, supports
        As for :func:`with_fields`.
    own : float, optional
        Elastic energy [J] of the model at the frame that has most of it; by default the run's.
    """
    wrong = sorted(_OF_MEMBRANE.intersection(run.fields))
    if not wrong or not len(run.energies):
        return run
    frame = int(run.energies[:, 1].argmax())
    own = float(run.energies[frame, 1]) if own is None else own
    x = np.asarray(run.positions[frame], dtype=np.float64)
    x = x if supports is None else supports.at(float(run.times[frame])).to_shell(x)
    bent = shell_at(shell, run, frame)
    stored = bent.stored_energy(x)
    if not stored > _UNLIKE * own > 0.0:
        return run
    rounding, single = np.finfo(run.positions.dtype).eps, run.positions.dtype == np.float32
    times = in_two_digits(stored / own)
    remark = f"{', '.join(wrong)}: wrong, as these positions hold {times} times the model's energy, in "
    if stored - own > _energy_of_rounding(bent, 0.5 * float(rounding * np.abs(x).max())):
        remark += "stretch that it does not describe; take ds, or of an equilibrium ms.error_bar(...).corrected"
    elif single:
        remark += "stretch by rounding to single precision; store them in double (float64)"
    else:
        return run
    return run if remark in run.message else run.with_remark(remark)


def _energy_of_rounding(shell: Shell, size: float) -> float:
    """Energy [J] of a shell whose vertices are off their rest by ``size`` [m] in every coordinate, at random."""
    rest = shell.rest_positions
    off = np.random.default_rng(0).choice((-size, size), rest.shape)
    return shell.elastic_energy.energy(rest + off) - shell.elastic_energy.energy(rest)
