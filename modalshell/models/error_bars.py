"""Error bars of answers of any model, on its own shell or on a coarse one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind, shown
from modalshell.core.errors import OptionError
from modalshell.core.timings import Stopwatch
from modalshell.loads import Load, Loading
from modalshell.models.base.bars import bar_on_shell, check_bar, refuse_on_coarse
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.model import Model
from modalshell.models.base.setup import given_contacts
from modalshell.models.coarse.coarse_shell import coarse_shell
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.shell import Shell
from modalshell.statics.branch_end import with_branch_end
from modalshell.statics.error_bar import ErrorBar, ErrorEstimator
from modalshell.supports.constraints import Constraint, checked_constraints

if TYPE_CHECKING:
    from modalshell.contact import Contact  # scenes without contacts do not import it

COARSE_TRIANGLES = 300
"""Triangles of a coarse shell that is made for bars."""


def error_bar(
    model_or_shell: Model | Shell,
    answer: Equilibrium | ArrayLike,
    on: str | Shell = "shell",
    *,
    walk: bool = False,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
    contacts: Sequence[Contact] | None = None,
    constraints: Sequence[Constraint] | None = None,
) -> ErrorBar:
    """How far a static answer is from that of discrete shells (DS) on the same shell, without solving DS.

    Two mixed Newton steps from the answer measure the error; the stability margin after them says whether the answer
    is on DS's branch at all (:mod:`modalshell.statics.error_bar`). This takes two to three factorisations in place of
    the six to thirty of DS.

    Parameters
    ----------
    model_or_shell : Model or Shell
        Whose answer it is.
    answer : Equilibrium or array_like, shape (n, 3)
        The answer of any model, or positions [m].
    on : {"shell", "coarse"} or Shell
        Where the steps are taken: on the shell itself; or on a coarse shell, for milliseconds. That is a flag rather
        than a bar, as errors below those of coarse DS itself (3 to 15 % on some hundred triangles) do not show, and
        loads that follow the shell are dead there, as they are at the answer. With "coarse" it is that of the model, or
        one of 300 triangles (extra ``remesh``), made at each call; give one of :func:`coarse_shell` to keep it.
    walk : bool
        Whether ``critical_load`` is found by a walk along the branch (:mod:`modalshell.statics.branch_end`), which
        costs some five to ten further bars, in place of an estimate from this one margin.
    gravity, force, loads, contacts, constraints : optional
        The load, colliders and constraints, as in :meth:`Model.equilibrium`, if ``answer`` has no record of them.
        What touches stays on its collider while the steps are taken; these are more than two, at most eight, where they
        change what touches. Constraints hold patches as DS does, each one rigid.

    Returns
    -------
    ErrorBar
        Void, and says so, where the answer is near the end of its branch or past it, or what touches does not settle.

    Raises
    ------
    OptionError
        For a shell that its supports do not hold, contacts with friction or whose vertices supports all hold,
        constraints that lead into a collider, loads, contacts or constraints given twice, or either of the latter with
        a bar on a coarse shell or with ``walk``.
    LoadError
        For positions or loads of the wrong shape or not finite.
    """
    shell = shell_of(model_or_shell)
    given = any(part is not None for part in (gravity, force, loads))
    loading, touching, led = None, given_contacts(contacts, shell), checked_constraints(constraints, shell.unknowns)
    if isinstance(answer, Equilibrium):
        loading = answer.loading
        if answer.contacts and contacts is not None:
            raise OptionError("the equilibrium knows its contacts: leave them out, or give its positions")
        if answer.constraints and constraints is not None:
            raise OptionError("the equilibrium knows its constraints: leave them out, or give its positions")
        touching, led = answer.contacts or touching, list(answer.constraints) or led
    if loading is not None and given:
        raise OptionError("the equilibrium knows its load: leave out gravity, force and loads, or give its positions")
    if loading is None:
        loading = shell.loading(gravity, force, loads)
    positions = shell.checked_positions(answer.positions if isinstance(answer, Equilibrium) else answer)
    check_bar(shell, constraints=led, contacts=touching)
    if isinstance(on, str) and on == "shell":
        return bar_on_shell(shell, positions, loading, touching, led, walk=walk)
    refuse_on_coarse(touching, led)
    return CoarseBars(coarse_of(model_or_shell, shell, on)).bar(positions, loading, walk=walk)


def shell_of(model_or_shell: Model | Shell) -> Shell:
    """The shell itself, or that of the model; OptionError for anything else."""
    if isinstance(model_or_shell, Shell):
        return model_or_shell
    return checked_kind("model_or_shell", model_or_shell, Model).true_shell  # type: ignore[type-abstract]


class CoarseBars:
    """Error bars of answers of a fine shell, found on a coarse one."""

    def __init__(self, coarse: CoarseDiscreteShell) -> None:
        self.coarse = coarse
        self._estimator = ErrorEstimator(coarse.coarse.shell)

    def bar(self, positions: ArrayLike, loading: Loading, *, walk: bool = False) -> ErrorBar:
        """The bar of an answer at ``positions`` (n, 3) [m]; loads that change act as they are there.

        With ``walk`` its critical load is found by a walk along its branch.
        """
        watch, coarse = Stopwatch(), self.coarse
        x = coarse.shell.checked_positions(positions)
        load = coarse.restrict(loading.force(x))
        found = self._estimator.bar(coarse.sampled(x), load, on="coarse")
        if walk:
            found = with_branch_end(self._estimator, found, load)
        corrected = x.copy() if found.message else coarse.prolong(found.corrected)
        return replace(found, corrected=corrected, seconds=watch())


def coarse_of(model: Model | Shell, shell: Shell, on: str | Shell) -> CoarseDiscreteShell:
    """The coarse shell on which bars of a shell are found, as :func:`error_bar` takes it; OptionError for others."""
    if isinstance(on, Shell):
        return CoarseDiscreteShell(shell, on)
    if on != "coarse":
        raise OptionError(f'on must be "shell", "coarse" or a coarse Shell (got {shown(on)})')
    own = None if isinstance(model, Shell) else model.coarse_shell
    return CoarseDiscreteShell(shell, own or coarse_shell(shell, COARSE_TRIANGLES))
