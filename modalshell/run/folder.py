"""Output folder of a run: identity of its frames, and removal of leftover temporary files."""

from __future__ import annotations

import hashlib
import re
import shutil
from pathlib import Path

from llvmlite.binding import get_host_cpu_name

from modalshell.provenance import run_record
from modalshell.reading import open_regular
from modalshell.scene import Scene
from modalshell.shell import Shell


def run_identity(scene: Scene, shell: Shell) -> dict[str, str]:
    """Digests of all that decides the frames, and what computes them: versions, factorisations, processor."""
    versions = {f"{name} version": str(version) for name, version in run_record({})["versions"].items()}
    return scene.digests(shell.mesh) | versions | {"processor": str(get_host_cpu_name())}


def result_digest(folder: Path, name: str, kind: str) -> str:
    """SHA-256 of the file ``NAME.KIND``, and of the frames that a ``.pvd`` file names; "" where it is missing."""
    whole = hashlib.sha256()
    try:
        for path in (folder / f"{name}.{kind}", *(sorted((folder / f"{name}_frames").glob("*")) * (kind == "pvd"))):
            with open_regular(path) as file:
                whole.update(f"{path.name} {path.stat().st_size}\n".encode())
                while block := file.read(1 << 20):
                    whole.update(block)
    except OSError:
        return ""
    return whole.hexdigest()


def remove_leftovers(folder: Path, name: str) -> None:
    """Delete the temporary files of killed processes, named by :func:`modalshell.atomic_io.replacing`."""
    ours = re.compile(rf"\.{re.escape(name)}\.\d+\.part(_frames|ial)?(\.\w+)?")
    for path in folder.iterdir():
        if not ours.fullmatch(path.name):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
