"""Scene files: keys and values replaced, text damaged, and what the scene then writes, inside its folder only."""

from __future__ import annotations

import copy
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from hypothesis import strategies as st

import modalshell as ms
from fuzzing.drawing import without_pictures
from fuzzing.expressions import expressions
from fuzzing.harness import FEW, Escape, Input, LongWork, UncaughtException, few_steps
from fuzzing.mutations import damaged, text_damage
from modalshell.crowd.scene import FlockScene
from modalshell.mesh.selection import select_vertices
from modalshell.scene import parse_scene
from modalshell.sweep import Sweep, load_sweep
from modalshell.sweep.case import CaseResult, Task, run_case

BASE: dict[str, Any] = {
    "name": "panel",
    "mesh": {"shape": "v_beam", "cells": [2, 2]},
    "material": {"stretch": 20.0, "shear": 20.0, "flexure": 0.05, "density": 0.2},
    "supports": {"clamped": "x < 0.6"},
    "loads": {"gravity": [0.0, 0.0, -4.0]},
    "model": {"name": "mwts", "modes": 2},
    "motion": {"duration": 0.1, "dt": 0.05},
}
BASES: tuple[dict[str, Any], ...] = (
    BASE | {"output": {"folder": "kept", "positions": "float32", "formats": ["npz", "png", "mp4"]}},
    BASE
    | {
        "supports": {
            "clamped": [0, 1, 2],
            "times": [0.0, 0.1],
            "translations": [[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]],
            "rotations": [[0.0, 0.0, 0.0], [0.0, 0.3, 0.0]],
            "pivot": [0.0, 0.0, 0.0],
        },
        "model": {"name": "ds", "step_tolerance": 1e-6, "integrator": "implicit", "allow_unstable_step": False},
    },
    {key: table for key, table in BASE.items() if key != "motion"}
    | {
        "material": {"young": 1e6, "poisson": 0.3, "thickness": 0.01, "density": 1e3},
        "units": {"length": "m", "mass": "kg", "time": "s"},
        "model": {"name": "mwts", "modes": 3, "consistent_force": True},
        "constraints": [{"kind": "position", "nearest": [1.0, 0.0, 0.0], "target": [0.9, 0.0, 0.1], "relative": False}],
    },
    BASE
    | {
        "loads": {
            "pressure": [{"p": 0.5, "follower": True, "sel": "x > 0.2"}],
            "wind": [{"velocity": [0.0, 0.0, 1.0], "density": 1.2, "normal": 1.0, "tangential": 0.01}],
            "moment": [{"sel": "x > 0.9", "m": 0.01, "times": [0.0, 0.1], "factors": [0.0, 1.0]}],
            "follower": [{"sel": [0, 8], "force": [0.0, 0.0, 0.01]}],
            "weight": [{"gravity": [0.0, 0.0, -1.0]}],
            "frame": [{"acceleration": [0.0, 1.0, 0.0], "angular_velocity": [0.0, 0.0, 1.0]}],
            "line": [{"sel": "x > 0.9", "force": [0.0, 0.0, 0.01]}],
        },
    },
    BASE
    | {
        "mesh": {"file": "panel.obj"},
        "supports": {"clamped": "x < 0.3 or not (abs(y) * 2 - z / 3 >= -9)"},
        "loads": {"gravity": [0.0, 0.0, -1.0], "forces": [{"where": "x > 0.9", "total": [0.0, 0.1, 0.0]}]},
        "model": {"name": "rsw", "modes": 2, "integrator": "implicit_midpoint"},
        "motion": {"duration": 0.1, "dt": 0.05, "damping": [0.1, 0.01], "store_every": 2},
        "constraints": [
            {"kind": "orientation", "vertices": [7, 8], "times": [0.0, 0.1], "path": "linear",
             "targets": [[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]]}
        ],
    },
    BASE
    | {
        "supports": [
            {"kind": "clamp", "sel": "x < 0.1 or nearest(0, 0, 0) and not box(1, 1, 1, 2, 2, 2)"},
            {"kind": "pin", "sel": [0, 1]},
            {"kind": "fix", "sel": "boundary(0) and x > 0.9", "axes": "y"},
            {"kind": "roller", "sel": [8], "direction": [0.0, 1.0, 0.5]},
            {"kind": "symmetry", "sel": "y > 0.05 and angle(0, 0, 1) < 60", "normal": [0.0, 1.0, 0.0]},
            {"kind": "diaphragm", "sel": "component(0) and x > 0.9", "axis": [1.0, 0.0, 0.0]},
            {"kind": "tie", "sel": [4, 5], "axes": "z"},
            {"kind": "path", "times": [0.0, 0.1], "translations": [[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]]},
        ],
        "model": {"name": "ds"},
    },
    BASE | {"model": {"name": "md-rom", "modes": 2, "cubature": False}, "output": {"formats": ["vtkhdf", "pvd"]}},
    BASE | {"mesh": {"shape": "leaf", "cells": [4, 2]}, "supports": {"clamped": "x < 0.5"}, "model": {"name": "lma"}},
    BASE | {"model": {"name": "reduced-rsw", "modes": 2, "rank": 8, "mixtures": 2}},
    BASE | {"model": {"name": "coarse-ds", "cells": [6, 2]}, "mesh": {"shape": "flat_beam", "cells": [8, 4]}},
    BASE | {"model": {"name": "coarse-ds", "triangles": 24}, "mesh": {"shape": "flat_beam", "cells": [8, 4]}},
    BASE | {"model": {"name": "rigid"}, "mesh": {"shape": "cylinder_panel", "cells": [2, 2], "angle": 90.0}},
    BASE | {"model": {"name": "springs", "integrator": "linear_implicit", "solver": "cg", "reference_fold": 0.2}},
    BASE
    | {
        "motion": {"duration": 0.1, "dt": 0.05, "damping": [0.5, 0.01]},
        "flock": {
            "count": 3, "radius": 2.0, "seed": 1, "warm_up": 0.1, "speed": 1.0, "neighbour_distance": 1.5,
            "field_of_view": 300.0, "weights": [1.0, 1.0, 0.5], "bounds": [[-9.0, -9.0, -9.0], [9.0, 9.0, 9.0]],
            "threads": 1,
            "camera": {"position": [0.0, -6.0, 1.0], "view_angle": 40.0, "size": [640, 360], "still": 0.05,
                       "rate_factor": 24, "color": "tab:blue"},
            "target": {"times": [0.0, 1.0], "points": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], "weight": 1.0},
            "flap": {"amplitude": 0.05, "frequency": 2.0, "largest_load_factor": 3.0},
            "detail": {"pixels": 0.5, "strains_within": 1.0},
        },
        "output": {"formats": ["png", "mp4"]},
    },
)  # fmt: skip
SWEEPS: tuple[dict[str, Any], ...] = (
    {
        "name": "panels",
        "scene": BASE,
        "axes": {"model.name": ["rigid", "lma", "ds"], "loads.gravity": [[0.0, 0.0, -1.0], [0.0, 0.0, -2.0]]},
        "truth": {"name": "ds"},
        "output": {"folder": "kept", "formats": ["png"], "value": "error"},
    },
    {
        "scene": "panel.toml",
        "axes": {"model.modes": {"from": 1, "to": 2, "count": 2}, "motion.dt": {"from": 0.01, "to": 0.1, "count": 3,
                                                                              "spacing": "log"}},
    },
)  # fmt: skip
ALL = BASES + SWEEPS

