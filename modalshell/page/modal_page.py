"""One HTML file that steps LMA and MWTS in a browser: modes and rotations as half floats, the warp in a shader."""

from __future__ import annotations

import base64
import html
import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.atomic_io import write_text
from modalshell.checks import checked_number, checked_vectors
from modalshell.errors import LoadError, OptionError
from modalshell.mesh import TriangleMesh
from modalshell.render import ShadedSurface, View, draw_views
from modalshell.typing import Array, Index

_MOST_MODES = 100
"""WebGL2 promises 256 uniform vectors; modes and rotations take one each."""
_SHOWN_SHARE = 0.2
"""Largest displacement of a mode shown by itself, as a share of the shell's size."""
_PULL = 20.0
"""Force of the pointer at a distance of the shell's size, in weights of the shell on Earth."""


@final
@dataclass(frozen=True)
class Page:
    """A self-contained HTML page; a notebook shows it live.

    Attributes
    ----------
    text : str
        The HTML.
    """

    text: str = field(repr=False)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page to an ``.html`` file."""
        return write_text(path, self.text)

    def _repr_html_(self) -> str:
        return (
            f'<iframe srcdoc="{html.escape(self.text)}" style="width: 100%; height: 480px; border: 1px solid #ddd">'
            "</iframe>"
        )


def modal_page(
    mesh: TriangleMesh,
    *,
    eigenvalues: Array,
    modes: Array,
    rotations: Array,
    mass: Array,
    held: Index,
    title: str,
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    force: ArrayLike | None = None,
    damping: tuple[float, float] = (0.5, 0.001),
    dt: float = 1.0 / 60.0,
) -> Page:
    """The page of a modal basis.

    The page integrates ``q'' + (xi + zeta Lambda) q' + Lambda q = p(q)`` by implicit Euler with the force of the
    step's beginning, p = Phi^T f for LMA and Phi^T R(Psi q)^T f for MWTS [choi2007, eq. 16-20]. Its modes and rotations
    are half floats: coordinates agree with the models of this package to about 1e-3.

    Parameters
    ----------
    mesh : TriangleMesh
        Rest shape.
    eigenvalues : ndarray, shape (m,)
        Squared angular frequencies [1/s^2].
    modes, rotations : ndarray, shape (3n, m)
        Phi and Psi.
    mass : ndarray, shape (n,)
        Of the vertices [kg].
    held : ndarray of int
        Vertices that the supports hold.
    title : str
        Headline of the page.
    gravity : sequence of 3 floats
        Acceleration [m/s^2] at which the page starts.
    force : array_like, shape (n, 3), optional
        Further dead forces on the vertices [N].
    damping : tuple of float
        Rayleigh factors of mass [1/s] and stiffness [s].
    dt : float
        Time step [s].

    Raises
    ------
    OptionError
        If there are more modes than a browser's shader takes, or an option is out of range.
    LoadError
        If ``force`` is not (n, 3) finite numbers.
    """
    count = len(eigenvalues)
    if count > _MOST_MODES:
        raise OptionError(f"a page takes at most {_MOST_MODES} modes (got {count}): solve for fewer")
    pull = checked_vectors("gravity", gravity, (3,), OptionError)
    factors = checked_vectors("damping", damping, (2,), OptionError)
    dt = checked_number("dt", dt, above=0.0)
    loads = None if force is None else checked_vectors("force", force, mesh.vertices.shape, LoadError)
    centre = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    rest = mesh.vertices - centre  # before it is rounded to single precision
    far = np.linalg.norm(rest - (rest[held].mean(axis=0) if len(held) else rest.mean(axis=0)), axis=1)
    half_modes, mode_scales = _halves(modes)
    half_rotations, rotation_scales = _halves(rotations)
    data: dict[str, Any] = {
        "vertices": len(rest),
        "modes": count,
        "rest": _text(rest.astype(np.float32)),
        "faces": _text(mesh.faces.astype(np.uint32)),
        "phi": _text(half_modes),
        "psi": _text(half_rotations),
        "phiScales": mode_scales.tolist(),
        "psiScales": rotation_scales.tolist(),
        "mass": _text(mass.astype(np.float32)),
        "force": None if loads is None else _text(loads.astype(np.float32)),
        "eigenvalues": np.asarray(eigenvalues).tolist(),
        "frequencies": (np.sqrt(eigenvalues) / (2.0 * np.pi)).tolist(),
        "amplitudes": (_SHOWN_SHARE * mesh.size / np.abs(modes).max(axis=0)).tolist(),
        "gravity": pull.tolist(),
        "damping": factors.tolist(),
        "dt": dt,
        "held": np.asarray(held).tolist(),
        "tip": int(far.argmax()),
        "size": float(mesh.size),
        "centre": centre.tolist(),
        "pull": _PULL * 9.81 * float(mass.sum()) / float(mesh.size),
    }
    template = Template(files("modalshell.page").joinpath("modal.html").read_text(encoding="utf-8"))
    return Page(template.safe_substitute(title=html.escape(title), data=json.dumps(data), picture=_picture(mesh)))


def _halves(matrix: Array) -> tuple[Array, Array]:
    """Columns scaled to 1 at most as half floats (3n, m), and their scales (m,)."""
    scales = np.abs(matrix).max(axis=0)
    scales[scales == 0.0] = 1.0
    return (matrix / scales).astype(np.float16), scales


def _text(array: Array) -> str:
    """The little-endian bytes of an array in base 64."""
    return base64.b64encode(np.ascontiguousarray(array, array.dtype.newbyteorder("<")).tobytes()).decode("ascii")


def _picture(mesh: TriangleMesh) -> str:
    """The rest shape as a PNG in base 64, for browsers that cannot draw it."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = draw_views(
            [View([ShadedSurface(mesh.vertices, mesh.faces)])], Path(folder, "rest.png"), size=(640, 400)
        )
        return base64.b64encode(drawn.read_bytes()).decode("ascii")
