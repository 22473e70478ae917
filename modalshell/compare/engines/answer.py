"""Answers of an engine to a shell, after its conversion has been checked on closed forms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, final

import numpy as np

from modalshell.compare.engines.case import CONSTANTS, STEPS, engine_case
from modalshell.compare.engines.engine import Engine, ask, interpreter
from modalshell.core.errors import ModalShellError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.mesh import flat_beam
from modalshell.shell import Isotropic, Shell
from modalshell.shell.energies_of import material_constants

COUNTS = "counts"
"""Outcome of an answer whose conversion held."""
SMALL = 0.05
"""Load ``12 rho g L^3 / (E h^2)`` of the check, at which linear theory holds within 0.1 %."""
MASS, DROP = 0.01, 0.1
"""Deviations of mass and small drop at which a conversion fails."""
_CELLS = (20, 2)


@final
@short_repr
@dataclass(frozen=True)
class EngineAnswer:
    """What an engine made of a shell."""

    name: str
    """The engine."""
    outcome: str
    """Whether it counts: "counts", or why not."""
    version: str = ""
    """Of the engine."""
    drop: float | None = None
    """How far the check's small drop is off, as a fraction."""
    seconds: float | None = None
    """Time of all loads on a processor [s]."""
    step: float | None = None
    """The longest step tried that stayed stable, in the unit of time of the shell's numbers."""
    frame_ms: float | None = None
    """Time of a step on a processor [ms]."""
    positions: Array | None = field(default=None, repr=False)
    """At every load [m]; fewer than the loads where ``note`` says why. Shape (L, n, 3)."""
    note: str = ""
    """What is missing of an answer that counts."""

    @property
    def counts(self) -> bool:
        """Whether its conversion held, and it has an answer."""
        return self.outcome == COUNTS


def answered(engine: Engine, shell: Shell, loads: Sequence[tuple[Array | None, Array | None]]) -> EngineAnswer:
    """An engine's equilibria of a shell under loads, each a gravity (3,) [m/s^2] and a force (n, 3) [N].

    Every engine first answers a strip of the same sheet, 100 thicknesses long and 10 wide: unless the mass that moves
    is met within 1 % and the small drop ``3 rho g L^4 / (2 E h^2)`` within 10 %, by some step in time, the shell is not
    asked.
    """
    try:
        case = engine_case(engine, shell, loads)
    except ModalShellError as error:
        return EngineAnswer(engine.name, f"cannot express: {error}")
    constants = tuple(material_constants(shell.material)[name] for name in CONSTANTS)
    checked = check(engine, constants, interpreter())
    if checked["outcome"] != COUNTS:
        limits = f" ({engine.limits})" if engine.limits and "drop" in checked else ""
        return EngineAnswer(engine.name, checked["outcome"] + limits, checked["version"], checked.get("drop"))
    steps = case["steps"][checked["first"] :] if engine.moves else []
    answer = ask(engine, case | {"calibration": checked["calibration"], "steps": steps})
    fault = answer.get("outcome") or _unfinished(engine, case, answer)
    version, drop = checked["version"], checked["drop"]
    if fault:
        return EngineAnswer(engine.name, fault, version, drop)
    taken = sum(answer.get("taken", []))
    return EngineAnswer(
        engine.name,
        COUNTS,
        version,
        drop,
        answer["seconds"],
        answer.get("step"),
        1e3 * answer["seconds"] / taken if taken else None,
        np.array(answer["positions"])[:, : len(shell.mesh.vertices)],
        answer.get("note", ""),
    )


def _unfinished(engine: Engine, case: dict[str, Any], answer: dict[str, Any]) -> str:
    """Why an answer is none."""
    if not answer.get("positions"):
        if not engine.moves:
            return str(answer.get("note", "no equilibrium"))
        return f"no step stayed stable, down to a {STEPS[-1]}th of the lowest mode's period"
    if engine.moves and any(taken * answer["step"] < 0.99 * case["duration"] for taken in answer["taken"]):
        return f"not at rest after {case['limit']:g} s a load"
    return ""


@cache
def check(engine: Engine, constants: tuple[float, ...], python: str) -> dict[str, Any]:  # noqa: ARG001 (of the key)
    """Outcome, version and deviations of an engine's conversion of a sheet's constants, by the longest step that does.

    Of an engine that fails by all of them the nearest row is kept. In another ``python`` it is asked again.
    """
    rows: list[dict[str, Any]] = []
    for first in range(len(STEPS) if engine.moves else 1):
        rows.append({"first": first, **_converted(engine, constants, first)})
        if rows[-1]["outcome"] == COUNTS or "drop" not in rows[-1]:
            break
    return min(rows, key=lambda row: (row["outcome"] != COUNTS, abs(row.get("drop", np.inf))))


def _converted(engine: Engine, constants: tuple[float, ...], first: int) -> dict[str, Any]:
    """The check by steps from the ``first`` on; of a calibrated modulus, on a strip of half the length."""
    scale, lengths = 1.0, (1.0, 0.5) if engine.calibrated else (1.0,)
    row: dict[str, Any] = {"version": "", "calibration": 1.0}
    for fraction in lengths:
        row["calibration"] = scale
        shell, gravity = strip(constants, fraction)
        case = engine_case(engine, shell, [(np.array([0.0, 0.0, -gravity]), None)], first)
        answer = ask(engine, case | {"calibration": scale})
        row["version"] = answer.get("version", "")
        row["outcome"] = answer.get("outcome") or _unfinished(engine, case, answer)
        if row["outcome"]:
            return row
        row |= deviations(answer, case, shell)
        scale *= 1.0 + row["drop"]
    faults = [f"mass {100.0 * row['mass']:+.1f} %"] if abs(row.get("mass", 0.0)) > MASS else []
    faults += [] if abs(row["drop"]) <= DROP else [f"small drop {100.0 * row['drop']:+.0f} %"]
    row["outcome"] = f"conversion check failed: {', '.join(faults)}" if faults else COUNTS
    return row


def strip(constants: tuple[float, ...], fraction: float = 1.0) -> tuple[Shell, float]:
    """The check's strip, clamped at x = 0, or a fraction of its length; and its gravity [m/s^2]."""
    young, _, thickness, density = constants
    length = 100.0 * thickness
    mesh = flat_beam(length=fraction * length, width=0.1 * length, cells=(round(fraction * _CELLS[0]), _CELLS[1]))
    shell = Shell(mesh, Isotropic(*constants), mesh.vertices[:, 0] < 1e-9 * length)
    return shell, SMALL * young * thickness**2 / (12.0 * density * (fraction * length) ** 3)


def deviations(answer: dict[str, Any], case: dict[str, Any], shell: Shell) -> dict[str, float]:
    """Deviation of the small drop of a strip's tip, and of the mass that moves where the engine tells it."""
    rest, length = shell.rest_positions, shell.size
    tip = rest[:, 0] > (1.0 - 1e-9) * rest[:, 0].max()
    fall = -float(np.array(answer["positions"])[0, : len(rest)][tip, 2].mean())
    row = {"drop": fall / (SMALL / 8.0 * length) - 1.0}
    if "mass" in answer:
        row["mass"] = answer["mass"] / float(np.delete(np.array(case["masses"]), case["held"]).sum()) - 1.0
    return row
