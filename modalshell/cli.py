"""The command line: figures, scenes, benchmarks, and motion and modes of meshes of your own."""

from __future__ import annotations

import io
import sys
import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import App, CycloptsError, Parameter
from rich.markdown import Markdown
from rich.markup import escape
from rich.table import Table

import modalshell as ms
from modalshell.atomic_io import make_folder
from modalshell.checks import shortened
from modalshell.commands import scenes
from modalshell.commands.terminal import CONSOLE, end_with, progress
from modalshell.compare import MODES
from modalshell.doctor import examine
from modalshell.errors import ModalShellError, OptionError
from modalshell.memory import available_memory, gigabytes
from modalshell.mesh.parts import chosen_part, refuse_loose_parts
from modalshell.models.factory import MODE_COUNT, ModelFactory
from modalshell.models.registry import MODELS
from modalshell.provenance import repository_module
from modalshell.render import ShadedSurface, View, draw_views
from modalshell.run import write_results
from modalshell.scene.models import model_tables
from modalshell.selection import select_vertices

app = App(name="modalshell", help="Thin shells from modal warping to discrete shells.", version=ms.__version__)
scenes.register(app)
_LONGEST_MESSAGE = 1000
"""Characters of an error that the command line prints."""


@app.command
def reproduce(
    *,
    only: Annotated[list[str] | None, Parameter(help="Names of the studies to run.")] = None,
    everything: Annotated[bool, Parameter(name="--all", help="All studies, not only those of the paper.")] = False,
    out: Annotated[Path, Parameter(help="Folder of the results; pictures go to 'figures' in it.")] = Path("results"),
    figures: Annotated[Path | None, Parameter(help="Another folder for the pictures.")] = None,
    quick: Annotated[bool, Parameter(help="Coarser meshes and fewer loads, to try things out.")] = False,
) -> None:
    """Run the studies and draw the paper's figures."""
    studies = repository_module("studies.reproduce")
    names = studies.chosen_studies(only, everything)
    make_folder(out)
    for name in names:
        with progress(name) as on_step:
            written = studies.reproduce(name, out, figures or out / "figures", quick=quick, on_step=on_step)
        for path in written:
            print(path)


@app.command
def tradeoff(
    scene: Annotated[Path, Parameter(help="TOML file.")],
    *,
    truth: Annotated[
        Path | None, Parameter(help="Outside solution under the whole load: .npz with 'positions', or a mesh file.")
    ] = None,
    modes: Annotated[tuple[int, ...], Parameter(help="Mode counts.")] = MODES,
    out: Annotated[Path, Parameter(help="Folder of tables and pictures.")] = Path("results"),
) -> None:
    """Measure every rung that a scene allows: error against DS, cost of a frame, and what none cheaper matches."""
    make_folder(out)
    with progress(f"{scene.stem} rungs") as on_step:
        found = ms.tradeoff(scene, truth=truth, modes=modes, on_step=on_step)
    print(found.table())
    for path in found.save(out):
        print(path)


@app.command
def advise(
    scene: Annotated[Path, Parameter(help="TOML file.")],
    *,
    error: Annotated[float, Parameter(help="Largest displacement error against DS, relative.")] = 0.02,
    fps: Annotated[float, Parameter(help="Frames a second at least.")] = 60.0,
    modes: Annotated[tuple[int, ...], Parameter(help="Mode counts.")] = MODES,
    write: Annotated[Path | None, Parameter(help="Write the scene with the named model to this file.")] = None,
    out: Annotated[Path, Parameter(help="Folder of tables and pictures.")] = Path("results"),
) -> None:
    """Name the cheapest rung that is as accurate and as fast as asked on a scene, from measured runs."""
    make_folder(out)
    with progress(f"{scene.stem} rungs") as on_step:
        found = ms.advise(scene, error=error, fps=fps, modes=modes, on_step=on_step)
    CONSOLE.print(Markdown(found.explanation))
    for path in found.save(out):
        print(path)
    if write is not None:
        print(found.write_scene(scene, write))


