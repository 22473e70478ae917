"""Defaults for a mesh without further information: supports, stiffness and time step.

The stiffness is chosen such that the weight bends the shell by a fixed fraction of its size, or is far from buckling
it; so a film of any mesh, in any unit, shows motion within the range of modal models.
"""

from __future__ import annotations

import warnings
from contextlib import suppress
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

import modalshell as ms
from modalshell.core.errors import REPAIR
from modalshell.core.typing import Array
from modalshell.core.units import in_percent

YOUNG, _THIN = 1e9, 200.0
"""Young's modulus [Pa], and size over thickness, if none is given or chosen."""
SAG = 0.15
"""Deflection under the weight as a fraction of the mesh's size, in linear theory, at most."""
BUCKLES = 5.0
"""Times its weight that a shell carries before it buckles, in linear theory, at least: it swings to twice the sag."""
_END, _LARGEST_END = 0.05, 0.5
"""Clamped fraction of a part's length, and the largest fraction tried until a triangle is clamped."""
_MOST_PARTS, _MOST_HELD = 20, 0.3
"""Parts, and fraction of the vertices, up to which ends are held without being asked for."""
_COARSE = 100
"""Vertices of a mesh up to which one clamped triangle may be a large fraction of it."""
_STEPS, _PERIODS = 24, 2.5
"""Steps per period, and periods of the motion."""
_NOTHING = 1e-9
"""Modes below this fraction of the highest eigenvalue are resisted by rounding errors only."""
UNSEEN, LARGE = 2e-3, 1.0
"""Largest displacement over size below which motion is invisible, and above which the shell is too soft."""
_UNMOVED = 1e-12
"""Largest displacement over size below which nothing moves but by rounding."""


def hold_one_end(mesh: ms.TriangleMesh, gravity: Array) -> tuple[NDArray[np.bool_], str]:
    """The end of each part that lies lowest along the longest axis across ``gravity`` (3,): a mask and a description.

    At least one triangle of each part is clamped, and if possible not all vertices of a part. SupportError if nothing
    is left to bend, or if more parts or a larger share of the vertices would be held than is likely of a mesh that was
    not cut into pieces as it was written.
    """
    axis = _axis_across(mesh, gravity)
    along = mesh.vertices[:, axis]
    labels = mesh.components
    parts = int(labels.max()) + 1
    faces_of = np.argsort(labels[mesh.faces[:, 0]], kind="stable")
    starts = np.searchsorted(labels[mesh.faces[faces_of, 0]], np.arange(parts + 1))
    held = np.zeros(len(mesh.vertices), dtype=np.bool_)
    for part in range(parts):
        faces = mesh.faces[faces_of[starts[part] : starts[part + 1]]]
        held[_end_of_part(along, faces)] = True
    if held.all():
        raise ms.SupportError(
            f"the mesh is {parts} single triangles without shared vertices: nothing can bend; merge coincident "
            "vertices by --repair, near ones by --join DISTANCE"
        )
    fraction = float(held.mean())
    if parts > _MOST_PARTS or (fraction > _MOST_HELD and len(held) > _COARSE):
        one = parts == 1
        joined = "" if one else "join parts that touch by --join DISTANCE, repair the mesh by --repair, or "
        raise ms.SupportError(
            f"one end of {'the mesh' if one else 'each part'} would be held: {'' if one else f'{parts} parts, '}"
            f"{100.0 * fraction:.0f} % of the vertices (at most {'' if one else f'{_MOST_PARTS} parts and '}"
            f"{100.0 * _MOST_HELD:.0f} % are held without being asked for); {joined}name the vertices to hold by "
            "--clamp"
        )
    name = "xyz"[axis]
    if parts == 1 and not (end := _written_end(along, held)):
        return held, f"holds the triangle of lowest {name} ({held.sum()} vertices)"
    if parts == 1:
        return held, f'holds the end "{name} <= {end}" ({held.sum()} vertices)'
    return held, f"holds the end of lowest {name} of each of {parts} parts ({held.sum()} vertices)"


def _written_end(along: Array, held: NDArray[np.bool_]) -> str:
    """The shortest bound of ``along`` (n,) by which --clamp holds the same vertices; "" if there is none."""
    last = float(along[held].max())
    inside = last + 0.01 * (float(along[~held].min()) - last)  # where the last itself is not a short number
    tries = (f"{value:.{digits}g}" for digits in range(6, 18) for value in (last, inside))
    return next((text for text in tries if np.array_equal(along <= float(text), held)), "")


