"""Error bars of what engineers read: stresses, reactions, displacements, frequencies.

The corrected answer of a bar still stretches the membrane a little, which stresses and reactions feel. A third step
takes that away, ``K d_2 = -g(x_2)``: with the factor of K_1(x_2) that the margin has left, where the step is short,
else with K_M(x_2, s_2). Where reactions are out of balance by more than 1 % even so, as those of thin shells may be,
all three are taken once more. For a quantity J it is, to first order, ``J(x_2) - z . g(x_2)`` with the adjoint
``K z = dJ/dx``, and one solve serves all quantities at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from modalshell.core.checks import checked_number, shown
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.models.base.bars import check_bar, estimator_of
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.model import Model
from modalshell.models.error_bars import shell_of
from modalshell.shell import Sheet, Shell
from modalshell.statics.error_bar import LARGEST_BAR, ErrorBar, ErrorEstimator, share_as_text
from modalshell.statics.live_loads import LiveLoads

UNITS = {"tip": "m", "von_mises": "Pa", "reactions": "N", "frequency": "Hz"}
"""Quantities by name, and their units."""
_BALANCED = 0.01
"""Such a force, over the reactions, up to which a third step does for these."""
Quantity = Callable[[Array], float]
"""A number of positions (n, 3) [m]."""


@final
@dataclass(frozen=True)
class QuantityBar:
    """The error of one number of an answer.

    Attributes
    ----------
    value : float
        Of the answer.
    corrected : float
        As DS is expected to find it.
    unit : str
        Of both; empty if unknown.
    valid : bool
        Whether the bar holds and the answer is at most 30 % off; see :class:`modalshell.ErrorBar`. That of reactions
        holds no more where the corrected answer is out of balance by more than 30 % of them, as under pure moments.
    """

    value: float
    corrected: float
    unit: str
    valid: bool

    @property
    def error(self) -> float:
        """Difference over the corrected value; infinite where that is 0 and the value is not."""
        off = abs(self.value - self.corrected)
        return off / abs(self.corrected) if self.corrected else (np.inf if off else 0.0)

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        if not self.valid:
            return f"{self.value:.4g}{unit}, void"
        return f"{self.value:.4g}{unit}, {share_as_text(self.error)} from DS ({self.corrected:.4g}{unit})"


def quantity_bars(
    model_or_shell: Model | Shell,
    answer: Equilibrium,
    of: Sequence[str] | Mapping[str, Quantity] = ("tip", "reactions"),
) -> dict[str, QuantityBar]:
    """How far numbers of a static answer are from those of discrete shells (DS), without solving DS.

    Parameters
    ----------
    model_or_shell : Model or Shell
        Whose answer it is; "frequency" needs the model.
    answer : Equilibrium
        The answer.
    of : sequence of str, or mapping of str to callable
        "tip", the displacement [m] of the vertex that the answer moves most; "von_mises", the largest von Mises stress
        [Pa]; "reactions", the largest force [N] of one support; "frequency", the lowest natural frequency [Hz] about
        the deformed state. Or any numbers by name: functions of the positions (n, 3) [m].

    Returns
    -------
    dict of QuantityBar
        By name. Stresses and reactions of modal answers come from a membrane that these hardly describe, and are often
        orders of magnitude too large: read ``corrected``.

    Raises
    ------
    OptionError
        For an unknown name, an answer that does not know its load or stands under constraints, stresses of a
        :class:`Material`, a shell that its supports do not hold, or contacts with friction or a frequency.
    SolverError
        Where what touches does not settle in the further steps.
    """
    if not isinstance(answer, Equilibrium) or answer.loading is None:
        raise OptionError(f"answer must be an equilibrium of a known load, as a model finds (got {shown(answer)})")
    shell = shell_of(model_or_shell)
    if answer.constraints:
        raise OptionError("bars of quantities under constraints are not known: take error_bar, or leave these out")
    check_bar(shell, contacts=answer.contacts)
    loading, named = answer.loading, not isinstance(of, Mapping)
    if answer.contacts and named and "frequency" in of:
        raise OptionError("under contacts a frequency has no bar: leave it out, or the contacts")
    estimator = estimator_of(shell, answer.contacts)

    def force(x: Array) -> Array:
        if isinstance(estimator, ErrorEstimator):
            return loading.force(x)
        return loading.force(x) + (answer.contact_forces if x is answer.positions else estimator.pushed())

    chosen = _chosen(of, shell, answer, force)
    live = LiveLoads(loading) if loading.live else None
    bar = estimator.bar(answer.positions, loading.dead, live)
    if bar.message:
        raise OptionError(f"this answer has no bars: {bar.message}")
    finer, stresses = estimator.refined()
    if named and "reactions" in of:
        # Of thin shells the membrane's stretch that is left may be as large as they are: the same steps take it away.
        least = _BALANCED * chosen["reactions"](finer)
        again = bar.valid and _lost(shell, force(finer), finer) > least
        if again and not estimator.bar(finer, loading.dead, live).message:
            finer, stresses = estimator.refined()
    found = {}
    for name, read in chosen.items():
        value, corrected = (checked_number(name, float(read(x)), error=OptionError) for x in (answer.positions, finer))
        found[name] = QuantityBar(value, corrected, UNITS.get(name, ""), bar.valid and not bar.beyond)
    if named and "reactions" in found:
        bar_of, lost = found["reactions"], _lost(shell, force(finer), finer)
        found["reactions"] = replace(bar_of, valid=bar_of.valid and lost <= LARGEST_BAR * bar_of.corrected)
    if named and "frequency" in of:
        found["frequency"] = _frequency(model_or_shell, answer, bar, estimator.lowest_eigenvalue(finer, stresses))
    return {name: found[name] for name in of}


def _lost(shell: Shell, force: Array, x: Array) -> float:
    """Force [N] by which a load ``force`` (n, 3) [N] and reactions are out of balance at x (n, 3) [m]."""
    return float(np.linalg.norm((force + shell.reactions(x, force=force)).sum(axis=0)))


def _chosen(
    of: Sequence[str] | Mapping[str, Quantity], shell: Shell, answer: Equilibrium, force: Callable[[Array], Array]
) -> dict[str, Quantity]:
    """What reads each quantity but the frequency, under a ``force`` (n, 3) [N] of positions."""
    if isinstance(of, Mapping):
        return dict(of)
    if isinstance(of, str) or not all(name in UNITS for name in of):
        raise OptionError(f"of must name some of {', '.join(UNITS)}, or map names to functions (got {shown(of)})")
    if "von_mises" in of and not isinstance(shell.material, Sheet):
        raise OptionError("von_mises needs a thickness: take ms.Isotropic in place of a Material")
    rest = shell.rest_positions
    tip = int(np.argmax(np.linalg.norm(answer.positions - rest, axis=1)))

    def reactions(x: Array) -> float:
        parts = shell.support_reactions(x, force=force(x))
        return max((float(np.linalg.norm(part.sum(axis=0))) for part in parts), default=0.0)

    known: dict[str, Quantity] = {
        "tip": lambda x: float(np.linalg.norm(x[tip] - rest[tip])),
        "von_mises": lambda x: float(shell.fields(x).values("von_mises").max()),
        "reactions": reactions,
    }
    return {name: known[name] for name in of if name in known}


def _frequency(model: Model | Shell, answer: Equilibrium, bar: ErrorBar, exact: float) -> QuantityBar:
    """Lowest frequency [Hz] about the answer by its own model, and about the corrected one by DS.

    ``exact`` is the square [1/s^2] of the latter's angular one.
    """
    assert answer.loading is not None
    own = None
    if not isinstance(model, Shell):
        own = model.tangent_eigenvalue(answer, answer.loading.force(answer.positions))
    if own is None:
        raise OptionError("a frequency needs the model that found the answer, one that has frequencies")
    value, corrected = (float(np.sqrt(max(one, 0.0)) / (2.0 * np.pi)) for one in (own, exact))
    return QuantityBar(value, corrected, UNITS["frequency"], bar.valid and not bar.beyond and exact > 0.0)
