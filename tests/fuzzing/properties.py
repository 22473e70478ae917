"""Answers that must not depend on where a mesh lies, who asks at the same time, or which mark a file begins with.

Also what must be said of loose parts, and of memory that runs out; and supports that move and come to rest.
"""

from __future__ import annotations

import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from hypothesis import strategies as st

import modalshell as ms
from fuzzing.command_line import called, check_exit, prepared
from fuzzing.harness import Contradiction, Input, Unsaid
from fuzzing.mesh_files import seeds
from fuzzing.mutations import damaged, text_damage
from fuzzing.world import world
from modalshell.commands import cli
from modalshell.mesh.parts import chosen_part, refuse_loose_parts

MARK = b"\xef\xbb\xbf"
"""The byte order mark that some editors write before a text."""
SHARED = ("lma", "mwts", "rsw", "ds", "springs")
"""Models that threads share."""


def make(folder: Path) -> st.SearchStrategy[Input]:
    """Inputs of every kind; files are written into ``folder``."""
    prepared(folder)
    return st.one_of(offsets(), _marks(folder), threads(), _loose_parts(), _memory(folder), carried())


# ---- meshes far from the origin


def displaced(offset: Any, rung: str) -> Any:
    """Equilibrium of a beam that lies at ``offset``, as displacements [m]."""
    mesh = ms.v_beam(cells=(4, 2))
    moved = ms.TriangleMesh(mesh.vertices + np.asarray(offset), mesh.faces)
    shell = ms.Shell(moved, world()["material"], world()["shell"].clamped)
    model = ms.DiscreteShell(shell) if rung == "ds" else ms.ModalWarping(ms.solve_modes(shell, 3))
    answer = model.equilibrium(gravity=(0.0, 0.0, -2.0), start=moved.vertices if rung == "ds" else None)
    return answer.positions - moved.vertices, answer.converged


def _offset_answer(offset: Any, rung: str) -> Any:
    found, converged = displaced(offset, rung)
    expected, _ = displaced(np.zeros(3), rung)
    # Coordinates at an offset are rounded to its last digit, which strains an edge of 0.1 m by 10 times as much.
    allowed = 1e-5 + 1e4 * np.finfo(float).eps * float(np.abs(offset).max())
    if converged and np.abs(found - expected).max() > allowed:
        raise Contradiction(f"{np.abs(found - expected).max():g} m apart from the answer at the origin")
    return found


def offsets() -> st.SearchStrategy[Input]:
    def build(direction: tuple[float, ...], power: float, rung: str) -> Input:
        offset = np.array(direction) * 10.0**power
        return Input(f"{rung} of a beam at {offset.tolist()}", lambda: _offset_answer(offset, rung))

    part = st.sampled_from((-1.0, 0.0, 0.37, 1.0))
    return st.builds(build, st.tuples(part, part, part), st.floats(0.0, 14.0), st.sampled_from(("mwts", "ds")))


# ---- byte order marks


def _same_with_mark(path: Path, data: bytes) -> Any:
    """A mesh that is read with a mark is the one that is read without."""
    path.write_bytes(data)
    plain = ms.load_mesh(path)
    path.write_bytes(MARK + data)
    try:
        marked = ms.load_mesh(path)
    except ms.ModalShellError as error:
        raise Contradiction(f"refused with a byte order mark alone: {error}") from error
    if not (np.array_equal(plain.vertices, marked.vertices) and np.array_equal(plain.faces, marked.faces)):
        raise Contradiction(f"{len(marked.vertices)} vertices with a byte order mark, {len(plain.vertices)} without")
    return marked


def _marks(folder: Path) -> st.SearchStrategy[Input]:
    texts = [(suffix, data) for suffix, data in seeds() if b"\0" not in data and not data.startswith(MARK)]

    def build(seed: tuple[str, bytes], damages: list[Any]) -> Input:
        data = damaged(seed[1], damages)
        return Input(f"marked {seed[0]} {data!r}", lambda: _same_with_mark(folder / f"marked{seed[0]}", data))

    return st.builds(build, st.sampled_from(texts), st.lists(text_damage, max_size=2))


# ---- threads


def _asked_together(rung: str, gravities: list[tuple[float, ...]]) -> Any:
    """Three threads that ask one model at once get the bits that each gets alone."""
    model = world()["models"][rung]

    def ask(gravity: tuple[float, ...]) -> Any:
        return model.equilibrium(gravity=gravity).positions

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        alone = [ask(gravity) for gravity in gravities]
        with ThreadPoolExecutor(len(gravities)) as pool:
            together = list(pool.map(ask, gravities))
    finally:
        sys.setswitchinterval(before)
    for expected, found in zip(alone, together, strict=True):
        if not np.array_equal(expected, found):
            raise Contradiction(f"{np.abs(expected - found).max():g} m apart from the answer of one thread")
    return together


def threads() -> st.SearchStrategy[Input]:
    component = st.sampled_from((-2.0, -0.3, 0.0, 0.5, 1.5, float("nan")))
    gravities = st.lists(st.tuples(component, component, component), min_size=3, max_size=3, unique=True)
    rungs = st.sampled_from([name for name in SHARED if name in world()["models"]])
    return st.builds(
        lambda rung, asked: Input(f"{rung} in three threads at {asked}", lambda: _asked_together(rung, asked)),
        rungs,
        gravities,
    )


# ---- loose parts