JUNK: tuple[Any, ...] = (
    *(0, -1, 1, 2, 3, 7, 0.0, 0.5, -0.5, 1e300, -1e300, 1e-300, 1e30, 2**31, 2**63, -(2**63), 10**30, 10**400),
    *(float("nan"), float("inf"), True, False, "", "x", "x < 0.6", "../x", "/", "/dev/null", "a/b", ".", "..", "a\0b"),
    *("é", "\u202e", "x" * 3000, "nul", "CON", "-", "--help", "0", "mwts", "ds", "npz", "sheet", "file", "panel.obj"),
    *([], {}, [[]], [0], [0.0, 0.0, 0.0], [1, 2, 3, 4], [True], ["x"], [None], {"a": 1}, {"": {}}, [{}], [[0, 0], [1]]),
    *([float("nan")] * 3, [1e300] * 3, [0, 0, -1e30], [10**6, 10**6], [2, 10**9], [1, 1], [-1, 2], [0.5, 2], [3, 5]),
    *("scene.toml", "no.obj", "scene.frames", "~", "$HOME", "http://x/y.obj", "[" * 500, "'", "\\", "\n"),
)
_FEW_CASES = 6


def toml(value: Any) -> str:
    """A value as TOML writes it inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if value is None:
        return "none"
    return "1" + "0" * 400 if isinstance(value, int) and value > 10**300 else repr(value)


def places(table: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Paths of all values in nested tables and lists."""
    inner = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in inner:
        yield (*path, key)
        yield from places(value, (*path, key))


_PLACES = [list(places(base)) for base in ALL]


def _changed(base: int, changes: list[tuple[int, str, Any]]) -> str:
    scene = copy.deepcopy(ALL[base])
    for index, action, junk in changes:
        path = _PLACES[base][index % len(_PLACES[base])]
        holder: Any = scene
        try:
            for key in path[:-1]:
                holder = holder[key]
            junk = copy.deepcopy(junk)
            if action == "remove":
                del holder[path[-1]]
            elif action == "add":
                holder[str(junk)[:9] if isinstance(holder, dict) else 0] = junk
            else:
                holder[path[-1]] = junk
        except (KeyError, IndexError, TypeError):
            continue
    return as_toml(scene)


