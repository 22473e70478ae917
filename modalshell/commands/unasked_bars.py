"""Error bars that no scene asked for: how far a run is from DS, and what to take where that is far."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from modalshell.core.typing import Array
from modalshell.models.base.bars import bar_on_shell, check_bar
from modalshell.models.motion_check import bar_at_largest
from modalshell.models.registry import MODELS, TRUTH
from modalshell.modes.rigid import left_free
from modalshell.motion.motion_check import too_far_apart
from modalshell.scene import ShellScene
from modalshell.scene.parts import build_damping
from modalshell.statics.error_bar import ErrorBar

_MOST_VERTICES = 30_000
"""Vertices of a shell up to which the error against DS is estimated without being asked for."""
_GOOD = 0.05
"""Estimated error from which another model is named."""


def has_bar(scene: ShellScene, shell: ms.Shell) -> bool:
    """Whether answers get an error bar of their own accord: those of DS need none, and large ones would take long."""
    return may_have_bar(scene, len(shell.mass)) and not left_free(shell)


def may_have_bar(scene: ShellScene, vertices: int) -> bool:
    """The same of any shell with this number of vertices that its supports hold."""
    return scene.model.spec.key != TRUTH and vertices <= _MOST_VERTICES


def error_as_text(scene: ShellScene, shell: ms.Shell, run: ms.Trajectory, advice: str) -> list[str]:
    """How far an equilibrium, or a motion where it is largest, is from DS, and an ``advice`` where that is far.

    An empty list if there is no bar; of motions with contacts that have friction, restitution or ``push_out``, under
    constraints, or with modal damping, whose bars take ``bar = true``; and where frames are too far apart or of
    float32. Bars that were asked for stand elsewhere: of them the advice alone.
    """
    if not has_bar(scene, shell) or run.outcome in (ms.Outcome.DIVERGED, ms.Outcome.RUNS_AWAY):
        return []
    text = ""
    if run.bars is not None:
        good = run.bars.void_from is None and run.bars.largest <= _GOOD
    else:
        found = _found(scene, shell, run)
        if found is None:
            return []
        where, bar = found
        good, text = bar.valid and bar.displacement <= _GOOD, f"{where}{bar}"
    said = "; ".join(part for part in (text, "" if good else advice) if part)
    return [said] if said else []


def _found(scene: ShellScene, shell: ms.Shell, run: ms.Trajectory) -> tuple[str, ErrorBar] | None:
    """Where a bar was found, as text, and the bar; None if there is none, or the frame is of DS."""
    path, force, loads, constraints = scene.build_loading(shell)
    contacts, loading = scene.build_contacts(shell), shell.loading(scene.gravity, force, loads)
    try:
        check_bar(shell, constraints=constraints, contacts=contacts)
        if scene.motion is None:
            x = np.array(run.positions[0], dtype=np.float64)
            return "", bar_on_shell(shell, x, loading, contacts, constraints)
    except ms.OptionError:  # such an answer has none
        return None
    damping = build_damping(scene.motion)
    if constraints or damping.ratios or any(contact.rough for contact in contacts):
        return None
    if run.positions.dtype != np.float64 or _far_apart(run, shell):  # no accelerations by differences
        return None
    found = bar_at_largest(run.times, run.positions, shell, loading, damping, path, contacts)
    levels = dict(zip(run.times.tolist(), run.levels, strict=False))
    if found is None or levels.get(found[0]) == MODELS[TRUTH].name:  # auto may have that frame of DS
        return None
    return f"at its largest displacement, at {found[0]:.3g} {run.units.time}: ", found[1]


def _far_apart(run: ms.Trajectory, shell: ms.Shell) -> bool:
    """Whether stored frames are too far apart for accelerations by their differences."""

    def size(moved: Array) -> float:
        return float(np.sqrt(np.sum(shell.mass[:, None] * moved**2)))

    frames = run.positions
    if len(frames) < 3:
        return True
    threes = zip(frames, frames[1:], frames[2:], strict=False)
    swings = [(size(c - 2.0 * b + a), 0.5 * size(c - a)) for a, b, c in threes]
    largest = max(size(frame - run.rest_positions) for frame in frames)
    return bool(too_far_apart(np.array(swings).T, largest))
