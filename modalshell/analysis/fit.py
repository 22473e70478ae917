"""Constants of a material from measured positions or frequencies, by least squares with exact Jacobians."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from modalshell.analysis.fit_measurements import MeasuredFrequencies, MeasuredPositions, Measurements
from modalshell.core.checks import checked_kind, checked_number, checked_switch, shown
from modalshell.core.errors import MaterialError, ModalShellWarning, OptionError, SolverError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.core.units import in_percent
from modalshell.loads import Load
from modalshell.mesh.selection import Selection
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.shell import Material, Orthotropic, Sheet, Shell
from modalshell.shell.energies_of import ANY_SIGN, material_constants, size_of_constant, with_constants

if TYPE_CHECKING:
    import scipy.optimize

_LIMIT = 100
"""Shells that are solved at most in one search."""
_ALIKE = 1e-9
"""Least singular value of the Jacobian's columns, scaled to one length, over the largest: below it they are alike."""
_SLOPING, _NOTHING = 1e-2, 1e-5
"""Cosine between the misfit and a column of the Jacobian, and their ratio, up to which the squares are least."""
_EXPLAINED, _UNEXPLAINED = 1e-6, 0.05
"""Misfit, as a share of what was measured, up to which no other minimum is sought; the second a warning."""
_ORDERS, _LOWER = 8, 0.9
"""Minima that are left for another at most, and the sum of squares there over that here."""
_WITHIN = 0.99
"""Share of the Poisson's ratio, or coupling, at which some strain has no stiffness that is looked up to."""


@final
@short_repr
@dataclass(frozen=True)
class Fit:
    """Constants of a material that explain measurements.

    Attributes
    ----------
    values : dict of float
        The constants, by name.
    intervals : dict of (float, float)
        Confidence interval of each, for independent errors of one variance; coordinates that no constant changes, as
        those of held vertices, do not count.
    material : Material or Sheet
        The material with these constants.
    state : Equilibrium or None
        The equilibrium of the shell with it, under the last load; None where frequencies were measured.
    converged : bool
        Whether the least squares converged. False at the end of the range of Poisson's ratio or a coupling, and where
        the residual still falls but the shell has left its branch of equilibria.
    residual : float
        Root mean square of the residual in coordinates [m], or in frequencies as a share of each.
    evaluations : int
        Shells that were solved.
    """

    values: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    material: Material | Sheet
    state: Equilibrium | None
    converged: bool
    residual: float
    evaluations: int


