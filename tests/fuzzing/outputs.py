"""What is written: never over what a command reads or another program made, and in the size and place of the shell.

Also surfaces of several parts, which are the same parts in every format.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from hypothesis import strategies as st
from scenes import TINY_BEAM, held

import modalshell as ms
from fuzzing.command_line import called, check_exit
from fuzzing.harness import Contradiction, Destroyed, Input, Unsaid
from modalshell.core.units import LENGTHS, MASSES, TIMES, UnitSystem

SCENE = TINY_BEAM + 'loads = {gravity = [0.0, 0.0, -4.0]}\nmodel = {name = "lma", modes = 2}\n'
FOREIGN = (
    *("beam.npz", "beam.json", "beam_path.npz", "beam_tradeoff.npz", "beam_tradeoff.json", "panel_mwts.npz"),
    *("panel_basis.npz", "run_rest.obj", "modes_body.npz", "modes_body.json"),
)
"""Names that commands derive, in the hands of other programs."""
NAMED = ("new", "scene", "panel", "data", "run", "modes", "notes", "linked", "hard")
_ALIASED = {".html": "scene.toml", ".json": "data.json", ".obj": "panel.obj", ".toml": "scene.toml", ".npz": "run.npz"}
"""Inputs that go by other names, too, with a suffix that a command may write."""
_OF_EXPORT = {"usd": ".usdc", "gltf": ".glb", "pc2": ".pc2", "mdd": ".mdd", "clip": ".clip", "page": ".html"}


def make(folder: Path) -> st.SearchStrategy[Input]:
    """Inputs of every kind; files are written into ``folder``."""
    often = [_commands(folder)] * 3 + [sizes(folder)] * 2  # parts take longest
    return st.one_of(*often, parts(folder))


# ---- files of the user


@cache
def _inputs() -> dict[str, bytes]:
    """Files that commands read, made once."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scene.toml").write_text(SCENE)
        (folder / "data.json").write_text('{"frequencies": [1.0, 2.0]}')
        (folder / "notes.txt").write_text("mine\n")
        ms.save_mesh(ms.sheet(length=1.0, width=0.4, cells=(4, 2)), folder / "panel.obj")
        text = (folder / "panel.obj").read_text()
        (folder / "panel.obj").write_text(f"# mine\n{text}")  # what is written over it is not the same
        ms.save_trajectory(_run(), folder / "run.npz")
        ms.solve_modes(held(ms.v_beam(cells=(2, 2)), 0.6), 2).save(folder / "modes.npz")
        return {path.name: path.read_bytes() for path in folder.iterdir()}


@cache
def _run() -> ms.Trajectory:
    basis = ms.solve_modes(held(ms.v_beam(cells=(2, 2)), 0.6), 2)
    return ms.simulate(ms.ModalWarping(basis), duration=0.1, gravity=(0.0, 0.0, -4.0))


def _command(folder: Path, argv: list[str], foreign: list[str]) -> None:
    """Run a command among the user's files: it may replace the file that it is told to write, unless it reads it."""
    work = folder / "among"
    shutil.rmtree(work, ignore_errors=True)
    (work / "deep").mkdir(parents=True)
    for name, data in _inputs().items():
        (work / name).write_bytes(data)
    for name in foreign:
        if name.endswith(".npz"):
            np.savez(work / name, measured=np.arange(3.0))
        else:
            (work / name).write_text('{"my": "settings"}' if name.endswith(".json") else "# mine\nv 0 0 0\n")
    for suffix, name in _ALIASED.items():
        (work / f"linked{suffix}").symlink_to(work / name)
        (work / f"hard{suffix}").hardlink_to(work / name)
    at = argv.index("--out") if "--out" in argv else len(argv)
    told = work / argv[at + 1] if at < len(argv) else None
    before = {path: path.read_bytes() for path in work.iterdir() if path.is_file()}
    _, errors, status = called(argv, work)
    read = {(work / word).resolve() for word in argv[1:at] if (work / word).is_file()}
    for path, data in before.items():
        named = told is not None and told.resolve() == path.resolve() and path.resolve() not in read
        if not named and (not path.is_file() or path.read_bytes() != data):
            raise Destroyed(f"{path.name} is not what it was after {argv}")
    check_exit(status, errors)


