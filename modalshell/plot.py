"""Pictures, notebook views and web pages of meshes, modes, equilibria and motions.

Nothing that is drawn imports this module: it enters its functions where the methods ``plot``, ``page`` and
``_repr_html_`` of :class:`modalshell.core.drawn.Drawn` find them.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np

from modalshell.core.checks import checked_count, shown
from modalshell.core.drawn import DRAWING
from modalshell.core.errors import OptionError
from modalshell.mesh import TriangleMesh
from modalshell.models import Equilibrium
from modalshell.modes import Basis
from modalshell.motion import Trajectory
from modalshell.page import modal_page
from modalshell.render import Picture, ShadedSurface, View, html_of
from modalshell.render.bodies import bodies_at, moving_bodies
from modalshell.render.picture import SMALL

_EDGES_SHOWN = 3000
"""Triangles up to which a small picture shows their sides."""
_SHOWN_SHARE = 0.15
"""Largest displacement of a mode in a picture, as a share of the shell's size."""
_MODES, _FRAMES = 8, 4
"""Modes that a notebook shows, and frames that a picture of a motion shows."""


def plot(thing: Any, **options: Any) -> Picture:
    """Draw a mesh, the modes of a basis, an equilibrium, a motion, a tradeoff or an advice.

    A notebook shows the picture, and its ``save(path)`` writes it. Every kind has the option ``size``, width and height
    [pixels].

    Parameters
    ----------
    thing : TriangleMesh, Basis, Equilibrium, Trajectory, Tradeoff or Advice
        A mesh is drawn at rest. A basis: its mode shapes coloured by displacement, with frequencies. An equilibrium:
        the shell coloured by its displacement, over its outline at rest, with the colliders of its contacts. A
        trajectory: frames in the same way; one that is read from a file knows no colliders.
    **options
        ``edges``: whether the sides of a mesh's triangles are drawn (True). ``count``: mode shapes (all). ``frames``:
        frames of a motion from the first to the last (4).

    Raises
    ------
    OptionError
        For an object that cannot be drawn, an option that it has not, an equilibrium without its mesh, or a trajectory
        without triangles.
    """
    known = inspect.signature(_drawn.dispatch(type(thing))).parameters.values()
    names = [option.name for option in known if option.kind is option.KEYWORD_ONLY]
    if names and (others := sorted(options.keys() - set(names))):
        raise OptionError(
            f"a picture of {type(thing).__name__} has the options {', '.join(names)} (got {', '.join(others)})"
        )
    return _drawn(thing, **options)


@singledispatch
def _drawn(thing: Any, **options: Any) -> Picture:
    """The picture of an object that draws itself; others are registered below."""
    own = getattr(thing, "plot", None)
    if own is None:
        raise OptionError(
            f"plot draws a mesh, basis, equilibrium, trajectory, tradeoff or advice (got {shown(thing)}): "
            "draw a shell by shell.mesh, a model by its equilibrium() or simulate()"
        )
    picture: Picture = own(**options)
    return picture


@_drawn.register
def _mesh(mesh: TriangleMesh, *, size: tuple[int, int] = (960, 600), edges: bool = True) -> Picture:
    return Picture.of_views([View([ShadedSurface(mesh.vertices, mesh.faces, edges=edges)])], size=size)


@_drawn.register
def _basis(basis: Basis, *, count: int | None = None, size: tuple[int, int] = (1600, 900)) -> Picture:
    drawn = basis.count if count is None else checked_count("count", count, at_most=basis.count)
    return Picture.of_views([_mode(basis, k) for k in range(drawn)], size=size, scalar_label="relative displacement")


def _mode(basis: Basis, mode: int) -> View:
    """A mode shape, its largest displacement a set share of the shell's size."""
    shape = basis.modes[:, mode].reshape(-1, 3)
    length = np.linalg.norm(shape, axis=1)
    moved = basis.shell.rest_positions + shape * (_SHOWN_SHARE * basis.shell.size / length.max())
    kind = "rigid" if mode < basis.rigid_modes else f"{basis.frequencies[mode]:.4g} Hz"
    surface = ShadedSurface(moved, basis.shell.mesh.faces, scalars=length / length.max(), smooth=True)
    return View([surface], title=f"mode {mode + 1}: {kind}")


