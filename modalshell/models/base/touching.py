"""Equilibria of full models with contacts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.layers import Layers
from modalshell.contact.self_contact import SelfContact
from modalshell.contact.statics import rest_on_contacts, rest_on_layers
from modalshell.contact.touching import Touching, parted
from modalshell.core.errors import OptionError
from modalshell.core.timings import Timings
from modalshell.core.typing import Array
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.statics.potential import Potential
from modalshell.statics.verdict import verdict
from modalshell.supports.constraints import Constraint

_DIP = 1e-3
"""Depth of edges between vertices, as a share of the shell's size, from which a message tells of it."""


def equilibrium_on_contacts(
    problem: Potential,
    origin: Array,
    start: Array | None,
    contacts: Sequence[Contact | SelfContact],
    constraints: Sequence[Constraint],
    costs: Timings,
) -> Equilibrium:
    """Equilibrium of a shell about its ``origin`` (3,) with contacts, from ``start`` (n, 3) in the world, or rest.

    Raises
    ------
    OptionError
        For what is no contact, for constraints with them, or a start inside a collider.
    """
    given, own = parted(contacts)
    if constraints:
        raise OptionError("contacts and constraints do not go together yet: move the supports instead")
    for index, contact in enumerate(contacts):
        if contact.friction:
            raise OptionError(
                f"contact {index} has friction (got {contact.friction:g}): statics of DS take contacts without it, as "
                "the answer would depend on the way there; simulate the motion"
            )
    before, shell = dict(costs), problem.shell
    touching = Touching(given, shell, origin)
    first = shell.rest_positions if start is None else start - origin
    further, closest = None, None
    with np.errstate(over="ignore", invalid="ignore"):  # absurd loads end as not converged
        if own is None:
            rest = rest_on_contacts(problem, touching, first)
        else:
            rest, layers = rest_on_layers(problem, touching, Layers(own, shell), first)
            further, closest = -layers.gradient(rest.point), layers.least(rest.point)
    gaps = touching.distances(rest.point)
    notes = [] if rest.converged else ["the contact set did not settle"]
    if (dip := touching.dip(rest.point, rest.active)) > _DIP * shell.size:
        notes.append(f"edges dip up to {dip:.2g} m into the collider between their vertices: take a finer mesh there")
    outcome, message = verdict(rest.residual, rest.stable, limited=rest.limited, note="; ".join(notes))
    if not rest.converged:
        outcome, message = verdict(np.inf, None)[0], f"residual {rest.residual:.1e}; " + "; ".join(notes)
    forces, touches = touching.forces(rest.point, rest.pushes), np.zeros(len(rest.point), dtype=bool)
    touches[touching.vertices[rest.active]] = True
    if further is not None:
        forces += further
        touches |= further.any(axis=1)
    return Equilibrium(
        rest.point + origin if origin.any() else rest.point,
        outcome,
        message,
        rest.iterations,
        rest.residual,
        rest.stable,
        costs=costs.since(before),
        contact_forces=forces,
        in_contact=touches,
        deepest=max(0.0, -float(gaps.min(initial=0.0))),
        self_contact=closest,
    )
