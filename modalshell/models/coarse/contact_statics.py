"""Equilibria of coarse discrete shells with contacts: exact at the coarse vertices, put out at the fine ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from modalshell.contact.contact import Contact
from modalshell.contact.touching import Touching, checked_contacts, put_out, refuse_friction
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.settle import self_consistent
from modalshell.supports.constraints import Constraint


def coarse_equilibrium_on_contacts(
    model: Any, loading: Loading, start: Array | None, contacts: Sequence[Contact], constraints: Sequence[Constraint]
) -> Equilibrium:
    """Equilibrium of the coarse shell with contacts at its own vertices, prolonged.

    Loads are those on the fine shell, and it begins at ``start`` (n, 3) [m] or at rest. Fine vertices that prolongation
    leaves inside are put onto the colliders: such an answer is a start of DS. Contact forces are those of the coarse
    vertices, at the fine vertices nearest to them. OptionError for what is no contact, friction, constraints, which it
    takes none of, or a start inside a collider.
    """
    given = checked_contacts(contacts)
    if constraints:
        raise model.no_constraints()
    refuse_friction(given, "statics on a coarse shell")
    fine, own = Touching(given, model.shell), model.coarse_contacts(given)
    under = Touching(own, model.coarse.shell)
    if start is not None:
        fine.refuse_inside(start)

    def solve(load: Array, start: Array | None) -> Equilibrium:
        begin = None
        if start is not None:
            begin = put_out(under, model.sampled(start), np.array([not contact.push_out for contact in given]))
        below = model.coarse.shell.loading(force=model.restrict(load))
        answer = model.coarse._solve_touching(below, begin, own, ())  # of which some may have no vertex that moves
        x = put_out(fine, model.prolong(answer.positions), np.ones(len(given), dtype=bool))
        forces, touches = model.spread(answer.contact_forces, answer.in_contact)
        return replace(
            answer,
            positions=x,
            coordinates=answer.positions,
            contact_forces=forces,
            in_contact=touches,
            deepest=max(0.0, -float(fine.distances(x).min(initial=0.0))),
        )

    return self_consistent(solve, loading, start) if loading.live else solve(loading.dead, start)


def equilibrium_or_coarse_contacts(
    model: Any,
    free: Callable[[], Equilibrium],
    loading: Loading,
    start: Array | None,
    contacts: Sequence[Contact],
    constraints: Sequence[Constraint],
) -> Equilibrium:
    """The ``free`` equilibrium of a model where that touches nothing, else that of its coarse shell with the contacts.

    The other parameters are those of :func:`coarse_equilibrium_on_contacts`.
    """
    if not constraints:
        touching = Touching(checked_contacts(contacts), model.shell)
        begin = model.shell.rest_positions if start is None else start
        touching.refuse_inside(begin)
        found = free()
        x = found.positions
        if found.converged and not (touching.distances(x) < 0.0).any() and not touching.crossed(begin, x):
            return replace(found, contact_forces=np.zeros_like(x), in_contact=np.zeros(len(x), dtype=bool))
    found = coarse_equilibrium_on_contacts(model, loading, start, contacts, constraints)
    how = f"answered by {model.name}: contacts press on the shell"
    return replace(found, coordinates=None, message="; ".join(part for part in (how, found.message) if part))
