"""Equilibria: positions, outcome and solver statistics of a static solve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, final

import numpy as np
import scipy.linalg
import scipy.sparse as sps
from numpy.typing import NDArray

from modalshell.core.checks import finite_answer
from modalshell.core.drawn import Drawn
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.mesh import TriangleMesh
from modalshell.modes.flutter import complex_among
from modalshell.shell import CreaseState
from modalshell.shell.pattern import SparsePattern
from modalshell.statics.error_bar import ErrorBar
from modalshell.statics.live_loads import LiveLoads
from modalshell.statics.verdict import LEVEL
from modalshell.supports.constraints import Constraint


@final
@short_repr
@dataclass(frozen=True)
class Equilibrium(Drawn):
    """A static solution with its outcome and solver statistics.

    Attributes
    ----------
    positions : ndarray, shape (n, 3)
        Vertex positions [m]; the best iterate where the solver did not converge.
    outcome : Outcome
        How the search ended; ``Outcome.CONVERGED`` where ``residual`` met the model's tolerance at a state that the
        model can hold and that is not known to be unstable, ``Outcome.DISTORTED`` where it did at a state that no
        modal model describes.
    message : str
        Message about the solution; empty if there is none.
    iterations : int
        Solver iterations over the whole load path.
    residual : float
        Out-of-balance force relative to the load (model-specific norm, see each model).
    stable : bool or None
        Whether it is stable; None if unknown.
    seconds : float
        Wall time.
    coordinates : ndarray or None
        Of reduced models: modal coordinates (m,), or positions (k, 3) [m] of the vertices of a coarse mesh.
    costs : dict
        Seconds of each part of the solver (assembly, factorisation, solution) of full models.
    constraint_residuals : ndarray, shape (k,)
        How far each constraint is from its target: [m] for positions, [rad] for orientations.
    constraint_reactions : ndarray, shape (k, 3)
        What each constraint does to the shell: the force [N] that holds a patch at its position, or the moment [N m]
        about its mean position that holds it in its orientation.
    contact_forces : ndarray, shape (n, 3)
        Force of the contacts on every vertex [N]; empty without contacts, as the next one.
    in_contact : ndarray of bool, shape (n,)
        Vertices that touch a collider.
    deepest : float
        Depth of the deepest vertex inside a collider [m]; 0 where none is inside.
    contacts : tuple of Contact
        Contacts under which it was found.
    constraints : tuple of Constraint
        Constraints under which it was found.
    self_contact : float or None
        Smallest distance [m] of parts in self-contact, its gap where none are nearer; None without it.
    creases : CreaseState or None
        What creases have kept, of a shell that has them: ``shell.creased(state.creases)`` resumes there.
    conservative : bool
        Whether the load has a potential; ``message`` says so where it has none.
    loading, gravity
        The load, for derivatives of the solution; None if unknown.
    mesh : TriangleMesh or None
        The mesh at rest, for pictures; None if unknown.
    bar : ErrorBar or None
        Estimated distance from DS, if it was requested.
    """

    positions: Array
    outcome: Outcome
    message: str
    iterations: int
    residual: float
    stable: bool | None
    seconds: float = 0.0
    coordinates: Array | None = None
    costs: dict[str, float] = field(default_factory=dict)
    constraint_residuals: Array = field(default_factory=lambda: np.empty(0))
    constraint_reactions: Array = field(default_factory=lambda: np.empty((0, 3)))
    contact_forces: Array = field(default_factory=lambda: np.empty((0, 3)))
    in_contact: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))
    deepest: float = 0.0
    contacts: tuple[Any, ...] = field(default=(), repr=False, compare=False)
    constraints: tuple[Constraint, ...] = field(default=(), repr=False, compare=False)
    self_contact: float | None = None
    creases: CreaseState | None = field(default=None, compare=False)
    conservative: bool = True
    loading: Loading | None = field(default=None, repr=False, compare=False)
    gravity: Array | None = field(default=None, repr=False, compare=False)
    mesh: TriangleMesh | None = field(default=None, repr=False, compare=False)
    bar: ErrorBar | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        finite_answer("the equilibrium's positions", self.positions)

    def __str__(self) -> str:
        if self.bar is None:
            return repr(self)
        return f"{self.outcome.with_message(self.message)}; {self.bar}"

    def load_stiffness(self, pattern: SparsePattern) -> Array:
        """Minus the derivatives of the load's forces by the positions, as entries of a Hessian; zero of dead loads."""
        data = np.zeros(pattern.size)
        if self.loading is not None and self.loading.live:
            LiveLoads(self.loading).add_stiffness(pattern, self.positions, data)
        return data

    def load_matrix(self, pattern: SparsePattern) -> sps.csr_array | None:
        """The same as a matrix (3n, 3n); None of dead loads."""
        if self.loading is None or not self.loading.live:
            return None
        return pattern.matrix(self.load_stiffness(pattern))

    def lowest_eigenvalue(
        self, hessian: Array, pattern: SparsePattern, moves: Callable[[], tuple[Array, Array]]
    ) -> float:
        """Lowest eigenvalue [1/s^2] of a Hessian (m, m) by coordinates of unit mass, and of the load's stiffness.

        ``moves`` finds what takes rates of coordinates to velocities (3n, m), and loads, turned around, to forces on
        coordinates (3n, m). Of loads without a potential it is 0 where one is complex: there the shell flutters.
        """
        if (resisting := self.load_matrix(pattern)) is None:
            return float(scipy.linalg.eigvalsh(hessian, subset_by_index=(0, 0))[0])
        moved, pushed = moves()
        values = scipy.linalg.eigvals(hessian + pushed.T @ (resisting @ moved))
        lowest = float(values.real.min())
        return min(lowest, 0.0) if not self.conservative and complex_among(values) else lowest

    def lowest_real_part(
        self, tangent: Array, pattern: SparsePattern, moves: Callable[[], Array], push: Callable[[Array], Array]
    ) -> float:
        """Lowest real part of the eigenvalues [1/s^2] of a tangent (m, m) by modal coordinates, and of the load's.

        ``moves`` finds what takes rates of coordinates to velocities (3n, m), and ``push`` the force on coordinates
        (m,) of a load (n, 3). Where loads without a potential make the shell flutter, it is at most 0. For warped
        models the symmetric part of the tangent is used: the other part comes from the warp, not from the shell.
        """
        if (resisting := self.load_matrix(pattern)) is None:
            return float(scipy.linalg.eigvals(tangent).real.min())
        moved = moves()
        pulled = resisting @ moved
        further = np.stack([push(column.reshape(-1, 3)) for column in pulled.T], axis=1)
        lowest = float(scipy.linalg.eigvals(tangent + further).real.min())
        if self.conservative:
            return lowest
        own = 0.5 * (tangent + tangent.T) + moved.T @ pulled
        return min(lowest, 0.0) if complex_among(scipy.linalg.eigvals(own)) else lowest

    @property
    def converged(self) -> bool:
        """Whether the model's own equations are solved: ``Outcome.CONVERGED``, or ``DISTORTED`` beyond its reach."""
        return self.outcome.solved

    @property
    def status(self) -> str:
        """The outcome as text."""
        return str(self.outcome)


def where_level(
    end: Equilibrium, loading: Loading, curves_down: Callable[[Array], bool | None], *, drifts: bool = False
) -> Equilibrium:
    """The end of a search; one called a saddle has converged where ``curves_down`` of its positions (n, 3) is False.

    Its Hessian is singular then, to rounding. That of a shell that ``drifts`` is so along its free motions, and the
    shell is stable; of another one stability is not known. Live loads, and creases of a held shell, are left as they
    are.
    """
    known = end.outcome is not Outcome.UNSTABLE or loading.live or (end.creases is not None and not drifts)
    if known or curves_down(end.positions) is not False:
        return end
    return replace(end, outcome=Outcome.CONVERGED, message="" if drifts else LEVEL, stable=True if drifts else None)
