"""Error bars of static answers on the shell that they are of."""

from __future__ import annotations

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.modes.rigid import left_free
from modalshell.shell import Shell
from modalshell.statics.branch_end import with_branch_end
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator
from modalshell.statics.live_loads import LiveLoads


def check_bar(shell: Shell, *, constrained: bool = False) -> None:
    """OptionError where answers on a shell have no error bar."""
    shell.refuse_creases("an error bar")
    if constrained:
        raise OptionError("error bars under position or orientation constraints, or contacts, are not known: drop one")
    if loose := left_free(shell):
        raise OptionError(f"an error bar needs a shell that its supports hold, but {loose}: hold more vertices")


def bar_on_shell(shell: Shell, positions: Array, loading: Loading, *, walk: bool = False) -> ErrorBar:
    """The bar of an answer at ``positions`` (n, 3) [m], loads of time being those at time 0.

    With ``walk`` its critical load is found by a walk along its branch.
    """
    live = LiveLoads(loading) if loading.live else None
    estimator = ErrorEstimator(shell)
    bar = estimator.bar(positions, loading.dead, live)
    return with_branch_end(estimator, bar, loading.dead, live) if walk else bar