@_drawn.register
def _equilibrium(answer: Equilibrium, *, size: tuple[int, int] = (960, 600)) -> Picture:
    if answer.mesh is None:
        raise OptionError("this equilibrium came without its mesh: draw that of a model's equilibrium()")
    rest, faces = answer.mesh.vertices, answer.mesh.faces
    bodies = bodies_at(answer.positions[None], faces, np.zeros(1), answer.contacts, 0.0)
    return Picture.of_views([_displaced(answer.positions, rest, faces, "m", bodies=bodies)], size=size)


@_drawn.register
def _trajectory(run: Trajectory, *, frames: int = _FRAMES, size: tuple[int, int] = (1600, 450)) -> Picture:
    if not len(run.faces):
        raise OptionError("a picture needs the triangles: give the trajectory its faces (simulate does)")
    count = min(checked_count("frames", frames), len(run.times))
    chosen = np.linspace(0, len(run.times) - 1, count).round().astype(int)
    unit = run.units.of("m")
    views, moving = [], moving_bodies(run.positions, run.faces, run.times, run.contacts, run.times[chosen])
    for index, (frame, time) in enumerate(zip(chosen, run.times[chosen].tolist(), strict=True)):
        bodies = [replace(body, vertices=moved[min(index, len(moved) - 1)]) for body, moved in moving]
        shape = run.positions[frame], run.rest_positions, run.faces
        views.append(_displaced(*shape, unit, f"{time:.4g} {run.units.time}", bodies=bodies))
    return Picture.of_views(views, size=size)


def _displaced(
    positions: Any, rest: Any, faces: Any, unit: str, title: str = "", *, bodies: Sequence[ShadedSurface] = ()
) -> View:
    """A shape coloured by its displacement over the outline at rest, with bodies that it touches."""
    moved = np.linalg.norm(positions - rest, axis=1)
    shape = ShadedSurface(positions, faces, scalars=moved, label=f"displacement [{unit}]", smooth=True)
    return View([shape, ShadedSurface(rest, faces, color="#999999", style="outline"), *bodies], title=title)


@singledispatch
def as_html(thing: Any) -> str:
    """Numbers and a picture of an object for a notebook."""
    raise OptionError(f"a notebook shows meshes, bases, equilibria and trajectories (got {shown(thing)})")


@as_html.register
def _mesh_html(mesh: TriangleMesh) -> str:
    numbers = {
        "vertices": f"{len(mesh.vertices):,}",
        "faces": f"{len(mesh.faces):,}",
        "extents [m]": " x ".join(f"{extent:.4g}" for extent in np.ptp(mesh.vertices, axis=0)),
        "area [m²]": f"{mesh.area:.4g}",
    }
    return html_of("TriangleMesh", numbers, _mesh(mesh, size=SMALL, edges=len(mesh.faces) <= _EDGES_SHOWN))


@as_html.register
def _basis_html(basis: Basis) -> str:
    numbers = {
        "shell": repr(basis.shell),
        "modes": f"{basis.count}, {basis.rigid_modes} rigid",
        "frequencies [Hz]": ", ".join(f"{value:.4g}" for value in basis.frequencies[:_MODES]),
    }
    return html_of("Basis", numbers, _basis(basis, count=min(basis.count, _MODES), size=(960, 400)))


@as_html.register
def _equilibrium_html(answer: Equilibrium) -> str:
    numbers = {
        "outcome": answer.outcome.with_message(answer.message),
        "residual": f"{answer.residual:.2g} after {answer.iterations} iterations",
        "stable": "not known" if answer.stable is None else ("yes" if answer.stable else "no"),
        "time": f"{answer.seconds:.3g} s",
    }
    return html_of("Equilibrium", numbers, None if answer.mesh is None else _equilibrium(answer, size=SMALL))


@as_html.register
def _trajectory_html(run: Trajectory) -> str:
    numbers = {
        "outcome": run.outcome.with_message(run.message),
        "frames": f"{len(run.times)} from {run.times[0]:.4g} to {run.times[-1]:.4g} {run.units.time}",
        "vertices": f"{run.positions.shape[1]:,}",
        "steps whose solver did not converge": str(run.unconverged_steps),
        "time": f"{run.seconds:.3g} s",
    }
    return html_of("Trajectory", numbers, _trajectory(run, size=(960, 300)) if len(run.faces) else None)


DRAWING.update(plot=plot, as_html=as_html, page=modal_page)
