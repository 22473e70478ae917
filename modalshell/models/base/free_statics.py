"""Parts of a shell that supports let translate: a load in balance is borne by them with as little held as can be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.loads.loading import Loading
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.modes.rigid import free_translations, left_free, six_motions
from modalshell.shell import Shell
from modalshell.supports import Pin, Support, Symmetry
from modalshell.supports.constraints import HeldPatch

_PARALLEL = 1e-9
"""Share of a part's forces across their direction up to which they are parallel, and a turn about it does nothing."""
_NEUTRAL = 1e-9
"""Sum of forces times places at rest, over their sizes, up to which no turn of a part does work to second order."""
_SHAPE = 0.1
"""Size of random moves over the shell's at which a load is tried."""
_ASIDE = 0.25
"""Way aside of the vertex that leads a free shell, in its distance from the farthest one, up to which that is held."""


@final
@dataclass(frozen=True)
class DriftingPart:
    """A part of a shell that its supports let translate."""

    vertices: Index
    """Its vertices; shape (k,)."""
    directions: Array
    """Orthonormal directions along which it translates; shape (3, d)."""
    axis: Array | None
    """Unit vector along the forces on a part that is free to turn, if they are parallel: a turn about it changes
    nothing. Shape (3,)."""
    neutral: bool
    """Whether the part is free to move in all six ways, and the forces neither turn it at rest nor resist a turn."""

    def supports(self, shell: Shell, *, turning: bool) -> list[Support]:
        """What holds it, ``turning`` about its axis or not: a load in balance makes no reaction there."""
        points = shell.rest_positions[self.vertices]
        middle = np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()
        one = self.vertices[[middle]]
        held: list[Support] = [Symmetry(one, along) for along in self.directions.T]
        held = [Pin(one)] if len(held) == 3 else held
        if self.axis is not None and not turning:
            across = np.cross(self.axis, points - points[middle])
            farthest = np.linalg.norm(across, axis=1).argmax()
            held.append(Symmetry(self.vertices[[farthest]], across[farthest]))
        return held

    def fixed(self, shell: Shell) -> list[Support]:
        """What holds it in all six ways, statically determinate."""
        points = shell.rest_positions[self.vertices]
        arms = points - points[np.linalg.norm(points - points.mean(axis=0), axis=1).argmin()]
        sizes = np.linalg.norm(arms, axis=1)
        first, second = sizes.argmin(), sizes.argmax()
        along = arms[second] / sizes[second]
        across = arms - np.outer(arms @ along, along)
        third = np.linalg.norm(across, axis=1).argmax()
        aside = across[third] / np.linalg.norm(across[third])
        normal = np.cross(along, aside)
        held = [(second, aside), (second, normal), (third, normal)]
        return [Pin(self.vertices[[first]]), *(Symmetry(self.vertices[[one]], way) for one, way in held)]

    def put_back(self, shell: Shell, x: Array, start: Array) -> None:
        """Move x (n, 3) [m] to have the centre of mass where it was at ``start``, turned as little as can be."""
        mass = shell.mass[self.vertices]
        after, before = x[self.vertices], start[self.vertices]
        centre, first = mass @ after / mass.sum(), mass @ before / mass.sum()
        arms = after - centre
        if self.axis is not None:
            arms = _turned(arms, before - first, self.axis, mass)
        x[self.vertices] = centre + self.directions @ (self.directions.T @ (first - centre)) + arms


def _turned(arms: Array, were: Array, axis: Array, mass: Array) -> Array:
    """``arms`` (k, 3), turned about a unit axis to be nearest to those that ``were``, in the norm of the mass."""
    across = np.cross(axis, arms)
    flat = arms - np.outer(arms @ axis, axis)
    angle = np.arctan2(mass @ np.sum(across * were, axis=1), mass @ np.sum(flat * were, axis=1))
    return np.asarray(arms - flat + np.cos(angle) * flat + np.sin(angle) * across)


def drifting_parts(shell: Shell, load: Array) -> list[DriftingPart]:
    """The parts that can translate, under a load (n, 3) [N]."""
    found = []
    for vertices, directions, motions in free_translations(shell):
        if directions.shape[1]:
            forces = load[vertices]
            axis = parallel(forces) if motions == 6 else None
            arms = shell.rest_positions[vertices] - shell.rest_positions[vertices].mean(axis=0)
            # Its antisymmetric part is the moment; a turn w does work w . (S - tr S) w / 2 to second order.
            product = np.linalg.norm(forces.T @ arms)
            most = np.linalg.norm(arms, axis=1).max() * np.linalg.norm(forces, axis=1).sum()
            found.append(DriftingPart(vertices, directions, axis, bool(motions == 6 and product <= _NEUTRAL * most)))
    return found


def goes_along(shell: Shell, loading: Loading) -> bool:
    """Whether no rigid motion of the parts of a shell, all free, changes the work of a load: a balloon's pressure.

    Then its forces are in balance at every shape: they are tried at one that is no other's.
    """
    parts = free_translations(shell)
    if loading.dead.any() or not loading.conservative or any(motions < 6 for _, _, motions in parts):
        return False
    rest = shell.rest_positions
    x = rest + _SHAPE * shell.mesh.size * np.random.default_rng(0).standard_normal(rest.shape)
    forces = loading.force(x)
    for vertices, _, _ in parts:
        arms, own = x[vertices] - x[vertices].mean(axis=0), forces[vertices]
        turns = np.cross(arms, own)
        for parted in (own, turns):
            if np.linalg.norm(parted.sum(axis=0)) > _PARALLEL * np.linalg.norm(parted, axis=1).sum():
                return False
    return True


