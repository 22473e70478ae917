"""Commands on a mesh file."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from cyclopts import Parameter
from rich.table import Table

import modalshell as ms
from modalshell.commands.choices import BUCKLES, SAG, YOUNG, Timing, assumed, hold_one_end, motion_as_text, softening
from modalshell.commands.terminal import CONSOLE, end_with, progress, say
from modalshell.commands.unasked_bars import error_as_text, has_bar
from modalshell.core.checks import checked_count, checked_number
from modalshell.core.units import LENGTHS
from modalshell.files.atomic_io import make_folder
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.mesh.files import WRITABLE, Up, repair_mesh, up_as_text
from modalshell.mesh.parts import chosen_part
from modalshell.models.factory import MODE_COUNT
from modalshell.models.registry import TRUTH
from modalshell.modes import model_basis
from modalshell.motion.colouring import DISPLACEMENT
from modalshell.render.content import DEFAULT_CAMERA, checked_direction
from modalshell.run.results import Look
from modalshell.run.run_shell import ShellRun
from modalshell.scene import ShellScene, parse_scene
from modalshell.scene.models import model_tables

_OR_FILE = ", or a file with one number per triangle"
_TIMING = Timing(2.0, 1.0 / 30.0, (0.5, 0.001))
"""Duration, time step and damping if none are given or chosen."""
_FILM_RATE = 30.0
"""Frames a second of a film whose time step was chosen: small shells are shown slowed down, large ones sped up."""
_LARGE = 20.0
"""Size [m] of meshes above which they are mostly of coordinates in mm."""
_OPTIONS = Path("options")
"""Stands for the file of the scene that options make."""
_SAME = "young poisson thickness density component join unit modes gravity duration dt damping color camera"
_OPTION_OF = {key: f"--{key}" for key in _SAME.split()} | {"clamped": "--clamp", "name": "--model"}
"""Options by the keys and parameters that they become."""

MeshPath = Annotated[Path, Parameter(help="OBJ, PLY, STL, OFF, glTF, USD or MSH (Gmsh) file.")]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class _MeshOptions:
    """Options that say how a mesh file becomes a mesh."""

    split: Annotated[
        bool,
        Parameter(
            negative="",
            help="Repair, and cut sheets apart where three or more faces meet at an edge, which are joined else: a "
            "rib then holds its plate no longer.",
        ),
    ] = False
    component: Annotated[
        Literal["largest", "all"] | int | None,
        Parameter(help="Connected part to take: its number, from 0 in order of decreasing area; largest; or all."),
    ] = None
    join: Annotated[float | None, Parameter(help="Distance [m] up to which vertices are merged.")] = None
    triangles: Annotated[
        int | None, Parameter(help="Remesh into about this many nearly equilateral triangles (extra remesh).")
    ] = None
    up: Annotated[
        Up | None,
        Parameter(help="Axis of the file that points up, rotated to z; by default as USD states, y of glTF, else z."),
    ] = None
    unit: Annotated[
        str | None, Parameter(help=f"Unit of the file's coordinates: one of {', '.join(LENGTHS)}; by default m.")
    ] = None

    def mesh(self, path: Path, repair: bool) -> ms.TriangleMesh:
        """Read a mesh, repaired, reduced to a part and remeshed as requested; print what was done."""
        lines = [up_as_text(path, self.up)]
        if repair or self.split:
            options: dict[str, Any] = {"component": self.component, "split": self.split, "up": self.up}
            mesh, report = repair_mesh(path, tolerance=self.join, unit=self.unit, **options)
            lines += str(report).splitlines()
        else:
            mesh = chosen_part(ms.load_mesh(path, up=self.up, unit=self.unit), self.component, self.join)
        if mesh.size > _LARGE and self.unit is None:
            lines.append(f"{mesh.size:.4g} m in size (`--unit mm` if its coordinates are in mm)")
        say(*(f"{path}: {line}" for line in lines), sep="\n")
        if self.triangles is None:
            return mesh
        made = ms.remesh(mesh, self.triangles)
        say(f"{path}: remeshed: {len(made.faces)} triangles in place of {len(mesh.faces)}")
        return made


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class _ShellOptions:
    """Options that say how a mesh becomes a shell."""

    clamp: Annotated[
        str | None, Parameter(help="Vertices to clamp, such as 'x < 0.01'; a .txt or .npy file of them; or 'none'.")
    ] = None
    young: Annotated[float | Path | None, Parameter(help=f"Young's modulus [Pa]{_OR_FILE}.")] = None
    poisson: Annotated[float | Path, Parameter(help=f"Poisson's ratio{_OR_FILE}.")] = 0.3
    thickness: Annotated[
        float | Path | None, Parameter(help=f"Thickness [m]{_OR_FILE}; 1/200 of the mesh's size if omitted.")
    ] = None
    density: Annotated[float | Path, Parameter(help=f"Mass per volume [kg/m^3]{_OR_FILE}.")] = 1000.0
    calibrated: Annotated[
        bool, Parameter(help="Springs and hinges calibrated on the mesh, in place of shell theory.", negative="")
    ] = False
    repair: Annotated[bool, Parameter(negative="", help="Repair the mesh first, and list what was done.")] = False
    source: _MeshOptions = _MeshOptions()

    def scene(self, path: Path, mesh: ms.TriangleMesh, tables: dict[str, Any]) -> ShellScene:
        """The scene of a mesh with these options, and with further tables."""
        sheet = {name: getattr(self, name) for name in ("young", "poisson", "thickness", "density", "calibrated")}
        sheet |= assumed(mesh.size, self.young, self.thickness)[0]
        file = {name: getattr(self.source, name) for name in ("component", "join", "split", "up")}
        raw: dict[str, Any] = {
            "mesh": {"file": str(path), "repair": self.repair} | file,
            "material": {name: str(value) if isinstance(value, Path) else value for name, value in sheet.items()},
            "model": {"name": "rigid"},
        }
        if self.clamp not in (None, "none"):
            raw["supports"] = {"clamped": self.clamp}
        return parse_scene(_OPTIONS, raw | tables).require_shell()

    def say_assumed(self, path: Path, mesh: ms.TriangleMesh) -> None:
        """Print what stands for the options that were not given."""
        if text := assumed(mesh.size, self.young, self.thickness)[1]:
            say(f"{path}: {text}")


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class _ModelOptions:
    """Options that say what is computed."""

    model: Annotated[str, Parameter(help="Such as lma, mwts, rsw or ds: 'modalshell keys model' lists all.")] = "mwts"
    modes: Annotated[int, Parameter(help="Number of modes of the modal models.")] = MODE_COUNT

    @property
    def table(self) -> dict[str, Any]:
        """The table of a scene."""
        known = model_tables()
        takes_modes = self.model in known and "modes" in known[self.model].__struct_fields__
        return {"name": self.model} | ({"modes": self.modes} if takes_modes else {})


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class _MotionOptions:
    """Options that say how long a shell moves, or that it does not."""

    static: Annotated[bool, Parameter(help="Equilibrium instead of motion: a picture instead of a film.")] = False
    duration: Annotated[float | None, Parameter(help="Simulated time [s]; 2 with --clamp.")] = None
    dt: Annotated[float | None, Parameter(help="Time step, and time between frames [s]; 1/30 with --clamp.")] = None
    damping: Annotated[
        tuple[float, float] | None,
        Parameter(help="Rayleigh factors of mass [1/s] and stiffness [s]; 0.5 and 0.001 with --clamp."),
    ] = None

    def table(self, timing: Timing) -> dict[str, Any]:
        """The table of a scene, with the values of ``timing`` for what was not given."""
        given = {name: getattr(self, name) for name in ("duration", "dt", "damping")}
        return {name: getattr(timing, name) if value is None else value for name, value in given.items()}


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class _FilmOptions:
    """Options that say how a film or a picture looks."""

    color: Annotated[
        str | None, Parameter(help="Colours: displacement, strain, curvature, von_mises, energy_density, ...")
    ] = None
    fps: Annotated[
        float | None, Parameter(help="Stored frames shown a second; else 30, or with --dt real speed, slowed if brief.")
    ] = None
    camera: Annotated[
        tuple[float, float, float], Parameter(help="Direction from the shell to the camera; z is up.")
    ] = DEFAULT_CAMERA
    follow: Annotated[bool, Parameter(negative="", help="Move the camera of a film with the shell.")] = False
    turntable: Annotated[bool, Parameter(negative="", help="Turn the shell once about the vertical.")] = False
    still: Annotated[float | None, Parameter(help="Also draw the frame at this time [s].")] = None
    style: Annotated[
        Literal["stage", "plain"],
        Parameter(name="--look", help="Films with ground, shadow, model and time, or the shell alone."),
    ] = "stage"

    @property
    def look(self) -> Look:
        """The options, checked."""
        return Look(
            rate=None if self.fps is None else checked_number("--fps", self.fps, above=0.0, at_most=1000.0),
            color="membrane_strain" if self.color == "strain" else self.color,
            camera=checked_direction(self.camera),
            turntable=self.turntable,
            still=None if self.still is None else checked_number("--still", self.still, at_least=0.0, unit="s"),
            style=self.style,
            follow=self.follow,
        )


def _choose(
    options: _ShellOptions, path: Path, mesh: ms.TriangleMesh, tables: dict[str, Any], modes: int
) -> tuple[_ShellOptions, Timing, str]:
    """Clamp one end by an entry of ``tables`` and, unless it is given, choose a stiffness for the weight.

    Return the options, the timing of the motion, and a description for the user.
    """
    gravity = np.array(tables["loads"]["gravity"])
    held, end = hold_one_end(mesh, gravity)
    tables["supports"] = {"clamped": np.flatnonzero(held).tolist()}
    if options.young is not None:
        return options, _TIMING, end
    # They are repeated for the shell that is simulated.
    with warnings.catch_warnings(action="ignore", category=ms.ModalShellWarning):
        shell = options.scene(path, mesh, tables).build_shell(mesh)
    count = min(checked_count("modes", modes), 3 * len(shell.free))
    factor, sag = softening(model_basis(shell, count), gravity)
    timing = Timing.of_sag(mesh.size, gravity, sag)
    does = "bends it" if sag == SAG else f"is 1/{BUCKLES:g} of what buckles it"
    chosen = f"Young's modulus {factor * YOUNG:.2g} Pa, at which the weight {does}; time step {timing.dt:.2g} s"
    return replace(options, young=factor * YOUNG), timing, f"{end}; {chosen}"


def _solve_modes(shell: ms.Shell, count: int) -> ms.Basis:
    """Compute the modes of a shell and print their range."""
    basis = ms.solve_modes(shell, count)
    span = f"{basis.frequencies[0]:.4g} to {basis.frequencies[-1]:.4g} Hz"
    say(f"{basis.count} modes, {basis.rigid_modes} rigid, {span}")
    return basis


def _with_options(text: str) -> str:
    """A message about a scene's key or a parameter, as one about the option that it comes from."""
    key = rf"^{_OPTIONS}: (?:\w+(?:\.(\w+)(\S*))?: )?"
    text = re.sub(key, lambda at: f"{_OPTION_OF.get(at[1], at[1])}{at[2]} " if at[1] else "", text)
    text = re.sub(r"^\w+(?= (must|holds) )", lambda name: _OPTION_OF.get(name[0], name[0]), text)
    text = re.sub("(?<= the mesh reaches from ).*", r"\g<0> m", text)  # whatever the unit of its file
    return text.replace("check [units]", "check the unit")


