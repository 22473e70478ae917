"""A scene as a self-contained web page."""

from __future__ import annotations

import warnings
from pathlib import Path

from modalshell.errors import ModalShellWarning
from modalshell.models import LinearModal, ModalWarping
from modalshell.models.factory import MODE_COUNT
from modalshell.modes import solve_modes
from modalshell.page import Page
from modalshell.provenance import repository_file
from modalshell.scene.flock_scene import FlockScene
from modalshell.scene.load import load_scene
from modalshell.scene.parts import build_damping
from modalshell.scene.read import located
from modalshell.scene.scene import Scene
from modalshell.typing import Progress


def scene_page(scene: Scene) -> Page:
    """The page of a scene: its flock, or its shell by LMA and MWTS with its loads, damping and number of modes.

    A ModalShellWarning names what the page leaves out: supports that move, constraints, another model.

    Raises
    ------
    SceneError
        If a table is refused.
    OptionError
        If there are more birds or modes than a browser takes.
    """
    if isinstance(scene, FlockScene):
        flight, eye = scene.build_flight(scene.build_shell()), scene.flock.camera
        span = scene.motion
        return flight.page(camera=(eye.position, eye.target), dt=span.dt, duration=span.duration, title=scene.name)
    declared = scene.require_shell()
    shell = declared.build_shell()
    path, force, loads, constraints = declared.build_loading(shell)
    model, motion = declared.model, declared.motion
    left = ["the supports rest"] if path is not None else []
    left += ["there are no loads that change with the shell or in time"] if loads else []
    left += ["there are no constraints"] if constraints else []
    left += (
        [f"the model is LMA or MWTS, not {model.spec.name}"]
        if model.spec.builder not in (LinearModal, ModalWarping)
        else []
    )
    left += ["modes are not damped one by one"] if motion is not None and motion.modal_damping else []
    if left:
        warnings.warn(f"{scene.file}: on the page {', '.join(left)}", ModalShellWarning, stacklevel=2)
    gravity = (declared.loads.gravity if declared.loads else None) or (0.0, 0.0, 0.0)
    basis = solve_modes(shell, model.options.get("modes", MODE_COUNT))
    if motion is None:
        return basis.page(title=scene.name, gravity=gravity, force=force)
    with located(scene.file, "motion", motion):
        damping = build_damping(motion)
    factors = damping.mass_factor, damping.stiffness_factor
    return basis.page(title=scene.name, gravity=gravity, force=force, damping=factors, dt=motion.dt)


def write_pages(folder: Path, on_step: Progress | None = None) -> list[Path]:
    """Write the page of every bundled scene into ``folder``; return the files."""
    scenes = sorted(repository_file("studies/scenes/v_beam.toml").parent.glob("*.toml"))
    written = []
    for index, file in enumerate(scenes):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModalShellWarning)  # what a page leaves out is known of these
            written.append(scene_page(load_scene(file)).save(folder / f"{file.stem}.html"))
        if on_step is not None:
            on_step(index + 1, len(scenes))
    return written
