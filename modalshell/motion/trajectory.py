"""The stored frames of a motion, with what the solver has to say about them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import DTypeLike, NDArray

from modalshell.models import Equilibrium
from modalshell.shell import Shell
from modalshell.typing import Array


@dataclass(frozen=True)
class Trajectory:
    """A simulated motion.

    Attributes
    ----------
    times : ndarray, shape (F,)
        Times of the stored frames [s], the start at 0 included.
    positions : ndarray of float64 or float32, shape (F, n, 3)
        Vertex positions [m]; every one finite.
    status : str
        "completed", or what went wrong and when. A motion that diverges keeps the frames up to there; one that wound
        up, cycles, missed its constraints or had steps that did not converge is kept whole.
    unconverged_steps : int
        Steps whose own solver did not converge.
    seconds : float
        Wall time.
    energies : ndarray, shape (F, 3)
        Kinetic and elastic energy and potential of the load [J] of each stored frame, in the model's own frame; the
        load's potential is zero at rest.
    constraint_residuals : ndarray, shape (F, k)
        How far each constraint is from its target: [m] for positions, [rad] for orientations.
    faces : ndarray of int, shape (T, 3)
        Triangles of the mesh.
    rest_positions : ndarray, shape (n, 3)
        Vertex positions at rest [m].
    """

    times: Array
    positions: NDArray[np.floating]
    status: str
    unconverged_steps: int
    seconds: float
    energies: Array = field(default_factory=lambda: np.empty((0, 3)))
    constraint_residuals: Array = field(default_factory=lambda: np.empty((0, 0)))
    faces: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    rest_positions: Array = field(default_factory=lambda: np.empty((0, 3)))

    @classmethod
    def still(cls, answer: Equilibrium, shell: Shell, load: Array, dtype: DTypeLike = np.float64) -> Trajectory:
        """One frame at time 0: a static answer under ``load`` (n, 3) [N], its status the solver's."""
        moved = answer.positions - shell.rest_positions
        energies = [0.0, shell.raw_energy(answer.positions), -float(np.vdot(load, moved))]
        return cls(
            np.zeros(1),
            answer.positions[None].astype(dtype),
            answer.status,
            int(not answer.converged),
            answer.seconds,
            np.array([energies]),
            answer.constraint_residuals[None],
            np.asarray(shell.mesh.faces),
            shell.rest_positions,
        )
