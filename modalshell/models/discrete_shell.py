"""DS, discrete shells: the full nonlinear shell [choi2007, section 3], the truth of the ladder."""

from __future__ import annotations

from typing import final

from modalshell.models.full import FullModel
from modalshell.typing import Index


@final
class DiscreteShell(FullModel):
    """DS: the discrete-shell energies as they stand; options as for :class:`FullModel`."""

    name = "DS"

    def holding(self, vertices: Index) -> DiscreteShell:
        """The same model, with further vertices held."""
        return DiscreteShell(
            self.shell.holding(vertices),
            integrator=self.integrator,
            allow_unstable_step=self.allow_unstable_step,
            step_tolerance=self.step_tolerance,
            backend=self._factoriser.backend,
        )
