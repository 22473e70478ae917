"""Numbers of a report on a run: peaks and their places, reactions and their balance, frequencies, buckling, meshes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from modalshell.core.errors import FileFormatError, ModalShellError, ModalShellWarning, OptionError, SolverError
from modalshell.core.typing import Array
from modalshell.core.units import UnitSystem
from modalshell.files.atomic_io import read_record
from modalshell.modes import solve_modes
from modalshell.modes.rigid import rigid_motions
from modalshell.motion import Trajectory
from modalshell.motion.fields import shell_at
from modalshell.page.report import shell_numbers
from modalshell.run.balance import has_reactions, held_by_supports
from modalshell.run.protocol import run_identity
from modalshell.scene import ShellScene
from modalshell.scene.index_files import numbered
from modalshell.scene.parts import build_path
from modalshell.shell import Shell
from modalshell.statics.buckling import bent_remark, buckling_factors

FREQUENCIES = 6
"""Natural frequencies that a report names."""
_COARSER = (0.5, 0.7)
"""Shares of the cells of the meshes on which a report's convergence is judged."""


_NO_REACTIONS = "none: the shell's own forces balance the load on answers of DS alone"


def checked_run(scene: ShellScene, shell: Shell, record: Path) -> dict[str, Any]:
    """The record of a run, which must be of this scene and mesh.

    FileFormatError if there is no record. OptionError if the run is of another scene or mesh.
    """
    found = read_record(record)
    if found is None:
        raise FileFormatError(f"{record} is no record of a run, which is written next to its trajectory: run the scene")
    expected = run_identity(scene, shell)
    differing = [name for name in ("scene", "mesh") if found.get("identity", {}).get(name) != expected[name]]
    if differing:
        raise OptionError(f"{record} is a run of another {' and '.join(differing)} than {scene.file}: name its own")
    return found


def report_numbers(scene: ShellScene, shell: Shell, run: Trajectory) -> dict[str, Any]:
    """All numbers of a report, in the units of the scene.

    Keys: ``mesh``, ``mass``, ``outcome``, ``message``, ``displacement`` and ``stress`` (each with its value, place and
    time; the stress is None without a thickness), ``load`` and ``reactions`` with their ``balance`` (None in motion;
    reactions of models other than DS are a text that says why there are none), ``frequencies``, ``buckling`` (the
    lowest factor of the load by linear theory, or why there is none), ``contact`` and ``creases`` of runs that have
    them (folds that stay [rad]), and ``warnings``, texts of what frequencies and buckling warned of.
    """
    warned: list[str] = []
    numbers: dict[str, Any] = {
        **shell_numbers(shell),
        "outcome": run.status,
        "message": run.message,
        "frames": len(run.times),
        "bar": None if run.bars is None else run.units.restated(str(run.bars)),
        "duration": float(run.times[-1]),
        **peaks(shell, run, scene),
    }
    if run.deepest.size:
        numbers["contact"] = {
            "force": run.contact_forces[-1].sum(axis=0).tolist(),
            "vertices": int(run.in_contact[-1].sum()),
            "deepest": float(run.deepest.max()),
        }
    if run.crease_angles.size:
        numbers["creases"] = {
            "edges": run.crease_angles.shape[1],
            "yielded": int(np.count_nonzero(run.crease_angles[-1])),
            "largest": float(max(run.crease_angles[-1], key=abs)),
            "heat": float(run.crease_heat[-1]),
        }
    numbers |= _balance(scene, shell, run)
    numbers["frequencies"] = _attempt(lambda: _frequencies(shell), "frequencies", warned, run.units)
    numbers["buckling"] = None
    if scene.motion is None:
        numbers["buckling"] = _attempt(lambda: _buckling(scene, shell), "buckling", warned, run.units)
    numbers["warnings"] = warned
    return numbers


def peaks(shell: Shell, run: Trajectory, scene: ShellScene) -> dict[str, Any]:
    """The largest displacement and the largest von Mises stress over all frames, with their places and times."""
    path, rest = build_path(scene.supports), shell.rest_positions
    largest: dict[str, Any] = {"displacement": {"value": -1.0}, "stress": None}
    for frame, (time, stored) in enumerate(zip(run.times, run.positions, strict=True)):
        x = np.asarray(stored, dtype=np.float64)
        own = x if path is None else path.at(float(time)).to_shell(x)
        moved = np.linalg.norm(x - rest, axis=1)
        at = int(moved.argmax())
        if moved[at] > largest["displacement"]["value"]:
            place = {"vertex": at, "place": x[at].tolist(), "time": float(time)}
            largest["displacement"] = {"value": float(moved[at]), **place}
        faces = shell_at(shell, run, frame).fields(own).von_mises_faces
        if faces is None:
            continue
        triangle, side = (int(index) for index in np.unravel_index(int(faces.argmax()), faces.shape))
        if largest["stress"] is None or faces[triangle, side] > largest["stress"]["value"]:
            largest["stress"] = {
                "value": float(faces[triangle, side]),
                "triangle": triangle,
                "place": x[shell.mesh.faces[triangle]].mean(axis=0).tolist(),
                "side": "to which the normals point" if side == 0 else "away from the normals",
                "time": float(time),
            }
    return largest


