"""Commands on a scene file, and the files of measurements that a fit reads."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

import modalshell as ms
from modalshell.commands.pages import scene_page
from modalshell.commands.terminal import end_with, progress, say
from modalshell.commands.unasked_bars import error_as_text, may_have_bar
from modalshell.core.checks import shortened, shown
from modalshell.core.errors import FileFormatError
from modalshell.core.typing import Array
from modalshell.files.atomic_io import make_folder, read_npz, write_record
from modalshell.files.outputs import checked_target, refuse_foreign
from modalshell.files.regular import read_text
from modalshell.models.registry import TRUTH
from modalshell.page.drape import drape_page
from modalshell.run.path_files import scene_path, write_path
from modalshell.scene import ShellScene
from modalshell.scene.parts import input_files
from modalshell.shell.energies_of import unit_of_constant
from modalshell.viewer import attach as follow_run
from modalshell.viewer import open_window, serve_page, take_picture

_AXES = ("x", "y", "z")
_WITHOUT_ANSWER = (ms.Outcome.REFUSED, ms.Outcome.FAILED)
_REASONS = 3
"""Reasons of cases without an answer that a sweep prints; all are in its table."""
_KEYS = ("positions", "factors", "frequencies")


def read_measurements(path: Path) -> dict[str, Array]:
    """Arrays ``positions``, ``factors`` and ``frequencies`` of a file, those that it has.

    A CSV file has the column ``frequency`` [Hz], or columns among ``x``, ``y`` and ``z`` [m], a row a load, and
    ``factor``, its share of the scene's load, where there are several; empty cells were not measured. JSON and NPZ
    files have the arrays under their names, null or NaN where nothing was measured. FileFormatError if the file is
    missing, damaged, or holds none of these.
    """
    readers = {".csv": _from_csv, ".json": _from_json, ".npz": _from_npz}
    try:
        if path.suffix.lower() not in readers:
            raise ValueError(f"its name must end in {', '.join(readers)}")
        arrays = readers[path.suffix.lower()](path)
        if not {"positions", "frequencies"} & set(arrays):
            raise ValueError("it has neither positions nor frequencies")
        return arrays
    except Exception as error:  # OS, zip, JSON, text, key and value errors all mean the same to the user
        raise FileFormatError(f"cannot read measurements from {path}: {shortened(str(error))}") from error


def _from_csv(path: Path) -> dict[str, Array]:
    reader = csv.reader(read_text(path).splitlines(), skipinitialspace=True)
    heading, *rows = [[cell.strip() for cell in line] for line in reader if line] or [[]]
    if not rows:
        raise ValueError("it has no rows below its heading")
    names = {name for name in heading if name}
    unknown = names - {"frequency", "factor", *_AXES}
    if unknown:
        raise ValueError(f"column {sorted(unknown)[0]!r} is none of frequency, factor, x, y, z")
    if len(names) < len(heading) - heading.count(""):
        raise ValueError(f"a column is there twice (got {', '.join(heading)})")
    for row in rows:
        if any(row[len(heading) :]):
            raise ValueError(f"the row {shown(','.join(row))} has more cells than the heading: write 0.5, not 0,5")
    table = [dict(zip(heading, row, strict=False)) for row in rows]

    def column(name: str) -> Array:
        cells = [row.get(name, "") for row in table]
        return np.array([float(cell) if cell else np.nan for cell in cells])

    if "frequency" in names:
        if len(names) > 1:
            raise ValueError("frequencies stand alone: leave the other columns out")
        return {"frequencies": column("frequency")}
    if not names & set(_AXES):
        raise ValueError("it has none of the columns frequency, x, y, z")
    arrays = {"positions": np.stack([column(axis) for axis in _AXES], axis=1)}
    if "factor" in names:
        arrays["factors"] = column("factor")
    elif len(rows) == 1:
        arrays["positions"] = arrays["positions"][0]
    else:
        raise ValueError(f"{len(rows)} rows need the column factor: the share of the load of each")
    return arrays


def _from_json(path: Path) -> dict[str, Array]:
    document = json.loads(read_text(path))
    if not isinstance(document, dict):
        raise ValueError("it must be one object")
    return _known(document)


def _from_npz(path: Path) -> dict[str, Array]:
    return _known(dict(read_npz(path)))


def _known(content: dict[str, Any]) -> dict[str, Array]:
    unknown = set(content) - set(_KEYS)
    if unknown:
        raise ValueError(f"{sorted(unknown)[0]!r} is none of {', '.join(_KEYS)}")
    return {name: np.array(value, dtype=np.float64) for name, value in content.items()}


def run(
    scene: Annotated[Path, Parameter(help="TOML file.")],
    *,
    out: Annotated[Path | None, Parameter(help="Folder of the results instead of the scene's own.")] = None,
    color: Annotated[
        str | None, Parameter(help="Field that colours the film or picture: curvature, von_mises, energy_density, ...")
    ] = None,
    restart: Annotated[bool, Parameter(help="Discard the frames of a stopped run and start again.")] = False,
) -> None:
    """Run a scene file, or resume a run of it that was stopped; say how far its answer is from DS.

    Example: modalshell run studies/scenes/leaf_wind.toml --out results
    """
    declared = ms.load_scene(scene)
    with progress(f"{scene.stem} steps") as on_step:
        result = ms.run_scene(declared, out=out, color=color, restart=restart, on_step=on_step)
    name = result.files[0].stem
    say(f"{name}: {result.summary}")
    if isinstance(declared, ShellScene) and isinstance(result, ms.SceneResult):
        run, model = result.trajectory, declared.model.spec.key
        advice = f'take name = "{TRUTH}" in [model]' + ("" if model == "auto" else ", or auto")
        shell = declared.build_shell() if may_have_bar(declared, len(run.rest_positions)) else None
        for line in [] if shell is None else error_as_text(declared, shell, run, advice):
            say(f"{name}: {line}")
    say(*result.files, sep="\n")
    end_with(result.outcome)


def view(
    scene: Annotated[Path | None, Parameter(help="TOML file; not with --attach.")] = None,
    *,
    web: Annotated[bool, Parameter(help="A page for a browser on this machine instead of a window.")] = False,
    port: Annotated[int, Parameter(help="Port of the page; 0 takes a free one.")] = 8080,
    frames: Annotated[
        int | None, Parameter(help="Frames of 1/30 s to play before the screenshot; 30 if omitted.")
    ] = None,
    screenshot: Annotated[Path | None, Parameter(help="Write a picture of the window to this PNG file.")] = None,
    attach: Annotated[
        Path | None, Parameter(help="Folder, scene file or .frames file of a run to follow live instead of playing.")
    ] = None,
    wait: Annotated[float, Parameter(help="Longest time [s] to wait for the first frame of an attached run.")] = 60.0,
    follow: Annotated[bool, Parameter(help="Print a line for each new frame of an attached run instead.")] = False,
) -> None:
    """Play a scene, and change gravity, the model or its mode count while it plays; or follow a running simulation.

    Example: modalshell view studies/scenes/leaf.toml --web
    """
    if attach is not None:
        if scene is not None or frames is not None:
            raise ms.OptionError("--attach shows a run's own scene and frames: leave out SCENE and --frames")
        follow_run(attach, wait=wait, web=web, port=port, screenshot=screenshot, follow=follow)
        return
    if scene is None or follow:
        raise ms.OptionError("name a scene file to play, or a run to follow with --attach RUN")
    if web and screenshot is not None:
        raise ms.OptionError("--screenshot is a picture of the window: leave out --web")
    declared = ms.load_scene(scene)
    if web:
        serve_page(declared, port)
    elif screenshot is None:
        open_window(declared)
    else:
        say(take_picture(declared, 30 if frames is None else frames, screenshot))


def sweep(
    file: Annotated[Path, Parameter(help="TOML file.")],
    *,
    out: Annotated[Path | None, Parameter(help="Folder of the results instead of the sweep's own.")] = None,
    workers: Annotated[int | None, Parameter(help="Number of worker processes; one per core if omitted.")] = None,
    cluster: Annotated[str | None, Parameter(help="Scheduler of dask.distributed, tcp:// or tls://.")] = None,
    certificates: Annotated[
        tuple[Path, Path, Path] | None, Parameter(help="Files for tls://: authority, certificate, key.")
    ] = None,
    time_limit: Annotated[float | None, Parameter(help="Time [s] after which a case is aborted.")] = None,
    retry: Annotated[bool, Parameter(help="Also repeat cases that failed or were aborted.")] = False,
) -> None:
    """Run a grid of scenes, or the cases that are still missing, and write a summary.

    Example: modalshell sweep studies/sweeps/v_beam_gravity.toml --workers 2
    """
    checked = progress(f"{file.stem} scenes checked", delay=1.0)
    with checked as on_check, progress(f"{file.stem} cases") as on_step:
        result = ms.run_sweep(
            file,
            out=out,
            workers=workers,
            cluster=cluster,
            certificates=certificates,
            time_limit=time_limit,
            retry=retry,
            on_check=on_check,
            on_step=on_step,
        )
    counts = ", ".join(f"{count} {outcome}" for outcome, count in result.counts().items())
    ready = f"{result.computed} computed now, {result.stored} from before"
    ready += ", references included" if result.computed + result.stored > len(result.rows) else ""
    say(f"{file.stem}: {len(result.rows)} cases, {counts}; {ready}")
    reasons: dict[tuple[str, str], list[str]] = {}
    for row in result.rows:
        if row["outcome"] in _WITHOUT_ANSWER:
            reasons.setdefault((str(row["outcome"]), str(row["message"])), []).append(str(row["case"]))
    for (outcome, message), (first, *more) in list(reasons.items())[:_REASONS]:
        say(f"case {first}{f' and {len(more)} more' if more else ''}, {outcome}: {message}")
    say(*([result.note] if result.note else []), *result.files, sep="\n")
    end_with(*result.counts())


def path(
    scene: Annotated[Path, Parameter(help="TOML file; its [path] table says how.")],
    *,
    until: Annotated[float | None, Parameter(help="Last load factor, in place of the scene's.")] = None,
    branches: Annotated[int | None, Parameter(help="Number of bifurcations whose other branch is followed.")] = None,
    out: Annotated[Path, Parameter(help="Folder of the numbers and pictures.")] = Path("results"),
) -> None:
    """Follow the equilibria of a scene under a growing load, through snaps: load-deflection curve with stability.

    Example: modalshell path studies/scenes/v_beam_stiff.toml --branches 1
    """
    declared = ms.load_scene(scene)
    refuse_foreign(out / f"{declared.name}_path.npz")
    changed = {name: value for name, value in (("until", until), ("branches", branches)) if value is not None}
    make_folder(out)
    with progress(f"{scene.stem} points") as on_step:
        followed = scene_path(declared, on_step, **changed)
    units = declared.require_shell().unit_system
    message = followed.outcome.with_message(units.restated(followed.message))
    say(f"{declared.name}: {message}, {len(followed.factors)} points")
    for number, one in enumerate([followed, *followed.branches]):
        begin = "" if one is followed else f"branch {number}: "
        for kind, index, factor in one.events:
            moved = f"{one.displacements[index]:.6g} {units.length}"
            say(f"{begin}{kind} at a load factor of {factor:.6g}, displacement {moved}")
    say(*write_path(followed, out, declared.name, units), sep="\n")
    end_with(followed.outcome)


def fit(
    scene: Annotated[Path, Parameter(help="TOML file; its material is the first guess.")],
    *,
    data: Annotated[Path, Parameter(help="Measurements: a CSV, JSON or NPZ file.")],
    wrt: Annotated[list[str], Parameter(help="Constants to recover, such as young or thickness.")],
    where: Annotated[
        str | None, Parameter(help="Vertices whose positions, or mean position, were measured: 'x > 0.29'.")
    ] = None,
    confidence: Annotated[float, Parameter(help="Level of the intervals.")] = 0.95,
    out: Annotated[Path | None, Parameter(help="JSON file of the result.")] = None,
) -> None:
    """Recover constants of a scene's material from measurements, with confidence intervals.

    A CSV file has the column frequency [Hz] of the lowest modes; or columns among x, y, z [m] of the mean position of
    the vertices --where, a row a load, with the column factor, its share of the scene's load. JSON and NPZ files hold
    arrays frequencies (m,); or positions (3,), with factors (L,) positions (L, 3), or those of every vertex --where
    (L, k, 3).

    Example: modalshell fit strip.toml --data tip.csv --wrt young --where "x > 0.299"
    """
    declared = ms.load_scene(scene).require_shell()
    if out is not None:
        checked_target("--out", out, (".json",), *input_files(declared), data)
    measured = read_measurements(data)
    if "positions" in measured and where is None:
        raise ms.OptionError("measured positions need --where: a selection of vertices, such as 'x > 0.29'")
    shell = declared.build_shell()
    given: dict[str, Any] = {"frequencies": measured.get("frequencies")}
    if "positions" in measured:
        path, force, loads, constraints = declared.build_loading(shell)
        if path is not None or constraints or declared.contacts or any(isinstance(one, ms.Scaled) for one in loads):
            raise ms.OptionError(
                "a fit takes scenes in equilibrium: leave moving supports, constraints, contacts, and times and "
                "factors of loads out"
            )
        average = measured["positions"].ndim == 1 + ("factors" in measured)
        given |= {"where": where, "average": average, "factors": measured.get("factors"), "force": force}
        given |= {"gravity": declared.gravity, "loads": loads}
    with declared.unit_system.said():
        fitted = ms.fit(shell, wrt, measured.get("positions"), confidence=confidence, **given)
    for name, value in fitted.values.items():
        low, high = fitted.intervals[name]
        unit = declared.unit_system.of(unit_of_constant(fitted.material, name))
        unit = f" {unit}" if unit else ""
        say(f"{name} = {value:.6g}, within {low:.6g} to {high:.6g}{unit} at {100 * confidence:g} %")
    length = declared.unit_system.length
    residual = f"{100 * fitted.residual:.3g} %" if fitted.state is None else f"{fitted.residual:.3g} {length}"
    say(f"residual: {residual} (root mean square); {fitted.evaluations} shells were solved")
    if out is not None:
        content = {"values": fitted.values, "intervals": fitted.intervals, "confidence": confidence}
        say(write_record(out, content | {"residual": fitted.residual, "converged": fitted.converged}))
    if not fitted.converged:
        end_with(ms.Outcome.NOT_CONVERGED)


def page(
    scene: Annotated[Path | None, Parameter(help="TOML file; not with --drape.")] = None,
    *,
    out: Annotated[Path, Parameter(help="HTML file to write.")],
    drape: Annotated[
        bool, Parameter(negative="", help="Instead of a scene: overhang and weight to bending stiffness and drape.")
    ] = False,
) -> None:
    """Write a scene as one web page that shows it in any browser, without a server.

    A motion by LMA (linear modal analysis) or MWTS (modal warping for thin shells) is computed live on the page. Of any
    other scene the page plays what a run gives, and offers live models where they are near. With --drape it is a meter
    of cloth: bending stiffness from a measured overhang, the nearest cards, and how a round cloth of it hangs.

    Example: modalshell page studies/scenes/v_beam.toml --out v_beam.html
    """
    if drape == (scene is not None):
        raise ms.OptionError("name a scene file to show, or give --drape" + " without one" * drape)
    if scene is None:
        checked_target("--out", out, (".html", ".htm"))
        say(drape_page().save(out))
        return
    declared = ms.load_scene(scene)
    checked_target("--out", out, (".html", ".htm"), *input_files(declared))
    with progress(f"{scene.stem} steps") as on_step:
        made = scene_page(declared, on_step)
    say(made.save(out))