def _parts(places: list[tuple[int, int, int]], held: list[bool], component: Any) -> Any:
    """Sheets side by side, some of them held: refused, or a warning, wherever one is loose."""
    one = ms.sheet(cells=(2, 2))
    count = len(one.vertices)
    vertices = np.vstack([one.vertices + 1.5 * np.array(place) for place in places])
    faces = np.vstack([one.faces + count * index for index in range(len(places))])
    mesh = chosen_part(ms.TriangleMesh(vertices, faces), component)
    clamped = np.zeros(len(mesh.vertices), dtype=bool)
    for index, is_held in enumerate(held[: len(mesh.vertices) // count]):
        clamped[count * index : count * index + 6] = is_held
    parts = mesh.components
    loose = parts.max() > 0 and any(not clamped[parts == part].any() for part in range(int(parts.max()) + 1))
    given = (mesh, world()["material"], clamped if clamped.any() else None)
    shell = ms.Shell(*given, loose_parts=True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        basis = ms.solve_modes(shell, 4)
    if loose and not any("rigid motion" in str(warning.message) for warning in caught):
        raise Unsaid("modes of loose parts without a word")
    refuse_loose_parts(mesh, clamped)
    ms.solve_modes(ms.Shell(*given), 4)
    if loose:
        raise Unsaid("loose parts are not refused")
    return basis


def _loose_parts() -> st.SearchStrategy[Input]:
    place = st.tuples(*[st.integers(0, 2)] * 3)
    component = st.sampled_from((None, "all", "largest", 0, 1, 4, -1, 1.5, "x"))

    def build(places: list[tuple[int, int, int]], held: list[bool], component: Any) -> Input:
        text = f"parts at {places}, held {held}, component {component!r}"
        return Input(text, lambda: _parts(places, held, component))

    places = st.lists(place, min_size=1, max_size=4, unique=True)
    return st.builds(build, places, st.lists(st.booleans(), min_size=4, max_size=4), component)


# ---- memory that runs out

_STEPS: dict[str, tuple[str, ...]] = {
    "simulate": ("load_mesh", "solve_modes"),
    "modes": ("load_mesh", "solve_modes"),
}
"""Steps of a command in which memory may run out."""


def _without_memory(folder: Path, name: str, step: str, message: str) -> None:
    """A command in which ``step`` finds no memory: one line and status 2."""
    error = MemoryError(message) if message else MemoryError()

    def fail(*_: Any, **__: Any) -> Any:
        raise error

    argv = [name, str(prepared(folder) / "panel.obj"), "--clamp", "x < 0.6", "--modes", "2", "--out", str(folder / "o")]
    argv += ["--duration", "0.1"] if name == "simulate" else []
    with mock.patch.object(cli.ms, step, fail):
        _, errors, status = called(argv, folder)
    if status == 0:
        raise Unsaid(f"{name} ended with status 0 although {step} found no memory")
    check_exit(status, errors)


def _memory(folder: Path) -> st.SearchStrategy[Input]:
    pairs = [(name, step) for name, steps in _STEPS.items() for step in steps]
    message = st.sampled_from(("", "Unable to allocate 1.2 TiB for an array with shape (400000, 400000)", "a\nb"))

    def build(pair: tuple[str, str], message: str) -> Input:
        return Input(f"{pair} without memory: {message!r}", lambda: _without_memory(folder, *pair, message))

    return st.builds(build, st.sampled_from(pairs), message)


# ---- supports that move


def _settled(rung: str, sheet: bool, supports: list[Any], moved: Any, turned: Any) -> Any:
    """A strip whose supports move and rest ends as a rigid copy of its rest shape."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
    material = ms.Isotropic(1e9, 0.3, 0.01, 1000.0) if sheet else ms.Material(2000.0, 2000.0, 5.0, 0.2)
    if not sheet and supports[0].clamps:  # hinges turn about one row
        supports = [ms.Clamp("x < 0.2"), *supports[1:]]
    shell = ms.Shell(mesh, material, supports=supports)
    basis = ms.solve_modes(shell, 3)
    first = 2.0 * np.pi * float(basis.frequencies[0])
    path = ms.SupportPath([0.0, 0.5], [[0, 0, 0], moved], [[0, 0, 0], turned], pivot=(0.1, 0.0, 0.2))
    model = ms.models()[rung].builder(basis) if rung != "ds" else ms.DiscreteShell(shell)
    run = ms.simulate(model, duration=0.5 + 12.0 / first, dt=0.05, damping=(2.0 * first, 1e-4), supports=path)
    off = np.abs(run.positions[-1] - path.at(10.0).to_world(shell.rest_positions)).max()
    if run.outcome.succeeded and off > 1e-3:
        raise Contradiction(f"{off:.3g} m from a rigid copy")
    return run.positions


def carried() -> st.SearchStrategy[Input]:
    kinds = {
        "one row": [ms.Clamp("x < 1e-6")],
        "two rows": [ms.Clamp("x < 0.2")],
        "pinned rows": [ms.Pin("x < 0.2")],
        "row and roller": [ms.Clamp("x < 1e-6"), ms.Roller("x > 0.99", direction=(1, 0, 0))],
        "row and symmetry": [ms.Clamp("x < 1e-6"), ms.Symmetry("y < -0.0999", normal=(0, 1, 0))],
    }
    part = st.sampled_from((-0.3, 0.0, 0.2, 0.5))

    def build(rung: str, sheet: bool, kind: str, moved: tuple[float, ...], turned: tuple[float, ...]) -> Input:
        text = f"{rung} of {'a sheet' if sheet else 'hinges'} on {kind}, moved by {moved} and turned by {turned}"
        return Input(text, lambda: _settled(rung, sheet, kinds[kind], moved, turned))

    rungs, three = st.sampled_from(("lma", "mwts", "rsw", "ds")), st.tuples(part, part, part)
    return st.builds(build, rungs, st.booleans(), st.sampled_from(sorted(kinds)), three, three)
