"""Parts of a shell that smooth planes or flat faces let drift along them: they rest with as little held as can be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from modalshell.contact.active_set import Rest
from modalshell.contact.contact import Contact
from modalshell.contact.plane import Plane
from modalshell.contact.touching import Touching
from modalshell.core.typing import Array
from modalshell.models.base.free_statics import DriftingPart, parallel
from modalshell.models.base.model import RIGID_LOAD
from modalshell.modes import Factoriser
from modalshell.modes.rigid import free_translations
from modalshell.shell import Shell
from modalshell.statics.potential import Potential

_ALONG = 1e-9
"""Singular value of unit normals on directions, or share of a load along one, that counts as none."""
BORNE = 1e-6
"""Force, as a share of the load, that a support which should bear none may bear."""

PUSHED = "the load pushes the shell along smooth planes"
"""How what is said of such a load begins."""


def _parts_on_planes(
    shell: Shell, load: Array, contacts: Sequence[Contact], *, every: bool
) -> list[tuple[DriftingPart, Array]]:
    """The parts that translate along the planes that a load (n, 3) [N] presses them onto, and normals of the others.

    Or along ``every`` plane that they may touch. A turn about the load changes nothing where the planes lie across it.
    Parts that may touch anything else have none.
    """
    found, masks = [], [contact.vertices(shell.mesh) for contact in contacts]
    for vertices, directions, motions in free_translations(shell):
        own = [contact for contact, mask in zip(contacts, masks, strict=True) if mask[vertices].any()]
        if not own or not directions.shape[1] or not all(isinstance(one.collider, Plane) for one in own):
            continue
        normals, force = np.concatenate([one.gap(np.zeros((1, 3)))[1] for one in own]), load[vertices].sum(axis=0)
        bears = every | (normals @ force < -_ALONG * np.linalg.norm(force))
        _, sizes, right = np.linalg.svd(normals[bears] @ directions)
        along = directions @ right[np.count_nonzero(sizes > _ALONG) :].T
        if along.shape[1]:
            forces = np.concatenate([load[vertices], np.linalg.norm(load) * normals[bears]])
            axis = parallel(forces) if motions == 6 else None
            found.append((DriftingPart(vertices, along, axis, False), normals[~bears]))
    return found


def rest_on_planes(
    problem: Potential, touching: Touching, origin: Array, start: Array, solve: Callable[[Potential, Touching], Rest]
) -> tuple[Rest, str] | None:
    """Where such parts come to rest from ``start`` (n, 3) [m], and what to say of a load that pushes them along.

    Both are about the shell's ``origin`` (3,) [m]. ``solve`` finds it with further supports, which bear nothing. None
    where no part drifts.
    """
    shell, load, tried = problem.shell, problem.load, 0
    for every in (False, True):  # of planes that the load does not press on, as walls, others may be pressed on yet
        parts = _parts_on_planes(shell, load, touching.contacts, every=every)
        if problem.live is not None or not parts:
            return None
        if pushed := _pushed_along(load, parts):
            share, fall = pushed
            if fall:
                continue
            none = np.zeros(touching.vertices.size)
            words = f"{PUSHED}, or off them, by {share:.2g} of itself: hold it, or give them friction"
            return Rest(start, none.astype(bool), none, share, tried, False), words
        rest, bears = _held(problem, touching, origin, start, [part for part, _ in parts], solve)
        tried += rest.iterations
        if not bears:
            return replace(rest, iterations=tried), ""
    return None


def rest_on_faces(
    problem: Potential,
    touching: Touching,
    origin: Array,
    start: Array,
    ended: Rest,
    solve: Callable[[Potential, Touching], Rest],
) -> Rest:
    """Where a solve ``ended``, or where parts rest that may drift along all flat faces that they touch there.

    So a table is one, as a plane is: the end is a minimum, but no strict one. See :func:`rest_on_planes`.
    """
    parts, rows, load = [], np.flatnonzero(ended.active), problem.load
    _, normals, curvatures = touching.gaps(ended.point, rows)
    for vertices, directions, motions in free_translations(problem.shell):
        own = np.isin(touching.vertices[rows], vertices)
        bent = float(np.abs(curvatures[own]).max(initial=0.0)) * touching.size
        if not own.any() or not directions.shape[1] or bent > _ALONG:
            continue
        _, sizes, right = np.linalg.svd(normals[own] @ directions)
        along = directions @ right[np.count_nonzero(sizes > _ALONG) :].T
        forces = np.concatenate([load[vertices], np.linalg.norm(load) * normals[own]])
        if along.shape[1]:
            parts.append(DriftingPart(vertices, along, parallel(forces) if motions == 6 else None, False))
    if problem.live is not None or not parts:
        return ended
    rest, bears = _held(problem, touching, origin, start, parts, solve)
    return replace(ended if bears or not rest.stable else rest, iterations=ended.iterations + rest.iterations)


def _held(
    problem: Potential,
    touching: Touching,
    origin: Array,
    start: Array,
    parts: Sequence[DriftingPart],
    solve: Callable[[Potential, Touching], Rest],
) -> tuple[Rest, bool]:
    """Where parts rest that are held along the ways on which they drift, put back there, and whether that bears."""
    shell = problem.shell
    held = shell.also_supported([one for part in parts for one in part.supports(shell, turning=False)])
    own = replace(problem, shell=held, factoriser=Factoriser(problem.factoriser.backend))
    rest = solve(own, Touching(touching.contacts, held, origin))
    forces, point = touching.forces(rest.point, rest.pushes), rest.point.copy()
    least = BORNE * float(np.linalg.norm(problem.load))
    if any(np.abs(forces[one.vertices] @ one.directions).sum() > least for one in parts):
        return rest, True
    for part in parts:
        part.put_back(shell, point, start)
    return replace(rest, point=point), False


def _pushed_along(load: Array, parts: Sequence[tuple[DriftingPart, Array]]) -> tuple[float, bool] | None:
    """Share of a load (n, 3) [N] along the planes, and whether it pushes towards others; None where it does not."""
    for part, others in parts:
        forces = load[part.vertices]
        pushed = part.directions @ (part.directions.T @ forces.sum(axis=0))
        share = float(np.linalg.norm(pushed) / (np.linalg.norm(forces, axis=1).sum() or 1.0))
        if share > RIGID_LOAD:
            return share, bool((others @ pushed < 0.0).any())
    return None
