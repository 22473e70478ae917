"""Protocol of a run: keep complete results, resume from stored frames, otherwise compute."""

from __future__ import annotations

import glob
import hashlib
import re
import shutil
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar, final

from llvmlite.binding import get_host_cpu_name

from modalshell.core.outcome import Outcome
from modalshell.core.typing import Progress
from modalshell.files.atomic_io import read_record, write_record
from modalshell.files.outputs import refuse_foreign, refuse_inputs
from modalshell.files.provenance import run_record
from modalshell.files.regular import open_regular
from modalshell.run.frame_file import FrameFile
from modalshell.scene import Scene
from modalshell.scene.parts import input_files
from modalshell.shell import Shell

_WITH = {"pvd": "_frames/*", "csv": "_triangles.csv"}
"""Files that are written with those of a format."""


@dataclass(frozen=True)
class RunResult(ABC):
    """What running a scene gave."""

    files: list[Path]
    resumed: int
    """Frames that an earlier, stopped run had left."""

    @property
    @abstractmethod
    def outcome(self) -> Outcome:
        """How the run ended."""

    @property
    @abstractmethod
    def summary(self) -> str:
        """One line on how it went."""


Result = TypeVar("Result", bound=RunResult)


class SceneRun(ABC, Generic[Result]):
    """The run of a scene and its shell in a folder; what kinds of scenes do differently is abstract.

    Attributes
    ----------
    identity : dict of str
        All that decides the frames.
    formats : list of str
        Of the results, ``npz`` first.
    frames : int
        Number of stored frames, once known.
    """

    def __init__(self, scene: Scene, shell: Shell, folder: Path) -> None:
        self.folder, self.name, self.shell = folder, scene.name, shell
        self._units = scene.unit_system
        self.identity = run_identity(scene, shell)
        self.formats: list[str] = list(dict.fromkeys(["npz", *scene.output.formats]))
        self.frames = 0
        self._content, self._inputs = scene.content(), input_files(scene)

    @abstractmethod
    def find_results(self, record: dict[str, Any], whole: list[str]) -> bool:
        """Load the results of this run's ``record``; False if they must be computed again.

        ``whole`` are the formats whose files are unchanged since they were written.
        """

    @abstractmethod
    def compute(self, file: FrameFile, restart: bool, on_step: Progress) -> int:
        """Compute to the end, from the start or from the last frame of ``file``; return how many frames it held."""

    @abstractmethod
    def write(self, formats: list[str], on_step: Progress) -> None:
        """Write the results in some formats."""

    @abstractmethod
    def record(self) -> dict[str, Any]:
        """Entries of the results' record that only this kind of run has."""

    @abstractmethod
    def result(self, files: list[Path], resumed: int) -> Result:
        """The results, all written."""

    def path(self, suffix: str) -> Path:
        """File of the results with a suffix."""
        return self.folder / f"{self.name}.{suffix}"

    @final
    def run(self, restart: bool, on_step: Progress) -> Result:
        """Compute and write what is missing; see :func:`modalshell.run_scene`."""
        with self._units.said(), FrameFile(self.path("frames")) as file:
            refuse_foreign(*(self.path(kind) for kind in ("npz", "csv") if kind in self.formats))
            if not self.path("npz").exists():  # else the record next to it is its own, damaged or not
                refuse_foreign(self.path("json"))
            refuse_inputs([self.path(suffix) for suffix in self.formats], *self._inputs)
            remove_leftovers(self.folder, self.name)
            record = None if restart else read_record(self.path("json"))
            if record is not None and record.get("identity") != self.identity:
                record = None
            digests = {} if record is None else record["digests"]
            whole = [one for one in digests if digests[one] == result_digest(self.folder, self.name, one)]
            found = record is not None and self.find_results(record, whole)
            resumed = self.frames
            if not found:
                whole = []
                if not restart:
                    file.refuse_others(self.identity)  # before the work of building the model
                resumed = self.compute(file, restart, on_step)
                self.path("json").unlink(missing_ok=True)  # what another run has left is about to be replaced
            missing = [suffix for suffix in self.formats if suffix not in whole]
            if missing:
                self.write(missing, on_step)
                self._write_record([*whole, *missing])
            if not found or not file.difference(self.identity):
                file.remove()
        return self.result([self.path(suffix) for suffix in (*self.formats, "json")], resumed)

    def _write_record(self, formats: list[str]) -> None:
        document = {
            "scene": self.name,
            "identity": self.identity,
            "formats": formats,
            "digests": {suffix: result_digest(self.folder, self.name, suffix) for suffix in formats},
            "frames": self.frames,
            "record": run_record(self._content),
        }
        write_record(self.path("json"), document | self.record())


def run_identity(scene: Scene, shell: Shell) -> dict[str, str]:
    """Digests of all that decides the frames, and what computes them: versions, factorisations, processor."""
    versions = {f"{name} version": str(version) for name, version in run_record({})["versions"].items()}
    return scene.digests(shell.mesh) | versions | {"processor": str(get_host_cpu_name())}


def result_digest(folder: Path, name: str, kind: str) -> str:
    """SHA-256 of the file ``NAME.KIND``, and of those that are written with it; "" where it is missing."""
    whole = hashlib.sha256()
    try:
        further = sorted(folder.glob(f"{glob.escape(name)}{_WITH[kind]}")) if kind in _WITH else []
        for path in (folder / f"{name}.{kind}", *further):
            with open_regular(path) as file:
                whole.update(f"{path.name} {path.stat().st_size}\n".encode())
                while block := file.read(1 << 20):
                    whole.update(block)
    except OSError:
        return ""
    return whole.hexdigest()


def remove_leftovers(folder: Path, name: str) -> None:
    """Delete the temporary files of killed processes, named by :func:`modalshell.files.atomic_io.replacing`."""
    ours = re.compile(rf"\.{re.escape(name)}\.\d+\.part(_frames|ial)?(\.\w+)?")
    for path in folder.iterdir():
        if not ours.fullmatch(path.name):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
