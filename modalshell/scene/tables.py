"""The tables of a scene file: their keys, types, bounds and defaults.

Next to the tables stand ``name``, of the results' files, and ``bar = true``: the equilibrium, or every 15th frame of a
motion, then gets an error bar against DS. In sweeps equilibria alone do, in their messages.

Keys of shapes, supports, loads, colliders and models are the parameters of these; ``modalshell keys`` lists them all.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from modalshell.core.units import UnitSystem
from modalshell.motion.recorder import step_count

Positive = Annotated[float, Meta(gt=0.0)]
NotNegative = Annotated[float, Meta(ge=0.0)]
Count = Annotated[int, Meta(ge=1)]
Vertex = Annotated[int, Meta(ge=0)]
Vector = tuple[float, float, float]
Keyframes = Annotated[list[Vector], Meta(min_length=2)]
Times = Annotated[list[float], Meta(min_length=2)]
Selection = str | list[Vertex | bool]
"""Vertices by an expression such as ``x < 0.026``, by index, or by a mask."""

FieldName = Literal[
    "membrane_strain", "membrane_force", "curvature", "moment", "von_mises", "von_mises_faces", "energy_density"
]
Format = Literal["npz", "vtkhdf", "pvd", "clip", "usdc", "usda", "glb", "pc2", "mdd", "csv", "mp4", "png"]


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the file; other keys than these are refused."""

    def plain(self) -> Any:
        """The table as plain dicts and lists, defaults filled in."""
        return msgspec.to_builtins(self)


class MeshFile(Table, frozen=True):
    """``[mesh]``: a file, relative to the scene file; ``meshes/...`` also finds the bundled ones.

    Parameters
    ----------
    file : str
        OBJ, PLY, STL, OFF, glTF, MSH or USD, in the scene's unit of length; USD states its own, which is converted.
    component : str or int
        Part of a file in several: its number from 0 by falling area, "largest", or "all" though some are not held.
    join : float
        Distance [m] up to which vertices are merged, to join parts that touch.
    repair : bool
        Whether the mesh is repaired first, by ``ms.repair``; a warning lists what was done.
    split : bool
        Whether it is repaired and cut apart at edges of three or more faces: a rib then holds its plate no longer.
    up : str
        Axis of the file that points up and is rotated to z; by default y for glTF, else z.
    """

    file: str
    component: Literal["largest", "all"] | Annotated[int, Meta(ge=0)] | None = None
    join: Annotated[float, Meta(gt=0)] | None = None
    repair: bool = False
    split: bool = False
    up: Literal["x", "y", "z"] | None = None


class Stiffnesses(Table, frozen=True):
    """``[material]`` by the stiffnesses of the discrete-shell energies.

    ``stretch`` [N/m], ``shear`` [N], ``flexure`` [N m], ``density`` per area [kg/m^2].
    """

    stretch: float
    shear: NotNegative
    flexure: NotNegative
    density: Positive


Field = Positive | Annotated[list[Positive], Meta(min_length=1)] | Annotated[str, Meta(min_length=1)]
"""One number, one per triangle, or a file of these: ``.npy``, or text with one number per line."""
_Ratio = Annotated[float, Meta(gt=-1.0, le=0.5)]


class PhysicalSheet(Table, frozen=True):
    """``[material]`` by an isotropic sheet of shell theory, or ``calibrated`` stiffnesses of discrete shells.

    ``young`` [Pa], ``poisson``, ``thickness`` [m], ``density`` per volume [kg/m^3]; files as those of ``[mesh]``.
    """

    young: Field
    poisson: _Ratio | Annotated[list[_Ratio], Meta(min_length=1)] | Annotated[str, Meta(min_length=1)]
    thickness: Field
    density: Field
    calibrated: bool = False


class Supports(Table, frozen=True):
    """``[supports]``: vertices that are held, and keyframes of the path that they move along.

    ``times`` [s], ``translations`` [m], ``rotations`` as rotation vectors [rad] about ``pivot`` [m]. A smooth path
    joins them that starts and stops at rest, so that its speed is not constant where keyframes are in one line.
    """

    clamped: Selection
    times: Times | None = None
    translations: Keyframes | None = None
    rotations: Keyframes | None = None
    pivot: Vector | None = None


class Units(Table, frozen=True):
    """``[units]``: the units of a scene's numbers, which must be of one system: forces follow from the three.

    With mm, t and s forces are in N and stresses in MPa. Numbers are not converted, but for the density of wind's
    air and the gravity of ``weight`` where they are left out.
    """

    length: Literal["m", "cm", "mm", "um", "km", "in", "ft"] = "m"
    mass: Literal["kg", "g", "mg", "t", "lb"] = "kg"
    time: Literal["s", "ms", "us", "min"] = "s"

    @property
    def system(self) -> UnitSystem:
        """The three, from which all others follow."""
        return UnitSystem(self.length, self.mass, self.time)


