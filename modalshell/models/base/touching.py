"""Equilibria of full models with contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from modalshell.contact.active_set import ActiveSet, Rest
from modalshell.contact.contact import Contact
from modalshell.contact.layers import Layers
from modalshell.contact.led import Led
from modalshell.contact.plane import Plane
from modalshell.contact.self_contact import SelfContact
from modalshell.contact.static_friction import LOAD_STEPS, SLIDES, rest_with_friction
from modalshell.contact.statics import rest_on_contacts, rest_on_layers, sides_note
from modalshell.contact.touching import Touching, parted
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.timings import Timings
from modalshell.core.typing import Array
from modalshell.models.base.drift_on_planes import BORNE, PUSHED, rest_on_faces, rest_on_planes
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.free_statics import neutral_turn, parallel
from modalshell.modes import Factoriser
from modalshell.shell import EXACT
from modalshell.statics.boundary import missed_by, reactions_of
from modalshell.statics.flutter import fluttering
from modalshell.statics.potential import Potential
from modalshell.statics.verdict import verdict
from modalshell.supports import Symmetry
from modalshell.supports.constraints import Constraint, held_patches

_DIP = 1e-3
"""Depth of edges between vertices, as a share of the shell's size, from which a message tells of it."""
_IN_STEPS = f"friction depends on the way: the load grew in {LOAD_STEPS} steps from the shell at rest"
_UNSETTLED = "the contact set did not settle"
_LED = "; the constraints moved on straight ways then"
_NOT_LED = "the contact set did not settle as constraints moved: hold more vertices, or simulate the damped motion"
_AT_ONCE = "friction depends on the way: the load came at once, from the start"


class _Found(NamedTuple):
    """Where a solve ended, forces (n, 3) [N] beyond those along normals, what to say of failure, nearest layers [m]."""

    rest: Rest
    further: Array | None = None
    failure: str = _UNSETTLED
    closest: float | None = None


def _checked(
    contacts: Sequence[Contact | SelfContact], constraints: Sequence[Constraint]
) -> tuple[tuple[Contact, ...], SelfContact | None, bool]:
    """Contacts with colliders, self-contact, and whether any of them has friction; OptionError where they disagree."""
    given, own = parted(contacts)
    if constraints and own is not None:
        raise OptionError("statics of DS take constraints or self-contact, not both: simulate the damped motion")
    if own is not None and own.friction:
        raise OptionError(
            f"self-contact has friction (got {own.friction:g}): statics of DS take it without; simulate the motion"
        )
    rubs = any(contact.friction for contact in given)
    if rubs and own is not None:
        raise OptionError("statics of DS take friction of colliders, or self-contact, not both: simulate the motion")
    return given, own, rubs


def _led(led: Led, first: Array, load_steps: int) -> _Found:
    """Where a shell comes to from ``first`` (n, 3) whose patches are led."""
    if any(contact.friction for contact in led.touching.contacts):
        return _Found(*led.rest_with_friction(first, load_steps)[:3])
    return _Found(led.rest(first), failure=_NOT_LED)


def _led_turning_nowhere(led: Led, first: Array) -> _Found | None:
    """The same of a free shell that one vertex leads over smooth planes, whose turn about the load changes nothing.

    It is held by a support that bears nothing; None where there is no such turn, or the support bears something.
    """
    problem, contacts, patch = led.problem, led.touching.contacts, led.patches[0]
    smooth = all(isinstance(one.collider, Plane) and one.motion is None and not one.friction for one in contacts)
    if problem.live is not None or not smooth or len(led.patches) > 1:
        return None
    load, target = problem.load, patch.at(0.0)[0] - led.origin
    normals = np.array([one.collider.normal for one in contacts if isinstance(one.collider, Plane)]).reshape(-1, 3)
    turn = neutral_turn(led.shell, load, patch, target, first)
    if turn is None or parallel(np.concatenate([load, np.linalg.norm(load) * normals])) is None:
        return None
    vertex, (a, b, c) = turn[0], turn[1].tolist()
    held = problem.shell.also_supported([Symmetry(vertex, (a, b, c))])
    problem = replace(problem, shell=held, factoriser=Factoriser(problem.factoriser.backend))
    found = _led(replace(led, problem=problem, touching=Touching(contacts, held, led.origin)), first, 1)
    borne = (held.energy_gradient(found.rest.point)[1] - load)[vertex[0]] @ turn[1] / np.linalg.norm(turn[1])
    return found if found.rest.converged and abs(borne) <= BORNE * np.linalg.norm(load) else None


def _smooth(
    problem: Potential, touching: Touching, origin: Array, first: Array, guess: Callable[[], Array | None] | None
) -> _Found:
    """Where a shell comes to from ``first`` (n, 3) without friction."""

    def solve(own: Potential, contacts: Touching) -> Rest:
        return rest_on_contacts(own, contacts, first, guess)

    touching.refuse_inside(first)
    drifted = rest_on_planes(problem, touching, origin, first, solve)
    if drifted is None:
        rest = solve(problem, touching)
        return _Found(rest_on_faces(problem, touching, origin, first, rest, solve))
    return _Found(drifted[0], failure=drifted[1] or _UNSETTLED)