def assumed(size: float, young: object, thickness: object) -> tuple[dict[str, float], str]:
    """What stands for Young's modulus [Pa] and the thickness [m] of a mesh of ``size`` [m] where they are None.

    Also as a text, empty where nothing is assumed.
    """
    known = {"young": (young, YOUNG, "Pa"), "thickness": (thickness, size / _THIN, "m")}
    missing = {name: (value, unit) for name, (given, value, unit) in known.items() if given is None}
    texts = ", ".join(f"--{name} {value:.4g} {unit}" for name, (value, unit) in missing.items())
    return {name: value for name, (value, _) in missing.items()}, texts and f"not given, and assumed: {texts}"


def _axis_across(mesh: ms.TriangleMesh, gravity: Array) -> int:
    """The axis along which the mesh is longest, of those that do not run along gravity."""
    extents = np.ptp(mesh.vertices, axis=0)
    strength = float(np.linalg.norm(gravity))
    if strength > 0.0:
        extents = np.where(np.abs(gravity) / strength > 0.8, -1.0, extents)
    return int(extents.argmax())


def _end_of_part(along: Array, faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Vertices of the part ``faces`` near its lower end, at least one whole triangle."""
    heights = along[faces]
    low, length = float(heights.min()), float(np.ptp(heights))
    highest = heights.max(axis=1)
    fraction = _END
    while fraction < _LARGEST_END and not (highest <= low + fraction * length).any():
        fraction *= 1.25
    bound = max(low + fraction * length, float(highest.min()))
    vertices = np.unique(faces)
    end = vertices[along[vertices] <= bound]
    return end if len(end) < len(vertices) else np.unique(faces[int(heights.mean(axis=1).argmin())])


def softening(basis: ms.Basis, gravity: Array) -> tuple[float, float]:
    """Factor on all stiffnesses, and the sag under the weight that it leaves, as a fraction of the size.

    In linear theory the weight sags the shell by SAG, or by less where BUCKLES times it would buckle it otherwise; with
    no weight these are 1 and SAG. SupportError if the supports leave motions without resistance.
    """
    load = basis.shell.gravity_force(gravity).ravel()
    values = np.maximum(basis.eigenvalues, 1e-300)
    sag = basis.modes @ ((load @ basis.modes) / values)
    largest = float(np.linalg.norm(sag.reshape(-1, 3), axis=1).max()) / basis.shell.mesh.size
    unresisted = int((values < _NOTHING * values[-1]).sum())
    if unresisted or largest * _NOTHING > 1.0 / _NOTHING:
        raise ms.SupportError(
            f"nothing resists {unresisted or 'the'} lowest modes of the mesh although each part is held: sheets hang "
            f"together by single vertices; split them by {REPAIR}"
        )
    if largest == 0.0:
        return 1.0, SAG
    share = SAG
    # Without a factor the sag alone decides, and error bars tell of what buckles; a coarse shape serves to choose by.
    with suppress(ms.SolverError), warnings.catch_warnings(action="ignore", category=ms.ModalShellWarning):
        factors = ms.buckling_factors(basis.shell, gravity=gravity).factors
        share = min(SAG, largest * float(factors.min(initial=np.inf)) / BUCKLES)
    return float(f"{largest / share:.2g}"), share


@final
@dataclass(frozen=True)
class Timing:
    """Duration, time step and damping of a motion."""

    duration: float
    dt: float
    """Of the motion and of a step [s]."""
    damping: tuple[float, float]
    """Rayleigh factors of mass [1/s] and stiffness [s]."""

    @classmethod
    def of_sag(cls, size: float, gravity: Array, sag: float) -> Timing:
        """Timing for a shell of ``size`` [m] whose weight bends it by ``sag`` times the size."""
        strength = float(np.linalg.norm(gravity))
        period = 2.0 * np.pi * np.sqrt(sag * size / strength) if strength > 0.0 else 1.0
        period = float(f"{period:.2g}")
        return cls(_PERIODS * period, period / _STEPS, (0.4 / period, 8e-4 * period))


def motion_as_text(run: ms.Trajectory, size: float) -> str:
    """One line on how far a shell of ``size`` [m] moved: too stiff, too soft, diverged, or fine."""
    moved = np.linalg.norm(run.positions - run.rest_positions, axis=2).max() / size
    reach = f"moves by up to {in_percent(moved)} of its size"
    if run.outcome in (ms.Outcome.DIVERGED, ms.Outcome.RUNS_AWAY):
        return f"flies apart ({reach}): take a smaller --dt or more --damping"
    if run.outcome in (ms.Outcome.DISTORTED, ms.Outcome.WOUND_UP) or moved > LARGE:
        return f"too soft ({reach}): raise --young or --thickness, or lower --gravity"
    if moved < _UNMOVED:
        return "does not move, as without a load: give another --gravity, or lower --young"
    if moved < UNSEEN:
        return f"too stiff to see ({reach}): lower --young, about {max(UNSEEN / moved, 2.0):.1g} times or more"
    return reach