class Moved(Table, frozen=True):
    """``path`` of ``[[contacts]]``: keyframes along which the collider moves, at rest at both ends."""

    times: Times
    translations: Keyframes | None = None
    rotations: Keyframes | None = None
    pivot: Vector | None = None


class Path(Moved, frozen=True, tag_field="kind", tag="path"):
    """``[[supports]]`` of ``kind = "path"``: keyframes along which all supports move, at rest at both ends."""


class SupportList(Table, frozen=True):
    """``[[supports]]``: a table for each support, by the kinds of :mod:`modalshell.supports`; one may be their path."""

    entries: list[Any]

    @property
    def path(self) -> Path | None:
        """The table of the path."""
        return next((entry for entry in self.entries if isinstance(entry, Path)), None)

    @property
    def times(self) -> Times | None:
        """Its times [s]."""
        return None if self.path is None else self.path.times


class Force(Table, frozen=True):
    """``[[loads.forces]]``: a force of ``total`` [N], spread over the vertices of ``where`` by their share of area."""

    where: Selection
    total: Vector


class Loads(Table, frozen=True):
    """``[loads]``: ``gravity`` [m/s^2] and forces."""

    gravity: Vector | None = None
    forces: list[Force] = []


class Constrained(Table, frozen=True):
    """``[[constraints]]``: prescribed position [m] or orientation (rotation vector [rad]) of a patch.

    The patch is given by ``vertices`` or as the vertex ``nearest`` to a point of the rest shape [m]; its goal by
    ``target``, or by ``targets`` at ``times`` [s], joined by a ``path`` that starts and stops at rest ("cubic") or
    straight. A ``relative`` position counts from the patch's rest position.
    """

    kind: Literal["position", "orientation"]
    vertices: Vertex | Selection | None = None
    nearest: Vector | None = None
    target: Vector | None = None
    times: Times | None = None
    targets: Keyframes | None = None
    path: Literal["cubic", "linear"] = "cubic"
    relative: bool = False


class MotionTable(Table, frozen=True):
    """``[motion]``: motion from rest; a scene without it asks for the equilibrium.

    ``duration`` and ``dt`` [s], Rayleigh ``damping`` of mass [1/s] and stiffness [s], ``store_every`` steps.
    In place of ``damping``: ``damping_ratios``, shares of critical damping measured at two frequencies, each ``[Hz,
    share]``; or, for modal models, ``modal_damping``, such a share for each mode or one for all. ``tolerance``, a share
    of the shell's size, divides steps as in :func:`modalshell.simulate`.
    """

    duration: Positive
    dt: Positive = 1.0 / 30.0
    damping: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    store_every: Count = 1
    tolerance: Annotated[float, Meta(ge=1e-9, le=1.0)] | None = None
    damping_ratios: tuple[tuple[Positive, NotNegative], tuple[Positive, NotNegative]] | None = None
    modal_damping: Annotated[list[NotNegative], Meta(min_length=1)] | None = None

    def steps(self, seconds: float | None = None) -> int:
        """Whole steps that cover some seconds, the duration by default; OptionError if no run would ever end."""
        return step_count(self.duration if seconds is None else seconds, self.dt)


class PathTable(Table, frozen=True):
    """``[path]``: how ``modalshell path`` follows the equilibria under the scene's load times a growing factor.

    ``until`` and ``begin`` are load factors, ``control`` what steps are measured by, ``steps`` their number at least,
    ``points`` the most of a path, ``branches`` the bifurcations whose other branch is followed. ``watch`` names the
    vertices whose mean displacement along ``direction`` is reported; by default the load's direction.
    """

    until: float = 1.0
    begin: float = 0.0
    control: Literal["arc", "load", "displacement"] = "arc"
    steps: Count = 20
    points: Annotated[int, Meta(ge=2)] = 400
    branches: Annotated[int, Meta(ge=0)] = 0
    watch: Selection | None = None
    direction: Vector | None = None


class Output(Table, frozen=True):
    """``[output]``: ``folder`` (relative to the working folder), precision of the positions, and formats.

    The ``.npz`` file is always written; ``csv`` is a table for spreadsheets, of the vertices and, with ``fields``, of
    the triangles. ``fields`` of the triangles are stored with every frame, and films and pictures coloured by the one
    named ``color``. A film of less than half a second is slowed, and says so. With the ``look`` "plain" films show the
    shell alone, without ground, shadow and text; with the ``camera`` "follow" their camera moves with the middle of the
    shell, as of one that falls. A ``camera`` of three numbers is the direction from the shell to it; z is up, and from
    right above y is.
    """

    folder: Annotated[str, Meta(min_length=1)] = "results"
    positions: Literal["float64", "float32"] = "float64"
    formats: list[Format] = []
    fields: list[FieldName] = []
    color: FieldName | Literal["displacement"] | None = None
    look: Literal["stage", "plain"] = "stage"
    camera: Literal["still", "follow"] | Vector = "still"
