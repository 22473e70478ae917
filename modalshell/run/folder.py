"""The folder of a run: whose frames lie there, and what killed runs have left."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
from llvmlite.binding import get_host_cpu_name

from modalshell.provenance import run_record
from modalshell.scene import Scene
from modalshell.shell import Shell


def run_identity(scene: Scene, shell: Shell) -> dict[str, str]:
    """Digests of all that decides the frames, and what computes them: versions, factorisations, processor."""
    content = json.dumps(scene.content(), sort_keys=True).encode()
    mesh = shell.mesh.vertices.tobytes() + np.asarray(shell.mesh.faces, dtype="<i8").tobytes()
    identity = {"scene": hashlib.sha256(content).hexdigest(), "mesh": hashlib.sha256(mesh).hexdigest()}
    identity |= {f"{name} version": str(version) for name, version in run_record({})["versions"].items()}
    return identity | {"processor": str(get_host_cpu_name())}


def remove_leftovers(folder: Path, name: str) -> None:
    """Delete what killed processes had begun to write."""
    for path in folder.glob(f".{name}.*.part*"):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
