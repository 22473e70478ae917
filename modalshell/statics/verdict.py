"""What is said of a static answer: one rule for full, coarse and reduced models."""

from __future__ import annotations

from modalshell.outcome import Outcome

ACCEPTED = 1e-7
"""Out-of-balance force, as a share of the load, at which an answer counts as converged."""


def verdict(residual: float, stable: bool | None, converged: bool) -> tuple[Outcome, str]:
    """Outcome and message of an answer with this residual, whose Hessian is positive definite or not."""
    if converged:
        return Outcome.CONVERGED, ""
    if stable is not False or not residual <= ACCEPTED:
        return Outcome.NOT_CONVERGED, f"residual {residual:.1e} of {ACCEPTED:.0e}"
    return Outcome.UNSTABLE, "in balance at a saddle, which the smallest push aside leaves"
