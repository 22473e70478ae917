"""Scene of a flock: the declaration in its file, and the birds built from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

from modalshell.brief import brief
from modalshell.crowd import Flight
from modalshell.errors import SceneError
from modalshell.modes import solve_modes
from modalshell.scene import tables
from modalshell.scene.flock import FlockTable
from modalshell.scene.read import located
from modalshell.scene.scene import Scene, ShellScene
from modalshell.scene.signatures import load_entries
from modalshell.shell import Shell

_GRAVITY = (0.0, 0.0, -9.81)
"""Gravity of a flock whose scene declares none [m/s^2]."""
_FORMATS = ("npz", "png", "mp4")


@final
@brief
@dataclass(frozen=True, kw_only=True)
class FlockScene(Scene):
    """A scene of many such shells in flight, stepped by MWTS under gravity alone.

    Attributes
    ----------
    name, file, mesh, material, model, supports, energies, loads, output
        See :class:`Scene`.
    motion : MotionTable
        Duration and steps of the flight.
    flock : FlockTable
        The birds; see :mod:`modalshell.scene.flock`.

    Raises
    ------
    SceneError
        If another table requests what a flock does not support.
    """

    motion: tables.MotionTable
    flock: FlockTable

    def __post_init__(self) -> None:
        model, loads = self.model, self.loads
        refused = {
            "model: a flock is stepped by mwts, with its number of modes and no other option": (
                model.spec.key != "mwts" or model != type(model)(modes=model.options["modes"])
            ),
            "loads: a flock takes gravity alone": bool(loads and (loads.forces or any(load_entries(loads)))),
            "supports.times: a bird's supports move with its boid": bool(self.supports and self.supports.times),
            "motion.modal_damping: a flock takes damping alone": bool(
                self.motion.damping_ratios or self.motion.modal_damping
            ),
            f"output.formats: those of a flock are {', '.join(_FORMATS)}": (
                not set(self.output.formats) <= set(_FORMATS)
            ),
        }
        refused["output.fields, output.color: a flock has no fields"] = bool(self.output.fields or self.output.color)
        for text, wrong in refused.items():
            if wrong:
                raise SceneError(f"{self.file}: {text}")

    def require_shell(self) -> ShellScene:
        """Raise SceneError: this scene has many shells."""
        raise SceneError(f"{self.file}: flock: this is about one shell; flocks are for run_scene, modalshell run")

    def content(self) -> dict[str, Any]:
        """All input except the mesh's vertices and faces, as plain dicts and lists."""
        return super().content() | {"flock": self.flock.plain()}

    def build_flight(self, shell: Shell) -> Flight:
        """The birds at their start; SceneError where the table is refused."""
        gravity = self.loads.gravity if self.loads and self.loads.gravity else _GRAVITY
        basis = solve_modes(shell, self.model.options["modes"])
        with located(self.file, "flock", self.flock):
            return self.flock.build(basis, gravity, self.motion.damping, self.output.positions)
