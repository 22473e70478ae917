"""Error bars along a motion, at the frames that were checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Mask
from modalshell.core.units import in_percent
from modalshell.statics.error_bar import LARGEST_BAR, ErrorBar, bar_as_text, share_as_text

_MOST = 1e9
"""Size of a bar or margin above which all are alike; files hold finite numbers."""


def check_text(error: float, valid: bool, unjudged: str = "") -> str:
    """What a check says, in a few words."""
    return f"{in_percent(error)} from DS" if valid else f"bar void: {unjudged}" if unjudged else "bar void"


@final
@short_repr
@dataclass(frozen=True)
class Bars:
    """Error bars of a motion: at each checked frame that of the balance with d'Alembert's inertial loads."""

    times: Array
    """Times of the checked frames [s]; that of an equilibrium is 0; shape (B,)."""
    displacement: Array
    """Estimated distance from DS, over the largest displacement of the motion up to then, in the norm of the mass;
    shape (B,)."""
    margin: Array
    """Stability margin; see :class:`modalshell.ErrorBar`; shape (B,)."""
    valid: Mask
    """Whether the bar holds; shape (B,). Of models that do not know which branch DS has taken, none holds once one
    was void: bars tell of branches, not of histories."""
    on: str = "shell"
    """Where they were found: on the "shell", or on a "coarse" one, whose own error is a floor to them."""
    unjudged: tuple[str, ...] = ()
    """Why each frame could not be judged, as something strikes a collider there, say; "" where it could. Such bars
    are void, and those after them hold. Empty without contacts."""

    @classmethod
    def of(cls, times: Array, displacement: Array, margin: Array, valid: Mask) -> Bars:
        """Bars of finite numbers, the largest ones cut to 1e9."""
        return cls(times, np.clip(displacement, 0.0, _MOST), np.clip(margin, -_MOST, _MOST), valid)

    @classmethod
    def still(cls, bar: ErrorBar) -> Bars:
        """That of an equilibrium."""
        numbers = (np.zeros(1), np.array([bar.displacement]), np.array([bar.margin]))
        return cls.of(*numbers, np.array([bar.valid]))

    @property
    def largest(self) -> float:
        """The largest valid bar; 0 if there is none."""
        return float(self.displacement[self.valid].max(initial=0.0))

    @property
    def least_margin(self) -> float | None:
        """The smallest stability margin; None where none could be found."""
        known = self.margin[self.margin > -_MOST]
        return float(known.min()) if known.size else None

    @property
    def void_from(self) -> float | None:
        """Time [s] of the first bar that is void, of frames that could be judged; None if all hold."""
        void = self._void
        return float(self.times[void[0]]) if void.size else None

    @property
    def _void(self) -> NDArray[np.intp]:
        void = ~self.valid
        if self.unjudged:
            void &= np.array(self.unjudged) == ""
        return np.flatnonzero(void)

    def texts(self) -> list[str]:
        """What each check says, in a few words."""
        numbers = zip(self.displacement, self.valid, self.unjudged or [""] * len(self.valid), strict=True)
        return [check_text(float(error), bool(valid), unjudged) for error, valid, unjudged in numbers]

    def __str__(self) -> str:
        if not self.times.size:
            return "no frame was checked: bars take three frames"
        if self.times[0] == 0.0:  # an equilibrium: motions are not checked at their start
            unknown = self.margin[0] <= -_MOST
            return "no error bar" if unknown else bar_as_text(float(self.displacement[0]), float(self.margin[0]))
        parts = []
        if self.valid.any():
            large = self.largest > LARGEST_BAR
            error = f"beyond {100.0 * LARGEST_BAR:.0f} %" if large else f"up to {share_as_text(self.largest)}"
            parts.append(f"{error} from DS" + ", found on a coarse shell" * (self.on == "coarse"))
        if self.void_from is not None:
            margin = self.margin[self._void[0]]
            parts.append(f"void from {self.void_from:.4g} s on (stability margin {margin:.2f} there)")
        for reason in dict.fromkeys(filter(None, self.unjudged)):
            count = self.unjudged.count(reason)
            parts.append(f"void in {count} frame{'s' * (count > 1)}: {reason}")
        return ", ".join(parts)
