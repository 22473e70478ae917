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

if TYPE_CHECKING:
    from modalshell.contact import Contact  # scenes without contacts do not import it
    from modalshell.contact.error_bar import ContactEstimator


def check_bar(shell: Shell, *, constrained: bool = False, contacts: Sequence[Contact] | None = None) -> None:
    """OptionError where answers on a shell have no error bar."""
    shell.refuse_creases("an error bar")
    if constrained:
        raise OptionError("error bars under position or orientation constraints are not known: drop one")
    if any(not getattr(contact, "has_surface", True) for contact in contacts or ()):
        raise OptionError("an error bar under self-contact is not known: leave out the bar, or the self-contact")
    if loose := left_free(shell):
        raise OptionError(f"an error bar needs a shell that its supports hold, but {loose}: hold more vertices")


def no_coarse_contacts() -> OptionError:
    """The error of bars on a coarse shell, which take no contacts."""
    return OptionError('under contacts a bar is found on the shell itself: take on="shell"')


def bar_on_shell(
    shell: Shell,
    positions: Array,
    loading: Loading,
    contacts: Sequence[Contact] | None = None,
    *,
    walk: bool = False,
) -> ErrorBar:
    """The bar of an answer at ``positions`` (n, 3) [m], loads of time and colliders being those at time 0.

    With ``walk`` its critical load is found by a walk along its branch, which contacts do not take.
    """
    live, estimator = LiveLoads(loading) if loading.live else None, estimator_of(shell, contacts)
    if walk and contacts:
        raise OptionError("under contacts the end of a branch is not walked to: leave out walk=True")
    bar = estimator.bar(positions, loading.dead, live)
    if walk and isinstance(estimator, ErrorEstimator):
        return with_branch_end(estimator, bar, loading.dead, live)
    return bar


def estimator_of(shell: Shell, contacts: Sequence[Contact] | None) -> ErrorEstimator | ContactEstimator:
    """What finds the bars of answers on a shell, under contacts if there are any."""
    if not contacts:
        return ErrorEstimator(shell)
    from modalshell.contact.error_bar import ContactEstimator  # not without contacts
    from modalshell.contact.touching import checked_contacts

    return ContactEstimator(shell, checked_contacts(contacts))