def _balance(scene: ShellScene, shell: Shell, run: Trajectory) -> dict[str, Any]:
    """The load's and the reactions' resultants at rest, and what is missing to their balance as a share."""
    if not held_by_supports(scene):
        return {"load": None, "reactions": None, "balance": None}
    force, loads = scene.build_forces(shell)
    x = np.asarray(run.positions[-1], dtype=np.float64)
    acting = shell.loading(scene.gravity, force, loads).force(x)
    total = acting.sum(axis=0)
    if not has_reactions(scene):
        return {"load": total.tolist(), "reactions": _NO_REACTIONS, "balance": None}
    held = shell_at(shell, run, -1).reactions(x, gravity=scene.gravity, force=force, loads=loads)
    answer = held.sum(axis=0)
    # As a share of what all parts of the load add up to: a load in balance with itself has no resultant.
    size = float(np.linalg.norm(acting, axis=1).sum())
    missing = float(np.linalg.norm(total + answer)) / size if size > 0.0 else 0.0
    return {"load": total.tolist(), "reactions": answer.tolist(), "balance": missing}


def _frequencies(shell: Shell) -> list[float]:
    """The lowest elastic natural frequencies at rest."""
    basis = solve_modes(shell, FREQUENCIES + rigid_motions(shell).shape[1])  # rigid ones are modes, too
    found: list[float] = basis.frequencies[basis.rigid_modes :].tolist()
    return found


def _buckling(scene: ShellScene, shell: Shell) -> float | str:
    """The lowest factor of the load at which linear theory has the shell buckle."""
    force, loads = scene.build_forces(shell)
    found = buckling_factors(shell, 1, gravity=scene.gravity, force=force, loads=loads)
    if remark := bent_remark(shell, found):
        raise SolverError(remark)
    return float(found.factors[0]) if len(found.factors) else "the load does not buckle it"


def _attempt(compute: Callable[[], Any], name: str, warned: list[str], units: UnitSystem) -> Any:
    """What is computed, or a text that says why it cannot be; its warnings are added to ``warned``, under its name."""
    try:
        with warnings.catch_warnings(record=True, action="always", category=ModalShellWarning) as given, units.said():
            answer = compute()
    except ModalShellError as refusal:
        return f"none: {refusal}"
    warned += [f"{name}: {text}" for text in texts_of(given)]
    return answer


def texts_of(given: Sequence[warnings.WarningMessage]) -> list[str]:
    """Texts of this package's warnings, each once."""
    texts = [str(one.message) for one in given if issubclass(one.category, ModalShellWarning)]
    return list(dict.fromkeys(texts))


def check_convergence(scene: ShellScene) -> tuple[int, int]:
    """The cells of a scene's mesh; OptionError where coarser ones are not: of a file, or vertices by number."""
    cells = getattr(scene.mesh, "cells", None)
    if cells is None:
        raise OptionError(
            f"{scene.file}: --convergence needs a mesh by [mesh] shape and cells: one from a file has no coarser one; "
            "make a finer file and compare two reports"
        )
    if key := numbered(scene.content()):
        raise OptionError(
            f"{scene.file}: --convergence needs selections by place, as 'x < 0.01': {key} selects vertices by number, "
            "and those are others on a coarser mesh"
        )
    return (int(cells[0]), int(cells[1]))


def convergence(scene: ShellScene, numbers: dict[str, Any], solve: Callable[[ShellScene], Trajectory]) -> list[Any]:
    """Displacement and stress on coarser meshes, by ``solve``, and on the scene's own, coarsest first.

    OptionError if the mesh is from a file, or vertices are selected by number, which are others on a coarser mesh.
    """
    cells = check_convergence(scene)
    rows = []
    for share in _COARSER:
        fewer = tuple(max(2, 2 * round(0.5 * share * count)) for count in cells)
        coarse = replace(scene, mesh=msgspec.structs.replace(scene.mesh, cells=fewer))
        found = peaks(coarse.build_shell(), solve(coarse), coarse)
        rows.append(_row(fewer, found))
    return [*rows, _row(tuple(cells), numbers)]


def _row(cells: tuple[int, ...], found: dict[str, Any]) -> dict[str, Any]:
    """One mesh's line."""
    stress = found["stress"]
    return {
        "cells": list(cells),
        "displacement": found["displacement"]["value"],
        "stress": None if stress is None else stress["value"],
    }


def load_arrows(scene: ShellScene, shell: Shell, x: Array) -> Array:
    """Forces (n, 3) of the whole load at positions x, for the picture; loads that change at their largest."""
    force, loads = scene.build_forces(shell)
    loading = shell.loading(scene.gravity, force, loads)
    return loading.force(x) if scene.motion is None else loading.dead + loading.largest_force()
