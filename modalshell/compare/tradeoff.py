"""Error against cost of every model on a case, with the Pareto front."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from modalshell.compare.bar_reference import path_by_bars
from modalshell.compare.bifurcation import first_bifurcation
from modalshell.compare.candidates import MODES, candidates, case_factory, quick_candidates
from modalshell.compare.case import Case, make_case
from modalshell.compare.draw import draw_fronts, draw_shapes, on_front
from modalshell.compare.engine_runs import engine_lines, engine_rows
from modalshell.compare.path import LoadPath, follow_loads
from modalshell.compare.report import html_table, markdown_table
from modalshell.compare.runs import Measurement, measure_row
from modalshell.core.checks import (
    checked_callback,
    checked_count,
    checked_switch,
    checked_vectors,
    shortened,
    shown,
    vector_count,
)
from modalshell.core.errors import FileFormatError, ModalShellError, OptionError, SolverError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Progress, unheard
from modalshell.files.atomic_io import read_npz, write_text
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult
from modalshell.mesh import TriangleMesh, flat_beam, load_mesh
from modalshell.models import CoarseMesh
from modalshell.models.registry import TRUTH, models
from modalshell.render import Picture, html_of
from modalshell.scene import Scene
from modalshell.shell import Material, Shell

LOADS = (0.25, 0.5, 0.75, 1.0)
"""Shares of the load at which rungs are compared."""

_FINDINGS = (
    *("key", "label", "preprocessing", "frame_ms", "statics", "errors", "area_errors", "tip_turns"),
    *("cost", "answer_seconds"),
    *("statuses", "frequency", "motion", "worst_error", "final_error", "near_errors", "outside_error"),
)
_COUNTS = ("elements", "solves", "bytes_read")
"""What of a row, and of its counted work, goes to the findings."""


@short_repr
@dataclass(frozen=True)
class Tradeoff:
    """Error and cost of every model on one case.

    Attributes
    ----------
    case : Case
        What was run.
    path : LoadPath
        DS over the load range, and whether it snaps.
    rows : list of Measurement
        Cheapest frame first, by counted cost.
    left_out : dict
        Rungs that were not run, and why.
    tip : int
        The vertex that DS moves most.
    outside : ndarray, shape (n, 3), or None
        The outside solution, if one was given [m].
    bifurcation : float or None
        Share of the load at which DS buckles: another branch crosses its path, before any snap.
    engines : list of dict
        Outcome, error and cost of every other engine, if they were asked for.
    """

    case: Case
    path: LoadPath
    rows: list[Measurement]
    left_out: dict[str, str]
    tip: int
    outside: Array | None = field(default=None, repr=False)
    bifurcation: float | None = None
    engines: list[dict[str, Any]] = field(default_factory=list)

    def error_of(self, row: Measurement) -> float | None:
        """The error that rungs are judged by: the worst over the load range, or against the outside solution."""
        return row.worst_error if self.outside is None else row.outside_error

    def front(self) -> list[Measurement]:
        """The rows that no cheaper one matches in error, cheapest first; tiny gains do not count."""
        return list(compress(self.rows, on_front([self.error_of(row) for row in self.rows])))

    def findings(self) -> dict[str, Any]:
        """Everything but arrays, ready for JSON."""
        front = self.front()
        return {
            "case": self.case.name,
            "note": self.case.notes,
            "vertices": len(self.case.shell.rest_positions),
            "load_factors": self.path.factors,
            "near_factors": self.path.near,
            "ds_statuses": [answer.status for answer in self.path.answers],
            "ds_tangents": self.path.tangents,
            "snap": None if self.path.snap is None else str(self.path.snap),
            "bifurcation": self.bifurcation,
            "rows": [
                {name: getattr(row, name) for name in _FINDINGS}
                | {name: getattr(row.work, name) for name in _COUNTS}
                | {"rung": row.candidate.spec.name, "size": row.candidate.size, "front": row in front}
                for row in self.rows
            ],
            "left_out": self.left_out,
            "engines": self.engines,
        }

    def table(self) -> str:
        """The rows as a Markdown table, cheapest frame first; those of the Pareto front in bold."""
        return "\n".join([markdown_table(self.findings()), *engine_lines(self.engines)])

    def plot(self) -> Picture:
        """Draw error over milliseconds per frame; a notebook shows the picture, and ``save(path)`` writes it."""
        return Picture.of(lambda path: draw_fronts([self.findings()], path))

    def _repr_html_(self) -> str:
        return html_of(f"Tradeoff of {self.case.name}", {}, self.plot()) + html_table(self.table())

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write ``NAME_tradeoff`` as JSON, NPZ, Markdown and pictures into ``folder``; return the paths."""
        stem = f"{self.case.name}_tradeoff"
        arrays = {f"row_{k}": row.positions for k, row in enumerate(self.rows)}
        arrays |= {"faces": np.asarray(self.case.shell.mesh.faces), "rest": self.case.shell.rest_positions}
        written = StudyResult(stem, self.findings(), arrays, run_record({"case": self.case.name})).save(folder)
        written.append(write_text(Path(folder) / f"{stem}.md", f"# {self.case.name}\n\n{self.table()}\n"))
        written.append(self.plot().save(Path(folder) / f"{stem}.png"))
        shapes = {models()[TRUTH].name: self.path.answers[-1].positions} | {
            row.label: row.positions for row in self.rows
        }
        faces = self.case.shell.mesh.faces
        written.append(draw_shapes([(self.findings(), shapes, faces)], Path(folder) / f"{stem}_shapes.png"))
        return written


