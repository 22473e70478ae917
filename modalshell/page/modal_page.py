"""Web page of a modal basis: steps LMA and MWTS, from modes and rotations in half precision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_number, checked_vectors
from modalshell.core.errors import LoadError, OptionError
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.integrators.modal.exponential import VIOLENT
from modalshell.models.base.free_frames import FreeFrames
from modalshell.models.base.stepper import LEAD
from modalshell.modes import Basis
from modalshell.page.html import MOST_SHAPES, Page, encoded, encoded_columns
from modalshell.page.shell_page import shell_page

_SHOWN_SHARE = 0.2
"""Largest displacement of a mode shown by itself, as a share of the shell's size."""
_STEP, _DAMPING = 1.0 / 60.0, (0.5, 0.001)
"""Step [s] and damping, of mass [1/s] and stiffness [s], unless others are given."""
_PULL = 20.0
"""Force of the pointer at a distance of the shell's size, in weights of the shell on Earth."""


def modal_page(
    basis: Basis,
    *,
    title: str = "modalshell",
    gravity: Sequence[float] = (0.0, 0.0, -9.81),
    force: ArrayLike | None = None,
    damping: tuple[float, float] = _DAMPING,
    dt: float = _STEP,
    reduced: tuple[Array, Array, Array] | None = None,
) -> Page:
    """A self-contained web page on which a shell moves by LMA and MWTS; notebooks show it live.

    It integrates ``q'' + (xi + zeta Lambda) q' + Lambda q = p(q)`` by the models' own rule,
    :class:`modalshell.integrators.modal.Exponential`, with p = Phi^T f for LMA and Phi^T R(Psi q)^T f for MWTS
    [choi2007, eq. 16-20]. Its modes and rotations are half floats: coordinates agree with the models of this package to
    about 1e-3. Parts without supports fly in frames of their own, as the models' do.

    Parameters
    ----------
    basis : Basis
        Modes and rotations of the shell.
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
    reduced : (ndarray, ndarray, ndarray), optional
        RSW in reduced form, which the page then offers as a third model: shapes (3n, r), amounts (6 T, r) and turns
        (6 T, m) of :class:`modalshell.models.reduced_rotation_strain.ReducedWarp`.

    Raises
    ------
    OptionError
        If there are more modes than a browser's shader takes, or an option is out of range.
    LoadError
        If ``force`` is not (n, 3) finite numbers.
    """
    live = live_model(basis, force=force, damping=damping, dt=dt, reduced=reduced)
    pull = checked_vectors("gravity", gravity, (3,), OptionError).tolist()
    mesh = basis.shell.mesh
    return shell_page(mesh.vertices, mesh.faces, title=title, tip=live_tip(basis), live=live, gravity=pull)


def _frames(frames: FreeFrames, vertices: int) -> dict[str, Any]:
    """The frames of free parts as the page reads them."""
    own = np.arange(vertices, dtype=np.uint32)
    return {
        "count": frames.count,
        "parts": [encoded(own[part.vertices]) for part in frames.parts],
        "to": frames.to_poses.tolist(),
        "from": frames.from_poses.tolist(),
        "others": frames.others.tolist(),
        "lead": LEAD,
    }


def live_tip(basis: Basis) -> int:
    """The vertex farthest from what is held, or from the middle where nothing is."""
    rest, held = basis.shell.mesh.vertices, basis.shell.clamped
    return int(np.linalg.norm(rest - (rest[held] if held.any() else rest).mean(axis=0), axis=1).argmax())


def live_model(
    basis: Basis,
    *,
    force: ArrayLike | None = None,
    damping: tuple[float, float] | None = None,
    dt: float | None = None,
    reduced: tuple[Array, Array, Array] | None = None,
    units: UnitSystem = SI,
) -> dict[str, Any]:
    """What a page needs to step a basis, of numbers in ``units``, live; for the rest see :func:`modal_page`."""
    own = np.array(_DAMPING) * (units.seconds, 1.0 / units.seconds)
    factors = checked_vectors("damping", own if damping is None else damping, (2,), OptionError)
    dt = checked_number("dt", _STEP / units.seconds if dt is None else dt, above=0.0)
    if basis.count > MOST_SHAPES:
        raise OptionError(f"a page takes at most {MOST_SHAPES} shapes (got {basis.count}): take fewer modes")
    shell, eigenvalues = basis.shell, basis.eigenvalues
    mesh = shell.mesh
    loads = None if force is None else checked_vectors("force", force, mesh.vertices.shape, LoadError)
    data: dict[str, Any] = {
        "phi": encoded_columns(basis.modes),
        "psi": encoded_columns(basis.rotations),
        "mass": encoded(shell.mass.astype(np.float32)),
        "force": None if loads is None else encoded(loads.astype(np.float32)),
        "eigenvalues": eigenvalues.tolist(),
        "frequencies": (np.sqrt(eigenvalues) / (2.0 * np.pi)).tolist(),
        "amplitudes": (_SHOWN_SHARE * mesh.size / np.abs(basis.modes).max(axis=0)).tolist(),
        "damping": factors.tolist(),
        "dt": dt,
        "violent": (VIOLENT * mesh.extent) ** 2 * float(shell.mass.sum()),
        "held": np.flatnonzero(shell.clamped).tolist(),
        "pull": _PULL * units.earth * float(shell.mass.sum()) / float(mesh.size),
    }
    if (frames := FreeFrames.of(basis.shell, basis.modes[:, : basis.rigid_modes])) is not None:
        data["frames"] = _frames(frames, len(shell.mass))
    if reduced is not None:
        data["reduced"] = dict(zip(("shapes", "amounts", "turns"), map(encoded_columns, reduced), strict=True))
    return data
