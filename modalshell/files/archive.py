"""Archives: NPZ files of one kind, whose arrays, units and version are written and checked by a table."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import astuple, dataclass, field
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import checked_folder, shortened
from modalshell.core.errors import FileFormatError
from modalshell.core.units import SI, UnitSystem
from modalshell.files.atomic_io import read_npz
from modalshell.files.regular import open_regular

_KINDS = {"f": "finite numbers", "fiu": "finite numbers", "iu": "whole numbers", "U": "text", "b": "true or false"}
"""What the letters of NumPy's kinds stand for."""
LARGEST_FLOAT = float(np.finfo(np.float64).max)
_MARK = "modalshell_"
"""What the names of marks begin with."""
UNITS = ("units", "unit_system")
"""Names of the arrays with the unit of each other array, and with the units of length, mass and time."""


class Field(NamedTuple):
    """An array of an archive."""

    kinds: str
    """Letters of its NumPy kinds: "f", "fiu", "iu", "U" or "b"."""
    shape: tuple[int | str, ...] | None = ()
    """Letters stand for the same number in every array; None for any shape."""
    unit: str | None = None
    """Unit in SI, "" of a plain number; None where it needs none."""


def marks_of(path: str | os.PathLike[str]) -> list[str]:
    """Names of the arrays that mark an archive as one of this package; none of a file that cannot be read as one."""
    with suppress(OSError, ValueError, NotImplementedError, zipfile.BadZipFile), open_regular(path) as file:
        return [name.removesuffix(".npy") for name in zipfile.ZipFile(file).namelist() if name.startswith(_MARK)]
    return []


@contextmanager
def readable(kind: str, path: str | os.PathLike[str]) -> Iterator[None]:
    """FileFormatError for whatever is wrong with ``kind``, "a clip", while it is read from ``path``."""
    try:
        yield
    except zipfile.BadZipFile as error:
        what = f"it is cut off, or not {kind}" if "not a zip" in str(error) else str(error)
        raise FileFormatError(f"cannot read {kind} from {os.fspath(path)}: {what}") from error
    except Exception as error:  # zip, zlib, OS, JSON, key, type and value errors all mean the same to the user
        raise FileFormatError(f"cannot read {kind} from {os.fspath(path)}: {shortened(str(error))}") from error


def check_arrays(
    fields: Mapping[str, Field], data: Mapping[str, NDArray[Any]], most: float = LARGEST_FLOAT, **sizes: int
) -> dict[str, int]:
    """Sizes that letters of shapes stand for, ``sizes`` of them known already.

    ValueError where an array is not as its field says, or holds a number above ``most`` in size; KeyError where one is
    missing.
    """
    for name, (kinds, shape, _) in fields.items():
        array = data[name]
        wanted = array.shape if shape is None else shape
        for size, length in zip(wanted, array.shape, strict=False):
            if isinstance(size, str):
                sizes.setdefault(size, length)
        expected = tuple(sizes.get(size, 0) if isinstance(size, str) else size for size in wanted)
        sound = array.dtype.kind in kinds and array.shape == expected
        if sound and array.dtype.kind == "f":
            low, high = float(array.min(initial=0.0)), float(array.max(initial=0.0))  # NaN where there is one
            sound = array.dtype.itemsize <= 8 and -most <= low and high <= most
        if not sound:
            raise ValueError(f"{name} must be {_KINDS[kinds]} {expected} (got {array.dtype} {array.shape})")
    return sizes


@final
@dataclass(frozen=True)
class Archive:
    """A kind of archive."""

    kind: str
    """Its name for messages: "a clip"."""
    mark: str
    """Name of the array that holds the version, and tells the kind."""
    fields: Mapping[str, Field] = field(default_factory=dict)
    """Its arrays by name."""
    most: float = LARGEST_FLOAT
    """Largest number that they may hold."""
    version: int = 1
    """Version that is written and read."""

    def arrays(
        self, values: Mapping[str, ArrayLike], units: UnitSystem = SI, further: Mapping[str, Field] | None = None
    ) -> dict[str, NDArray[Any]]:
        """What to write: the values of all fields, and of ``further`` ones, with the mark and the units."""
        known = {**self.fields, **(further or {})}
        named = {name: known[name].unit for name in values}
        whole = {self.mark: np.array(self.version)} | {name: np.asarray(value) for name, value in values.items()}
        labels = units.array({name: unit for name, unit in named.items() if unit is not None})
        return whole | dict(zip(UNITS, (labels, np.array(astuple(units))), strict=True))

    @contextmanager
    def read(self, path: str | os.PathLike[str]) -> Iterator[dict[str, NDArray[Any]]]:
        """The arrays of a file, checked; what is found wrong with them meanwhile is a FileFormatError as well."""
        file = checked_folder("path", path)
        with readable(self.kind, file):
            data = read_npz(file)
            self.check(data)
            yield data

    def check_mark(self, names: Collection[str]) -> None:
        """ValueError that says what a file is whose arrays have these ``names``, if not of this kind."""
        if self.mark in names:
            return
        for name in names:
            if name.startswith(_MARK):
                raise ValueError(f"it is a {name.removeprefix(_MARK)} that modalshell saved, not {self.kind}")
        listed = ", ".join(name for name in names if name not in (*UNITS, "sha256")) or "none"
        raise ValueError(f"it is not {self.kind} but other arrays, for numpy.load to read: {listed}")

    def check(
        self, data: Mapping[str, NDArray[Any]], further: Mapping[str, Field] | None = None, **sizes: int
    ) -> UnitSystem:
        """The units of the arrays; ValueError for another version or kind, and as by :func:`check_arrays`."""
        self.check_mark(data)
        if (version := int(data[self.mark])) != self.version:
            remedy = "make it again with this version" if version < self.version else "read it with a newer version"
            raise ValueError(f"format {version} (this version reads {self.version}): {remedy}")
        fields = {**self.fields, **(further or {})}
        check_arrays(fields, data, self.most, **sizes)
        units = UnitSystem.from_array(data[UNITS[1]])
        labels = json.loads(str(data[UNITS[0]]))
        named = units.labels({name: unit for name, (_, _, unit) in fields.items() if unit is not None})
        if {name: labels.get(name) for name in named} != named:
            raise ValueError(f"units are not those of {units.length}, {units.mass}, {units.time}")
        return units