def tradeoff(
    scene: Scene | Shell | Case | str | os.PathLike[str],
    *,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    coarse: Sequence[TriangleMesh] = (),
    modes: Sequence[int] = MODES,
    loads: Sequence[float] = LOADS,
    truth: ArrayLike | str | os.PathLike[str] | None = None,
    engines: bool = False,
    quick: bool = False,
    on_step: Progress | None = None,
) -> Tradeoff:
    """Run every rung that a scene allows, at several mode counts, against DS over the load range.

    Of a shell of shell theory (:class:`modalshell.Isotropic`) DS stands for that theory on the same mesh; rungs that
    take discrete-shell energies alone are left out, with the reason.

    Parameters
    ----------
    scene : Scene, path or Shell
        A scene or its file; of a scene in motion the load, or the largest inertial load of its moving supports, is
        taken. Or a shell, with ``gravity`` or ``force``.
    gravity : array_like, shape (3,), optional
        Acceleration [m/s^2]; with a shell.
    force : array_like, shape (n, 3), optional
        Dead forces on the vertices [N]; with a shell.
    coarse : sequence of TriangleMesh
        Coarse meshes of the shell's surface; with a shell.
    modes : sequence of int
        Mode counts.
    loads : sequence of float
        Growing shares of the load at which answers are compared, the last one 1.
    truth : array_like, shape (n, 3), or path, optional
        An external solution under the whole load [m]: positions, an ``.npz`` file with ``positions``, or a mesh file
        with the same vertices in the same order. Rungs, DS among them, are then judged by it.
    engines : bool
        Whether other engines answer the whole load, too, each in a process of its own: CalculiX, MuJoCo's flex and
        Newton's VBD, in the Python that the environment variable ``MODALSHELL_ENGINES`` names, or in this one. What is
        missing is named, with how to get it.
    quick : bool
        Whether errors are measured against what error bars (:class:`modalshell.ErrorBar`) say that DS would answer;
        DS itself is solved only where a bar is void. Models that are trained, found by motion or on coarse shells are
        left out, and DS is not timed.
    on_step : callable, optional
        Called with the models done and their total.

    Returns
    -------
    Tradeoff
        Error and cost of every model.

    Raises
    ------
    OptionError
        If the supports leave rigid motions free, nothing loads the shell, it has creases, the scene has constraints, or
        a parameter is out of range.
    SolverError
        If DS finds no equilibrium at any of the loads, or the lowest mode has no stiffness.
    """
    on_step = checked_callback("on_step", on_step)
    case = make_case(scene, gravity, force, coarse)
    if case.shell.crease_state is not None:
        raise OptionError(
            f"{case.name!r}: rungs are not compared on shells with creases, which DS and coarse DS alone know: leave "
            "creases out, or compare answers of these two"
        )
    factors = checked_factors(loads)
    modes = checked_counts(modes)
    outside = None if truth is None else outside_positions(truth, case.shell)
    asked = checked_switch("engines", engines)
    if (by_bars := checked_switch("quick", quick)) and asked:
        raise OptionError("quick compares models by error bars, not engines: leave out quick or engines")
    warm_up(by_bars)
    with case.units.said():
        measured = _measured(case, modes, factors, outside, on_step, by_bars)
    if not asked:
        return measured
    path = measured.path
    whole = path.answers[-1].positions if path.known[-1] == len(factors) - 1 else None
    return replace(measured, engines=engine_rows(case, whole if outside is None else outside, on_step))


