"""Scenes of a flock of birds, each an instance of the scene's shell: ``[flock]``, its tables and objects."""

from __future__ import annotations

import copyreg
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, final

import numpy as np
from msgspec import Meta

from modalshell.core.errors import SceneError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.crowd.crowd import Crowd
from modalshell.crowd.flap import Flap
from modalshell.crowd.flight import Flight
from modalshell.crowd.flock import MOST, MOST_THREADS, Flock
from modalshell.modes import Basis, model_basis
from modalshell.page import Page
from modalshell.scene import tables
from modalshell.scene.kinds import KINDS, SceneKind
from modalshell.scene.load import pickled_scene
from modalshell.scene.parts import checked_keyframes
from modalshell.scene.read import located
from modalshell.scene.scene import Scene, ShellScene
from modalshell.scene.signatures import load_entries
from modalshell.scene.tables import Keyframes, NotNegative, Positive, Table, Times, Vector
from modalshell.shell import Shell

Pixels = Annotated[int, Meta(ge=64, le=8192)]
_FORMATS = ("npz", "png", "mp4")


class TargetTable(Table, frozen=True):
    """``[flock.target]``: ``points`` [m] at ``times`` [s], joined smoothly, that attract it with a ``weight``."""

    times: Times
    points: Keyframes
    weight: float = 1.0


class FlapTable(Table, frozen=True):
    """``[flock.flap]``: parameters of :class:`modalshell.crowd.Flap`."""

    amplitude: NotNegative = 0.0
    frequency: NotNegative = 2.0
    largest_load_factor: Positive = 3.0


class DetailTable(Table, frozen=True):
    """``[flock.detail]``: allowed error of levels of detail.

    No vertex is drawn more than ``pixels`` from its position by MWTS, seen from the camera of a film. Birds nearer than
    ``strains_within`` [m] are drawn by RSW, birds beyond half as much again are not, and between them it blends in;
    0 leaves it out.
    """

    pixels: Positive = 0.5
    strains_within: NotNegative = 0.0


class CameraTable(Table, frozen=True):
    """``[flock.camera]``: position, and settings of films and pictures.

    ``position`` and ``target`` [m], vertical ``view_angle`` [degrees], picture ``size`` [pixels], time of the ``still``
    [s] (the end without it), H.264's ``rate_factor`` (higher is smaller), ``color`` of the birds. With ``follow`` the
    camera goes along with the middle of the flock, which it has at ``target``; with the height of a ``ground`` [m]
    there are ground, sky and shadows.
    """

    position: Vector
    target: Vector = (0.0, 0.0, 0.0)
    view_angle: Annotated[float, Meta(gt=0.0, lt=170.0)] = 40.0
    size: tuple[Pixels, Pixels] = (960, 540)
    still: NotNegative | None = None
    rate_factor: Annotated[int, Meta(ge=0, le=51)] = 24
    color: str = "#8fb3d9"
    follow: bool = False
    ground: float | None = None


class FlockTable(Table, frozen=True):
    """``[flock]``: ``count`` birds that start in a ball of ``radius`` [m], and the parameters of a flock.

    ``warm_up`` [s] is flown before time 0. The remaining keys are parameters of :class:`modalshell.Flock`; ``weights``
    are those of separation, alignment and cohesion.
    """

    count: Annotated[int, Meta(ge=1, le=MOST)]
    radius: Positive
    camera: CameraTable
    seed: Annotated[int, Meta(ge=0)] = 0
    warm_up: NotNegative = 0.0
    speed: NotNegative = 1.0
    speed_variation: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.2
    noise_frequency: NotNegative = 0.5
    rotation_speed: NotNegative = 1.0
    neighbour_distance: Positive = 1.0
    field_of_view: Annotated[float, Meta(gt=0.0, le=360.0)] = 360.0
    weights: tuple[NotNegative, NotNegative, NotNegative] = (1.0, 1.0, 1.0)
    flock_position: Vector = (0.0, 0.0, 0.0)
    bounds: tuple[Vector, Vector] | None = None
    threads: Annotated[int, Meta(ge=1, le=MOST_THREADS)] = 1
    target: TargetTable | None = None
    flap: FlapTable = FlapTable()
    detail: DetailTable = DetailTable()

    def build(self, basis: Basis, gravity: Vector, damping: tuple[float, float], positions: str) -> Flight:
        """The birds at the start, before they warm up."""
        own = ("speed", "speed_variation", "noise_frequency", "rotation_speed", "neighbour_distance", "field_of_view",
               "weights", "flock_position", "bounds", "threads")  # fmt: skip
        parameters = {name: getattr(self, name) for name in own}
        weight = 1.0 if self.target is None else self.target.weight
        flock = Flock.random(self.count, radius=self.radius, seed=self.seed, target_weight=weight, **parameters)
        crowd = Crowd(basis, self.count, damping=damping, dtype=positions, threads=self.threads)
        flap = Flap(basis, **self.flap.plain())
        path = None if self.target is None else build_target(self.target)
        return Flight(flock, crowd, flap, gravity=gravity, target=path, seed=self.seed)


