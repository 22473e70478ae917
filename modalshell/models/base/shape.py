"""Base of modal models: the shape of a shell at its modal coordinates, from which all else derives."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, ClassVar, Self

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.slope import slope
from modalshell.core.typing import Array, Index
from modalshell.integrators.modal import ModalIntegrator
from modalshell.integrators.modal.base import DeadForce
from modalshell.modes import Basis
from modalshell.modes.modal_rotation import largest_at_vertices
from modalshell.shell import Shell

SHAPE = "warped"
"""The hook that a model defines."""
OF_SHAPE = (
    "warped_positions",
    "warped_gradient",
    "warped_force",
    "dead_force",
    "warped_jacobian",
    "warped_work",
    "warped_curvature",
    "warped_patch",
    "warped_rows",
    "contact_frame",
    "contact_rows",
    "contact_shape",
    "contact_tiles",
    "load_quadrature",
    "farthest",
    "_free_statics",
)
"""Hooks whose defaults derive from the shape: what is written for one shape is wrong for another."""
DERIVED = {
    "displacement": "warped",
    "raw_displacement": "warped",
    "displacement_gradient": "warped_gradient",
    "modal_force": "warped_force",
    "modal_force_jacobian": "warped_jacobian",
    "work": "warped_work",
    "work_curvature": "warped_curvature",
}
"""Methods that are no hooks, as frames of free parts stand between, and the hooks to override in their place."""
_BASES = tuple(f"modalshell.models.base.{name}" for name in ("shape", "modal_motion", "modal"))
"""Modules whose hooks are defaults for every shape."""
_SMALL = 1e-3
"""Turn [rad], and displacement as a share of the shell's size, over which the shape is differenced."""

_FITS, _LEAST_SHARE = 30, 1e-3
"""Steps of a fit of a shape, and the share of one below which it leads no nearer."""


class ModalShape(ABC):
    """The shape of a shell at modal coordinates q (m,), free parts in their frames.

    A model defines :meth:`warped`. Its derivatives, its work, the modal force and the rows of contacts and patches
    follow by differences of fourth order, with errors about 1e-10; a model overrides them where it knows better. The
    shape is a function of ``Phi q`` and of the modal rotations ``Psi q`` alone, as sensitivities ask for it on modes
    that are not orthonormal. To first order about rest it is ``Phi q``: coordinates have unit mass, and positions are
    projected onto the modes. :func:`modalshell.models.check.check_model` checks all of it. OptionError at its
    definition, for a class that overrides a method that is no hook, or whose shape and derivatives are not of one
    class.

    Attributes
    ----------
    straight : bool
        Whether displacements are linear in the coordinates, so that dead loads push the modes as they are.
    """

    name: str
    shell: Shell
    basis: Basis
    conservative: bool = True
    """Whether the modal force is the gradient of the load's work, so that equilibria are the minima of a potential."""
    straight: ClassVar[bool] = False
    integrator: ModalIntegrator
    _given: tuple[tuple[Any, ...], dict[str, Any]]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        _check_hooks(cls)

    def __new__(cls, *args: Any, **options: Any) -> Self:
        """Keep the constructor's options, for :meth:`on_basis`."""
        self = super().__new__(cls)
        self._given = args[1:], {name: value for name, value in options.items() if name != "basis"}
        return self

    def on_basis(self, basis: Basis) -> Self:
        """The same model, with the options of its constructor, on another basis of its shell."""
        further, options = self._given
        other = type(self)(basis, *further, **options)
        other.integrator = self.integrator
        return other

    @abstractmethod
    def warped(self, q: Array) -> Array:
        """Displacements (n, 3) [m] at coordinates (m,), a new array; ``Phi q`` to first order about rest."""

    def warped_positions(self, q: Array) -> Array:
        """Positions (n, 3) [m] of :meth:`warped`, a new array."""
        moved = self.warped(q)
        moved += self.shell.rest_positions
        return moved

    def warped_gradient(self, q: Array, weights: Array) -> Array:
        """Derivatives (m,) of :meth:`warped`, contracted with weights (n, 3)."""
        return self.by_differences(lambda q: np.vdot(weights, self.warped(q)), q)

    def warped_force(self, q: Array, load: Array) -> Array:
        """Modal force (m,) of a load (n, 3) [N], a new array; the gradient of its work unless overridden.

        A model with another force sets ``conservative = False``.
        """
        return self.warped_gradient(q, load)

    def dead_force(self, load: Array) -> DeadForce:
        """:meth:`warped_force` of one load (n, 3) [N], which is looked at once for all that are asked for."""
        return DeadForce(partial(self.warped_force, load=load))  # which can be pickled

    def warped_jacobian(self, q: Array, load: Array) -> Array:
        """Derivatives (m, m) of :meth:`warped_force`."""
        return self.by_differences(lambda q: self.warped_force(q, load), q)

    def warped_work(self, q: Array, load: Array) -> tuple[float, Array]:
        """Work [J] of a load (n, 3) [N] on :meth:`warped`, and its gradient (m,)."""
        return float(np.vdot(load, self.warped(q))), self.warped_gradient(q, load)

    def warped_curvature(self, q: Array, load: Array) -> Array:
        """Second derivatives (m, m) of :meth:`warped_work`."""
        slope = self.by_differences(lambda q: self.warped_gradient(q, load), q)
        return 0.5 * (slope + slope.T)

    def warped_rows(self, q: Array, vertices: Index) -> Array:
        """Rows (k, 3, m) that take rates to velocities of some vertices."""
        return self.by_differences(lambda q: self.warped(q)[vertices], q)

    def warped_patch(self, q: Array, vertices: Index) -> tuple[Array, Array]:
        """Mean position (3,) [m] of a patch by :meth:`warped`, and its Jacobian (3, m)."""
        rows = self.by_differences(lambda q: self.warped(q)[vertices].mean(axis=0), q)
        return self.warped_positions(q)[vertices].mean(axis=0), rows

    @property
    def contact_shape(self) -> tuple[Array, Array, Array] | None:
        """Positions at rest (n, 3), modes, and rotations (3n, m) if they turn; None without a closed form."""
        return None

    @property
    def contact_tiles(self) -> tuple[Array, Array, Array] | None:
        """Modal data and positions at rest as a :class:`WarpFrame` has them, if positions are by one, and no lines.

        Of straight models no data, positions at rest (n, 3), and modes as lines (m, 3n). None of others.
        """
        return None

    def farthest(self, q: Array) -> float:
        """Length [m] beyond which no vertex moves from rest at q (m,); infinite where none is known at once."""
        return math.inf

    @cached_property
    def reach(self) -> Array:
        """How far [m] each mode moves a vertex at most, by a unit; shape (m,)."""
        return largest_at_vertices(self.basis.modes)

    def largest_turn(self, q: Array) -> float:
        """Largest rotation [rad] of a part of the shell at q; a linear model knows none."""
        return 0.0

    def _projected(self, displacement: Array) -> Array:
        return np.asarray(self.basis.modes.T @ (np.repeat(self.shell.mass, 3) * displacement.ravel()))

    def nearest(self, positions: Array) -> Array:
        """Coordinates (m,) whose shape is nearest to positions (n, 3) [m] in the norm of the mass, without frames.

        By Gauss-Newton from the projection, which far from rest is that of another shape: each way as far, of halves
        of halves, as it leads nearer, and winds nothing up.
        """
        moved, root = positions - self.shell.rest_positions, np.sqrt(self.shell.mass)[:, None]
        q, every = self._projected(moved), np.arange(len(moved))
        missing, most = root * (moved - self.warped(q)), max(2.0 * np.pi, self.largest_turn(q))
        for _ in range(0 if self.straight else _FITS):
            rows, share = (root[:, :, None] * self.warped_rows(q, every)).reshape(-1, q.size), 1.0
            way = np.linalg.lstsq(rows, missing.ravel(), rcond=None)[0]
            while share > _LEAST_SHARE:
                lacks = root * (moved - self.warped(q + share * way))
                nearer = bool(np.vdot(lacks, lacks) < np.vdot(missing, missing))
                if nearer and self.largest_turn(q + share * way) <= most:
                    break
                share *= 0.5
            else:
                break
            q, missing = q + share * way, lacks
        return q

    def by_differences(self, function: Callable[[Array], Any], q: Array) -> Array:
        """Derivatives (..., m) of a function at q (m,), of fourth order over small moves of the vertices."""
        moves = np.abs(self.basis.modes).max(axis=0) / self.shell.size
        steps = _SMALL / np.maximum(np.maximum(np.abs(self.basis.rotations).max(axis=0), moves), 1e-300)
        columns = [slope(function, q, unit, step) for unit, step in zip(np.eye(q.size), steps, strict=True)]
        return np.stack(columns, axis=-1)