def fit(
    shell: Shell,
    wrt: str | Sequence[str],
    observed: ArrayLike | None = None,
    *,
    where: Selection | None = None,
    average: bool = False,
    factors: ArrayLike | None = None,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
    frequencies: ArrayLike | None = None,
    confidence: float = 0.95,
) -> Fit:
    """Recover constants of a shell's material from measured positions, a load-deflection curve, or frequencies.

    Least squares by a trust region (``scipy.optimize.least_squares``) over the logarithms of the constants, those of
    any sign as they are (Poisson's ratio, a direction, the couplings of a :class:`Fabric`), with the Jacobians of
    :meth:`modalshell.DiscreteShell.sensitivity` and :meth:`Basis.sensitivity`. Frequencies are known by their order
    alone, so that there is a minimum for each order of the modes: from where a search ends, those that linear theory
    expects to be deeper are searched too.

    Parameters
    ----------
    shell : Shell
        The shell; its material has the first guess.
    wrt : str or sequence of str
        Constants to recover, such as ``"young"``; each one number for the whole mesh.
    observed : array_like, shape (k, 3), or (L, k, 3) with ``factors``
        Measured positions [m] in equilibrium; NaN for coordinates that were not measured.
    where : selection, optional
        The k measured vertices, in the order of their numbers; by default all.
    average : bool
        Whether the mean position of these vertices was measured, as of a strip's tip: ``observed`` then is (3,), or
        (L, 3).
    factors : array_like, shape (L,), optional
        Shares of the load at which positions were measured, in their order: a load-deflection curve.
    gravity, force, loads : optional
        The load, as in :meth:`modalshell.Model.equilibrium`.
    frequencies : array_like, shape (m,), optional
        Measured natural frequencies [Hz] in place of positions: those of the lowest modes that are no rigid motion, in
        their order; NaN for those that were not measured.
    confidence : float
        Level of the intervals.

    Returns
    -------
    Fit
        The constants, with confidence intervals. A ModalShellWarning says so where least squares leave more than 5 % of
        what was measured, displacements or frequencies, unexplained.

    Raises
    ------
    OptionError
        For names that are no constants of the material, a shape that does not fit, both kinds of measurement, or a
        shell with creases.
    LoadError
        For loads of the wrong shape, or no measured number.
    SolverError
        If there is no equilibrium at the initial guess, or the measurements do not determine the constants.
    """
    checked_kind("shell", shell, Shell).refuse_creases("a fit")
    names = _checked_constants(shell, wrt)
    confidence = checked_number("confidence", confidence, above=0.0, at_most=0.999999)
    checked_switch("average", average)
    if (observed is None) == (frequencies is None):
        raise OptionError("give measured positions as observed, or frequencies: one of the two")
    measured: Measurements
    if frequencies is not None:
        if any(given is not None for given in (where, factors, gravity, force, loads)) or average:
            raise OptionError("frequencies are those of the shell at rest: leave where, average, factors and loads out")
        measured = MeasuredFrequencies(frequencies)
    else:
        assert observed is not None
        of = {"gravity": gravity, "force": force, "loads": loads}
        measured = MeasuredPositions(shell, observed, where=where, average=average, factors=factors, **of)  # type: ignore[arg-type]
    constants = material_constants(shell.material)
    misfit = _Misfit(shell, names, measured)
    guess = misfit.parameters(np.array([constants[name] for name in names]))
    if (slopes := misfit.jacobian(guess)).any(axis=0).all():  # constants that are not told apart would run away
        _refuse_undetermined(slopes, misfit.state)
    misfit.size = float(np.abs(slopes).max()) or 1.0  # the tolerances know no unit
    optimum = _least_squares(misfit, guess)
    differences = misfit.at(optimum.x, exact=True)
    slopes = misfit.jacobian(optimum.x)
    _refuse_undetermined(slopes, misfit.state)
    varied = slopes.any(axis=1)  # what supports hold was known before
    half_widths = _half_widths(slopes[varied], differences[varied], confidence)
    values, low, high = (misfit.constants(optimum.x + side * half_widths).tolist() for side in (0.0, -1.0, 1.0))
    if not np.isfinite([low, high]).all():
        raise SolverError("the measurements say next to nothing of the constants: measure more, or under another load")
    converged = bool(optimum.success) and not optimum.active_mask.any() and _is_least(slopes, differences)
    residual = float(np.sqrt(np.mean(differences**2)))
    if converged and residual > _UNEXPLAINED * measured.size:
        warnings.warn(
            f"the fitted shell is {in_percent(residual / measured.size)} off what was measured (root mean square): "
            "begin nearer, fit more constants, or look whether load, supports and numbers are those of the measurement",
            ModalShellWarning,
            stacklevel=2,
        )
    return Fit(
        values=dict(zip(names, values, strict=True)),
        intervals=dict(zip(names, zip(low, high, strict=True), strict=True)),
        material=misfit.material,
        state=misfit.state,
        converged=converged,
        residual=residual,
        evaluations=misfit.evaluations,
    )