def _measured(
    case: Case,
    modes: Sequence[int],
    factors: Sequence[float],
    outside: Array | None,
    on_step: Progress,
    quick: bool = False,
) -> Tradeoff:
    chosen, left_out = candidates(case, modes)
    if quick:
        chosen, left_out = quick_candidates(chosen, left_out)
    total, done = len(factors) + len(chosen), 0

    def advance() -> None:
        nonlocal done
        done += 1
        on_step(done, total)

    factory = case_factory(case)
    if quick:
        exact = [one for one in chosen if one.spec.on_modes][-1]  # the last on modes, the dearest and most exact
        path, note = path_by_bars(exact.build(factory)[0], case.load, factors, advance)
        case = replace(case, note=" ".join(filter(None, (case.units.restated(note), case.note))))
    else:
        path = follow_loads(case.shell, case.load, factors, advance)
    if not path.known:
        first = path.answers[0]
        raise SolverError(
            f"{case.name}: DS, which errors are measured against, has an equilibrium at none of "
            f"{shown(path.factors)} of the load (at {path.factors[0]:g}: {first.status}, {first.message}): lessen the "
            "load, or let the shares in loads begin lower"
        )
    last = path.answers[path.known[-1]].positions
    tip = int(np.argmax(np.linalg.norm(last - case.shell.rest_positions, axis=1)))
    rows = []
    for candidate in chosen:
        try:
            rows.append(measure_row(candidate, case, factory, path, tip, outside))
        except ModalShellError as error:
            left_out[candidate.label] = case.units.restated(str(error))
        advance()
    rows.sort(key=lambda row: row.cost)  # stable: of equals the simpler one, first on the ladder
    # Where every bar holds no branch ends, and none crosses: the margin is that of the stiffness.
    barred = all(answer.bar is not None for answer in path.answers)
    return Tradeoff(case, path, rows, left_out, tip, outside, None if barred else first_bifurcation(case))


def checked_factors(loads: Sequence[float]) -> tuple[float, ...]:
    """Growing shares of the load that end at 1, or OptionError."""
    factors = checked_vectors("loads", loads, (vector_count(loads),), OptionError)
    if not factors.size or factors[0] <= 0.0 or factors[-1] != 1.0 or not (np.diff(factors) > 0.0).all():
        raise OptionError(f"loads must be growing shares above 0 of the load, the last one 1 (got {shown(loads)})")
    return tuple(factors.tolist())


def checked_counts(modes: Sequence[int]) -> tuple[int, ...]:
    """Mode counts, at least one, or OptionError."""
    try:
        counts = tuple(modes)
    except TypeError:
        counts = ()
    if not counts:
        raise OptionError(f"modes must be whole numbers of at least 1 (got {shown(modes)})")
    return tuple(checked_count("each of modes", count) for count in counts)


def outside_positions(truth: ArrayLike | str | os.PathLike[str], shell: Shell) -> Array:
    """Positions (n, 3) [m] of an outside solution, from an array or a file."""
    count = len(shell.rest_positions)
    if not isinstance(truth, str | os.PathLike):
        return checked_vectors("truth", truth, (count, 3), OptionError)
    file = Path(truth)
    if file.suffix != ".npz":
        mesh = load_mesh(file)
        if not np.array_equal(mesh.faces, shell.mesh.faces):
            raise FileFormatError(
                f"{file}: holds another mesh ({len(mesh.vertices)} vertices, the scene's has {count}, or other "
                "triangles): save the solution on the scene's own mesh, its vertices in the same order"
            )
        return mesh.vertices
    try:
        positions = np.asarray(read_npz(file)["positions"], dtype=np.float64)
    except Exception as error:  # OS, zip and key errors all mean the same to the user
        raise FileFormatError(
            f"{file}: no readable .npz file with an array 'positions': {shortened(str(error))}"
        ) from error
    last = positions[-1] if positions.ndim == 3 else positions
    return checked_vectors(f"{file}: positions", last, (count, 3), FileFormatError)


@cache
def warm_up(quick: bool = False) -> None:
    """Load every compiled kernel on a shell of few triangles, so that no measured time holds that."""
    mesh = flat_beam(cells=(6, 2))
    shell = Shell(mesh, Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.2)
    coarse = [CoarseMesh(flat_beam(cells=(6, 2)), "6x2")]
    load = shell.gravity_force((0.0, 0.0, -1.0))
    _measured(Case("warm-up", shell, load, coarse=coarse), (2,), (1.0,), None, unheard, quick)
