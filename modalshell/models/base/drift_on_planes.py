"""Parts of a shell that smooth planes let drift along them: they rest there with as little held as can be."""

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
        held = shell.also_supported([one for part, _ in parts for one in part.supports(shell, turning=False)])
        own = replace(problem, shell=held, factoriser=Factoriser(problem.factoriser.backend))
        rest = solve(own, Touching(touching.contacts, held, origin))
        tried += rest.iterations
        forces, point = touching.forces(rest.point, rest.pushes), rest.point.copy()
        least = BORNE * float(np.linalg.norm(load))
        if all(np.abs(forces[one.vertices] @ one.directions).sum() <= least for one, _ in parts):
            for part, _ in parts:
                part.put_back(shell, point, start)
            return replace(rest, point=point, iterations=tried), ""
    return None


def _pushed_along(load: Array, parts: Sequence[tuple[DriftingPart, Array]]) -> tuple[float, bool] | None:
    """Share of a load (n, 3) [N] along the planes, and whether it pushes towards others; None where it does not."""
    for part, others in parts:
        forces = load[part.vertices]
        pushed = part.directions @ (part.directions.T @ forces.sum(axis=0))
        share = float(np.linalg.norm(pushed) / (np.linalg.norm(forces, axis=1).sum() or 1.0))
        if share > RIGID_LOAD:
            return share, bool((others @ pushed < 0.0).any())
    return None