@final
class _Misfit:
    """Differences from measured numbers by parameters (p,): logarithms of constants, those of any sign over a size.

    ``material``, ``state`` and ``evaluations`` are those of the last parameters; ``size`` is what relative ones are
    taken over.
    """

    def __init__(self, shell: Shell, names: list[str], measured: Measurements) -> None:
        self._shell, self._names, self._measured = shell, names, measured
        self._logarithmic = np.array([name not in ANY_SIGN for name in names])
        self._ratios = np.array([name in ANY_SIGN and name != "direction" for name in names])
        self._sizes = np.array([size_of_constant(shell.material, shell.mesh, name) for name in names])
        self._parameters, self._differences = np.empty(0), np.empty(0)
        self.material, self.size = shell.material, 1.0
        self.state: Equilibrium | None = None
        self.evaluations = 0

    def bounds(self, guess: Array) -> tuple[Array, Array]:
        """Least and largest parameters: Poisson's ratio and couplings are limited, by the guess's other stiffnesses."""
        material, most = self._shell.material, np.ones_like(guess)
        least = -most
        for k in np.flatnonzero([name == "poisson" for name in self._names]):
            if isinstance(material, Orthotropic):
                first, second = (np.asarray(e, dtype=np.float64) for e in material.on(self._shell.mesh).young)
                most[k] = float(np.sqrt(np.min(first / second)))
                least[k] = -most[k]
            else:
                most[k] = 0.5
        low, high = np.minimum(_WITHIN * least, guess), np.maximum(_WITHIN * most, guess)
        return np.where(self._ratios, low, -np.inf), np.where(self._ratios, high, np.inf)

    def parameters(self, constants: Array) -> Array:
        """The parameters that stand for constants."""
        return np.where(self._logarithmic, np.log(np.where(self._logarithmic, constants, 1.0)), constants / self._sizes)

    def constants(self, parameters: Array) -> Array:
        """The constants that parameters stand for."""
        with np.errstate(over="ignore"):  # bounds of what is not determined
            grown = np.exp(np.where(self._logarithmic, parameters, 0.0))
            return np.where(self._logarithmic, grown, parameters * self._sizes)

    def at(self, parameters: Array, *, exact: bool = False) -> Array:
        """The differences (k,); a shell is solved where the parameters are new, or the last balance was loose."""
        if np.array_equal(parameters, self._parameters) and (self._measured.exact or not exact):
            return self._differences
        constants = dict(zip(self._names, self.constants(parameters).tolist(), strict=True))
        try:
            material = with_constants(self._shell.material, constants)
            shell = self._shell.with_material(material)
            self._differences, self.state = self._measured.misfit(shell, self._names, exact=exact)
        except (SolverError, MaterialError, np.linalg.LinAlgError) as error:  # the last of constants beyond all reason
            values = ", ".join(f"{name} = {value:.4g}" for name, value in constants.items())
            mend = "" if isinstance(error, SolverError) else "; begin nearer, or leave one of them as it is"
            raise SolverError(f"at {values}: {error}{mend}") from error
        self._parameters, self.material = parameters.copy(), material
        self.evaluations += 1
        return self._differences

    def jacobian(self, parameters: Array) -> Array:
        """Derivatives (k, p) of the differences."""
        self.at(parameters)
        return self._measured.slopes(self._names) * self._scale(parameters)

    def _scale(self, parameters: Array) -> Array:
        """Derivative (p,) of each constant by its parameter."""
        return np.where(self._logarithmic, self.constants(parameters), self._sizes)

    def explained(self, parameters: Array) -> bool:
        """Whether next to nothing is left of the misfit."""
        return float(np.sqrt(np.mean(self.at(parameters) ** 2))) <= _EXPLAINED * self._measured.size

    def deeper(self, parameters: Array) -> list[Array]:
        """Parameters that may lie near deeper least squares than these, the deepest first."""
        self.at(parameters)
        shell, scale = self._shell.with_material(self.material), self._scale(parameters)
        return [parameters + step for step in self._measured.deeper(shell, self._names, scale)]


