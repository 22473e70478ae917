"""Engines other than this package, and the processes that run their adapters."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, final

from modalshell.core.cores import ONE_THREAD

ADAPTERS = Path(__file__).with_name("adapters")
SECONDS = 600.0
"""Time after which an engine is stopped."""


@final
@dataclass(frozen=True, eq=False)  # by identity, as its options cannot be hashed
class Engine:
    """An engine other than this package."""

    key: str
    """Name of its adapter."""
    name: str
    """What tables call it."""
    install: str
    """How to get it."""
    limits: str = ""
    """What it cannot express by its own documents."""
    options: dict[str, Any] = field(default_factory=dict)
    """What its adapter takes in addition to the case."""
    moves: bool = True
    """Whether it steps in time, so that an answer is where motion comes to rest."""
    has_turns: bool = False
    """Whether its vertices have turns, so that it clamps an edge by itself; otherwise it gets mirror images of the
    triangles along a clamped edge, which are held."""
    calibrated: bool = False
    """Whether its modulus is calibrated on the drop of a strip, and checked on another."""
    color: str = "0.5"
    marker: str = "X"
    """Of its marks in pictures, none of them a model's color."""


_FLEX = {"limit": 60.0}
ENGINES = (
    Engine(
        "calculix",
        "CalculiX S6",
        "apt-get install calculix-ccx",
        options={"limit": 0.95 * SECONDS},  # the adapter stops the program, which would outlive it
        moves=False,
        has_turns=True,
        color="#222222",
    ),
    Engine(
        "mujoco_flex",
        "MuJoCo flex",
        "pip install 'mujoco>=4.0'",
        limits="its bending has a stiffness of its own at the modulus that its documents name",
        options=_FLEX,
        color="#b8a9d9",
        marker="p",
    ),
    Engine(
        "mujoco_flex",
        "MuJoCo flex, calibrated modulus",
        "pip install 'mujoco>=4.0'",
        options=_FLEX,
        calibrated=True,
        color="#8c6d4f",
        marker="<",
    ),
    Engine(
        "newton_vbd",
        "Newton VBD, 20 iterations a step",
        "pip install newton",
        limits="20 iterations a step do not reach the equilibrium of a stiff membrane",
        options={"limit": 60.0, "iterations": 20},
        color="#999999",
        marker=">",
    ),
)


def interpreter() -> str:
    """The Python that adapters run in: that of the environment variable ``MODALSHELL_ENGINES``, or this one."""
    return os.environ.get("MODALSHELL_ENGINES", sys.executable)


def ask(engine: Engine, case: dict[str, Any]) -> dict[str, Any]:
    """An adapter's answer to a case, or ``{"outcome": why there is none}``.

    Adapters run on one thread, in the Python of :func:`interpreter`.
    """
    python = interpreter()
    command = [os.path.abspath(python) if os.sep in python else python, str(ADAPTERS / f"{engine.key}.py")]
    try:
        with tempfile.TemporaryDirectory() as folder:  # engines leave logs where they run
            ended = subprocess.run(
                command,
                input=json.dumps(case),
                capture_output=True,
                text=True,
                timeout=SECONDS,
                check=False,
                cwd=folder,
                env={**os.environ, **ONE_THREAD},
            )
    except subprocess.TimeoutExpired:
        return {"outcome": f"stopped after {SECONDS:g} s"}
    except OSError as error:
        return {"outcome": f"did not start: {error.strerror}"}
    lines = ended.stdout.strip().splitlines()
    if ended.returncode == 0 and lines:
        try:
            return dict(json.loads(lines[-1]))
        except (TypeError, ValueError):
            return {"outcome": f"answered no table: {lines[-1][:200]}"}
    last = (ended.stderr.strip().splitlines() or ["no message"])[-1]
    if "No module named" in last or "No program named" in last:
        return {"outcome": f"not installed: {engine.install}"}
    return {"outcome": f"ended with status {ended.returncode}: {last[:200]}"}
