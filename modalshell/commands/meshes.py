"""Commands on a mesh file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import App, Parameter
from numpy.typing import NDArray
from rich.table import Table

import modalshell as ms
from modalshell.commands.choices import Timing, hold_one_end, motion_in_words, softening
from modalshell.commands.terminal import CONSOLE, end_with, progress, say
from modalshell.core.checks import checked_number
from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import make_folder
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.mesh.files import WRITABLE, Up, repair_mesh, told_up
from modalshell.mesh.parts import chosen_part, refuse_loose_parts
from modalshell.mesh.selection import selected
from modalshell.models.factory import MODE_COUNT, ModelFactory
from modalshell.models.registry import MODELS
from modalshell.motion.fields import checked_fields, with_fields
from modalshell.render.content import DEFAULT_CAMERA, checked_direction
from modalshell.run import Look, write_results
from modalshell.run.results import DISPLACEMENT
from modalshell.scene.models import model_tables
from modalshell.scene.parts import build_material
from modalshell.scene.tables import PhysicalSheet
from modalshell.statics.buckling import ADVICE, buckles

_OR_FILE = ", or a file with one number per triangle"
_YOUNG = 1e9
"""Young's modulus [Pa] if none is given or chosen."""
_TIMING = Timing(2.0, 1.0 / 30.0, (0.5, 0.001))
"""Duration, time step and damping if none are given or chosen."""
_FILM_RATE = 30.0
"""Frames a second of a film whose time step was chosen: small shells are shown slowed down, large ones sped up."""

MeshPath = Annotated[Path, Parameter(help="OBJ, PLY, STL, OFF or glTF file.")]
Repair = Annotated[bool, Parameter(name="--repair", negative="", help="Repair the mesh first, and list what was done.")]
Part = Annotated[
    Literal["largest", "all"] | int | None,
    Parameter(help="Connected part to take: its number, from 0 in order of decreasing area; largest; or all."),
]
UpAxis = Annotated[
    Up | None, Parameter(help="Axis of the file that points up, rotated to z; y for glTF and z for others if omitted.")
]
Join = Annotated[float | None, Parameter(help="Distance [m] up to which vertices are merged.")]


Triangles = Annotated[
    int | None, Parameter(help="Remesh into about this many nearly equilateral triangles (extra remesh).")
]


@Parameter(name="*")
class _ShellOptions:
    """Options that say how a mesh becomes a shell."""

    def __init__(
        self,
        *,
        clamp: Annotated[str | None, Parameter(help="Vertices to clamp, such as 'x < 0.01', or 'none'.")] = None,
        young: Annotated[float | Path | None, Parameter(help=f"Young's modulus [Pa]{_OR_FILE}.")] = None,
        poisson: Annotated[float | Path, Parameter(help=f"Poisson's ratio{_OR_FILE}.")] = 0.3,
        thickness: Annotated[
            float | Path | None, Parameter(help=f"Thickness [m]{_OR_FILE}; 1/200 of the mesh's size if omitted.")
        ] = None,
        density: Annotated[float | Path, Parameter(help=f"Mass per volume [kg/m^3]{_OR_FILE}.")] = 1000.0,
        calibrated: Annotated[
            bool, Parameter(help="Springs and hinges calibrated on the mesh, in place of shell theory.", negative="")
        ] = False,
        repair: Repair = False,
        component: Part = None,
        join: Join = None,
        triangles: Triangles = None,
        up: UpAxis = None,
    ) -> None:
        self.up = up
        self.repair, self.component, self.join, self.triangles = repair, component, join, triangles
        self.clamp, self.calibrated = clamp, calibrated
        self.material = {"young": young, "poisson": poisson, "thickness": thickness, "density": density}

    def mesh(self, path: Path) -> ms.TriangleMesh:
        """Load the mesh, repaired, of the parts and in as many triangles as are asked for."""
        if self.repair:
            mesh, report = repair_mesh(path, tolerance=self.join, component=self.component, up=self.up)
            say(f"{path}: {told_up(path, self.up)}")
            _tell(path, report)
        else:
            mesh = chosen_part(ms.load_mesh(path, up=self.up), self.component, self.join)
            say(f"{path}: {told_up(path, self.up)}")
        return _remeshed(path, mesh, self.triangles)

    def held(self, mesh: ms.TriangleMesh) -> NDArray[np.bool_]:
        """The vertices of ``--clamp``; none without it."""
        held = np.zeros(len(mesh.vertices), dtype=np.bool_)
        if self.clamp is not None and self.clamp != "none":
            held = selected("--clamp", self.clamp, mesh)
        if self.component != "all":
            refuse_loose_parts(mesh, held)
        return held

    def build(self, mesh: ms.TriangleMesh, held: NDArray[np.bool_]) -> ms.Shell:
        """The shell of a mesh with vertices held."""
        values: dict[str, Any] = {
            name: str(value) if isinstance(value, Path) else value for name, value in self.material.items()
        }
        if values["thickness"] is None:
            values["thickness"] = mesh.size / 200.0
        if values["young"] is None:
            values["young"] = _YOUNG
        material = build_material(PhysicalSheet(**values, calibrated=self.calibrated), mesh, Path())
        return ms.Shell(mesh, material, held if held.any() else None, loose_parts=self.component == "all")


