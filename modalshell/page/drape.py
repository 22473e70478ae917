"""The drape meter: a page that turns a measured overhang and weight into bending stiffness, cards and a drape."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

import numpy as np

from modalshell.page.html import Page, filled_page
from modalshell.shell.cards import CARDS, GRAVITY
from modalshell.shell.fabric import Fabric

CLOTH, DISCS = 0.15, 0.09
"""Radius of the cloth, and of the discs that hold it [m]: the drape test of Cusick, BS 5058."""
OVERHANG = 2.0003
"""Overhang over bending length at which a strip hangs to 41.5 degrees."""
FAMILY = Path(str(files(__package__))) / "drape_family.json"
"""The drapes, made by ``python -m studies.drape_family``."""


def coefficient_between(length: float, lengths: Sequence[float], coefficients: Sequence[float]) -> float:
    """Drape coefficient at a bending length [m] between those of a family, by the logarithm of the lengths."""
    order = np.argsort(lengths)
    return float(np.interp(np.log(length), np.log(np.array(lengths)[order]), np.array(coefficients)[order]))


def drape_page() -> Page:
    """The page, with the family of drapes and all cards; it needs no server and no network."""
    family = json.loads(FAMILY.read_text(encoding="utf-8"))
    positions = np.frombuffer(_decoded(family["positions"]), dtype="<i2").reshape(len(family["lengths"]), -1, 3)
    faces = np.frombuffer(_decoded(family["faces"]), dtype="<u2").reshape(-1, 3).astype(np.int64)
    middle = family["scale"] * positions[len(positions) // 2].astype(np.float64)
    cards = [
        {
            "name": name,
            "what": card.what,
            "bending": card.bending,
            "weight": card.weight,
            "stretch": _stretch(card.material),
        }
        for name, card in CARDS.items()
    ]
    data = {
        **family,
        "cards": cards,
        "gravity": GRAVITY,
        "overhang": OVERHANG,
        "discs": DISCS,
        "cloth": CLOTH,
        "size": 2.0 * CLOTH,
    }
    notes = ["Measure how far a strip hangs over an edge when it has sunk to 41.5 degrees, and weigh it."]
    return filled_page("drape", "Drape meter", data, middle, faces, notes=notes)


def _decoded(text: str) -> bytes:
    import base64

    return base64.b64decode(text)


def _stretch(material: object) -> list[float] | None:
    """Stretch of a fabric [N/m]; None of other sheets."""
    return [float(value) for value in material.stretch] if isinstance(material, Fabric) else None  # type: ignore[arg-type]
