"""Saved results: damaged anywhere they are refused, or read as exactly what was written."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from hypothesis import strategies as st
from scenes import TINY_BEAM, held

import modalshell as ms
from fuzzing.command_line import called, check_exit
from fuzzing.harness import HalfRead, Input
from fuzzing.mutations import TOKENS, array_like, byte_damage, damaged, flips
from modalshell.compare.tradeoff import outside_positions
from modalshell.core.checks import shown
from modalshell.files.atomic_io import read_npz
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult
from modalshell.run import RunFollower
from modalshell.run.frame_file import ALIGNMENT, CONSTANTS, LINE_CHECKSUM, MAGIC, line_checksum, record_dtype
from modalshell.sweep import load_sweep
from modalshell.sweep.case import run_case
from modalshell.sweep.plan import Plan
from modalshell.sweep.store import CaseFolder

SCENE = (
    TINY_BEAM
    + """
loads = {gravity = [0.0, 0.0, -4.0]}
model = {name = "mwts", modes = 2}
motion = {duration = 0.2, dt = 0.02}
"""
)
FLIGHT = (
    SCENE.replace('"beam"', '"birds"')
    + """
[flock]
count = 3
radius = 2.0
camera = {position = [0.0, -5.0, 0.0]}
"""
)


@dataclass(frozen=True)
class Saved:
    """One kind of result: its files, which of them is damaged, and how it is read."""

    name: str
    files: dict[str, bytes]
    damaged: str
    read: Callable[[Path], Any]
    expected: Any
    arrays: dict[str, Any]
    """Contents of an .npz file, to write others of the kind."""


class _Stop(Exception):
    """Ends a run that has frames left to make."""


def _stop(done: int, _total: int) -> None:
    if done == 6:
        raise _Stop


@cache
def results() -> tuple[Saved, ...]:
    """Every kind of saved result, made once."""
    mesh = ms.v_beam(cells=(2, 2))
    shell = held(mesh, 0.6)
    basis = ms.solve_modes(shell, 2)
    run = ms.simulate(ms.ModalWarping(basis), duration=0.1, gravity=(0.0, 0.0, -4.0))
    made = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        basis.save(folder / "basis.npz")
        ms.save_trajectory(run, folder / "run.npz")
        ms.save_trajectory(run, folder / "run.clip")
        longer = ms.simulate(ms.ModalWarping(basis), duration=2.0, gravity=(0.0, 0.0, -4.0))
        ms.save_trajectory(longer, folder / "long.npz")
        findings = {"rows": [{"label": "DS", "error": 0.25, "modes": 8}], "note": "é"}
        arrays = {"a": np.arange(6.0), "b": mesh.faces}
        StudyResult("study", findings, arrays, run_record({"cells": [2, 2]})).save(folder)
        np.savez(folder / "truth.npz", positions=run.positions[-1])
        (folder / "beam.toml").write_text(SCENE)
        whole = ms.run_scene(folder / "beam.toml", out=folder / "whole")
        with contextlib.suppress(_Stop):
            ms.run_scene(folder / "beam.toml", out=folder, on_step=_stop)

        def kind(title: str, damaged_file: str, names: tuple[str, ...], read: Callable[[Path], Any]) -> None:
            files = {name: (folder / name).read_bytes() for name in names}
            arrays = {}
            if damaged_file.endswith((".npz", ".clip")):
                with np.load(folder / damaged_file) as stored:
                    arrays = dict(stored)
            expected = whole.trajectory if title == "frames" else read(folder)
            made.append(Saved(title, files, damaged_file, read, plain(expected), arrays))

        def resumed(at: Path) -> Any:
            return ms.run_scene(at / "beam.toml", out=at).trajectory

        def flown(at: Path) -> Any:
            result = ms.run_scene(at / "birds.toml", out=at)
            report = replace(result.report, seconds_steps=0.0)
            return [report, read_npz(at / "birds.npz")]

        def followed(at: Path) -> Any:
            follower = RunFollower(at / "beam.frames")
            try:
                follower.poll()
                shape = [follower.rest_positions, follower.faces, follower.held, follower.gravity]
                shown = [follower.name, follower.time, follower.positions, follower.outcome, *shape]
            finally:
                follower.close()
            if follower.index < 0:
                raise ms.FileFormatError(f"no sound frame in {at}")
            if follower.index < frames - 1 and not np.array_equal(follower.positions, kept[follower.index]):
                raise HalfRead(f"frame {follower.index} of a damaged file is not what was written")
            if follower.index < frames - 1:
                raise ms.FileFormatError(f"{at}: frame {follower.index} is the last that is sound")
            return shown

        def case(at: Path) -> Any:
            with CaseFolder(at) as cases:
                found = cases.read(task.digest)
            if found is None:
                raise ms.FileFormatError(f"no sound case in {at}: it would be computed again")
            return found

        def exported(at: Path) -> Any:
            """As an archive too large to be verified by whoever only looks at it."""
            with mock.patch("modalshell.export.archive._VERIFIED", 0):
                _, errors, status = called(["export", "long.npz", "--to", "pc2"], at)
            check_exit(status, errors)
            return np.frombuffer((at / "long.pc2").read_bytes(), np.uint8)

        both = ("study.json", "study.npz")
        kind("basis", "basis.npz", ("basis.npz",), lambda at: ms.Basis.load(at / "basis.npz"))
        kind("trajectory", "run.npz", ("run.npz",), lambda at: ms.load_trajectory(at / "run.npz"))

        def clip(at: Path) -> Any:
            found = ms.load_clip(at / "run.clip")
            if (np.diff(found.times) <= 0.0).any() or found.faces.max(initial=0) >= found.positions.shape[1]:
                raise HalfRead("a clip whose times do not increase, or whose faces name no vertices")
            return found

        kind("clip", "run.clip", ("run.clip",), clip)
        kind("exported archive", "long.npz", ("long.npz",), exported)
        kind("study's arrays", "study.npz", both, lambda at: StudyResult.load(at, "study"))
        kind("study's findings", "study.json", both, lambda at: StudyResult.load(at, "study"))
        kind("frames", "beam.frames", ("beam.frames", "beam.toml"), resumed)
        kind("outside solution", "truth.npz", ("truth.npz",), lambda at: outside_positions(at / "truth.npz", shell))
        kept = whole.trajectory.positions
        frames = 7  # at rest, and after each of the six steps
        kind("followed frames", "beam.frames", ("beam.frames",), followed)
        for name in ("beam.json", "beam.npz"):
            shutil.copy(folder / "whole" / name, folder / name)
        kind("run's record", "beam.json", ("beam.json", "beam.npz", "beam.toml"), resumed)
        kind("run's positions", "beam.npz", ("beam.json", "beam.npz", "beam.toml"), resumed)
        (folder / "birds.toml").write_text(FLIGHT)
        with contextlib.suppress(_Stop):
            ms.run_scene(folder / "birds.toml", out=folder, on_step=_stop)
        kind("flight's frames", "birds.frames", ("birds.frames", "birds.toml"), flown)
        kind("flight's record", "birds.json", ("birds.json", "birds.npz", "birds.toml"), flown)
        kind("flight's arrays", "birds.npz", ("birds.json", "birds.npz", "birds.toml"), flown)
        task = next(iter(Plan(load_sweep(Path(__file__).with_name("sweep.toml"))).tasks.values()))
        with CaseFolder(folder) as cases:
            cases.write(run_case(task))
        kind("sweep's case", f"{task.digest}.json", (f"{task.digest}.json",), case)
    return tuple(made)


TIMINGS = ("seconds", "made")


def plain(value: Any) -> Any:
    """An answer as bytes and plain values, to compare; without how long it took."""
    if isinstance(value, ms.Shell):
        return plain([value.mesh.vertices, value.mesh.faces, value.clamped, value.material])
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, np.asarray(value).tobytes())
    if is_dataclass(value):
        return {item.name: plain(getattr(value, item.name)) for item in fields(value) if item.name not in TIMINGS}
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return repr(value)


def _written(folder: Path, saved: Saved, data: bytes) -> Any:
    for file in folder.iterdir():
        shutil.rmtree(file) if file.is_dir() else file.unlink()
    for name, content in saved.files.items():
        (folder / name).write_bytes(data if name == saved.damaged else content)
    return saved.read(folder)


def _damage(folder: Path, saved: Saved, damages: list[Any]) -> Input:
    data = damaged(saved.files[saved.damaged], damages)

    def call() -> Any:
        answer = _written(folder, saved, data)
        if plain(answer) != saved.expected:
            raise HalfRead(f"a damaged {saved.name} was read as something else than what was written")
        return answer

    original = saved.files[saved.damaged]
    first = next((at for at, (a, b) in enumerate(zip(data, original, strict=False)) if a != b), "the end")
    return Input(
        f"{saved.name}, {len(data)} of {len(original)} bytes, different from byte {first}: {data[:400]!r}", call
    )


def _forged(folder: Path, saved: Saved, names: list[str], junk: dict[str, Any], packing: str) -> Input:
    """A sound zip file of the kind with other contents: what it is read as must at least be finite."""
    arrays = {name: array for name, array in saved.arrays.items() if name != "sha256"}  # as of one who knows the kind
    for name in names:
        if name in junk:
            arrays[name] = junk[name]
        else:
            arrays.pop(name, None)

    def call() -> Any:
        answer = _written(folder, saved, _packed(arrays, packing))
        return None if isinstance(answer, StudyResult) else answer  # a study may draw gaps as NaN

    told = {name: shown(junk[name]) if name in junk else "left out" for name in names}
    return Input(f"{saved.name} forged ({packing}): {told}", call)


def _packed(arrays: dict[str, Any], packing: str) -> bytes:
    """Arrays as .npz; pickled where NumPy would, with headers that promise too much, or nested."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED if packing == "deflated" else zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            try:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=True)
            except (TypeError, ValueError, AttributeError):  # what cannot even be pickled
                member.write(shown(array).encode(errors="replace"))
            data = member.getvalue()
            if packing == "bomb":
                data = data.replace(b"'shape': (", b"'shape': (999999999999, ", 1)
            if packing == "negative":
                data = data.replace(b"'shape': (", b"'shape': (-", 1)
            archive.writestr(f"../{name}.npy" if packing == "escaping" else f"{name}.npy", data)
            if packing == "doubled":
                archive.writestr(f"{name}.npy", data)
    if packing == "nested":
        outer = io.BytesIO()
        with zipfile.ZipFile(outer, "w") as archive:
            archive.writestr("positions.npy", out.getvalue())
        return outer.getvalue()
    return out.getvalue()


