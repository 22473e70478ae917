"""Cubature of the reduced energy: few weighted elements whose forces stand for those of all [an2008; farhat2014]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from numpy.typing import ArrayLike

from modalshell.checks import checked_vectors
from modalshell.errors import OptionError
from modalshell.reduction.derivatives import DerivativeBasis
from modalshell.reduction.reduced_energy import ReducedEnergy
from modalshell.reduction.reduced_potential import ReducedPotential
from modalshell.shell import Shell
from modalshell.shell.elements import ElementSet
from modalshell.statics.continuation import equilibrium
from modalshell.statics.newton import NewtonResult
from modalshell.timings import Stopwatch
from modalshell.typing import Array, Index

_GOAL = 0.005
"""Displacement error on training loads at which no more elements are taken."""
_CANDIDATES = 4000
"""Elements to choose from; of more, so many are drawn at random."""
_PROBES = 30
"""Random small displacements about rest that are trained on besides: they keep every coordinate stiff."""
_GROWTH = 0.2
"""Share by which the set of elements may grow between two fits."""
_FIRST_CHECK = 0.05
"""Relative residual of the fitted forces at which the answers are first looked at."""
_HELD_OUT = 4
"""Every so many loads one is held out."""
_GRAVITY_TURNS = (0.7, 2.5)
"""Largest turns [rad] of the training loads by gravity, one after the other."""
_MODE_TURN = 0.35
"""Largest turn [rad] of the load of a mode by itself, for a normal random number of one."""
_LOADS = 24
"""Training loads."""


@dataclass(frozen=True)
class Cubature:
    """A trained cubature.

    Attributes
    ----------
    energy : ReducedEnergy
        The weighted sum over the chosen elements.
    chosen : list of ndarray of int
        The chosen triangles, each with its elements and its shares of those on its edges, and the chosen elements of
        each further set: hinges first.
    factors : ndarray
        Their positive factors, in that order.
    share : float
        Chosen elements as a share of all that there are to choose from.
    training_errors, held_out_errors : ndarray
        Relative displacement error (norm of the mass matrix) of the nearest equilibrium to that of the sum over all
        elements, for each load; infinite where one of them found none.
    seconds : float
        Wall time of the training.
    """

    energy: ReducedEnergy
    chosen: list[Index]
    factors: Array
    share: float
    training_errors: Array
    held_out_errors: Array
    seconds: float

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
    the root of the number of modes. The random numbers are the same every time.
    """
    shell, modes = basis.shell, basis.modes
    mass = np.repeat(shell.mass, 3)
    participation = modes.modes.T @ (mass[:, None] * np.tile(np.eye(3), (len(shell.mass), 1)))

    def turn(q: Array) -> float:
        return float(np.linalg.norm((modes.rotations @ q).reshape(-1, 3), axis=1).max())

    strongest = max(turn(column / modes.eigenvalues) for column in participation.T)
    mode_sizes = np.array([1.0 / turn(q) for q in np.eye(modes.count)])
    random = np.random.default_rng(0)
    loads = []
    for index in range(_LOADS):
        direction = random.standard_normal(3)
        gravity = _GRAVITY_TURNS[index % 2] / strongest * direction / np.linalg.norm(direction)
        q = _MODE_TURN * mode_sizes * random.standard_normal(modes.count) / np.sqrt(modes.count)
        further = mass * (modes.modes @ (modes.eigenvalues * q))
        loads.append(shell.mass[:, None] * gravity + further.reshape(-1, 3))
    return loads


def train(basis: DerivativeBasis, full: ReducedEnergy, loads: Sequence[Array], most: int | None = None) -> Cubature:
    """Non-negative factors of few elements that meet the reduced forces at the training loads' equilibria.

    Elements are triangles, each with its stretch and its shares of its edges' shear (which alone may be negative, or
    hold too little), hinges, and those of further energies. The columns of the least-squares problem are the reduced
    forces ``U^T grad E_e`` of one element at all poses (half-way to each equilibrium and at it, and small random ones
    about rest), the right side their sum over all elements; both in the norm of the inverse rest stiffness, over the
    load. Elements that point most along what is missing are taken first, and the factors fitted anew (NNLS) as their
    number grows, until the answers on the training loads are within 0.5 %, ``most`` elements are reached, or no further
    element helps.

    Parameters
    ----------
    basis : DerivativeBasis
        The reduced basis.
    full : ReducedEnergy
        Energy over all elements.
    loads : sequence of ndarray, shape (n, 3)
        Loads [N]; every fourth is held out.
    most : int, optional
        Largest number of elements.
    """
    watch = Stopwatch()
    shell = basis.shell
    pushes = [load.ravel() @ basis.vectors for load in loads]
    answers = [_statics(basis, full, push) for push in pushes]
    solved = list(zip(pushes, answers, strict=True))
    unseen = solved[_HELD_OUT - 1 :: _HELD_OUT]
    seen = [pair for number, pair in enumerate(solved, 1) if number % _HELD_OUT]
    poses, sizes = _poses(basis, seen)
    candidates, total = _candidates(shell)
    matrix = _force_columns(basis, candidates, poses, sizes)
    goal = _goal_column(basis, full, poses, sizes)

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
            picked = _picked(candidates, chosen)
            energy = _energy(basis, picked, factors)
            training = _errors(basis, energy, seen)
            if last or training.max() <= _GOAL:
                break
    held = _errors(basis, energy, unseen)
    return Cubature(energy, picked, factors, chosen.size / total, training, held, watch())


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
    for direction in np.random.default_rng(0).standard_normal((_PROBES, basis.size)):
        poses.append(small * direction / np.linalg.norm(direction) / scaling)
        sizes.append(small)
    return np.array(poses), np.array(sizes)


