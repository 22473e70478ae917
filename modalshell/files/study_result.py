"""Study results, saved as JSON and NPZ with a record of the run that made them."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.files.archive import readable
from modalshell.files.atomic_io import checked_record, digest, read_npz, write_npz, write_record
from modalshell.files.outputs import refuse_foreign

_ARRAYS = "arrays"
"""Key of the arrays' digest in the JSON file."""


@dataclass(frozen=True)
class StudyResult:
    """Result of a study."""

    name: str
    findings: dict[str, Any]
    """Tables and numbers, ready for JSON."""
    arrays: dict[str, NDArray[Any]] = field(repr=False)
    """Positions, faces and other arrays that figures draw."""
    record: dict[str, Any] = field(repr=False)
    """See :func:`modalshell.files.provenance.run_record`."""

    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write ``NAME.json`` and ``NAME.npz`` into ``folder``; return the paths. OptionError for files of others."""
        content = {"study": self.name, "record": self.record, "findings": self.findings}
        # As they read back: tuples as lists, NumPy's numbers as Python's.
        content = json.loads(json.dumps(content, default=_plain, allow_nan=False))
        arrays = {name: np.asarray(array) for name, array in self.arrays.items()}
        stem = Path(folder) / self.name
        refuse_foreign(stem.with_suffix(".npz"), stem.with_suffix(".json"))
        document = content | {_ARRAYS: digest(arrays)}
        return [write_npz(stem.with_suffix(".npz"), **arrays), write_record(stem.with_suffix(".json"), document)]

    @classmethod
    def load(cls, folder: str | os.PathLike[str], name: str) -> StudyResult:
        """Read a saved result; FileFormatError if it is missing, damaged, or JSON and NPZ are not of one run."""
        stem = Path(folder) / name
        with readable(f"a result of study {name!r}", Path(folder)):
            document = checked_record(stem.with_suffix(".json"))
            arrays = read_npz(stem.with_suffix(".npz"))
            if set(document) != {"study", "record", "findings", _ARRAYS}:
                raise ValueError(f"its JSON has the keys {', '.join(document)}")
            if document[_ARRAYS] != digest(arrays):
                raise ValueError("its JSON and NPZ are not those that were written together: the digest differs")
            return cls(name, document["findings"], arrays, document["record"])


def _plain(value: Any) -> Any:
    """Convert NumPy numbers and arrays to JSON types."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"no JSON form for {type(value).__name__}")