_RECORDS = (
    *("[]", "5", "{}", "null", "", "__import__('os').abort()", "[" * 100_000, '[["time", "<f8"]]', '[["time", "O"]]'),
    *('[["time", "<f8", [-1]], ["positions", "<f8", [9, 3]]]', '[["time", "<f8"], ["positions", "<f8", [9, 3]]]'),
    *('[["time", "<f8"], ["positions", "<f8", [99999999999, 99999999999]]]', '[["a", "<f8"], ["a", "<f8"]]'),
    *('[["time", "S8"], ["positions", "<f4", [9, 3]]]', '[["", ""]]'),
)
_ARRAYS = ("<f8", "<f4", "<i8", "?", "O", "S3", "x", "<c16", "V0")


def _forged_frames(folder: Path, saved: Saved, draw: st.DrawFn) -> Input:
    """A file of frames whose checksums are right and whose contents are another's."""
    data = saved.files[saved.damaged]
    line = data[len(MAGIC) : data.index(b"\n", len(MAGIC)) + 1]
    document = json.loads(line)
    del document[LINE_CHECKSUM]
    layout = [list(row) for row in document[CONSTANTS]["arrays"]]
    sizes = [np.dtype(kind).itemsize * int(np.prod(shape)) for _, kind, shape in layout]
    body = data[len(MAGIC) + len(line) :]
    starts = np.cumsum([0, *sizes])
    parts = [body[start : start + size] for start, size in zip(starts, sizes, strict=False)]
    changes = draw(
        st.lists(st.sampled_from(("record", "name", "kind", "shape", "bytes", "less", "frames")), min_size=1)
    )
    for change in changes:
        row = draw(st.integers(0, len(layout) - 1)) if layout else None
        if change == "record":
            document["record"] = draw(st.sampled_from(_RECORDS))
        elif row is None or change == "frames":
            continue
        elif change == "name":
            layout[row][0] = draw(st.sampled_from(("faces", "self", "", "rest_positions", "x")))
        elif change == "kind":
            layout[row][1] = draw(st.sampled_from(_ARRAYS))
        elif change == "shape":
            layout[row][2] = draw(st.sampled_from(([], [0], [3], [9, 3], [-1, 3], [10**12, 3], [2**62, 8], [0, 3])))
        elif change == "bytes":
            parts[row] = draw(st.sampled_from((b"\xff", b"\x00", b"\x7f"))) * len(parts[row])
        else:
            del layout[row], parts[row]
    for index, (_, kind, shape) in enumerate(layout):  # the bytes that the layout promises, if there can be so many
        with contextlib.suppress(TypeError, ValueError):
            size = np.dtype(kind).itemsize * int(np.prod(shape, dtype=object))
            if 0 <= size < 10_000:
                parts[index] = parts[index].ljust(size, b"\0")[:size]
    constants = b"".join(parts)
    document[CONSTANTS] = {"arrays": layout, "checksum": zlib.crc32(constants)}
    document[LINE_CHECKSUM] = line_checksum(document)
    head = MAGIC + json.dumps(document, sort_keys=True).encode()
    head += b" " * (-(len(head) + 1) % ALIGNMENT) + b"\n" + constants
    head += b"\0" * (-len(constants) % ALIGNMENT)
    frames = b""
    with contextlib.suppress(TypeError, ValueError, RecursionError):
        fields = [(name, kind, *map(tuple, shape)) for name, kind, *shape in json.loads(document["record"])]
        record = np.full(record_dtype(fields).itemsize - 4, 255 if "frames" in changes else 0, np.uint8).tobytes()
        frames = (record + zlib.crc32(record).to_bytes(4, "little")) if len(record) < 10_000 else b""

    def call() -> Any:
        path = folder / "forged.frames"
        path.write_bytes(head + frames)
        follower = RunFollower(path)
        try:
            follower.poll()
            return [follower.time, follower.positions, follower.rest_positions, follower.gravity, follower.status()]
        finally:
            follower.close()

    return Input(f"frames forged: {document['record'][:100]!r}, {str(layout)[:400]}, {changes}", call)


