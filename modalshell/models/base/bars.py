"""Error bars of static answers on the shell that they are of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.modes.rigid import left_free
from modalshell.shell import Shell
from modalshell.statics.branch_end import with_branch_end
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator
from modalshell.statics.live_loads import LiveLoads
from modalshell.supports import SupportPath
from modalshell.supports.constraints import Constraint, LedVertices, held_patches

if TYPE_CHECKING:
    from modalshell.contact import Contact  # scenes without contacts do not import it
    from modalshell.contact.error_bar import ContactEstimator


def check_bar(
    shell: Shell, *, constraints: Sequence[Constraint] = (), contacts: Sequence[Contact] | None = None
) -> None:
    """OptionError where answers on a shell have no error bar."""
    shell.refuse_creases("an error bar")
    led_vertices(shell, constraints)
    if any(not getattr(contact, "has_surface", True) for contact in contacts or ()):
        raise OptionError("an error bar under self-contact is not known: leave out the bar, or the self-contact")
    if loose := left_free(shell):
        raise OptionError(f"an error bar needs a shell that its supports hold, but {loose}: hold more vertices")


def led_vertices(
    shell: Shell, constraints: Sequence[Constraint], path: SupportPath | None = None
) -> LedVertices | None:
    """Vertices of a shell that constraints lead, its supports moving along a path; None without constraints.

    OptionError for constraints that DS does not take.
    """
    if not constraints:
        return None
    return LedVertices(held_patches(constraints, shell.rest_positions, shell.mesh.faces, shell.unknowns), path)


def refuse_on_coarse(contacts: Sequence[Contact], constraints: Sequence[Constraint]) -> None:
    """OptionError for what acts on vertices of a shell, with a bar on a coarse one, which has others."""
    if contacts or constraints:
        what = "contacts" if contacts else "constraints"
        raise OptionError(f'under {what} a bar is found on the shell itself: take on="shell"')


def bar_on_shell(
    shell: Shell,
    positions: Array,
    loading: Loading,
    contacts: Sequence[Contact] | None = None,
    constraints: Sequence[Constraint] = (),
    *,
    walk: bool = False,
) -> ErrorBar:
    """The bar of an answer at ``positions`` (n, 3) [m], loads of time, colliders and targets being those at time 0.

    With ``walk`` its critical load is found by a walk along its branch, which contacts and constraints do not take.
    """
    if walk and (contacts or constraints):
        what = "contacts" if contacts else "constraints"
        raise OptionError(f"under {what} the end of a branch is not walked to: leave out walk=True")
    live, estimator = LiveLoads(loading) if loading.live else None, estimator_of(shell, contacts, constraints)
    bar = estimator.bar(positions, loading.dead, live)
    if walk and isinstance(estimator, ErrorEstimator):
        return with_branch_end(estimator, bar, loading.dead, live)
    return bar


def estimator_of(
    shell: Shell, contacts: Sequence[Contact] | None, constraints: Sequence[Constraint] = ()
) -> ErrorEstimator | ContactEstimator:
    """What finds the bars of answers on a shell, under contacts or constraints if there are any."""
    led = led_vertices(shell, constraints)
    if not contacts:
        return ErrorEstimator(shell, led=led)
    from modalshell.contact.error_bar import ContactEstimator  # not without contacts
    from modalshell.contact.led import refuse_led_inside
    from modalshell.contact.touching import checked_contacts

    estimator = ContactEstimator(shell, checked_contacts(contacts), led)
    if led is not None:
        refuse_led_inside(estimator.touching, led.vertices, led.at(0.0))
    return estimator