def _on_layers(problem: Potential, touching: Touching, origin: Array, first: Array, layers: Layers) -> _Found:
    """Where a shell with ``layers`` comes to from ``first`` (n, 3), those at rest on planes held along them."""

    def solve(own: Potential, contacts: Touching) -> Rest:
        nonlocal layers
        rest, layers = rest_on_layers(own, contacts, layers, first)
        return rest

    touching.refuse_inside(first)
    drifted = rest_on_planes(problem, touching, origin, first, solve)
    rest, failure = (solve(problem, touching), "") if drifted is None else drifted
    return _Found(rest, -layers.gradient(rest.point), failure or _UNSETTLED, layers.least(rest.point))


def _shape_notes(touching: Touching, first: Array, rest: Rest) -> list[str]:
    """What is said of a start at ``first`` (n, 3) deep in a collider, and of edges that dip in at the end."""
    notes = [side] if (side := sides_note(touching, first)) else []
    if (dip := touching.dip(rest.point, rest.active)) > _DIP * touching.shell.size:
        notes.append(f"edges dip up to {dip:.2g} m into the collider between their vertices: take a finer mesh there")
    return notes


def _flutters(problem: Potential, touching: Touching, rest: Rest, rubs: bool) -> bool:
    """Whether vibrations that keep the gaps flutter under a load without a potential.

    Not asked where something ``rubs``: the part of friction in what vibrates is not known here.
    """
    if not problem.unsymmetric or (rubs and rest.active.any()):
        return False
    return fluttering(problem, ActiveSet(problem, touching, 1.0).equations(rest, EXACT)[0].kept())


def equilibrium_on_contacts(
    problem: Potential,
    origin: Array,
    start: Array | None,
    contacts: Sequence[Contact | SelfContact],
    constraints: Sequence[Constraint],
    costs: Timings,
    guess: Callable[[], Array | None],
) -> Equilibrium:
    """Equilibrium of a shell about its ``origin`` (3,) with contacts, from ``start`` (n, 3) in the world, or rest.

    With friction the load grows in steps from rest, but comes at once where there is a start. Where Newton's method
    fails from rest, it begins again at a ``guess`` (n, 3) in the world. Patches under constraints are led to their
    targets, with friction once the load is there. OptionError for what is no contact, for constraints with
    self-contact, or that lead into a collider, self-contact with friction, or a start inside a collider.
    """
    given, own, rubs = _checked(contacts, constraints)
    steps, before, shell = LOAD_STEPS if start is None else 1, dict(costs), problem.shell
    patches = held_patches(constraints, shell.rest_positions + origin, shell.mesh.faces, shell.unknowns)
    if patches:
        held = shell.holding(np.concatenate([patch.vertices for patch in patches]))
        problem = replace(problem, shell=held, factoriser=Factoriser(problem.factoriser.backend))
    touching = Touching(given, problem.shell, origin)
    first = shell.rest_positions if start is None else start - origin

    def guessed() -> Array | None:
        found = guess()
        return None if found is None else found - origin

    with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as not converged
        if own is not None:
            found = _on_layers(problem, touching, origin, first, Layers(own, shell))
        elif patches:
            led = Led(problem, shell, touching, patches, origin)
            found = _led_turning_nowhere(led, first) or _led(led, first, steps)
        elif rubs:
            found = _Found(*rest_with_friction(problem, touching, first, steps)[:3])
        else:
            found = _smooth(problem, touching, origin, first, guessed if start is None else None)
    rest, further, failure, closest = found
    gaps = touching.distances(rest.point)
    if own is not None and problem.live is not None and not problem.live.conservative:
        failure = "self-contact settles under loads with a potential alone: simulate the damped motion"
    notes = [] if rest.converged else [failure]
    if rubs and rest.converged:
        notes.append((_AT_ONCE if steps == 1 else _IN_STEPS) + (_LED if patches else ""))
    notes += _shape_notes(touching, first, rest)
    stable, follows = rest.stable and not _flutters(problem, touching, rest, rubs), problem.unsymmetric
    outcome, message = verdict(rest.residual, stable, limited=rest.limited, note="; ".join(notes), follows=follows)
    if not rest.converged:
        outcome, message = verdict(np.inf, None)[0], f"residual {rest.residual:.1e}; " + "; ".join(notes)
    if failure.startswith((SLIDES, PUSHED)):
        outcome, message = Outcome.NO_EQUILIBRIUM, failure
    forces, touches = touching.forces(rest.point, rest.pushes), np.zeros(len(rest.point), dtype=bool)
    touches[touching.vertices[rest.active]] = True
    if further is not None:
        forces += further
    if own is not None:
        touches |= forces.any(axis=1)
    return Equilibrium(
        rest.point + origin if origin.any() else rest.point,
        outcome,
        message,
        rest.iterations,
        rest.residual,
        stable,
        costs=costs.since(before),
        contact_forces=forces,
        in_contact=touches,
        deepest=max(0.0, -float(gaps.min(initial=0.0))),
        self_contact=closest,
        constraint_residuals=missed_by(constraints, patches, rest.point, origin),
        constraint_reactions=reactions_of(shell, constraints, patches, rest.point, problem.load, problem.live),
    )