@contextmanager
def _name_options() -> Iterator[None]:
    """Errors and warnings raised inside name options."""
    with warnings.catch_warnings():
        show = warnings.showwarning
        warnings.showwarning = lambda message, *rest, **more: show(_with_options(str(message)), *rest, **more)
        try:
            yield
        except ms.ModalShellError as error:
            raise ms.OptionError(_with_options(str(error))) from error


@_name_options()
def simulate(
    mesh: MeshPath,
    *,
    shell: _ShellOptions | None = None,
    gravity: Annotated[tuple[float, float, float], Parameter(help="Acceleration [m/s^2].")] = (0.0, 0.0, -9.81),
    model: _ModelOptions | None = None,
    motion: _MotionOptions | None = None,
    film: _FilmOptions | None = None,
    out: Annotated[Path, Parameter(help="Folder for the results.")] = Path("results"),
    restart: Annotated[bool, Parameter(help="Discard the frames of a stopped run.", negative="")] = False,
) -> None:
    """Simulate a mesh under gravity; write a film, or with --static a picture, and the positions.

    Without --clamp one end of each part is clamped, and Young's modulus, duration, time step and damping, unless
    given, are chosen from the mesh's size such that its weight bends it visibly and is far from buckling it; the choice
    is printed. --clamp none lets it fall. Models: LMA (linear modal analysis), MWTS (modal warping), RSW
    (rotation-strain warping), MD-ROM (modal-derivative reduced-order model), DS (discrete shells). A stopped command
    that is repeated resumes after its last frame; complete results are not computed again.

    Example: modalshell simulate meshes/leaf.obj --clamp "x < 0.08" --model rsw --duration 1
    """
    options, look = shell or _ShellOptions(), (film or _FilmOptions()).look
    chosen, moved = model or _ModelOptions(), motion or _MotionOptions()
    name = f"{mesh.stem}_{chosen.model}"
    refuse_foreign(out / f"{name}.npz")
    formats = ["png"] if moved.static else ["mp4", *(["png"] if look.still is not None else [])]
    tables: dict[str, Any] = {
        "model": chosen.table,
        "loads": {"gravity": gravity},
        "output": {"formats": formats, "color": None if look.color == DISPLACEMENT else look.color},
    }
    built_mesh, timing, description = options.source.mesh(mesh, options.repair), _TIMING, ""
    if options.clamp is None:
        options, timing, description = _choose(options, mesh, built_mesh, tables, chosen.modes)
    if not moved.static:
        tables["motion"] = moved.table(timing)
    last = 0.0 if moved.static else tables["motion"]["duration"]
    if look.still is not None and look.still > last:
        raise ms.OptionError(f"--still must be a time of the film, from 0 to {last:g} s (got {look.still:g})")
    scene = replace(options.scene(mesh, built_mesh, tables), name=name)
    built = scene.build_shell(built_mesh)
    scene = replace(scene, bar=moved.static and has_bar(scene, built))
    say(f"{mesh}: {len(built.mesh.vertices)} vertices, {len(built.mesh.faces)} triangles, {built.clamped.sum()} held")
    if description:
        say(f"{mesh}: {description}")
    options.say_assumed(mesh, built_mesh)
    spec = scene.model.spec.name
    rate = look.rate or (_FILM_RATE if timing is not _TIMING and moved.dt is None else None)
    if rate is not None and scene.motion is not None:
        say(f"{mesh}: the film shows the motion at {rate * scene.motion.dt:.3g} times its real speed (--fps)")
    look = replace(look, rate=rate, title=f"{mesh.stem}, {spec}", model=spec)
    with progress(f"{spec} steps") as on_step, progress("film") as on_frame:
        result = ShellRun(scene, built, out, look, on_frame, _solve_modes).run(restart, on_step)
    say(f"{spec}: {result.summary}")
    if built.clamped.any():
        say(f"{spec}: {motion_as_text(result.trajectory, built.mesh.size)}")
        for line in error_as_text(scene, built, result.trajectory, f"take --model {TRUTH}"):
            say(f"{spec}: {line}")
    say(*result.files, sep="\n")
    end_with(result.outcome)


