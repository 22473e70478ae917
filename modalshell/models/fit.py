"""Constants of a material from measured positions, by least squares with exact Jacobians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy.optimize
import scipy.stats
from numpy.typing import ArrayLike

from modalshell.brief import brief
from modalshell.checks import as_array, checked_kind, checked_number, shown
from modalshell.errors import LoadError, OptionError, SolverError
from modalshell.loads import Load
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.models.equilibrium import Equilibrium
from modalshell.selection import Selection, selected
from modalshell.shell import Isotropic, Material, Shell
from modalshell.shell.energies_of import material_constants
from modalshell.typing import Array

_LIMIT = 100
"""Equilibria at most."""


@final
@brief
@dataclass(frozen=True)
class Fit:
    """Constants of a material that explain measured positions.

    Attributes
    ----------
    values : dict of float
        The constants, by name.
    intervals : dict of (float, float)
        Confidence interval of each, for independent errors of one variance.
    material : Material or Isotropic
        The material with these constants.
    state : Equilibrium
        The equilibrium of the shell with it.
    converged : bool
        Whether the least squares converged.
    residual : float
        Root mean square of the residual in the measured coordinates [m].
    evaluations : int
        Equilibria that were solved.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    material: Material | Isotropic
    state: Equilibrium
    converged: bool
    residual: float
    evaluations: int


def fit(
    shell: Shell,
    wrt: str | Sequence[str],
    observed: ArrayLike,
    *,
    where: Selection | None = None,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
    confidence: float = 0.95,
) -> Fit:
    """Recover constants of a shell's material from positions that were measured in equilibrium.

    Least squares by a trust region (``scipy.optimize.least_squares``) over the logarithms of the constants, Poisson's
    ratio as it is, with the Jacobians of :meth:`modalshell.DiscreteShell.sensitivity`.

    Parameters
    ----------
    shell : Shell
        The shell; its material has the first guess.
    wrt : str or sequence of str
        Constants to recover, such as ``"young"``; each one number for the whole mesh.
    observed : array_like, shape (k, 3)
        Measured positions [m]; NaN for coordinates that were not measured.
    where : selection, optional
        The k measured vertices, in the order of their numbers; by default all.
    gravity, force, loads
        The load, as in :meth:`modalshell.Model.equilibrium`.
    confidence : float
        Level of the intervals.

    Raises
    ------
    OptionError
        For names that are no constants of the material, or a shape that does not fit.
    LoadError
        For loads of the wrong shape, or no measured coordinate.
    SolverError
        If there is no equilibrium at the initial guess, or the measurements do not determine the constants.
    """
    checked_kind("shell", shell, Shell)
    if not isinstance(wrt, str | list | tuple) or not all(isinstance(name, str) for name in wrt):
        raise OptionError(f"wrt must be the name of a constant, or a list of names (got {shown(wrt)})")
    names = [wrt] if isinstance(wrt, str) else list(wrt)
    known = material_constants(shell.material)
    for name in names:
        if name not in known or (known[name] <= 0.0 and name != "poisson"):
            raise OptionError(f"wrt must be constants above 0 among {', '.join(known)} (got {shown(name)})")
    if not names or len(set(names)) < len(names):
        raise OptionError(f"wrt must name each constant once (got {shown(wrt)})")
    confidence = checked_number("confidence", confidence, above=0.0, at_most=0.999999)
    vertices = np.arange(len(shell.rest_positions))
    if where is not None:
        vertices = np.flatnonzero(selected("where", where, shell.mesh.vertices))
    measured = np.array(as_array("observed", observed, "positions of the measured vertices", OptionError), dtype=float)
    if measured.shape != (len(vertices), 3):
        raise OptionError(f"observed must have shape {(len(vertices), 3)} (got {measured.shape})")
    seen = np.isfinite(measured)
    if not seen.any():
        raise LoadError("observed must hold at least one measured coordinate (got none that is finite)")
    logarithmic = np.array([name != "poisson" for name in names])
    states: dict[bytes, tuple[DiscreteShell, Equilibrium]] = {}

    def constants(parameters: Array) -> Array:
        with np.errstate(over="ignore"):  # bounds of what is not determined
            return np.where(logarithmic, np.exp(np.where(logarithmic, parameters, 0.0)), parameters)

    def solved(parameters: Array) -> tuple[DiscreteShell, Equilibrium]:
        key = parameters.tobytes()
        if key not in states:
            changed = dict(zip(names, constants(parameters).tolist(), strict=True))
            material: Material | Isotropic = replace(shell.material, **changed)
            body = DiscreteShell(shell.with_material(material))
            start = next(reversed(states.values()))[1].positions if states else None
            answer = body.equilibrium(gravity=gravity, force=force, loads=loads, start=start)
            if not answer.converged and start is not None:
                answer = body.equilibrium(gravity=gravity, force=force, loads=loads)
            if not answer.converged:
                told = ", ".join(f"{name} = {value:.4g}" for name, value in changed.items())
                raise SolverError(f"no equilibrium was found at {told} ({answer.status}): begin nearer to the answer")
            states[key] = body, answer
        return states[key]

    def misfit(parameters: Array) -> Array:
        return (solved(parameters)[1].positions[vertices] - measured)[seen]

    def jacobian(parameters: Array) -> Array:
        body, answer = solved(parameters)
        values = constants(parameters)
        columns = []
        for name, value, by_logarithm in zip(names, values, logarithmic, strict=True):
            slope = body.sensitivity(answer, wrt=name)[vertices, :, 0][seen]
            columns.append(slope * value if by_logarithm else slope)
        return np.column_stack(columns)

    guess = np.array([known[name] for name in names])
    first = np.where(logarithmic, np.log(np.where(logarithmic, guess, 1.0)), guess)
    low, high = np.where(logarithmic, -np.inf, -0.95), np.where(logarithmic, np.inf, 0.495)
    found = scipy.optimize.least_squares(
        misfit, first, jacobian, (low, high), x_scale="jac", ftol=1e-12, xtol=1e-10, gtol=1e-14, max_nfev=_LIMIT
    )
    body, answer = solved(found.x)
    values = constants(found.x)
    spread = _half_widths(np.asarray(found.jac), found.fun, confidence)
    bounds = [constants(found.x + side * spread) for side in (-1.0, 1.0)]
    if not np.isfinite(bounds).all():
        raise SolverError("the measurements say next to nothing of the constants: measure more, or under another load")
    return Fit(
        values=dict(zip(names, values.tolist(), strict=True)),
        intervals={name: (float(bounds[0][i]), float(bounds[1][i])) for i, name in enumerate(names)},
        material=body.shell.material,
        state=answer,
        converged=bool(found.success),
        residual=float(np.sqrt(np.mean(found.fun**2))),
        evaluations=len(states),
    )


def _half_widths(jacobian: Array, misfit: Array, confidence: float) -> Array:
    """Half widths (p,) of the parameters' confidence intervals by the linearised model; SolverError if undetermined."""
    count, parameters = jacobian.shape
    sizes = np.linalg.norm(jacobian, axis=0)
    if count <= parameters or not sizes.all() or np.linalg.matrix_rank(jacobian / sizes) < parameters:
        raise SolverError(
            f"{count} measured coordinates do not determine {parameters} constants: measure more, or under another load"
        )
    variance = float(misfit @ misfit) / (count - parameters)
    covariance = variance * np.linalg.inv(jacobian.T @ jacobian)
    return np.asarray(scipy.stats.t.ppf(0.5 + 0.5 * confidence, count - parameters) * np.sqrt(np.diag(covariance)))