@app.command
def bench(
    *,
    only: Annotated[str | None, Parameter(help="One benchmark instead of all.")] = None,
    out: Annotated[Path, Parameter(help="Folder of the tables and the picture.")] = Path("results"),
    quick: Annotated[bool, Parameter(help="Without the largest sizes.")] = False,
) -> None:
    """Measure this machine: frames, modes, assembly, implicit steps and flocks against plain NumPy and SciPy."""
    with progress("benchmarks") as on_step:
        written = repository_module("studies.benchmarks.run").main(out, quick, only, on_step)
    CONSOLE.print(Markdown(next(path for path in written if path.suffix == ".md").read_text(encoding="utf-8")))
    for path in written:
        print(path)


@Parameter(name="*")
class _ShellOptions:
    """Options that say how a mesh becomes a shell."""

    def __init__(
        self,
        *,
        clamp: Annotated[str | None, Parameter(help="Vertices to hold, such as 'x < 0.01'; none without it.")] = None,
        young: Annotated[float, Parameter(help="Young's modulus [Pa].")] = 1e9,
        poisson: Annotated[float, Parameter(help="Poisson's ratio.")] = 0.3,
        thickness: Annotated[float | None, Parameter(help="Thickness [m]; else 1/200 of the mesh's size.")] = None,
        density: Annotated[float, Parameter(help="Mass per volume [kg/m^3].")] = 1000.0,
        component: Annotated[
            Literal["largest", "all"] | int | None,
            Parameter(
                help="Part of a mesh in several: its number from 0 by falling area, largest, or all as they are."
            ),
        ] = None,
        join: Annotated[float | None, Parameter(help="Distance [m] up to which vertices are merged.")] = None,
    ) -> None:
        self.component, self.join = component, join
        self.clamp, self.young, self.poisson, self.thickness, self.density = clamp, young, poisson, thickness, density

    def build(self, path: Path) -> ms.Shell:
        """Load the mesh and make the shell."""
        mesh = chosen_part(ms.load_mesh(path), self.component, self.join)
        thickness = self.thickness
        if thickness is None:
            thickness = mesh.size / 200.0
        material = ms.Material.from_physical(
            young=self.young, poisson=self.poisson, thickness=thickness, density=self.density, mesh=mesh
        )
        clamped = None
        if self.clamp is not None:
            clamped = select_vertices(self.clamp, mesh.vertices)
            if not clamped.any():
                low, high = mesh.vertices.min(axis=0).round(6).tolist(), mesh.vertices.max(axis=0).round(6).tolist()
                raise OptionError(f"--clamp {self.clamp!r} holds no vertex; the mesh reaches from {low} to {high}")
        if self.component != "all":
            refuse_loose_parts(mesh, np.zeros(len(mesh.vertices), bool) if clamped is None else clamped)
        return ms.Shell(mesh, material, clamped)


@app.command
def simulate(
    mesh: Annotated[Path, Parameter(help="OBJ, PLY, STL, OFF or glTF file.")],
    *,
    shell: _ShellOptions | None = None,
    gravity: Annotated[tuple[float, float, float], Parameter(help="Acceleration [m/s^2].")] = (0.0, 0.0, -9.81),
    model: Annotated[str, Parameter(help=f"One of {', '.join(MODELS)}.")] = "mwts",
    modes: Annotated[int, Parameter(help="Number of modes of the modal models.")] = MODE_COUNT,
    static: Annotated[bool, Parameter(help="Equilibrium instead of motion: a picture instead of a film.")] = False,
    duration: Annotated[float, Parameter(help="Simulated time [s].")] = 2.0,
    dt: Annotated[float, Parameter(help="Time step, and time between frames [s].")] = 1.0 / 30.0,
    damping: Annotated[tuple[float, float], Parameter(help="Rayleigh factors of mass [1/s] and stiffness [s].")] = (
        0.5,
        0.001,
    ),
    out: Annotated[Path, Parameter(help="Folder for the results.")] = Path("results"),
) -> None:
    """Let a mesh of your own hang, fall or swing; write a film or a picture, and the positions."""
    known = model_tables()
    if model not in known:
        raise OptionError(f"there is no model {model!r}; choose from {', '.join(known)}")
    options = shell or _ShellOptions()
    built = options.build(mesh)
    print(f"{mesh}: {len(built.mesh.vertices)} vertices, {len(built.mesh.faces)} triangles, {built.clamped.sum()} held")
    kind = known[model]
    factory = ModelFactory(built, lambda: built.gravity_force(gravity))
    chosen = kind(**({"modes": modes} if "modes" in kind.__struct_fields__ else {})).build(factory)
    for basis in factory.bases.values():
        span = f"{basis.frequencies[0]:.4g} to {basis.frequencies[-1]:.4g} Hz"
        print(f"{basis.count} modes, {basis.rigid_modes} rigid, {span}")
    make_folder(out)
    if static:
        answer = chosen.equilibrium(gravity=gravity)
        told = answer.outcome.with_message(answer.message)
        print(f"{chosen.name}: {told}, {answer.iterations} iterations, residual {answer.residual:.1e}")
        found = ms.Trajectory.still(answer, built, built.gravity_force(gravity))
    else:
        with progress(f"{chosen.name} steps") as on_step:
            found = ms.simulate(chosen, duration=duration, dt=dt, gravity=gravity, damping=damping, on_step=on_step)
        told = found.outcome.with_message(found.message)
        print(f"{chosen.name}: {told}, {len(found.times)} frames in {found.seconds:.3g} s")
    formats = ["npz", "png" if static else "mp4"]
    title = f"{mesh.stem}, {chosen.name}"
    with progress("film") as on_frame:
        written = write_results(found, out, f"{mesh.stem}_{model}", formats, title=title, on_step=on_frame)
    for path in written:
        print(path)
    end_with(found.outcome)


