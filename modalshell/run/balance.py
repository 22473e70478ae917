"""Whether load and reactions of a scene are in balance, and the reactions."""

from __future__ import annotations

from modalshell.models.registry import TRUTH
from modalshell.scene import ShellScene


def held_by_supports(scene: ShellScene) -> bool:
    """Whether its supports alone carry the load: in motion inertia does, too, else colliders and constraints may."""
    return scene.motion is None and not scene.contacts and not scene.constraints


def has_reactions(scene: ShellScene) -> bool:
    """Whether its answer has reactions: the shell's own forces balance the load on answers of DS alone."""
    return held_by_supports(scene) and scene.model.spec.key == TRUTH
