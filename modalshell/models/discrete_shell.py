"""DS, discrete shells: the full nonlinear shell [choi2007, section 3], the reference of all comparisons."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import ModalShellError
from modalshell.core.typing import Array, Index
from modalshell.integrators.state import MotionState
from modalshell.loads import Loading
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.full import FullModel
from modalshell.models.rotation_strain import RotationStrain
from modalshell.modes import lowest_modes
from modalshell.modes.rigid import left_free
from modalshell.shell.strain_range import ends_strained, strained_beyond
from modalshell.supports.constraints import Constraint

_MODES = 8
"""Modes of the model whose answer begins statics with contacts."""
_FEW, _MANY, _SHARE = 64, 256, 4
"""Vertices that bear contacts there: one in four, but not fewer and not more than these."""
_SHAPES = 2_000_000
"""Vertices at most, times those that bear contacts: RSW keeps the shape of the shell under a force on each of these."""


@final
class DiscreteShell(FullModel):
    """DS: the discrete-shell energies, with all vertices free.

    Statics with contacts without friction tries the whole load from rest; where that fails, from the answer of RSW in a
    few modes with contacts at some vertices spread over the shell; and where this fails too, or would raise the
    potential or pass a collider, the shell goes downhill from rest: in a thick fluid, and where that fails by steps
    that lower the potential. ``iterations`` are Newton's of DS: from RSW's answer on where the minimum is found from
    it, else all. ``message`` says where strains are beyond those that a material's law is meant for.

    Parameters
    ----------
    shell : Shell
        The shell.
    integrator : str or FullIntegrator
        ``"composite"``: two solves a step, to ``step_tolerance`` (second order, stable at any step). ``"sdirk2"``: two
        solves (second order, but first where a stiff sheet swings about its supports). ``"bdf2"``: one solve (second
        order). ``"implicit"``, or ``"implicit_euler"``: implicit Euler (first order, loses energy).
        ``"linear_implicit"``: one Newton step of it (first order). ``"explicit"``: symplectic Euler (first order, the
        paper's choice for DS) and ``"verlet"`` (second order), both stable below :meth:`stable_step` only. Or
        the key of any other :class:`modalshell.integrators.full.FullIntegrator`, or a rule itself.
    allow_unstable_step : bool
        Whether explicit integrators may exceed their stability estimate.
    step_tolerance : float
        Out-of-balance force at which an implicit step's Newton stops, as a share of its load and inertia.
    backend : str, optional
        Factorisation to use; see :class:`modalshell.modes.Factoriser`.

    Attributes
    ----------
    costs : dict
        Seconds of assembly, factorisation and solution so far.
    """

    name = "DS"

    def holding(self, vertices: Index) -> DiscreteShell:
        """The same model, with further vertices held."""
        return DiscreteShell(
            self.shell.holding(vertices),
            integrator=self.integrator,
            allow_unstable_step=self.allow_unstable_step,
            step_tolerance=self.step_tolerance,
            backend=self.factoriser.backend,
        )

    def beyond_range(self, answer: Equilibrium, constraints: Sequence[Constraint]) -> str:
        """What is said of an answer with large membrane strains."""
        return strained_beyond(self.shell, answer.positions)

    def account(self, state: MotionState) -> str:
        """What is said of a motion that ends with large membrane strains."""
        return ends_strained(self.shell, self.positions(state))

    def _near_contacts(self, loading: Loading, contacts: Sequence[Any]) -> Array | None:
        """Positions (n, 3) [m] of RSW with contacts at some vertices; None where RSW has no answer."""
        shell, size = self.shell, len(self.shell.rest_positions)
        if left_free(shell) or any(contact.push_out for contact in contacts):
            return None
        most = max(1, min(max(_FEW, size // _SHARE), _MANY, _SHAPES // size) // len(contacts))
        try:
            masks = [contact.vertices(shell.mesh) & ~shell.clamped for contact in contacts]
            some = [c.on(_spread(shell.rest_positions, mask, most)) for c, mask in zip(contacts, masks, strict=True)]
            model = RotationStrain(lowest_modes(shell, min(_MODES, shell.unknowns.count))[0])
            found = model._solve_touching(loading, None, some, ())
        except ModalShellError:
            return None
        return found.positions if found.converged else None


def _spread(points: Array, chosen: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """Mask (n,) of at most some of the ``chosen`` (n,) points (n, 3) [m], each the farthest from those before."""
    places = np.flatnonzero(chosen)
    own = points[places] - points.mean(axis=0)
    apart, mask = np.sum(own**2, axis=1), np.zeros(len(points), dtype=bool)
    for _ in range(min(most, len(places))):
        following = int(apart.argmax())
        distance = np.sum((own - own[following]) ** 2, axis=1)
        apart = np.minimum(apart, distance) if mask.any() else distance
        mask[places[following]] = True
    return mask