def _least_squares(misfit: _Misfit, guess: Array) -> scipy.optimize.OptimizeResult:
    """The least squares from a guess, and from there the deepest of those where modes stand in another order."""
    import scipy.optimize  # not before something is fitted: its import takes long

    lowest, highest = misfit.bounds(guess)

    def search(start: Array) -> scipy.optimize.OptimizeResult:
        # From the start, all alike, so that the first step is of a few times and not as long as the logarithms are.
        def differences(step: Array) -> Array:
            return misfit.at(start + step) / misfit.size

        def slopes(step: Array) -> Array:
            return misfit.jacobian(start + step) / misfit.size

        found = scipy.optimize.least_squares(
            differences,
            np.zeros_like(start),
            slopes,
            (lowest - start, highest - start),
            ftol=1e-10,
            xtol=1e-8,
            gtol=1e-14,
            max_nfev=_LIMIT,
        )
        found.x = start + found.x
        return found

    best, failed = None, SolverError()
    try:
        best = search(guess)
    except SolverError as error:  # no stable sheet, or no equilibrium, on the way
        failed = error
    for _ in range(_ORDERS):
        if best is not None and misfit.explained(best.x):
            break
        for start in misfit.deeper(guess if best is None else best.x):
            try:
                other = search(np.clip(start, lowest, highest))
            except (SolverError, OptionError):  # the latter where two modes share an eigenvalue
                continue
            if best is None or other.cost < _LOWER * best.cost:
                best = other
                break
        else:
            break
    if best is None:
        raise failed
    return best


def _checked_constants(shell: Shell, wrt: str | Sequence[str]) -> list[str]:
    """Names of constants of the shell's material that can be recovered."""
    if not isinstance(wrt, str | list | tuple) or not all(isinstance(name, str) for name in wrt):
        raise OptionError(f"wrt must be the name of a constant, or a list of names (got {shown(wrt)})")
    names = [wrt] if isinstance(wrt, str) else list(wrt)
    known = material_constants(shell.material)
    for name in names:
        if name not in known or (known[name] <= 0.0 and name not in ANY_SIGN):
            raise OptionError(f"wrt must be constants above 0 among {', '.join(known)} (got {shown(name)})")
    if not names or len(set(names)) < len(names):
        raise OptionError(f"wrt must name each constant once (got {shown(wrt)})")
    return names


def _refuse_undetermined(jacobian: Array, state: Equilibrium | None) -> None:
    """SolverError unless the columns differ by more than the residual of the equilibrium that they are taken at."""
    count, parameters = int(jacobian.any(axis=1).sum()), jacobian.shape[1]
    sizes = np.linalg.norm(jacobian, axis=0)
    least = max(_ALIKE, 10.0 * state.residual if state is not None else 0.0)
    if count > parameters and sizes.all():
        singular = np.linalg.svd(jacobian / sizes, compute_uv=False)
        if singular[-1] > least * singular[0]:
            return
    raise SolverError(
        f"{count} measured numbers do not determine {parameters} constants: measure more, under another load, or take "
        "fewer constants"
    )


def _is_least(jacobian: Array, misfit: Array) -> bool:
    """Whether the sum of squares is stationary: the misfit is at right angles to every column, or next to nothing."""
    columns, size = np.linalg.norm(jacobian, axis=0), float(np.linalg.norm(misfit))
    return bool((np.abs(jacobian.T @ misfit) <= np.maximum(_SLOPING * size, _NOTHING * columns) * columns).all())


def _half_widths(jacobian: Array, misfit: Array, confidence: float) -> Array:
    """Half widths (p,) of the parameters' confidence intervals by the linearised model."""
    count, parameters = jacobian.shape
    variance = float(misfit @ misfit) / (count - parameters)
    covariance = variance * np.linalg.inv(jacobian.T @ jacobian)
    return np.asarray(scipy.special.stdtrit(count - parameters, 0.5 + 0.5 * confidence) * np.sqrt(np.diag(covariance)))