@_name_options()
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
    loaded = options.source.mesh(mesh, options.repair)
    built = options.scene(mesh, loaded, {}).build_shell(loaded)
    options.say_assumed(mesh, loaded)
    make_folder(out)
    basis = ms.solve_modes(built, count)
    table = Table("mode", "frequency [Hz]", "kind")
    for k, frequency in enumerate(basis.frequencies):
        table.add_row(str(k + 1), f"{frequency:.6g}", "rigid" if k < basis.rigid_modes else "elastic")
    CONSOLE.print(table)
    if basis.rigid_modes == basis.count:
        say(f"{mesh}: rigid motions alone: clamp it (--clamp), or ask for more (--count {basis.count + 8})")
    basis.save(out / f"{mesh.stem}_basis.npz")
    say(out / f"{mesh.stem}_basis.npz")
    say(basis.plot().save(out / f"{mesh.stem}_modes.png"))


def repair(
    mesh: MeshPath,
    *,
    out: Annotated[Path, Parameter(help="File to write: OBJ, PLY, STL, OFF or GLB; not the mesh itself.")],
    options: _MeshOptions | None = None,
) -> None:
    """Repair a mesh so that it can be a shell, and list what was done (see ms.repair); holes stay open.

    Example: modalshell repair scan.stl --out scan_repaired.ply --component largest
    """
    checked_target("--out", out, WRITABLE, mesh)
    repaired = (options or _MeshOptions()).mesh(mesh, repair=True)
    make_folder(out.parent)
    ms.save_mesh(repaired, out)
    say(out)
