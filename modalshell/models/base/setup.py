"""Setup of a motion: its step, damping, loads, supports, constraints and contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

from modalshell.core.checks import shown
from modalshell.core.errors import OptionError
from modalshell.loads import Loading
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.supports import SupportPath
from modalshell.supports.constraints import Constraint

if TYPE_CHECKING:
    from modalshell.contact import Contact  # motions without contacts do not import it
    from modalshell.integrators.full import FullIntegrator


def given_contacts(contacts: Sequence[Contact] | None, shell: Shell) -> tuple[Any, ...]:
    """The contacts that a caller gives, as a tuple; OptionError for no list of them, or one of held vertices alone."""
    if not contacts:
        return ()
    from modalshell.contact.touching import listed_contacts  # not without contacts

    listed = listed_contacts(contacts)
    for contact in listed:
        if not (contact.vertices(shell.mesh) & ~shell.unknowns.held).any():
            raise OptionError(f"sel must name a vertex that supports do not hold (got {shown(contact.sel)})")
    return listed


@final
@dataclass(frozen=True, eq=False)
class MotionSetup:
    """What decides a motion in steps of ``dt`` [s], but for its model and its start.

    Constraints are those on patches of vertices, contacts those with colliders. Steps that are ``divided`` are so as
    their errors ask for.
    """

    dt: float
    damping: Damping
    loading: Loading
    supports: SupportPath | None = None
    constraints: Sequence[Constraint] = ()
    contacts: Sequence[Contact] = ()
    divided: bool = False

    @property
    def averaged(self) -> MotionSetup:
        """The same motion for steps that join the forces at their ends by straight lines; divided ones find bends."""
        return self._under(self.loading.averaged(self.dt))

    def felt_by(self, rule: FullIntegrator) -> MotionSetup:
        """The same motion for a rule that takes the forces at the ends of its steps, or of their parts."""
        return self._under(self.loading.averaged(self.dt, within=not rule.joins)) if rule.takes_live else self

    def _under(self, loading: Loading) -> MotionSetup:
        return self if self.divided or loading is self.loading else replace(self, loading=loading)