def build_target(table: TargetTable) -> Callable[[float], Array]:
    """The target's place at a time; before the first and after the last keyframe it stays."""
    from scipy.interpolate import CubicSpline  # not before there is a target: its import takes long

    times, points = checked_keyframes(table.times, table.points)
    spline = CubicSpline(times, points)
    return lambda time: spline(np.clip(time, times[0], times[-1]))


@final
@short_repr
@dataclass(frozen=True, kw_only=True)
class FlockScene(Scene):
    """A scene of many such shells in flight, stepped by MWTS under gravity alone.

    SceneError if another table requests what a flock does not support.

    Attributes
    ----------
    name, file, mesh, material, model, supports, energies, loads, output
        See :class:`Scene`.
    motion : MotionTable
        Duration and steps of the flight.
    flock : FlockTable
        The birds; see :mod:`modalshell.crowd.scene`.
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
        refused["motion.tolerance: a flock takes whole steps"] = self.motion.tolerance is not None
        refused["output.look, output.camera: a flock takes flock.camera in their place, its follow and ground"] = (
            self.output.look != "stage" or self.output.camera != "still"
        )
        for text, wrong in refused.items():
            if wrong:
                raise SceneError(f"{self.file}: {text}")

    def require_shell(self) -> ShellScene:
        """Raise SceneError: this scene has many shells."""
        raise SceneError(f"{self.file}: flock: this is about one shell; flocks are for run_scene, modalshell run")

    def own_page(self) -> Page:
        """The flight, computed live in the browser; OptionError for more birds or modes than it takes."""
        flight, eye, span = self.build_flight(self.build_shell()), self.flock.camera, self.motion
        times: dict[str, Any] = {"dt": span.dt, "duration": span.duration, "units": self.unit_system}
        return flight.page(camera=(eye.position, eye.target), title=self.name, **times)

    def content(self) -> dict[str, Any]:
        """All input except the mesh's vertices and faces, as plain dicts and lists."""
        return super().content() | {"flock": self.flock.plain()}

    def build_flight(self, shell: Shell) -> Flight:
        """The birds at their start; SceneError where the table is refused."""
        earth = (0.0, 0.0, -self.unit_system.earth)
        gravity = self.loads.gravity if self.loads and self.loads.gravity else earth
        basis = model_basis(shell, self.model.options["modes"])
        if basis.rigid_modes:
            fault = "a boid carries its bird by the supports, which do not hold this one"
            raise SceneError(f"{self.file}: supports: {fault}: clamp its body")
        with located(self.file, "flock", self.flock):
            return self.flock.build(basis, gravity, self.motion.damping, self.output.positions)


def declared_flock(declared: dict[str, Any]) -> FlockScene:
    """The scene of checked tables; SceneError where one is missing that a flight needs, or is none of a flock's."""
    file, tables_given = declared["file"], dict(declared)
    if "motion" not in declared:
        raise SceneError(f"{file}: motion: missing; a flight needs it")
    if tables_given.pop("constraints"):
        raise SceneError(f"{file}: constraints: a flock takes none")
    if "contacts" in declared:
        raise SceneError(f"{file}: contacts: a flock takes none")
    if "path" in declared:
        raise SceneError(f"{file}: path: a flock has none; leave the table out")
    return FlockScene(**tables_given)


KINDS["flock"] = SceneKind(FlockTable, declared_flock)
copyreg.pickle(FlockScene, pickled_scene)
