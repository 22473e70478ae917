"""Base of models whose contacts a coarse shell bears."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.integrators.state import MotionState
from modalshell.models.base.implicit import ImplicitModel
from modalshell.models.base.setup import MotionSetup


class OnCoarse(ImplicitModel):
    """An implicit model that moves with a coarse shell, or may be handed over to one."""

    @property
    @abstractmethod
    def on_coarse(self) -> Any:
        """The :class:`CoarseDiscreteShell` that bears contacts."""

    def remembered(self, before: MotionState, after: MotionState) -> MotionState:
        """The state ``after`` a step that contacts took, with what the model remembers of its motion."""
        return after

    def contact_motion(self, setup: MotionSetup, origin: Array) -> Any:
        """What takes the steps of a motion with contacts: those that contacts press on are the coarse shell's."""
        from modalshell.models.coarse.contacts import CoarseContactMotion  # not without contacts

        if self.shell.creases is not None:
            raise OptionError("coarse DS in motion takes contacts or creases, not both: take ms.DiscreteShell")
        return CoarseContactMotion(self, setup, origin)
