"""Outcome and message of a static solve, by one rule for full, coarse and reduced models."""

from __future__ import annotations

from modalshell.core.outcome import Outcome
from modalshell.statics.mixed_newton import ACCEPTED

_GROWS = (
    "in balance, but without damping the smallest push aside grows, as at a saddle or in flutter: whether damping, "
    "that of wind too, holds it is shown by a motion from there"
)
LEVEL = (
    "in balance, but some shapes resist no small push, or too little to tell from rounding, as those of flat sheets of "
    "springs out of their plane: whether it is stable is not known"
)


def verdict(
    residual: float, stable: bool | None, *, limited: bool = False, note: str = "", follows: bool = False
) -> tuple[Outcome, str]:
    """Outcome and message of an answer with this residual, whose Hessian is positive definite or not.

    ``limited``: whether rounding limits the residual; ``note`` is added to the message. ``follows``: whether the load
    has no potential, as wind: then what is not stable without damping may flutter instead, and be held by damping.
    """
    if residual <= ACCEPTED:
        if stable:
            return Outcome.CONVERGED, note
        if follows:
            return Outcome.UNSTABLE, _GROWS
        return Outcome.UNSTABLE, "in balance at a saddle, which the smallest push aside leaves"
    if limited:
        return (
            Outcome.ROUNDING_LIMITED,
            f"rounding keeps the residual at {residual:.1e} of {ACCEPTED:.0e}: the membrane is too stiff for this load",
        )
    return Outcome.NOT_CONVERGED, f"residual {residual:.1e} of {ACCEPTED:.0e}"