def balanced(
    shell: Shell, loading: Loading, start: Array | None, solve: Callable[[Shell, Array | None], Equilibrium]
) -> Equilibrium:
    """Equilibrium of a shell whose free parts a load does not push away: a dead one, or one that :func:`goes_along`.

    ``solve`` finds it for the shell with further supports, from a start. Turns that change nothing are held, too,
    unless the way to the answer is too hard so. A load that at rest neither turns parts nor resists turns, as one
    across a flat sheet, leaves the first Hessian singular: parts are held in all ways first, and turn from there.
    """
    load = loading.dead
    parts, iterations, begin = drifting_parts(shell, load), 0, start
    if loading.live:
        found = solve(fixed(shell, parts), start)
        return replace(found, positions=put_back(found.positions, parts, shell, start))
    neutral = load.any() and parts and all(part.neutral for part in parts)
    if start is None and neutral and shell.crease_state is None:  # creases yield once
        held = solve(fixed(shell, parts), None)
        iterations = held.iterations
        begin = held.positions if held.converged and held.stable and not held.message else None
    for turning in (False, True):
        supports = [support for part in parts for support in part.supports(shell, turning=turning)]
        found = solve(shell.also_supported(supports) if supports else shell, begin)
        iterations += found.iterations
        if found.converged or all(part.axis is None for part in parts):
            break
    return replace(found, positions=put_back(found.positions, parts, shell, start), iterations=iterations)


def fixed(shell: Shell, parts: Sequence[DriftingPart]) -> Shell:
    """The shell with its parts held in all ways."""
    return shell.also_supported([support for part in parts for support in part.fixed(shell)])


def put_back(x: Array, parts: Sequence[DriftingPart], shell: Shell, start: Array | None) -> Array:
    """Positions x (n, 3) [m] with the parts where they were at the ``start``, by default at rest."""
    positions = x.copy()
    for part in parts:
        part.put_back(shell, positions, shell.rest_positions if start is None else start)
    return positions


def relieved(shell: Shell, load: Array, x: Array) -> Array:
    """A load (n, 3) [N] without what moves free parts at x (n, 3) [m] as rigid bodies: their inertia bears that."""
    left = load.copy()
    for vertices, _, motions in free_translations(shell):
        if motions == 6:
            turns, mass = six_motions(x[vertices]).reshape(-1, 6), np.repeat(shell.mass[vertices], 3)
            weighted = mass[:, None] * turns
            pushed = np.linalg.solve(turns.T @ weighted, turns.T @ load[vertices].ravel())
            left[vertices] -= (weighted @ pushed).reshape(-1, 3)
    return left


def neutral_turn(shell: Shell, load: Array, patch: HeldPatch, target: Array, x: Array) -> tuple[Index, Array] | None:
    """What holds the turn of a free shell about the one vertex that leads it to a ``target`` (3,); or None.

    A turn about parallel forces of the load (n, 3) [N] changes nothing, as on smooth planes across them. The vertex
    (1,) that is farthest from the axis at x (n, 3) is to keep its plane with this, of which the normal (3,) is given.
    The vertex that leads must not be led out of its reach.
    """
    axis, parts = parallel(load), free_translations(shell)
    if axis is None or patch.vertices.size != 1 or len(parts) != 1 or parts[0][2] < 6:
        return None
    across = np.cross(axis, x - x[patch.vertices])
    farthest = int(np.linalg.norm(across, axis=1).argmax())
    aside, reach = across[farthest] @ (target - x[patch.vertices[0]]), across[farthest] @ across[farthest]
    return None if abs(aside) > _ASIDE * reach else (np.array([farthest]), across[farthest])


def parallel(forces: Array) -> Array | None:
    """Unit vector (3,) along the largest of some forces (k, 3) if they are parallel, else None."""
    strongest = forces[np.linalg.norm(forces, axis=1).argmax()]
    if not strongest.any():
        return None
    axis = np.asarray(strongest / np.linalg.norm(strongest))
    return None if np.linalg.norm(np.cross(forces, axis)) > _PARALLEL * np.linalg.norm(forces) else axis


def refuse_drifting(shell: Shell, what: str) -> None:
    """OptionError for a shell that its supports let translate: its stiffness is singular."""
    if any(directions.shape[1] for _, directions, _ in free_translations(shell)):
        raise OptionError(f"{what} needs a shell that its supports hold, but {left_free(shell)}: hold more vertices")


def pushed_share(shell: Shell, load: Array) -> float:
    """Largest share of the forces (n, 3) [N] on a part along translations that its supports leave free."""
    shares = [0.0]
    for vertices, directions, _ in free_translations(shell):
        forces = load[vertices]
        if directions.shape[1] and forces.any():
            pushed = np.linalg.norm(forces.sum(axis=0) @ directions)
            shares.append(float(pushed / np.linalg.norm(forces, axis=1).sum()))
    return max(shares)
