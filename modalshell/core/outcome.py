"""Outcomes: one enumeration for statics, motion, sweeps and the stability atlas."""

from __future__ import annotations

from enum import StrEnum


class Outcome(StrEnum):
    """Named outcome of an equilibrium, a motion or a case of a sweep; ``str(outcome)`` is its status.

    Members are ordered from best to worst: if several apply, the last one is reported.
    """

    CONVERGED = "converged"
    """Statics: the residual met its tolerance at a state that the model can hold."""
    COMPLETED = "completed"
    """Motion: every step succeeded."""
    STOPPED = "stopped"
    """Ended by a time limit or by the user; can be resumed."""
    STEPS_NOT_CONVERGED = "steps not converged"
    """Motion: the solver of some steps missed its tolerance."""
    CONSTRAINTS_MISSED = "constraints missed"
    """Motion: a target was not met to tolerance at some stored frame, or colliders left no room there."""
    ROUNDING_LIMITED = "rounding limited"
    """Statics: rounding keeps the residual above its tolerance."""
    INACCURATE = "inaccurate"
    """Finished, but farther from the reference than requested."""
    OUT_OF_REACH = "out of reach"
    """Statics: no state of the model meets the constraints."""
    DISTORTED = "distorted"
    """Area (of all or a tenth of the surface) doubled or halved, or triangles inverted: beyond modal models."""
    CYCLING = "cycling"
    """Motion: damped motion under a constant load does not settle."""
    UNSTABLE = "unstable"
    """In equilibrium, or at rest after motion, at a saddle of the energy: unstable."""
    NO_FIXED_POINT = "no fixed point"
    """Statics: the branch of fixed points ends before the load is reached."""
    NO_EQUILIBRIUM = "no equilibrium"
    """Statics: the load acts on a rigid motion that the supports leave free."""
    NOT_CONVERGED = "not converged"
    """Statics: the residual missed its tolerance."""
    WOUND_UP = "wound up"
    """A vertex or triangle turned by more than 2 pi."""
    RUNS_AWAY = "runs away"
    """Motion: the energy grows far beyond the work of the load."""
    DIVERGED = "diverged"
    """The state is not finite any more."""
    REFUSED = "refused"
    """The input was refused before any work."""
    FAILED = "failed"
    """An error ended the work."""

    @property
    def succeeded(self) -> bool:
        """Whether the answer can be used without a caveat."""
        return self in (Outcome.CONVERGED, Outcome.COMPLETED)

    @property
    def solved(self) -> bool:
        """Whether a static result solves the model's equations, even if the state is outside the model's range."""
        return self in (Outcome.CONVERGED, Outcome.DISTORTED)

    def with_message(self, message: str) -> str:
        """The outcome as text, followed by the message if there is one."""
        return f"{self}: {message}" if message else str(self)


def gravest(*outcomes: Outcome) -> Outcome:
    """The worst of some outcomes."""
    order = list(Outcome)
    return max(outcomes, key=order.index)