@Parameter(name="*")
class _FilmOptions:
    """Options that say how a film or a picture looks."""

    def __init__(
        self,
        *,
        color: Annotated[
            str | None,
            Parameter(help="Colours: displacement, strain, curvature, von_mises, energy_density, ..."),
        ] = None,
        fps: Annotated[float | None, Parameter(help="Stored frames shown per second; real speed without it.")] = None,
        camera: Annotated[
            tuple[float, float, float], Parameter(help="Direction from the shell to the camera; z is up.")
        ] = DEFAULT_CAMERA,
        turntable: Annotated[bool, Parameter(negative="", help="Turn the shell once about the vertical.")] = False,
        still: Annotated[float | None, Parameter(help="Also draw the frame at this time [s].")] = None,
    ) -> None:
        self.color = "membrane_strain" if color == "strain" else color
        self.fps = None if fps is None else checked_number("--fps", fps, above=0.0, at_most=1000.0)
        self.camera = checked_direction(camera)
        self.turntable = turntable
        self.still = None if still is None else checked_number("--still", still, at_least=0.0, unit="s")


def _tell(path: Path, report: ms.RepairReport) -> None:
    for line in str(report).splitlines():
        say(f"{path}: {line}")


def _remeshed(path: Path, mesh: ms.TriangleMesh, triangles: int | None) -> ms.TriangleMesh:
    """The mesh in ``triangles`` triangles; as it is without them."""
    if triangles is None:
        return mesh
    made = ms.remesh(mesh, triangles)
    say(f"{path}: remeshed: {len(made.faces)} triangles in place of {len(mesh.faces)}")
    return made


@dataclass(frozen=True)
class _Chosen:
    """A shell and what its motion is stepped by; ``description`` says what was chosen for it."""

    shell: ms.Shell
    timing: Timing
    description: str


def _choose(options: _ShellOptions, mesh: ms.TriangleMesh, gravity: tuple[float, float, float], modes: int) -> _Chosen:
    """Supports for a mesh of which nothing is said, and unless it is named a stiffness that lets it sag visibly."""
    ends = hold_one_end(mesh, np.array(gravity))
    shell = options.build(mesh, ends.held)
    if options.material["young"] is not None:
        return _Chosen(shell, _TIMING, ends.description)
    factor = softening(ms.solve_modes(shell, min(modes, 3 * int(shell.free.sum()))), np.array(gravity))
    timing = Timing.of_sag(mesh.size, np.array(gravity))
    description = f"Young's modulus {factor * _YOUNG:.2g} Pa, at which the weight bends it; time step {timing.dt:.2g} s"
    return _Chosen(
        ms.Shell(mesh, _softer(shell.material, factor), ends.held, loose_parts=shell.loose_parts),
        timing,
        f"{ends.description}; {description}",
    )


def _softer(material: ms.Material | ms.Isotropic, factor: float) -> ms.Material | ms.Isotropic:
    """The material with all stiffnesses times ``factor``."""
    names = ("young",) if isinstance(material, ms.Isotropic) else ("stretch", "shear", "flexure")
    changed: dict[str, Any] = {name: factor * np.asarray(getattr(material, name)) for name in names}
    return replace(material, **changed)


