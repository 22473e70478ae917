"""Self-contained HTML from a template and arrays in base 64, with a picture as a fallback."""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.files.atomic_io import write_text
from modalshell.render import Picture, ShadedSurface, View

MOST_SHAPES = 100
"""WebGL2 promises 256 uniform vectors; a mode and its rotations take one each."""


@final
@dataclass(frozen=True)
class Page:
    """A self-contained HTML page; a notebook shows it live."""

    text: str = field(repr=False)
    """The HTML."""

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page to an ``.html`` file."""
        return write_text(path, self.text)

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{html.escape(self.text)}" style="width: 100%; height: 480px; border: 1px solid #ddd">'
            "</iframe>"
        )


def filled_page(
    kind: str,
    title: str,
    data: Mapping[str, Any],
    vertices: Array,
    faces: NDArray[Any],
    folder: str = __package__,
    *,
    notes: Sequence[str] = (),
    words: Mapping[str, str] | None = None,
) -> Page:
    """A page with the controls and the script of its ``kind``, and a picture for browsers without WebGL2.

    ``KIND.html``, ``KIND_*.js`` and ``KIND.js`` are in the ``folder`` of that package; what all pages share is here.
    The ``notes`` stand below the title; ``words`` fill the places of the controls that depend on the page. Further
    scripts of the folder are those that the data names as its ``scripts``.
    """
    checked_kind("title", title, str)
    picture = Picture.of_views([View([ShadedSurface(vertices, np.asarray(faces))])], size=(640, 400)).base64
    own, common = files(folder), files(__package__)
    controls = Template((own / f"{kind}.html").read_text(encoding="utf-8")).substitute(words or {})
    parts_of_kind = [one for one in own.iterdir() if one.name.startswith(f"{kind}_") and one.name.endswith(".js")]
    further = [own / name for name in data.get("scripts", ())]
    ordered = [common / "common.js", common / "view.js", *sorted(parts_of_kind, key=str), *further, own / f"{kind}.js"]
    script = "\n".join(path.read_text(encoding="utf-8") for path in ordered)
    said = "\n".join(f'  <p class="notes">{html.escape(note)}</p>' for note in notes)
    parts = {"controls": controls, "script": script, "picture": picture, "notes": said}
    template = Template(common.joinpath("page.html").read_text(encoding="utf-8"))
    return Page(template.substitute(parts, title=html.escape(title), data=json.dumps(data)))


def modal_data(
    vertices: Array, faces: NDArray[np.integer], modes: Array, rotations: Array | None = None
) -> dict[str, Any]:
    """The rest shape, and modes (3n, m) with their rotations in half floats, by the names that the scripts read.

    OptionError if there are more modes than a browser's shader takes.
    """
    count = modes.shape[1]
    if count > MOST_SHAPES:
        raise OptionError(f"a page takes at most {MOST_SHAPES} shapes (got {count}): take fewer modes")
    data: dict[str, Any] = {
        "vertices": len(vertices),
        "modes": count,
        "rest": encoded(vertices.astype(np.float32)),
        "faces": encoded(faces.astype(np.uint32)),
    }
    for name, matrix in (("phi", modes), ("psi", rotations)):
        if matrix is not None:
            data[name] = encoded_columns(matrix)
    return data


def encoded(array: NDArray[Any]) -> str:
    """The little-endian bytes of an array in base 64."""
    return base64.b64encode(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()).decode("ascii")


def encoded_columns(matrix: Array) -> dict[str, Any]:
    """Columns of a matrix scaled to 1 at most as half floats, and their scales."""
    scales = np.abs(matrix).max(axis=0, initial=0.0)
    scales[scales == 0.0] = 1.0
    return {"halves": encoded((matrix / scales).astype(np.float16)), "scales": scales.tolist()}