@app.command
def modes(
    mesh: Annotated[Path, Parameter(help="OBJ, PLY, STL, OFF or glTF file.")],
    *,
    shell: _ShellOptions | None = None,
    count: Annotated[int, Parameter(help="Number of modes, rigid ones counted in.")] = 8,
    out: Annotated[Path, Parameter(help="Folder for the picture and the basis.")] = Path("results"),
) -> None:
    """Print the natural frequencies of a mesh and draw its mode shapes."""
    built = (shell or _ShellOptions()).build(mesh)
    make_folder(out)
    basis = ms.solve_modes(built, count)
    table = Table("mode", "frequency [Hz]", "kind")
    size = built.size
    views = []
    for k, frequency in enumerate(basis.frequencies):
        rigid = k < basis.rigid_modes
        table.add_row(str(k + 1), f"{frequency:.6g}", "rigid" if rigid else "elastic")
        shape = basis.modes[:, k].reshape(-1, 3)
        length = np.linalg.norm(shape, axis=1)
        moved = built.rest_positions + shape * (0.15 * size / length.max())
        title = f"mode {k + 1}: " + ("rigid" if rigid else f"{frequency:.4g} Hz")
        surface = ShadedSurface(moved, built.mesh.faces, scalars=length / length.max(), smooth=True)
        views.append(View([surface], title=title))
    CONSOLE.print(table)
    basis.save(out / f"{mesh.stem}_basis.npz")
    print(out / f"{mesh.stem}_basis.npz")
    print(draw_views(views, out / f"{mesh.stem}_modes.png", scalar_label="relative displacement"))


@app.command
def doctor() -> None:
    """Show what this machine brings: versions, solvers, threads, what draws, and which extras are missing."""
    table = Table("what", "found", "what would better it")
    for reading in examine():
        table.add_row(reading.name, escape(reading.value), escape(reading.hint))
    CONSOLE.print(table)


def main(arguments: list[str] | None = None) -> None:
    """Entry point: 0 is success, 1 work that did not converge or complete, 2 a refusal, one line on standard error."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given
    if debug:
        given.remove("--debug")
    for stream in (sys.stdout, sys.stderr):  # names of files need not be text that the terminal can show
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    warnings.showwarning = lambda message, *_, **__: print(f"modalshell: warning: {message}", file=sys.stderr)
    try:
        app(given, exit_on_error=False, print_error=False)
    except (ModalShellError, CycloptsError, OSError) as error:
        if debug:
            raise
        print(f"modalshell: {shortened(str(error), _LONGEST_MESSAGE)}", file=sys.stderr)
        sys.exit(2)
    except MemoryError as error:
        if debug:
            raise
        told = f"{shortened(str(error))}; " if str(error) else ""
        advice = f"{told}{gigabytes(available_memory())} are free: take a coarser mesh, fewer modes or frames"
        print(f"modalshell: out of memory: {advice}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("modalshell: stopped", file=sys.stderr)
        sys.exit(130)