def contact_shape(basis: Basis, *, turns: bool) -> tuple[Array, Array, Array]:
    """What compiled contacts need of a warp in closed form; see :attr:`ModalShape.contact_shape`."""
    own = [np.array(part, dtype=np.float64, order="C") for part in (basis.shell.rest_positions, basis.modes)]
    rotations = np.array(basis.rotations, dtype=np.float64, order="C") if turns else np.empty((0, basis.count))
    return own[0], own[1], rotations


def _providers(cls: type, name: str) -> list[type]:
    """Classes of models that define a hook, in the order of resolution, the bases' own defaults left out."""
    owners = [owner for owner in cls.__mro__ if owner.__module__ not in _BASES and name in vars(owner)]
    return [owner for owner in owners if not getattr(vars(owner)[name], "__isabstractmethod__", False)]


def _check_hooks(cls: type[ModalShape]) -> None:
    """OptionError for a model whose methods are not those of one shape."""
    for name, hook in DERIVED.items():
        if _providers(cls, name):
            raise OptionError(
                f"{cls.__name__} overrides {name}, which the base derives from {hook}: override {hook} instead, so "
                "that statics, motion, contacts and derivatives all know of it"
            )
    shapes, order = _providers(cls, SHAPE), cls.__mro__
    stale: dict[str, list[str]] = {}
    for name in OF_SHAPE if len(shapes) > 1 else ():
        owners = _providers(cls, name)
        if owners and order.index(owners[0]) > order.index(shapes[0]):
            stale.setdefault(owners[0].__name__, []).append(name)
    if stale:
        kept = "; ".join(f"{', '.join(names)} of {owner}" for owner, names in stale.items())
        raise OptionError(
            f"{cls.__name__} overrides {SHAPE}, but inherits what belongs to another shape: {kept}. Derive from "
            "modalshell.models.base.modal.ModalModel, which finds them from the shape, or override them too"
        )
    if _providers(cls, "warped_force") and not _providers(cls, "warped_work") and cls.conservative:
        raise OptionError(
            f"{cls.__name__} overrides warped_force, but not the work that statics minimises: override "
            "warped_gradient, from which the force follows, or set conservative = False"
        )
