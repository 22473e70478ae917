"""Scene files: keys and values replaced, text damaged, and what the scene then writes, inside its folder only."""

from __future__ import annotations

import copy
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

import modalshell as ms
from fuzzing.drawing import without_pictures
from fuzzing.expressions import expressions
from fuzzing.harness import FEW, Escape, Input, LongWork, few_steps
from fuzzing.mutations import damaged, text_damage
from modalshell.selection import select_vertices

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
        "model": {"name": "mwts", "modes": 3, "warp": "closed_form", "consistent_force": True},
        "constraints": [{"kind": "position", "nearest": [1.0, 0.0, 0.0], "target": [0.9, 0.0, 0.1], "relative": False}],
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
    BASE | {"model": {"name": "md-rom", "modes": 2, "cubature": False}, "output": {"formats": ["vtkhdf", "pvd"]}},
    BASE | {"mesh": {"shape": "leaf", "cells": [4, 2]}, "supports": {"clamped": "x < 0.5"}, "model": {"name": "lma"}},
    BASE | {"model": {"name": "rigid"}, "mesh": {"shape": "cylinder_panel", "cells": [2, 2], "angle": 90.0}},
)  # fmt: skip

JUNK: tuple[Any, ...] = (
    *(0, -1, 1, 2, 3, 7, 0.0, 0.5, -0.5, 1e300, -1e300, 1e-300, 1e30, 2**31, 2**63, -(2**63), 10**30, 10**400),
    *(float("nan"), float("inf"), True, False, "", "x", "x < 0.6", "../x", "/", "/dev/null", "a/b", ".", "..", "a\0b"),
    *("é", "\u202e", "x" * 3000, "nul", "CON", "-", "--help", "0", "mwts", "ds", "npz", "sheet", "file", "panel.obj"),
    *([], {}, [[]], [0], [0.0, 0.0, 0.0], [1, 2, 3, 4], [True], ["x"], [None], {"a": 1}, {"": {}}, [{}], [[0, 0], [1]]),
    *([float("nan")] * 3, [1e300] * 3, [0, 0, -1e30], [10**6, 10**6], [2, 10**9], [1, 1], [-1, 2], [0.5, 2], [3, 5]),
    *("scene.toml", "no.obj", "scene.frames", "~", "$HOME", "http://x/y.obj", "[" * 500, "'", "\\", "\n"),
)


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


_PLACES = [list(places(base)) for base in BASES]


def _changed(base: int, changes: list[tuple[int, str, Any]]) -> str:
    scene = copy.deepcopy(BASES[base])
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
    return "\n".join(f"{json.dumps(key)} = {toml(table)}" for key, table in scene.items()) + "\n"


def files_of(folder: Path) -> set[str]:
    """Every file below ``folder``."""
    return {str(Path(root) / name) for root, _, names in os.walk(folder) for name in names}


def run(folder: Path, data: bytes, out: Path | None) -> Any:
    """Run a scene in a fresh ``folder / "work"``; Escape if it leaves files outside its own results' folder."""
    work = folder / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    ms.save_mesh(ms.sheet(cells=(2, 2)), work / "panel.obj")
    (work / "scene.toml").write_bytes(data)
    before, here = files_of(folder), Path.cwd()
    os.chdir(work)
    chosen = work / "results" if out is None else out
    try:
        with without_pictures():
            scene = ms.load_scene("scene.toml")
            chosen = Path(scene.output.folder) if out is None else out
            chosen = chosen if chosen.is_absolute() else work / chosen
            if out is None and not chosen.resolve().is_relative_to(folder):
                return None  # the user chose a folder elsewhere: not ours to fill
            if len(scene.build_shell().rest_positions) > FEW:
                raise LongWork
            return ms.run_scene(scene, out=out, on_step=few_steps)
    finally:
        os.chdir(here)
        outside = [path for path in files_of(folder) - before if not Path(path).is_relative_to(chosen.resolve())]
        if outside:
            raise Escape(f"{outside[0]} lies outside {chosen}")


def make(folder: Path) -> st.SearchStrategy[Input]:
    """Inputs that are run in ``folder``."""
    vertices = np.array([[0.0, 0.0, 0.0], [0.5, 0.2, -1.0], [1.0, -0.2, 1e-9]])

    def build(text: str, damages: list[Any], elsewhere: bool) -> Input:
        data = damaged(text.encode("utf-8", "surrogatepass"), damages)
        out = folder / "work" / "out" if elsewhere else None
        return Input(f"scene {data!r}, out={out}", lambda: run(folder, data, out))

    change = st.tuples(
        st.integers(0, 99), st.sampled_from(("replace", "replace", "replace", "remove", "add")), st.sampled_from(JUNK)
    )
    texts = st.builds(_changed, st.integers(0, len(BASES) - 1), st.lists(change, max_size=2))
    no_damage: st.SearchStrategy[list[Any]] = st.just([])
    scenes = st.builds(build, texts, st.one_of(no_damage, no_damage, st.lists(text_damage, max_size=2)), st.booleans())
    clamped = expressions.map(lambda text: build(_changed(0, []).replace('"x < 0.6"', toml(text)), [], False))
    selected = expressions.map(
        lambda text: Input(f"select_vertices({text!r})", lambda: select_vertices(text, vertices))
    )
    return st.integers(0, 9).flatmap(lambda roll: scenes if roll < 7 else clamped if roll < 8 else selected)