_PACKINGS = ("stored", "stored", "stored", "deflated", "bomb", "negative", "nested", "escaping", "doubled")


def _forgeries(folder: Path, saved: Saved) -> st.SearchStrategy[Input]:
    names = sorted(saved.arrays.keys() - {"sha256"})

    @st.composite
    def build(draw: st.DrawFn) -> Input:
        chosen = draw(st.lists(st.sampled_from(names), min_size=1, max_size=2, unique=True))
        junk = {name: draw(array_like(saved.arrays[name])) for name in chosen if draw(st.integers(0, 5))}
        return _forged(folder, saved, chosen, junk, draw(st.sampled_from(_PACKINGS)))

    return build()


def _json_junk(folder: Path, saved: Saved) -> st.SearchStrategy[Input]:
    """Other JSON documents, and none, in place of the record."""
    document = json.loads(saved.files[saved.damaged])
    texts = ["5", "[]", "null", "{}", "[" * 100_000, '"x"', "NaN", "1e999", "{" * 500]
    texts.append(json.dumps(document | {"record": 5}))
    texts += [json.dumps({key: inner for key, inner in document.items() if key != gone}) for gone in document]
    return st.sampled_from(texts).map(
        lambda text: Input(f"{saved.name}: {text[:200]}", lambda: _written(folder, saved, text.encode()))
    )


