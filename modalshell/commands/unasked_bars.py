"""How far runs of scenes are from DS that ask for no error bar, and what to take where that is far."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from modalshell.models.base.bars import bar_on_shell, check_bar
from modalshell.models.motion_check import bar_at_largest
from modalshell.models.registry import MODELS, TRUTH
from modalshell.modes.rigid import left_free
from modalshell.scene import ShellScene
from modalshell.scene.parts import build_damping
from modalshell.statics.error_bar import ErrorBar

_MOST_VERTICES = 30_000
"""Vertices of a shell up to which the error against DS is estimated without being asked for."""
_GOOD = 0.05
"""Estimated error from which another model is named."""


def has_bar(scene: ShellScene, shell: ms.Shell) -> bool:
    """Whether answers get an error bar of their own accord: those of DS need none, and large ones would take long."""
    return scene.model.spec.key != TRUTH and len(shell.mass) <= _MOST_VERTICES and not left_free(shell)


def error_as_text(scene: ShellScene, shell: ms.Shell, run: ms.Trajectory, advice: str) -> list[str]:
    """How far an equilibrium, or a motion where it is largest, is from DS, and an ``advice`` where that is far.

    Nothing of what has no bar, or of motions with friction, under constraints and of modal damping, where one takes
    more than the frames that are stored. Bars that were asked for stand elsewhere.
    """
    if not has_bar(scene, shell) or run.outcome in (ms.Outcome.DIVERGED, ms.Outcome.RUNS_AWAY):
        return []
    text = ""
    if run.bars is not None:
        good = bool((run.bars.valid & (run.bars.displacement <= _GOOD)).all())
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
    except ms.OptionError:  # such an equilibrium has none
        return None
    damping = build_damping(scene.motion)
    if constraints or damping.ratios or any(contact.rough for contact in contacts):
        return None
    found = bar_at_largest(run.times, run.positions, shell, loading, damping, path, contacts)
    levels = dict(zip(run.times.tolist(), run.levels, strict=False))
    if found is None or levels.get(found[0]) == MODELS[TRUTH].name:  # auto may have that frame of DS
        return None
    return f"at its largest displacement, at {found[0]:.3g} {run.units.time}: ", found[1]