def simulate(
    mesh: MeshPath,
    *,
    shell: _ShellOptions | None = None,
    gravity: Annotated[tuple[float, float, float], Parameter(help="Acceleration [m/s^2].")] = (0.0, 0.0, -9.81),
    model: Annotated[str, Parameter(help=f"One of {', '.join(MODELS)}.")] = "mwts",
    modes: Annotated[int, Parameter(help="Number of modes of the modal models.")] = MODE_COUNT,
    static: Annotated[bool, Parameter(help="Equilibrium instead of motion: a picture instead of a film.")] = False,
    duration: Annotated[float | None, Parameter(help="Simulated time [s]; 2 with --clamp.")] = None,
    dt: Annotated[float | None, Parameter(help="Time step, and time between frames [s]; 1/30 with --clamp.")] = None,
    damping: Annotated[
        tuple[float, float] | None,
        Parameter(help="Rayleigh factors of mass [1/s] and stiffness [s]; 0.5 and 0.001 with --clamp."),
    ] = None,
    film: _FilmOptions | None = None,
    out: Annotated[Path, Parameter(help="Folder for the results.")] = Path("results"),
) -> None:
    """Simulate a mesh under gravity; write a film, or with --static a picture, and the positions.

    Without --clamp one end of each part is clamped, and Young's modulus, duration, time step and damping, unless
    given, are chosen from the mesh's size such that its weight bends it visibly; the choice is printed. --clamp none
    lets it fall. Models: LMA (linear modal analysis), MWTS (modal warping), RSW (rotation-strain warping), MD-ROM
    (modal-derivative reduced-order model), DS (discrete shells).

    Example: modalshell simulate meshes/leaf.obj --clamp "x < 0.08" --model rsw --duration 1
    """
    known = model_tables()
    if model not in known:
        raise OptionError(f"there is no model {model!r}; choose from {', '.join(known)}")
    name = f"{mesh.stem}_{model}"
    refuse_foreign(out / f"{name}.npz")
    options = shell or _ShellOptions()
    built_mesh = options.mesh(mesh)
    if options.clamp is None:
        chosen = _choose(options, built_mesh, gravity, modes)
    else:
        chosen = _Chosen(options.build(built_mesh, options.held(built_mesh)), _TIMING, "")
    built, timing = chosen.shell, chosen.timing
    say(f"{mesh}: {len(built.mesh.vertices)} vertices, {len(built.mesh.faces)} triangles, {built.clamped.sum()} held")
    if chosen.description:
        say(f"{mesh}: {chosen.description}")
    kind = known[model]
    seen = film or _FilmOptions()
    color = seen.color
    if color is not None and color != DISPLACEMENT:
        checked_fields([color], built)
    load = built.gravity_force(gravity)
    factory = ModelFactory(built, lambda: load)
    model_used = kind(**({"modes": modes} if "modes" in kind.__struct_fields__ else {})).build(factory)
    for basis in factory.bases.values():
        span = f"{basis.frequencies[0]:.4g} to {basis.frequencies[-1]:.4g} Hz"
        say(f"{basis.count} modes, {basis.rigid_modes} rigid, {span}")
    make_folder(out)
    if static:
        answer = model_used.equilibrium(gravity=gravity)
        found = ms.Trajectory.still(answer, built, built.loading(gravity))
        work = f"{answer.iterations} iterations, residual {answer.residual:.1e}"
    else:
        with progress(f"{model_used.name} steps") as on_step:
            found = ms.simulate(
                model_used,
                duration=timing.duration if duration is None else duration,
                dt=timing.dt if dt is None else dt,
                gravity=gravity,
                damping=damping or timing.damping,
                on_step=on_step,
            )
        work = f"{len(found.times)} frames in {found.seconds:.3g} s"
    if color is not None and color != DISPLACEMENT:
        found = with_fields(found, built, [color])
    if kind.spec.quadratic and buckles(built, load):
        found = found.with_remark(ADVICE)
    say(f"{model_used.name}: {found.outcome.with_message(found.message)}, {work}")
    if built.clamped.any():
        say(f"{model_used.name}: {motion_in_words(found, built.mesh.size)}")
    formats = ["npz", "png"] if static else ["npz", "mp4", *(["png"] if seen.still is not None else [])]
    title = f"{mesh.stem}, {model_used.name}"
    rate = seen.fps or (_FILM_RATE if timing is not _TIMING and dt is None else None)
    look = Look(rate=rate, color=color, camera=seen.camera, turntable=seen.turntable, still=seen.still)
    with progress("film") as on_frame:
        written = write_results(found, out, name, formats, title=title, look=look, on_step=on_frame)
    say(*written, sep="\n")
    end_with(found.outcome)


def modes(
    mesh: MeshPath,
    *,
    shell: _ShellOptions | None = None,
    count: Annotated[int, Parameter(help="Number of modes, rigid ones included.")] = 8,
    out: Annotated[Path, Parameter(help="Folder for the picture and the basis.")] = Path("results"),
) -> None:
    """Print the natural frequencies of a mesh and draw its mode shapes; without --clamp it is free.

    Example: modalshell modes meshes/leaf.obj --clamp "x < 0.08" --count 8
    """
    refuse_foreign(out / f"{mesh.stem}_basis.npz")
    options = shell or _ShellOptions()
    loaded = options.mesh(mesh)
    built = options.build(loaded, options.held(loaded))
    make_folder(out)
    basis = ms.solve_modes(built, count)
    table = Table("mode", "frequency [Hz]", "kind")
    for k, frequency in enumerate(basis.frequencies):
        table.add_row(str(k + 1), f"{frequency:.6g}", "rigid" if k < basis.rigid_modes else "elastic")
    CONSOLE.print(table)
    basis.save(out / f"{mesh.stem}_basis.npz")
    say(out / f"{mesh.stem}_basis.npz")
    say(basis.plot().save(out / f"{mesh.stem}_modes.png"))


def repair(
    mesh: MeshPath,
    *,
    out: Annotated[Path, Parameter(help="File to write: OBJ, PLY, STL, OFF or GLB; not the mesh itself.")],
    component: Part = None,
    join: Join = None,
    triangles: Triangles = None,
    up: UpAxis = None,
) -> None:
    """Repair a mesh so that it can be a shell, and list what was done (see ms.repair); holes stay open.

    Example: modalshell repair scan.stl --out scan_repaired.ply --component largest
    """
    checked_target("--out", out, WRITABLE, mesh)
    mended, report = repair_mesh(mesh, tolerance=join, component=component, up=up)
    say(f"{mesh}: {told_up(mesh, up)}")
    _tell(mesh, report)
    ms.save_mesh(_remeshed(mesh, mended, triangles), out)
    say(out)


def register(app: App) -> None:
    """Add the commands to ``app``."""
    for command in (simulate, modes, repair):
        app.command(command)
