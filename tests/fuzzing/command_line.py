"""The command line: arguments from a grammar of what its help tells, and junk; in this process and in others."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

from hypothesis import strategies as st

import modalshell as ms
from fuzzing.drawing import without_pictures
from fuzzing.expressions import expressions
from fuzzing.harness import FEW, DirtyExit, Escape, Input, LongWork, UncaughtException
from fuzzing.scenes import BASE, BASES, SWEEPS, as_toml, files_of, in_this_process
from modalshell.commands import cli
from modalshell.files.atomic_io import write_text

BAD_MESHES = Path(__file__).resolve().parents[1] / "data" / "bad"
QUICK = ("simulate", "modes", "repair", "run", "view", "sweep", "reproduce", "bench", "tradeoff", "advise", "doctor")
"""Commands that may be given what they accept: what takes minutes in them is left out here."""

_WORDS = (
    *("0", "1", "-1", "2", "3", "7", "0.5", "-0.5", "1e3", "1e300", "-1e300", "1e-300", "nan", "inf", "-inf", "1e999"),
    *("", " ", "-", "--", "---", "-x", "--x", "--=", "=", "x", "é", "\ud800", "a\0b", "9" * 400, "9" * 5000, "x" * 300),
    *("true", "false", "None", "[]", "{}", "0x10", "1_0", "1,2", "mwts", "ds", "lma", "rigid", "MWTS", "frame"),
    *("../out", "/", "/dev/null", ".", "~", "*", "%s", "$(false)", "\n", "\x1b[31m", "[red]x[/red]", "-9.81", "--help"),
)  # fmt: skip


def arguments_of(command: str) -> list[str]:
    """Options of a command, as its help tells them."""
    shown, _, _ = called([command, "--help"], Path.cwd())
    return sorted(set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", shown)) - {"--help", "--version"})


@cache
def commands() -> dict[str, list[str]]:
    """Every command that the application registers, with its options."""
    names = [name for name in cli.app if not name.startswith("-")]
    return {name: arguments_of(name) for name in names}


class _Captured(io.TextIOWrapper):
    """Standard output or error as a terminal has it: UTF-8, and no surrogates."""

    def __init__(self, errors: str = "strict") -> None:
        super().__init__(io.BytesIO(), encoding="utf-8", errors=errors, write_through=True)

    @property
    def text(self) -> str:
        buffer = self.buffer
        assert isinstance(buffer, io.BytesIO)
        return buffer.getvalue().decode()


def _bench(out: Path, *_: Any, **__: Any) -> list[Path]:
    """In place of the benchmarks."""
    return [write_text(out / "benchmarks.md", "# table\n")]


class _Clock:
    """In place of the time module: waits end at once, and whoever watches a run for ever is stopped."""

    def __init__(self) -> None:
        self._now, self._sleeps = 1.0, 0

    def monotonic(self) -> float:
        self._now *= 1e3
        return self._now

    def sleep(self, _: float) -> None:
        self._sleeps += 1
        if self._sleeps > FEW:
            raise LongWork


class _Shown:
    """In place of a window or a page of a run."""

    def __init__(self, run: Any, **_: Any) -> None:
        assert run.index >= 0

    def show(self) -> None:
        pass

    def serve(self, _: int) -> None:
        pass

    def save_picture(self, path: Any) -> None:
        write_text(path, "picture")


def _no_scheduler(address: str, *_: object) -> Any:
    raise ms.WorkerError(f"no scheduler answers at {address!r:.60}")


@contextlib.contextmanager
def _without_windows() -> Iterator[None]:
    """Runs that are followed open no window and no page, and sweeps start no processes."""
    clock, nothing = _Clock(), {name: lambda *_: None for name in ("demand_window", "demand_opengl")}
    with (
        mock.patch.multiple("modalshell.viewer.attached", AttachedWindow=_Shown, AttachedPage=_Shown, **nothing),
        mock.patch("modalshell.viewer.web.demand_opengl", nothing["demand_opengl"]),
        mock.patch("modalshell.viewer.attached.time", clock),
        mock.patch("modalshell.run.follow.time", clock),
        mock.patch("modalshell.commands.doctor.choose_backend", return_value="built-in"),
        mock.patch.multiple("modalshell.sweep.driver", run_locally=in_this_process, connect=_no_scheduler),
    ):
        yield


def called(argv: list[str], work: Path) -> tuple[str, str, Any]:
    """Standard output, standard error and exit status of a command in the folder ``work``."""
    here, out, errors = Path.cwd(), _Captured(), _Captured("backslashreplace")
    status: Any = 0

    def load_only(scene: Any, *_: Any) -> str:
        scene.require_shell().build()
        return "window"

    patched = {
        "write_pages": lambda *_, **__: [],
        "open_window": load_only,
        "serve_page": load_only,
        "take_picture": load_only,
    }
    with contextlib.ExitStack() as stack:
        for name, stand_in in patched.items():
            if hasattr(cli, name):
                stack.enter_context(mock.patch.object(cli, name, stand_in))
        stack.enter_context(mock.patch("studies.reproduce.reproduce", return_value=[]))
        stack.enter_context(mock.patch("studies.benchmarks.run.main", _bench))
        stack.enter_context(mock.patch.multiple("modalshell.compare.tradeoff", _measured=_too_long))
        stack.enter_context(without_pictures())
        stack.enter_context(_without_windows())
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(errors))
        stack.enter_context(mock.patch.object(sys, "argv", ["modalshell", *argv]))
        os.chdir(work)
        try:
            cli.main(list(argv))
        except SystemExit as stop:
            status = stop.code
        except LongWork:
            raise
        except Exception as error:  # a refusal that gets this far would be a traceback as well
            raise UncaughtException(f"{type(error).__name__}: {error}"[:500]) from error
        finally:
            os.chdir(here)
    return out.text, errors.text, status or 0


def _too_long(*_: Any, **__: Any) -> Any:
    """In place of the minutes in which rungs are measured."""
    raise ms.SolverError("nothing is measured here: 'tradeoff' and 'advise' stop at their checks")


def check_exit(status: Any, errors: str) -> None:
    """DirtyExit unless a command ended its work (status 0 or 1) or with one line, which is then raised as an error."""
    said = ("modalshell: warning: ", "modalshell: compiling kernels, ")
    lines = [line for line in errors.splitlines() if not line.startswith(said)]
    if "Traceback" in errors or status not in (0, 1, 2):
        raise DirtyExit(f"status {status}: {errors[-500:]}")
    if status == 2:
        if len(lines) != 1 or not lines[0].startswith("modalshell: "):
            raise DirtyExit(f"status 2 with {len(lines)} lines: {errors[:500]!r}")
        raise ms.ModalShellError(lines[0])


def run(folder: Path, argv: list[str]) -> None:
    """Run a command in a fresh folder; it may write below that only."""
    work = folder / "work"
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(prepared(folder), work)
    before = files_of(folder)
    _, errors, status = called(argv, work)
    outside = [path for path in files_of(folder) - before if not Path(path).is_relative_to(work)]
    if outside and not any(".." in argument for argument in argv):
        raise Escape(f"{outside[0]} lies outside {work}")
    check_exit(status, errors)


def _stop(done: int, _total: int) -> None:
    if done == 1:
        raise LongWork


@cache
def prepared(folder: Path) -> Path:
    """A folder with files that commands take."""
    place = folder / "prepared"
    place.mkdir()
    ms.save_mesh(ms.sheet(cells=(2, 2)), place / "panel.obj")
    ms.save_mesh(ms.sheet(cells=(2, 2)), place / "panel.ply")
    for index, base in enumerate(BASES):
        (place / f"scene_{index}.toml").write_text(as_toml(base))
    for path in BAD_MESHES.iterdir():
        shutil.copy(path, place / path.name)
    for index, sweep in enumerate(SWEEPS):
        (place / f"sweep_{index}.toml").write_text(as_toml(sweep))
    (place / "panel.toml").write_text(as_toml(BASE))
    for name, on_step in (("stopped", _stop), ("finished", None)):
        with contextlib.suppress(LongWork):
            ms.run_scene(place / "panel.toml", out=place / name, on_step=on_step)
    (place / "empty.toml").write_text("")
    (place / "broken.npz").write_bytes(b"PK\x03\x04")
    (place / "folder").mkdir()
    return place


def make(folder: Path) -> st.SearchStrategy[Input]:
    """Inputs that are run in ``folder``."""
    files = sorted(path.name for path in prepared(folder).iterdir())
    meshes, scenes = ["panel.obj", "panel.ply"], [name for name in files if name.startswith("scene_")]
    sweeps = [name for name in files if name.startswith("sweep_")]
    table = commands()

    def value_of(option: str) -> st.SearchStrategy[list[str]]:
        junk = st.sampled_from(_WORDS).map(lambda word: [word])
        if option == "--clamp":
            known = st.sampled_from(["x < 0.6", "x < 9", "x < -9"])
            return st.one_of(expressions, known).map(lambda text: [text])
        if option in ("--out", "--figures", "--screenshot", "--truth"):
            return st.one_of(st.sampled_from([["out"], ["out/deep/er"], ["panel.obj"], ["folder"]]), junk)
        if option == "--attach":
            runs = [
                "finished",
                "stopped",
                "stopped/panel.frames",
                "finished/panel.frames",
                "panel.toml",
                "no",
                "folder",
            ]
            return st.one_of(st.sampled_from([*runs, "scene_0.toml"]).map(lambda run: [run]), junk)
        if option == "--gravity":
            return st.lists(st.sampled_from(["0", "-9.81", "1e30", "nan", "x", "1e200"]), min_size=1, max_size=4)
        return st.one_of(st.just(["2"]), st.just(["0.1"]), junk, st.just([]))

    @st.composite
    def build(draw: st.DrawFn) -> Input:
        name = draw(st.sampled_from([*table, *table, "simulate", "modes", "run", "fly", "", "--version", "--help"]))
        argv = [name] if name else []
        file = draw(st.sampled_from([*meshes, *meshes, *scenes, *scenes, *files, "no_such.obj", *_WORDS]))
        wanted = meshes if name in ("simulate", "modes", "repair") else sweeps if name == "sweep" else scenes
        if draw(st.integers(0, 2)) and name in QUICK:
            file = draw(st.sampled_from(wanted))
        attached = name == "view" and draw(st.booleans())
        if name not in QUICK and file in (*meshes, *scenes):
            file = "no_such.toml"  # what an unknown command accepts may take minutes
        if name not in ("reproduce", "bench", "doctor") and draw(st.integers(0, 9)) and not attached:
            argv.append(file)
        if attached:
            argv += ["--attach", *draw(value_of("--attach"))]
            argv += draw(st.sampled_from([[], ["--follow"], ["--web"], ["--screenshot", "shot.png"]]))
        if name == "simulate":  # short unless the junk says otherwise
            argv += ["--modes", "2", "--duration", "0.1"] if draw(st.booleans()) else ["--static", "--modes", "2"]
            argv += ["--clamp", "x < 0.3"] if draw(st.integers(0, 3)) else []
        for option in draw(st.lists(st.sampled_from([*table.get(name, []), "--x", "--out"]), max_size=3)):
            argv += [option, *draw(value_of(option))]
        argv += draw(st.lists(st.sampled_from(_WORDS), max_size=1)) if draw(st.integers(0, 4)) == 0 else []
        argv = [word for word in argv if word != "--debug"]  # shows the traceback on purpose
        return Input(f"modalshell {argv!r:.1000}", lambda: run(folder, argv))

    return build()
