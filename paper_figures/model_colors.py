"""One colour a model in every picture: that of the registry, by the model's name at the start of a label."""

from __future__ import annotations

from modalshell.models.registry import TRUTH, models

SHELL_THEORY = ("#145c25", "#2f9e44", "#8fd19e")
"""Shades of the colour of DS, for discrete shells of ``Isotropic`` on several meshes."""


def model_color(label: str, number: int = 0) -> str:
    """The colour of the model that a label such as "MD-ROM 8, twisted" begins with; twisted branches are paler."""
    for spec in sorted(models().values(), key=lambda spec: -len(spec.name)):
        if label.startswith(spec.name):
            return paler(spec.color) if "twisted" in label else spec.color
    return SHELL_THEORY[(number + 1) % len(SHELL_THEORY)] if number else models()[TRUTH].color


def paler(color: str, share: float = 0.5) -> str:
    """A colour ``#rrggbb`` mixed with white."""
    parts = (int(color[start : start + 2], 16) for start in (1, 3, 5))
    return "#" + "".join(f"{round(part + share * (255 - part)):02x}" for part in parts)
