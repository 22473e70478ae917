"""A scene as a self-contained web page."""

from __future__ import annotations

import warnings

from modalshell.errors import ModalShellWarning
from modalshell.models.factory import MODE_COUNT
from modalshell.modes import solve_modes
from modalshell.page import Page
from modalshell.scene.scene import Scene


def scene_page(scene: Scene) -> Page:
    """The page of a scene's shell by LMA and MWTS, with the scene's gravity, forces, damping and number of modes.

    A ModalShellWarning names what the page leaves out: supports that move, constraints, another model.

    Raises
    ------
    SceneError
        If the scene is about a flock, or a table is refused.
    """
    declared = scene.require_shell()
    shell = declared.build_shell()
    path, force, constraints = declared.build_loading(shell)
    model, motion = declared.model, declared.motion
    left = ["the supports rest"] if path is not None else []
    left += ["there are no constraints"] if constraints else []
    left += [f"the model is LMA or MWTS, not {model.spec.name}"] if model.spec.key not in ("lma", "mwts") else []
    if left:
        warnings.warn(f"{scene.file}: on the page {', '.join(left)}", ModalShellWarning, stacklevel=2)
    gravity = (declared.loads.gravity if declared.loads else None) or (0.0, 0.0, 0.0)
    basis = solve_modes(shell, model.options.get("modes", MODE_COUNT))
    if motion is None:
        return basis.page(title=scene.name, gravity=gravity, force=force)
    return basis.page(title=scene.name, gravity=gravity, force=force, damping=motion.damping, dt=motion.dt)