def forged_clips(folder: Path) -> st.SearchStrategy[Input]:
    """Sound files of clips with other contents."""
    return _forgeries(_place(folder), next(saved for saved in results() if saved.name == "clip"))


def _place(folder: Path) -> Path:
    """Where files of saved results are written."""
    place = folder / "saved"
    place.mkdir(exist_ok=True)
    return place


def make(folder: Path) -> st.SearchStrategy[Input]:
    """Inputs that are written into ``folder``."""
    kinds, place = results(), _place(folder)
    anywhere = st.one_of(flips.map(lambda flip: [flip]), st.lists(byte_damage, max_size=2))
    quick = [saved for saved in kinds if not any(name.endswith(".toml") for name in saved.files)]
    large = [saved for saved in kinds if saved.name == "exported archive"]
    any_kind = st.sampled_from(
        [*quick, *quick, *kinds, *large, *large]
    )  # to run a scene takes ten times as long as to read a file
    broken = st.builds(_damage, st.just(place), any_kind, anywhere)
    replaced = st.builds(
        _damage, st.just(place), any_kind, st.sampled_from(TOKENS).map(lambda token: [lambda _: token])
    )
    zipped = [_forgeries(place, saved) for saved in (*quick, *kinds) if saved.arrays]
    followed = next(saved for saved in kinds if saved.name == "followed frames")
    zipped.append(st.composite(lambda draw: _forged_frames(place, followed, draw))())
    written = [_json_junk(place, saved) for saved in kinds if saved.damaged.endswith(".json")]
    return st.integers(0, 9).flatmap(
        lambda roll: broken if roll < 6 else st.one_of(zipped) if roll < 9 else st.one_of(replaced, *written)
    )
