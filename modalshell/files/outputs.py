"""Files that a command is about to write: never one of its inputs, and never a file that something else wrote."""

from __future__ import annotations

import os
import re
import zipfile
from contextlib import suppress
from pathlib import Path

from modalshell.core.checks import shown
from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import read_record
from modalshell.files.regular import open_regular

SIGNATURE = "# written by modalshell"
"""How OBJ files of this package begin."""
TABLE_SIGNATURE = "frame,time ["
"""How its tables of the frames of a motion begin."""
_RECORD = re.compile(rb'\{\n "(scene|study|layout)": "[^\n]*",\n "(identity|record|units)": \{')
"""How records and descriptions begin, damaged ones too."""
_BEGINNING = 4096
"""Bytes of a file in which it tells who wrote it."""


def checked_target(
    name: str, path: str | os.PathLike[str], suffixes: tuple[str, ...], *inputs: str | os.PathLike[str] | None
) -> Path:
    """Return the ``path`` of the option ``name`` if it has one of the ``suffixes`` and is none of the ``inputs``.

    OptionError if it has another suffix, is no path of a file, cannot be written where it is, or is the same file as an
    input, by whatever name.
    """
    target = Path(path)
    if "\0" in str(target):
        raise OptionError(f"{name} must be the path of a file (got {shown(str(target))}): leave the null character out")
    if target.suffix.lower() not in suffixes:
        raise OptionError(f"{name} must end in {', '.join(suffixes)} (got {shown(target.name)}): name such a file")
    refuse_inputs([target], *inputs, name=name)
    try:
        # What is missing is made as it is written.
        there = next(one for one in target.absolute().parents if one.exists())
        folder = target.is_dir()
    except OSError as error:  # what may not be looked at, or is too long
        raise OptionError(
            f"{name} {shown(str(target))} cannot be written ({error.strerror}): name another file"
        ) from error
    if folder or not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        reason = "is a folder" if folder else f"cannot be written, for {there} is no folder open to you"
        raise OptionError(f"{name} {shown(str(target))} {reason}: name another file")
    return target


def refuse_inputs(targets: list[Path], *inputs: str | os.PathLike[str] | None, name: str = "the result") -> None:
    """OptionError where one of the ``targets`` is the same file as one of the ``inputs``."""
    for target in targets:
        for given in inputs:
            if given is not None and _same(target, Path(given)):
                raise OptionError(
                    f"{name} {shown(str(target))} is an input and would be overwritten; inputs are never overwritten: "
                    "name another file or folder"
                )


def _same(one: Path, other: Path) -> bool:
    with suppress(OSError, ValueError):
        return os.path.samefile(one, other)
    return os.path.abspath(one) == os.path.abspath(other)  # one is not there, or a link in a circle


def refuse_foreign(*paths: Path) -> None:
    """OptionError where a file whose name the user did not write out is there and is not of this package.

    Files of this package are known by what they hold; they, and empty ones, may be replaced.
    """
    for path in paths:
        if path.is_symlink() or path.exists():
            if path.is_file() and _is_ours(path):
                continue
            raise OptionError(
                f"{shown(str(path))} is there already and was not written by modalshell: it is not replaced; move it "
                "away, or name another folder or file with --out"
            )


def _is_ours(path: Path) -> bool:
    """Whether a file says that this package wrote it; an empty one holds nothing to lose."""
    try:
        with open_regular(path) as file:
            begins = file.read(_BEGINNING)
    except OSError:
        return False
    if not begins:
        return True
    if path.suffix == ".obj":
        return begins.startswith(SIGNATURE.encode())
    if path.suffix == ".csv":
        return begins.startswith(TABLE_SIGNATURE.encode())
    if path.suffix == ".json":
        return bool(_RECORD.match(begins)) or read_record(path) is not None
    return path.suffix == ".npz" and (_marked(path, begins) or _recorded(path))


def _marked(path: Path, begins: bytes) -> bool:
    """Whether an archive has a mark or a digest of this package; one cut short has the mark of its first array."""
    with suppress(OSError, ValueError, NotImplementedError, zipfile.BadZipFile), zipfile.ZipFile(path) as archive:
        return any(name == "sha256.npy" or name.startswith("modalshell_") for name in archive.namelist())
    return begins.startswith(b"PK") and b"modalshell_" in begins[:64]


def _recorded(path: Path) -> bool:
    """Whether the record of the same name lists the archive as a result."""
    record = read_record(path.with_suffix(".json"))
    formats = (record or {}).get("formats")
    return isinstance(formats, list) and "npz" in formats
