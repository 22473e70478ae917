"""DS, discrete shells: the full nonlinear shell [choi2007, section 3], the reference of all comparisons."""

from __future__ import annotations

from typing import final

from modalshell.core.typing import Index
from modalshell.models.base.full import FullModel


@final
class DiscreteShell(FullModel):
    """DS: the discrete-shell energies, with all vertices free.

    Parameters
    ----------
    shell : Shell
        The shell.
    integrator : str or FullIntegrator
        ``"sdirk2"``: two solves a step, to ``step_tolerance`` (second order, stable at any step). ``"bdf2"``: one solve
        (second order). ``"implicit"``, or ``"implicit_euler"``: implicit Euler (first order, loses energy).
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