def _commands(folder: Path) -> st.SearchStrategy[Input]:
    place = st.sampled_from(("", "./", "deep/../"))

    @st.composite
    def build(draw: st.DrawFn) -> Input:
        kind = draw(st.sampled_from(sorted(_OF_EXPORT)))
        command, suffix = draw(
            st.sampled_from(
                (
                    (["page", "scene.toml"], ".html"),
                    (["fit", "scene.toml", "--data", "data.json", "--wrt", "flexure"], ".json"),
                    (["export", "run.npz", "--to", kind], _OF_EXPORT[kind]),
                    (["export", "run.npz", "--to", "pc2"], ""),
                    (["export", "modes.npz", "--to", "body"], ".npz"),
                    (["repair", "panel.obj"], ".obj"),
                    (["advise", "scene.toml", "--write"], ".toml"),
                    (["tradeoff", "scene.toml"], "folder"),
                    (["run", "scene.toml"], "folder"),
                    (["path", "scene.toml"], "folder"),
                    (["modes", "panel.obj", "--count", "2", "--clamp", "x < 0.3"], "folder"),
                    (["simulate", "panel.obj", "--static", "--modes", "2", "--clamp", "x < 0.3"], "folder"),
                )
            )
        )
        argv = list(command)
        name = draw(st.sampled_from(NAMED))
        other = draw(st.sampled_from((".html", ".json", ".obj", ".toml", ".txt", ".npz")))
        if suffix == "folder":
            argv += ["--out", draw(st.sampled_from((".", "deep", "deep/..")))]
        elif argv[-1] == "--write":
            argv.append(draw(place) + name + draw(st.sampled_from((suffix, suffix, other))))
        elif command[0] != "export" or draw(st.booleans()):
            argv += ["--out", draw(place) + name + draw(st.sampled_from((suffix or ".pc2", suffix or ".pc2", other)))]
        foreign = draw(st.lists(st.sampled_from(FOREIGN), max_size=4, unique=True))
        return Input(f"modalshell {argv} among {foreign}", lambda: _command(folder, argv, foreign))

    return build()


# ---- sizes and places in exports


def _read_back(path: Path) -> Any:
    """Positions at rest (n, 3) [m] as readers of the format find them; None where there is no reader here."""
    if path.suffix == ".usda":
        from pxr import Usd, UsdGeom

        stage = Usd.Stage.Open(str(path))
        shell = UsdGeom.Mesh(stage.GetDefaultPrim())
        points = shell.GetPointsAttr()
        place = np.array(UsdGeom.Xformable(shell).ComputeLocalToWorldTransform(0))
        found = np.array(points.Get(points.GetTimeSamples()[0]), float) @ place[:3, :3] + place[3, :3]
        return UsdGeom.GetStageMetersPerUnit(stage) * found
    if path.suffix == ".glb":
        scene = trimesh.load(path, process=False)
        (name,) = scene.graph.nodes_geometry
        place, _ = scene.graph[name]
        (mesh,) = scene.geometry.values()
        turned = mesh.vertices @ place[:3, :3].T + place[:3, 3]
        return turned[:, [0, 2, 1]] * [1, -1, 1]
    return None


def _sized(folder: Path, units: UnitSystem, offset: Any, suffix: str) -> Any:
    """A motion in other units and far away keeps its size, and its place to single precision, in a file."""
    run = _run()
    run = replace(run, units=units, positions=run.positions + offset, rest_positions=run.rest_positions + offset)
    path = folder / f"sized{suffix}"
    path.unlink(missing_ok=True)
    ms.save_trajectory(run, path)
    metres = LENGTHS[units.length]
    wanted = run.rest_positions
    if suffix == ".pc2":
        data = path.read_bytes()
        count = struct.unpack_from("<i", data, 16)[0]
        found = np.frombuffer(data, "<f4", 3 * count, 32).reshape(-1, 3).astype(float)
        wanted = run.positions[0]  # in the units of the scene: the format names none
    elif suffix in (".clip", ".npz"):
        read = ms.load_clip(path) if suffix == ".clip" else ms.load_trajectory(path)
        if read.units != units:
            raise Contradiction(f"{read.units} for {units}")
        found = np.asarray(read.positions[0], dtype=float)
    else:
        found, wanted = _read_back(path), metres * wanted
    size = float(np.ptp(wanted, axis=0).max())
    off = np.abs((found - found.mean(axis=0)) - (wanted - wanted.mean(axis=0))).max() / size
    if not off < 2e-3:
        raise Contradiction(f"{suffix} in {units.length} at {np.asarray(offset).tolist()}: {off:.3g} of its size off")
    if np.abs(found.mean(axis=0) - wanted.mean(axis=0)).max() > 1e-6 * np.abs(wanted).max() + 2e-3 * size:
        raise Contradiction(f"{suffix} in {units.length} lies elsewhere than at {np.asarray(offset).tolist()}")
    return found


