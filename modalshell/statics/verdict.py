"""Outcome and message of a static solve, by one rule for full, coarse and reduced models."""

from __future__ import annotations

from modalshell.core.outcome import Outcome
from modalshell.statics.mixed_newton import ACCEPTED


def verdict(residual: float, stable: bool | None, *, limited: bool = False, note: str = "") -> tuple[Outcome, str]:
    """Outcome and message of an answer with this residual, whose Hessian is positive definite or not.

    ``limited``: whether rounding limits the residual; ``note`` is added to the message.
    """
    if residual <= ACCEPTED:
        if stable:
            return Outcome.CONVERGED, note
        return Outcome.UNSTABLE, "in balance at a saddle, which the smallest push aside leaves"
    if limited:
        return (
            Outcome.ROUNDING_LIMITED,
            f"rounding keeps the residual at {residual:.1e} of {ACCEPTED:.0e}: the membrane is too stiff for this load",
        )
    return Outcome.NOT_CONVERGED, f"residual {residual:.1e} of {ACCEPTED:.0e}"
