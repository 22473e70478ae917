"""Equilibria of coarse discrete shells with contacts: exact at the coarse vertices, put out at the fine ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.constraints.constraints import Constraint
from modalshell.contact.contact import Contact
from modalshell.contact.touching import Touching, checked_contacts
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array, Index
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium


def coarse_equilibrium_on_contacts(
    model: Any, loading: Loading, start: Array | None, contacts: Sequence[Contact], constraints: Sequence[Constraint]
) -> Equilibrium:
    """Equilibrium of the coarse shell with contacts at its own vertices, prolonged.

    Fine vertices that prolongation leaves inside are put onto the colliders: such an answer is a start of DS. Contact
    forces are those of the coarse vertices, at the fine vertices nearest to them.

    Parameters
    ----------
    model : CoarseDiscreteShell
        The model.
    loading : Loading
        Dead loads on the fine shell.
    start : ndarray, shape (n, 3), optional
        Where to begin.
    contacts, constraints : sequence
        What was declared.

    Raises
    ------
    OptionError
        For what is no contact, constraints with contacts, loads that change, or a start inside a collider.
    """
    given = checked_contacts(contacts)
    if constraints:
        raise OptionError("contacts and constraints do not go together yet: move the supports instead")
    if loading.live:
        raise OptionError(f"{model.name} takes contacts under dead loads: take DS where loads change with the shell")
    shell, coarse, nearest = model.shell, model.coarse.shell, model.nearest
    own = [_on(contact, contact.vertices(shell.mesh)[nearest]) for contact in given]
    fine, under = Touching(given, shell), Touching(own, coarse)
    begin = None
    if start is not None:
        fine.refuse_inside(start)
        begin = _put_out(under, model.sampled(start), np.array([not contact.push_out for contact in given]))
    answer = model.coarse.equilibrium(force=model.restrict(loading.dead), start=begin, contacts=own)
    x = _put_out(fine, model.prolong(answer.positions), np.ones(len(given), dtype=bool))
    forces, touches = np.zeros_like(x), np.zeros(len(x), dtype=bool)
    np.add.at(forces, nearest, answer.contact_forces)
    touches[nearest[answer.in_contact]] = True
    return replace(
        answer,
        positions=x,
        coordinates=answer.positions,
        contact_forces=forces,
        in_contact=touches,
        deepest=max(0.0, -float(fine.distances(x).min(initial=0.0))),
    )


def _on(contact: Contact, chosen: Index) -> Contact:
    """The same contact of other vertices."""
    return Contact(
        contact.collider,
        chosen,
        contact.friction,
        contact.restitution,
        contact.motion,
        push_out=contact.push_out,
    )


def _put_out(touching: Touching, x: Array, contacts: NDArray[np.bool_]) -> Array:
    """Positions (n, 3) [m] with what may move and lies inside put onto the colliders of some contacts."""
    x = x.copy()
    rows = np.flatnonzero((touching.distances(x) < 0.0) & contacts[touching.contact_of])
    rows = rows[touching.movable(rows, touching.gaps(x, rows)[1])]
    touching.put_on(x, rows, np.zeros(rows.size))
    return x