def sizes(folder: Path) -> st.SearchStrategy[Input]:
    suffixes = [".pc2", ".clip", ".npz"]
    suffixes += [".usda"] if importlib.util.find_spec("pxr") else []
    suffixes += [".glb"] if importlib.util.find_spec("pygltflib") else []
    part = st.sampled_from((-1.0, 0.0, 0.37, 1.0))

    def build(length: str, mass: str, time: str, way: tuple[float, ...], power: float, suffix: str) -> Input:
        offset = np.array(way) * 10.0**power
        text = f"{suffix} in {length}, {mass}, {time} at {offset.tolist()}"
        return Input(text, lambda: _sized(folder, UnitSystem(length, mass, time), offset, suffix))

    names = (st.sampled_from([*sorted(known), "furlong"]) for known in (LENGTHS, MASSES, TIMES))
    return st.builds(build, *names, st.tuples(part, part, part), st.floats(-1.0, 9.0), st.sampled_from(suffixes))


# ---- parts by format


def _stored(mesh: ms.TriangleMesh, path: Path, flat: bool) -> None:
    """Write a mesh, flat-shaded where the format is one in which programs do so."""
    if not (flat and path.suffix in (".glb", ".stl")):
        ms.save_mesh(mesh, path)
        return
    corners = mesh.vertices[mesh.faces].reshape(-1, 3)
    if path.suffix == ".glb":
        corners = corners[:, [0, 2, 1]] * [1, 1, -1]
    made = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    path.write_bytes(made.export(file_type=path.suffix[1:]))


def _same_parts(folder: Path, count: int, cells: tuple[int, int], suffix: str, flat: bool, gap: float) -> Any:
    """Sheets next to one another: as many parts as were written, and refused to be clamped one by one where many."""
    one = ms.sheet(length=1.0, width=0.5, cells=cells)
    vertices = np.vstack([one.vertices + np.array([0.0, k * (0.5 + gap), 0.0]) for k in range(count)])
    faces = np.vstack([one.faces + k * len(one.vertices) for k in range(count)])
    path = folder / f"parts{suffix}"
    _stored(ms.TriangleMesh(vertices, faces), path, flat)
    found = ms.load_mesh(path)
    parts = int(found.components.max()) + 1
    if parts != count:
        raise Contradiction(f"{parts} parts for {count} in {suffix}{', flat-shaded' * flat}")
    argv = ["simulate", path.name, "--static", "--modes", "2", "--out", "parts"]
    out, errors, status = called(argv, folder)
    check_exit(status, errors)
    held = re.search(r"(\d+) vertices, \d+ triangles, (\d+) held", out)
    many = held is None or (int(held[1]) > 100 and int(held[2]) > 0.3 * int(held[1]))
    if many or parts > 20:
        raise Unsaid(f"{parts} parts clamped one by one, {held and held[0]}")
    return found.vertices


def parts(folder: Path) -> st.SearchStrategy[Input]:
    def build(count: int, cells: tuple[int, int], suffix: str, flat: bool, gap: float) -> Input:
        text = f"{count} sheets of {cells} cells in {suffix}{', flat-shaded' * flat}, {gap} apart"
        return Input(text, lambda: _same_parts(folder, count, cells, suffix, flat, gap))

    suffixes = [".obj", ".ply", ".stl", ".off", ".glb"]
    cells = st.tuples(st.integers(1, 8), st.integers(1, 3))
    counts = st.one_of(st.integers(1, 4), st.integers(18, 24))
    return st.builds(build, counts, cells, st.sampled_from(suffixes), st.booleans(), st.sampled_from((0.1, 1e-3)))