def _sorted_sets(shell: Shell) -> tuple[list[ElementSet], list[ElementSet], list[ElementSet]]:
    """The shell's element sets over triangles, over edges, and all others."""
    faces, edges, others = list[ElementSet](), list[ElementSet](), list[ElementSet]()
    for elements in shell.elements:
        if np.array_equal(elements.stencils, shell.mesh.faces):
            faces.append(elements)
        elif np.array_equal(elements.stencils, shell.mesh.edges):
            edges.append(elements)
        else:
            others.append(elements)
    return faces, edges, others


def _candidates(shell: Shell) -> tuple[list[Index], int]:
    """Triangles, and elements of each set on neither triangles nor edges, to choose from; and how many there are.

    All that can move, or a random sample of a large shell's.
    """
    stencils = [shell.mesh.faces, *(elements.stencils for elements in _sorted_sets(shell)[2])]
    groups = [np.flatnonzero(~shell.clamped[group].all(axis=1)) for group in stencils]
    count = sum(group.size for group in groups)
    if count > _CANDIDATES:
        groups = _picked(groups, np.sort(np.random.default_rng(0).choice(count, _CANDIDATES, replace=False)))
    return groups, sum(map(len, stencils))


def _picked(groups: Sequence[Index], numbers: Index) -> list[Index]:
    """Of groups that are numbered one after the other, the entries of the sorted ``numbers``, group by group."""
    starts = np.cumsum([0, *(group.size for group in groups)])
    cuts = np.searchsorted(numbers, starts)
    return [
        group[numbers[low:high] - start]
        for group, start, low, high in zip(groups, starts[:-1], cuts[:-1], cuts[1:], strict=True)
    ]


def _edge_shares(shell: Shell) -> Array:
    """Share of each edge (E,) that one of its triangles stands for: a half, or all of a boundary edge."""
    return 1.0 / np.bincount(shell.mesh.face_edges.ravel(), minlength=len(shell.mesh.edges))


def _energy(basis: DerivativeBasis, picked: Sequence[Index], factors: Array) -> ReducedEnergy:
    """Energy over weighted triangles, each with its shares of its edges, and weighted elements of the other sets."""
    shell = basis.shell
    parts = np.split(factors, np.cumsum([group.size for group in picked])[:-1])
    of_edges = np.zeros(len(shell.mesh.edges))
    np.add.at(of_edges, shell.mesh.face_edges[picked[0]], parts[0][:, None])
    sides = np.flatnonzero(of_edges)
    on_edges = (sides, (of_edges * _edge_shares(shell))[sides])
    faces, edges, _ = _sorted_sets(shell)
    others = iter(zip(picked[1:], parts[1:], strict=True))
    chosen = [(picked[0], parts[0]) if e in faces else on_edges if e in edges else next(others) for e in shell.elements]
    return ReducedEnergy(shell, basis.vectors, [indices for indices, _ in chosen], [values for _, values in chosen])


def _force_columns(basis: DerivativeBasis, candidates: Sequence[Index], poses: Array, sizes: Array) -> Array:
    """Scaled reduced force of each candidate, triangles first, at each pose (poses * r, candidates)."""
    shell = basis.shell
    faces, edges, others = _sorted_sets(shell)
    triangles = candidates[0]
    sides = shell.mesh.face_edges[triangles].ravel()
    # Every candidate on vertices of its own, so that the gradient of a sum holds each candidate's apart.
    own_triangles = np.arange(3 * triangles.size).reshape(-1, 3)
    own_edges = own_triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    shares = _edge_shares(shell)[sides]
    parts = [(e, own_triangles, e.rest[triangles], e.weight[triangles]) for e in faces]
    parts += [(e, own_edges, e.rest[sides], e.weight[sides] * shares) for e in edges]
    groups = [(shell.mesh.faces[triangles], parts)]
    for e, chosen in zip(others, candidates[1:], strict=True):
        own = np.arange(e.stencils[chosen].size).reshape(chosen.size, -1)
        groups.append((e.stencils[chosen], [(e, own, e.rest[chosen], e.weight[chosen])]))
    scaled = (basis.vectors / np.sqrt(basis.eigenvalues)).reshape(-1, 3, basis.size)
    displacements = (poses @ basis.vectors.T).reshape(len(poses), -1, 3)
    blocks = []
    for stencils, parts in groups:
        fields = scaled[stencils].reshape(len(stencils), -1, basis.size)
        forces = np.empty((len(poses), len(stencils), basis.size))
        for pose, displacement in enumerate(displacements):
            x = (shell.rest_positions + displacement)[stencils].reshape(-1, 3)
            gradient = np.zeros_like(x)
            for elements, own, rest, weight in parts:
                elements.kernel.add_gradient(x, own, rest, weight, gradient)
            np.matmul(gradient.reshape(len(stencils), 1, -1), fields, out=forces[pose][:, None])
            forces[pose] /= sizes[pose]
        blocks.append(forces.transpose(0, 2, 1).reshape(-1, len(stencils)))
    return np.hstack(blocks)


def _goal_column(basis: DerivativeBasis, full: ReducedEnergy, poses: Array, sizes: Array) -> Array:
    """Scaled reduced force of all elements at each pose (poses * r,)."""
    scaling = np.sqrt(basis.eigenvalues)
    return np.concatenate([full.gradient(z)[1] / scaling / size for z, size in zip(poses, sizes, strict=True)])