def as_toml(scene: dict[str, Any]) -> str:
    """Tables as a TOML file has them."""
    return "\n".join(f"{json.dumps(key)} = {toml(table)}" for key, table in scene.items()) + "\n"


def files_of(folder: Path) -> set[str]:
    """Every file below ``folder``."""
    return {str(Path(root) / name) for root, _, names in os.walk(folder) for name in names}


def run(folder: Path, data: bytes, out: Path | None, sweep: bool) -> Any:
    """Run a scene or sweep in a fresh ``folder / "work"``; Escape if it writes outside its results' folder."""
    work = folder / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    ms.save_mesh(ms.sheet(cells=(2, 2)), work / "panel.obj")
    (work / "panel.toml").write_text(as_toml(BASE), encoding="utf-8")
    (work / "scene.toml").write_bytes(data)
    before, here = files_of(folder), Path.cwd()
    os.chdir(work)
    chosen = work / "results" if out is None else out
    try:
        with without_pictures():
            scene: Any = load_sweep("scene.toml") if sweep else ms.load_scene("scene.toml")
            chosen = Path(scene.output.folder) if out is None else out
            chosen = chosen if chosen.is_absolute() else work / chosen
            if out is None and not chosen.resolve().is_relative_to(folder):
                return None  # the user chose a folder elsewhere: not ours to fill
            if sweep:
                return run_few_cases(scene, out=out)
            if len(scene.build_shell().rest_positions) > FEW or is_long_flight(scene):
                raise LongWork
            return ms.run_scene(scene, out=out, on_step=few_steps)
    finally:
        os.chdir(here)
        outside = [path for path in files_of(folder) - before if not Path(path).is_relative_to(chosen.resolve())]
        if outside:
            raise Escape(f"{outside[0]} lies outside {chosen}")


def is_long_flight(scene: Any) -> bool:
    """Whether a scene asks for more birds, or a longer flight to warm up, than there is time for."""
    if not isinstance(scene, FlockScene):
        return False
    return scene.flock.count > FEW or scene.flock.warm_up > FEW * scene.motion.dt


def run_few_cases(sweep: Any, **options: Any) -> Any:
    """Run a sweep whose cases are few and short in this process; UncaughtException where one fails."""
    declared = sweep if isinstance(sweep, Sweep) else load_sweep(sweep)
    if declared.count > FEW:
        raise LongWork
    with mock.patch("modalshell.sweep.driver.run_locally", in_this_process):
        return ms.run_sweep(sweep, **options)


def in_this_process(tasks: Sequence[Task], *_: Any) -> Iterator[CaseResult]:
    """Outcomes of a sweep's cases while they are few and short; UncaughtException where one fails."""
    for number, task in enumerate(tasks):
        motion = parse_scene(Path(task.file), task.scene).motion
        long = motion is not None and motion.duration > FEW * motion.dt
        if number == _FEW_CASES or len(task.vertices) > 24 * FEW or long:
            raise LongWork
        found = run_case(task)
        if found.outcome == "failed":
            raise UncaughtException(f"a case of the sweep failed: {found.message}")
        yield found


def make(folder: Path) -> st.SearchStrategy[Input]:
    """Inputs that are run in ``folder``."""
    vertices = np.array([[0.0, 0.0, 0.0], [0.5, 0.2, -1.0], [1.0, -0.2, 1e-9]])

    def build(base: int, changes: list[Any], damages: list[Any], elsewhere: bool) -> Input:
        return written(_changed(base, changes), damages, elsewhere, base >= len(BASES))

    def written(text: str, damages: list[Any], elsewhere: bool, sweep: bool = False) -> Input:
        data = damaged(text.encode("utf-8", "surrogatepass"), damages)
        out = folder / "work" / "out" if elsewhere else None
        return Input(f"{'sweep' if sweep else 'scene'} {data!r}, out={out}", lambda: run(folder, data, out, sweep))

    change = st.tuples(
        st.integers(0, 99), st.sampled_from(("replace", "replace", "replace", "remove", "add")), st.sampled_from(JUNK)
    )
    bases, changes = st.integers(0, len(ALL) - 1), st.lists(change, max_size=2)
    no_damage: st.SearchStrategy[list[Any]] = st.just([])
    damages = st.one_of(no_damage, no_damage, st.lists(text_damage, max_size=2))
    scenes = st.builds(build, bases, changes, damages, st.booleans())
    clamped = expressions.map(lambda text: written(_changed(0, []).replace('"x < 0.6"', toml(text)), [], False))
    selected = expressions.map(
        lambda text: Input(f"select_vertices({text!r})", lambda: select_vertices(text, vertices))
    )
    return st.integers(0, 9).flatmap(lambda roll: scenes if roll < 7 else clamped if roll < 8 else selected)
