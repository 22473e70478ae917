"""What the hybrid says of its errors: its coarse shell's own against DS, and where none holds, next to a snap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modalshell.core.errors import SolverError
from modalshell.core.typing import Array
from modalshell.loads import Loading
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.models.hybrid.assumed_stress import StressPotential
from modalshell.models.hybrid.training import Trained
from modalshell.shell import EXACT, Shell
from modalshell.shell.measure import displacement_error
from modalshell.statics.mixed_newton import SHORT
from modalshell.statics.newton import is_minimum, mixed_newton

SHARES = (0.25, 0.5, 0.75, 1.0)
"""Shares of the load under which the coarse shell is compared with DS."""
_ORDER = (3, 1, 2, 0)
"""Which of them come first where not all may."""
_COST = 0.1
"""Part of the training's cost that the comparison may add."""
_IN_FRAME, _IN_ANSWER = 3, 8
"""Newton iterations in a frame of training, and in an answer of DS next to that of the coarse shell."""
_NO_STATE = 1.0
"""Error where DS has no stable state next to that of the coarse shell."""
_MARGIN = 0.25
"""Change of the load, as a share of it, that brings a snap, below which no error is known."""
_SMALL = 1e-3
"""Change of the load to either side over which the Hessian is differenced."""


def coarse_errors(model: CoarseDiscreteShell, load: Array, frames: int) -> Array:
    """Shares of a load (n, 3) [N] and the coarse shell's error against DS at rest under each, shape (c, 2).

    The coarse shell follows the load from rest; DS begins at its answer. An error of 1 says that DS has no stable state
    near. There are fewer loads the larger the fine shell and the fewer ``frames`` of training, but one at least; none
    where the shell is its own coarse one, or has parts that fall.
    """
    if model.coarse.shell is model.shell or model.free_parts is not None:
        return np.empty((0, 2))
    start, answers = None, {}
    for share in SHARES:
        found = model.equilibrium(force=share * load, start=start)
        if found.converged:
            start = answers[share] = found.positions
    cost_of_iterations = (model.shell.unknowns.count / model.coarse.shell.unknowns.count) ** 1.5
    most = max(1, int(_COST * frames * _IN_FRAME / (_IN_ANSWER * cost_of_iterations)))
    shares = [SHARES[at] for at in _ORDER if SHARES[at] in answers][:most]
    errors = [(share, _error(model.shell, share * load, answers[share])) for share in sorted(shares)]
    return np.array(errors).reshape(-1, 2)


def _error(shell: Shell, load: Array, positions: Array) -> float:
    """Error of a coarse shell's answer (n, 3) [m] against the state of DS next to it, at most 1."""
    problem, origin = DiscreteShell(shell).problem(Loading(shell.rest_positions, load))
    start = positions - origin
    try:
        found = mixed_newton(problem, start, problem.scale_at(start), limit=SHORT)
    except SolverError:
        return _NO_STATE
    if not is_minimum(problem, found):
        return _NO_STATE
    return min(_NO_STATE, displacement_error(positions, found.point + origin, shell))


def stated(trained: Trained, snap: str = "") -> str:
    """The errors that training measured; none of them holds next to a ``snap``."""
    if snap:
        return f"trained on {trained.description}; next to a snap ({snap}) no error is known"
    own = f"error {100 * trained.held_out_error:.1f} % on held-out loads (90th percentile)"
    shares, errors = trained.coarse_errors.T
    near = errors < _NO_STATE
    parts = [own]
    if near.any():
        least, most = (f"{100 * value:.2g}" for value in (errors[near].min(), errors[near].max()))
        size = most if least == most else f"{least} to {most}"
        parts.append(f"its coarse shell's own {size} % against DS at rest under {_listed(shares[near])} of the load")
    if not near.all():
        parts.append(f"DS has no stable state near that of the coarse shell under {_listed(shares[~near])} of the load")
    return f"trained on {trained.description}; {', '.join(parts)}, more just below a snap"


def _listed(shares: Array) -> str:
    """Shares as words: 0.25, 0.5 and 1."""
    words = [f"{share:g}" for share in shares]
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def next_to_snap(problem: StressPotential, z: Array, jumps: Sequence[tuple[str, float]]) -> str:
    """Which snap is near an equilibrium z (m,), with what happened on the way to it; empty where none is.

    A snap is near where the lowest eigenvalue would vanish, if it changed with the load as it does at z, or where a
    stable branch has just ended.
    """
    for _, share in jumps:
        if abs(share - 1.0) < _MARGIN:
            return f"a stable branch ends at {share:.2g} of this load"
    hessian = problem.linearise(z, EXACT)[1]
    try:
        rate = np.linalg.solve(hessian, problem.load)
    except np.linalg.LinAlgError:
        return "the stiffness vanishes at this load"
    eigenvalues, vectors = np.linalg.eigh(hessian)
    lowest, softest = float(eigenvalues[0]), vectors[:, 0]
    # A step along the straight line of the rate strains the membrane, of which the difference to both sides is free.
    before, after = (softest @ problem.linearise(z + step * rate, EXACT)[1] @ softest for step in (-_SMALL, _SMALL))
    slope = float(after - before) / (2.0 * _SMALL)
    if lowest < _MARGIN * abs(slope):
        return f"the stiffness vanishes at about {1.0 - lowest / slope:.2g} of this load"
    return ""
