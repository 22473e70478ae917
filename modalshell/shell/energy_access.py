"""A shell's energy as solvers take it: on arrays that they own, without checks."""

from __future__ import annotations

import copy
from abc import ABC
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array, Index, Mask
from modalshell.mesh import TriangleMesh
from modalshell.shell.creases import CreaseSet, CreaseState
from modalshell.shell.elastic_energy import ElasticEnergy, nearest_measures
from modalshell.shell.energies_of import gradient_by_constant
from modalshell.shell.extended import Extended
from modalshell.shell.material import Material
from modalshell.shell.pattern import SparsePattern
from modalshell.shell.rest_shape import RestShape
from modalshell.shell.sheet import Sheet
from modalshell.shell.slopes import HeldSlopes
from modalshell.supports import Support


class EnergyAccess(ReadOnlyArrays, ABC):
    """Energy, gradient, Hessian and damping of a shell, whose attributes a subclass sets."""

    mesh: TriangleMesh
    rest_mesh: TriangleMesh
    rest_shape: RestShape | None
    creases: CreaseSet | None
    crease_state: CreaseState | None
    supports: tuple[Support, ...]
    material: Material | Sheet
    rest_positions: Array
    clamped: Mask
    pattern: SparsePattern
    _energy: ElasticEnergy
    _slots: list[Index]
    _slopes: HeldSlopes
    _settled: bool
    _damping: tuple[Self, list[Array], float, float] | None = None

    @property
    def elastic_energy(self) -> ElasticEnergy:
        """The elastic energy itself."""
        return self._energy

    @property
    def stressed(self) -> bool:
        """Whether the mesh is under stress: the shape without it is another one."""
        return self.rest_shape is not None or self.rest_mesh is not self.mesh

    @property
    def energy_at_rest(self) -> float:
        """Elastic energy [J] that stresses have stored in the mesh; 0 of one without stress."""
        return self._energy.energy(self.rest_positions) if self.stressed else 0.0

    def stored_energy(self, x: Array) -> float:
        """Elastic energy [J] at x (n, 3) [m], unchecked, with what the hardening of creases has stored."""
        energy = self._energy.energy(x)
        if self.creases is None or self.crease_state is None:
            return energy
        return energy + self.creases.stored(self.crease_state.angles)

    def creased(self, state: CreaseState | ArrayLike) -> Self:
        """The same shell whose creases have kept the plastic folds of ``state``, or those of an array (C,) [rad].

        The fields and reactions of an answer whose creases have yielded are those of ``shell.creased(answer.creases)``.

        OptionError for a shell without creases, LoadError for another number of folds.
        """
        if self.creases is None or self.crease_state is None:
            raise OptionError("this shell has no creases to keep a state: pass creases=[ms.Crease(...)]")
        state = state if isinstance(state, CreaseState) else CreaseState(self.creases.checked(state))
        if self._damping is not None:
            return self._redamped(self.undamped.creased(state))
        further = self.creases.checked(state.angles) - self.crease_state.angles
        other = copy.copy(self)
        other._energy = self._energy.with_rest_angles(self.creases.on_mesh(further))
        other.crease_state = state
        return other

    def settled(self, positions: ArrayLike) -> Self:
        """The same shell with another mesh that its stresses hold in equilibrium, for modes and modal models about it.

        The energy stays as it is, and so does what is without stress; displacements count from ``positions``, as loads
        that follow the rest shape do.

        Parameters
        ----------
        positions : array_like, shape (n, 3)
            An equilibrium without load [m], such as that of :class:`DiscreteShell`; :func:`solve_modes` checks it.

        Raises
        ------
        OptionError
            If the shell has creases, whose folds would change with the state.
        LoadError
            For positions of the wrong shape or not finite.
        """
        self.refuse_creases("a settled shell")
        other = copy.copy(self)
        other.mesh = TriangleMesh(checked_vectors("positions", positions, self.rest_positions.shape), self.mesh.faces)
        other.rest_positions = np.asarray(other.mesh.vertices)
        other.supports = tuple(support.on(self.mesh) for support in self.supports)
        other._settled = True
        return other

    def refuse_creases(self, name: str, remedy: str = "leave creases out") -> None:
        """OptionError where the shell has creases, which ``name`` does not know, with the ``remedy``."""
        if self.creases is not None:
            raise OptionError(f"{name} knows no creases: {remedy}")

    def refuse_creases_in(self, model: str) -> None:
        """OptionError where the shell has creases, which a ``model`` does not know."""
        self.refuse_creases(model, "take ms.DiscreteShell or ms.CoarseDiscreteShell, or leave creases out")

    def energy_gradient(self, x: Array) -> tuple[float, Array]:
        """Energy [J] and gradient (n, 3) [N] in one pass."""
        return self._energy.energy_gradient(x)

    def extended_gradient(self, displacement: Extended) -> Extended:
        """Gradient (n, 3) [N] in extended precision, at displacements (n, 3) [m] from the rest shape."""
        return self._energy.extended_gradient(self.rest_positions, displacement)

    def energy_gradient_hessian(
        self, x: Array, geometric: int, stresses: list[Array] | None = None
    ) -> tuple[float, Array, Array]:
        """Energy, gradient (n, 3) and Hessian values for :attr:`pattern`, in one pass.

        ``geometric`` is one of GAUSS_NEWTON, EXACT, MIXED (with ``stresses``, as predicted) and PROJECTED.
        """
        return self._energy.energy_gradient_hessian(self._slots, self.pattern, x, geometric, stresses)

    def hessian(self, x: Array, geometric: int, stresses: list[Array] | None = None) -> Array:
        """The Hessian values alone; see :meth:`energy_gradient_hessian`."""
        return self._energy.hessian(self._slots, self.pattern, x, geometric, stresses)

    def rates_by_constant(self, name: str, x: Array, step: Array | None = None) -> Array:
        """Derivative (n, 3) of the gradient at ``x``, or of the first part of the Hessian times ``step``."""
        of = self._energy, self.rest_mesh, self.material, self._slopes, self.clamped
        return gradient_by_constant(*of, name, x, step)

    def predicted_stresses(self, x: Array, step: Array) -> list[Array]:
        """Stresses after ``step`` (n, 3) by the linearised measures at ``x`` (mixed Newton)."""
        return self._energy.linear_stresses(x, step)

    @property
    def has_dashpots(self) -> bool:
        """Whether elements are damped by dashpots of their own, whatever the Rayleigh factors."""
        return self._energy.has_dashpots

    def changes(self, x: Array) -> list[Array]:
        """Changes of the measures of every kind at x (n, 3) from those at rest."""
        return self._energy.changes(x)

    def damped(self, begun: list[Array], factor: float, dt: float) -> Self:
        """The shell with the energy that damping makes of its own in a step of ``dt`` [s]; see ElasticEnergy.damped."""
        other = copy.copy(self)
        other._energy, other._damping = self._energy.damped(begun, factor, dt), (self, begun, factor, dt)
        return other

    @property
    def undamped(self) -> Self:
        """The shell with its own energy; see :meth:`damped`."""
        return self if self._damping is None else self._damping[0]

    def _redamped(self, shell: Self) -> Self:
        """A shell that differs from :attr:`undamped` by its rest angles, damped as this one."""
        assert self._damping is not None
        own, begun, *step = self._damping
        x = self.rest_positions
        shifts = zip(begun, own.changes(x), shell.changes(x), own.elastic_energy.periods, strict=True)
        # A rest angle that comes to half a turn jumps by a whole one, as folds do.
        moved = [
            known + nearest_measures(after - before, np.zeros(()), period) for known, before, after, period in shifts
        ]
        return shell.damped(moved, *step)

    def damping_force(self, x: Array, velocity: Array, factor: float = 1.0) -> Array:
        """``-(factor K_1(x) + D(x)) velocity`` (n, 3) [N].

        K_1 is the positive semi-definite first term of the Hessian, ``factor`` [s] Rayleigh's zeta, D the dashpots.
        """
        return self._energy.damping_force(x, velocity, factor)

    def damping_matrix(self, x: Array, factor: float) -> Array:
        """Values of ``factor K_1(x) + D(x)`` [N s/m] for :attr:`pattern`; see :meth:`damping_force`."""
        return self._energy.damping_matrix(self._slots, self.pattern, x, factor)
