"""Cubature (hyper-reduction) of the reduced energy: few weighted elements replace all [an2008; farhat2014].

See theory 10, eq. 3 and 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.short_repr import short_repr
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array, Index
from modalshell.models.reduction.candidates import candidates_of, picked
from modalshell.models.reduction.derivatives import DerivativeBasis
from modalshell.models.reduction.reduced_energy import ReducedEnergy, ReducedPotential
from modalshell.shell import Shell
from modalshell.statics.continuation import equilibrium
from modalshell.statics.newton import NewtonResult

_GOAL = 0.005
"""Displacement error on training loads at which no more elements are taken."""
_PROBES = 30
"""Number of small random displacements added to the training: they keep every coordinate stiff."""
_GROWTH = 0.2
"""Relative growth of the set of elements between two fits."""
_FIRST_CHECK = 0.05
"""Relative residual of the fitted forces at which the answers are first looked at."""
_HELD_OUT = 4
"""One load in this many is held out."""
_GRAVITY_TURNS = (0.7, 2.5)
"""Largest rotations [rad] under the training loads by gravity, in turn."""
_MODE_TURN = 0.35
"""Largest turn [rad] of the load of a mode by itself, for a normal random number of one."""
MUCH_KEPT = 0.75
"""Share of the elements from which a model says that it keeps as many."""
_LOADS = 24
"""Training loads."""


@short_repr
@dataclass(frozen=True)
class Cubature:
    """A trained cubature."""

    energy: ReducedEnergy
    """The weighted sum over the chosen elements."""
    chosen: list[Index]
    """The chosen elements of each kind; see :mod:`modalshell.models.reduction.candidates`."""
    factors: Array
    """Their positive factors, in that order."""
    share: float
    """Chosen elements as a share of all that there are to choose from."""
    training_errors: Array
    held_out_errors: Array
    """Relative displacement error (norm of the mass matrix) of the nearest equilibrium to that of the sum over all
    elements, for each load; infinite if there is no solution."""
    seconds: float
    """Wall time of the training."""

    @property
    def held_out_error(self) -> float:
        """Largest error on the loads that training did not see."""
        return float(self.held_out_errors.max())


def checked_loads(loads: Sequence[ArrayLike], shell: Shell) -> list[Array]:
    """Training loads (n, 3) [N], or OptionError if one is zero or there are too few to hold one out."""
    checked = [checked_vectors("each training load", load, shell.rest_positions.shape) for load in loads]
    if len(checked) < _HELD_OUT:
        raise OptionError(
            f"training_loads must be at least {_HELD_OUT} loads, every {_HELD_OUT}th is held out (got {len(checked)})"
        )
    for number, load in enumerate(checked):
        if not load[shell.free].any():
            raise OptionError(f"each of training_loads must push a vertex that is free (number {number} does not)")
    return checked


def default_loads(basis: DerivativeBasis) -> list[Array]:
    """Random gravity-like loads, each with random loads ``M phi_i`` on top, within the range that the modes allow.

    Gravity has a random direction; its size is such that linear modes under the direction that bends the shell most
    turn a vertex by 0.7 or 2.5 rad. Every mode's own load turns a vertex by 0.35 rad times a normal random number over
    the root of the number of modes. The random numbers are the same every time, along the mesh's own axes. A shell with
    parts that fall has no such gravity: its modes' own loads turn a vertex by 0.7 or 2.5 rad.
    """
    shell, modes, rigid = basis.shell, basis.modes, basis.modes.rigid_modes
    elastic, eigenvalues, rotations = modes.modes[:, rigid:], modes.eigenvalues[rigid:], modes.rotations[:, rigid:]
    mass = np.repeat(shell.mass, 3)
    participation = elastic.T @ (mass[:, None] * np.tile(np.eye(3), (len(shell.mass), 1)))

    def turn(q: Array) -> float:
        return float(np.linalg.norm((rotations @ q).reshape(-1, 3), axis=1).max())

    strongest = max(turn(column / eigenvalues) for column in (participation @ shell.mesh.axes.T).T)
    mode_sizes = np.array([1.0 / turn(q) for q in np.eye(eigenvalues.size)])
    random = np.random.default_rng(0)
    loads = []
    for index in range(_LOADS):
        direction = random.standard_normal(3) @ shell.mesh.axes
        size = _GRAVITY_TURNS[index % 2]
        q = (size if rigid else _MODE_TURN) * mode_sizes * random.standard_normal(eigenvalues.size)
        further = (mass * (elastic @ (eigenvalues * (q / np.sqrt(eigenvalues.size))))).reshape(-1, 3)
        if not rigid:
            further = shell.mass[:, None] * (size / strongest * direction / np.linalg.norm(direction)) + further
        loads.append(further)
    return loads


def train(basis: DerivativeBasis, full: ReducedEnergy, loads: Sequence[Array], most: int | None = None) -> Cubature:
    """Non-negative factors of few elements that meet the reduced forces at the training loads' equilibria.

    The columns of the least-squares problem are the reduced forces ``U^T grad E_e`` of one element at all poses
    (half-way to each equilibrium and at it, and small random ones about rest), the right side their sum over all
    elements; both in the norm of the inverse rest stiffness, over the load. Elements that point most along what is
    missing are taken first, and the factors refitted (NNLS) as their number grows, until the answers on the training
    loads are within 0.5 %, ``most`` elements are reached, or no further element helps. ``full`` is the energy over all
    elements. Of the loads (n, 3) [N] every fourth is held out.
    """
    import scipy.optimize  # not before there is something to train: its import takes long

    watch = Stopwatch()
    pushes = [load.ravel() @ basis.vectors for load in loads]
    answers = [_statics(basis, full, push) for push in pushes]
    solved = list(zip(pushes, answers, strict=True))
    unseen = solved[_HELD_OUT - 1 :: _HELD_OUT]
    seen = [pair for number, pair in enumerate(solved, 1) if number % _HELD_OUT]
    poses, sizes = _poses(basis, seen)
    candidates = candidates_of(basis, poses, sizes)
    matrix = candidates.columns(poses, sizes)
    goal = np.zeros((len(poses), matrix.shape[0] // len(poses)))
    goal[:, : basis.size] = [full.gradient(z)[1] / size for z, size in zip(poses, sizes, strict=True)]
    goal[:, : basis.size] /= np.sqrt(basis.eigenvalues)
    goal = goal.ravel()

    limit = min(matrix.shape[1], most or matrix.shape[1])
    chosen, factors, residual, check = np.empty(0, np.int64), np.empty(0), 1.0, _FIRST_CHECK
    while True:
        score = matrix.T @ (goal - matrix[:, chosen] @ factors)
        score[chosen] = -np.inf
        batch = min(limit - chosen.size, max(4, int(_GROWTH * chosen.size)))
        chosen = np.sort(np.concatenate([chosen, np.argsort(-score)[:batch]]))
        factors, distance = scipy.optimize.nnls(matrix[:, chosen], goal, maxiter=30 * chosen.size)
        chosen, factors = chosen[factors > 0.0], factors[factors > 0.0]
        previous, residual = residual, float(distance / np.linalg.norm(goal))
        last = chosen.size >= limit or abs(previous - residual) < 1e-6
        if residual <= check or last:
            check = 0.8 * residual
            groups = picked(candidates.groups, chosen)
            energy = ReducedEnergy(basis.shell, basis.vectors, candidates.part(groups, factors))
            training = _errors(basis, energy, seen)
            if last or training.max() <= _GOAL:
                break
    held = _errors(basis, energy, unseen)
    return Cubature(energy, groups, factors, chosen.size / candidates.total, training, held, watch())


def _statics(basis: DerivativeBasis, energy: ReducedEnergy, push: Array, start: Array | None = None) -> NewtonResult:
    problem = ReducedPotential(push, np.zeros_like(push), energy, np.sqrt(basis.eigenvalues), basis.edge_change)
    with np.errstate(over="ignore", invalid="ignore"):
        return equilibrium(problem, start)


def _errors(basis: DerivativeBasis, energy: ReducedEnergy, solved: Sequence[tuple[Array, NewtonResult]]) -> Array:
    errors = np.full(len(solved), np.inf)
    for k, (push, full) in enumerate(solved):
        few = _statics(basis, energy, push, full.point)
        if few.converged and full.converged:
            errors[k] = np.linalg.norm(few.point - full.point) / np.linalg.norm(full.point)
    return errors


def _poses(basis: DerivativeBasis, solved: Sequence[tuple[Array, NewtonResult]]) -> tuple[Array, Array]:
    """Coordinates (poses, r) to train on, and the size of the force that holds each."""
    scaling = np.sqrt(basis.eigenvalues)
    poses, sizes = [], []
    for push, answer in solved:
        path = answer.path
        for factor, z in {len(path) // 2: path[len(path) // 2], len(path) - 1: path[-1]}.values():
            poses.append(z)
            sizes.append(factor * float(np.linalg.norm(push / scaling)))
    small = 1e-3 * min(sizes)
    shell = basis.shell
    # Fields along the mesh's axes, and not coordinates: a shell that is turned may have others.
    fields = np.random.default_rng(0).standard_normal((_PROBES, len(shell.mass), 3)) @ shell.mesh.axes
    for direction in (np.sqrt(shell.mass)[:, None] * fields).reshape(_PROBES, -1) @ basis.vectors:
        poses.append(small * direction / np.linalg.norm(direction) / scaling)
        sizes.append(small)
    return np.array(poses), np.array(sizes)
