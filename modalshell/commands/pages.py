"""A scene as a self-contained web page."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

import modalshell as ms
from modalshell.core.typing import Array, Progress
from modalshell.crowd.scene import FlockScene
from modalshell.files.provenance import repository_file
from modalshell.models.factory import MODE_COUNT
from modalshell.models.reduced_rotation_strain import ReducedWarp, trained_on_loads
from modalshell.page import Page
from modalshell.scene.parts import build_damping
from modalshell.scene.read import located

_RANK, _SAMPLES, _MIXTURES = 8, 32, 8
"""Shapes and triangles of reduced RSW on a page, and copies of each answer in its training."""
_MOST_NUMBERS = 700_000
"""Numbers of modes, rotations and shapes up to which a page has reduced RSW: about 2 MB."""
_NEAR = 0.05
"""Error in training up to which a page has reduced RSW."""
_EARTH = 9.81
"""Acceleration [m/s^2] that it is trained on where the scene has none."""


def scene_page(scene: ms.Scene) -> Page:
    """The page of a scene: its flock, or its shell with its loads, damping and number of modes.

    A shell moves by LMA, MWTS and, where its data are small enough, reduced RSW.

    A ModalShellWarning names what is left out: supports that move, constraints, how loads change, another model.

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
    lacking = ["the supports rest"] if path is not None else []
    if loads:
        lacking += ["loads that change are dead: as on the shape at rest, at their largest"]
        loading = shell.loading(force=force, loads=loads)
        force = loading.dead + loading.largest_force()
    lacking += ["there are no constraints"] if constraints else []
    lacking += ["there are no contacts"] if declared.contacts else []
    lacking += (
        [f"the model is LMA, MWTS or reduced RSW, not {model.spec.name}"]
        if model.spec.builder not in (ms.LinearModal, ms.ModalWarping, trained_on_loads)
        else []
    )
    lacking += ["modes are not damped one by one"] if motion is not None and motion.modal_damping else []
    if lacking:
        warnings.warn(f"{scene.file}: on the page {', '.join(lacking)}", ms.ModalShellWarning, stacklevel=2)
    gravity = (declared.loads.gravity if declared.loads else None) or (0.0, 0.0, 0.0)
    basis = ms.solve_modes(shell, model.options.get("modes", MODE_COUNT))
    reduced = _reduced(basis, np.array(gravity), force)
    if motion is None:
        return basis.page(title=scene.name, gravity=gravity, force=force, reduced=reduced)
    with located(scene.file, "motion", motion):
        damping = build_damping(motion)
    factors = damping.mass_factor, damping.stiffness_factor
    return basis.page(title=scene.name, gravity=gravity, force=force, damping=factors, dt=motion.dt, reduced=reduced)


def _reduced(basis: ms.Basis, gravity: Array, force: Array | None) -> ReducedWarp | None:
    """Reduced RSW for a page, trained on the scene's load and its weight in every direction; None where it is large."""
    size = 3 * len(basis.shell.rest_positions) * (2 * basis.count + _RANK)
    if basis.rigid_modes or size > _MOST_NUMBERS:
        return None
    strength = float(np.linalg.norm(gravity)) or _EARTH
    pulls = [sign * strength * axis for axis in np.eye(3) for sign in (1.0, -1.0)] + [gravity]
    dead = np.zeros_like(basis.shell.rest_positions) if force is None else force
    loads = [factor * (basis.shell.gravity_force(pull) + dead) for pull in pulls for factor in (0.5, 1.0)]
    full = ms.RotationStrain(basis)
    trained = ms.ReducedRotationStrain.trained(
        full, loads=np.array(loads), mixtures=_MIXTURES, aside=0.1, rank=_RANK, samples=_SAMPLES
    )
    return trained.on_page() if trained.training_error < _NEAR else None


def write_pages(folder: Path, on_step: Progress | None = None) -> list[Path]:
    """Write the page of every bundled scene into ``folder``; return the files."""
    scenes = sorted(repository_file("studies/scenes/v_beam.toml").parent.glob("*.toml"))
    written = []
    for index, file in enumerate(scenes):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ms.ModalShellWarning)  # what a page leaves out is known of these
            written.append(scene_page(ms.load_scene(file)).save(folder / f"{file.stem}.html"))
        if on_step is not None:
            on_step(index + 1, len(scenes))
    return written
