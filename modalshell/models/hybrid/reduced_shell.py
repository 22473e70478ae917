"""A reduced shell in motion: its steps, the loads that it holds, and what its assumed stresses see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import final

import numpy as np

from modalshell.core.cost import count_elements, count_products, count_read, count_solves
from modalshell.core.thread_safety import PerThread
from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.integrators.state import MotionState
from modalshell.models.hybrid.assumed_stress import ReducedStress, measures_of
from modalshell.models.hybrid.assumed_stress_step import STEP_GOAL, implicit_step, reduced_start
from modalshell.models.hybrid.coarse_states import CoarseShape
from modalshell.models.hybrid.energy_kernels import evaluate
from modalshell.models.hybrid.flat_record import flat_record, surface_of
from modalshell.models.hybrid.training import SMALL, Trained
from modalshell.models.hybrid.whole_step import whole_step
from modalshell.shell.damping import Damping


@final
@dataclass
class _Last:
    """A load (n, 3) that has been checked, that of the next step mostly, its push, and what steps keep."""

    load: Array = field(default_factory=lambda: np.empty(0))
    push: Array | None = None
    kept: Array = field(default_factory=lambda: np.empty(0))


def _nothing_known(size: int) -> _Last:
    return _Last(kept=np.full(size, np.nan))


@final
class ReducedShell:
    """Steps of a reduced shell in coordinates (m,), and their checks.

    ``reduced`` is its energy, ``shape`` what coordinates make of the coarse shell. ``push`` gives the force (m,) of a
    load (n, 3) [N], or None where it is not held.
    """

    def __init__(
        self, trained: Trained, reduced: ReducedStress, shape: CoarseShape, push: Callable[[Array], Array | None]
    ) -> None:
        self._trained, self._reduced, self._shape, self._push = trained, reduced, shape, push
        self._measures = measures_of(shape.coarse.coarse.shell)
        surface = surface_of(self._measures, trained.basis)
        self._looks, self._record = len(surface.edges) > 0, flat_record(reduced, surface)
        self._limits = STEP_GOAL, SMALL * trained.energy, trained.strain_limit
        # Strains and their slopes, both parts of the Hessian, the hinges, and the factor.
        size, modes, bending = trained.basis.shape[1], reduced.membrane.modes, reduced.bending
        self._products = 2 * modes * size**2 + 2 * len(bending.hinges) * size * (size + 9) + size**3 // 6
        read = *reduced.membrane[:2], bending.flat, bending.modes, bending.across
        self._bytes = sum(part.nbytes for part in read)
        self._last = PerThread(partial(_nothing_known, size + modes))  # an array of its own for each thread

    def count(self, evaluations: int) -> None:
        """Count evaluations of the reduced energy with its derivatives."""
        count_elements(evaluations * len(self._reduced.bending.hinges))
        count_read(evaluations * self._bytes)
        count_products(evaluations * self._products)

    def sees(self, z: Array, energy: float, seen: float) -> bool:
        """Whether the assumed stresses see the membrane at z, of their energy ``seen`` and the whole ``energy`` [J]."""
        count_elements(self._measures.evaluated)
        return self._trained.unseen(self._measures, self._shape.under(z), energy, seen) <= self._trained.strain_limit

    def sees_state(self, z: Array) -> bool:
        """The same, of any state."""
        modes = self._reduced.membrane.modes
        energy, strains, *_ = evaluate(self._reduced, z, np.zeros(modes))
        self.count(1)
        return self.sees(z, energy, 0.5 * float(strains[:modes] @ strains[:modes]))

    def held_last(self) -> bool:
        """Whether it held the load of the last step."""
        return self._last().push is not None

    def _known(self, load: Array) -> _Last:
        last = self._last()
        if last.load.shape != load.shape or not (last.load == load).all():
            last.load, last.push = load.copy(), self._push(load)
        return last

    def euler_step(self, start: EulerStart, load: Array, damping: Damping) -> tuple[Array, bool]:
        """Coordinates z (m,) after a step of implicit Euler; not solved where the load or the end is not held."""
        last = self._known(load)
        if last.push is None:
            return start.near, False
        options = last.push, float(start.dt), *_factors(damping), STEP_GOAL, last.kept
        begin = reduced_start(self._reduced, start, damping.stiffness_factor, last.kept)
        moved, solved, energy, seen, iterations = implicit_step(self._reduced, begin, *options)
        self._count_step(iterations)
        return moved, bool(solved) and self.sees(moved, energy, seen)

    def bdf2_step(self, state: MotionState, dt: float, load: Array, damping: Damping) -> MotionState | None:
        """A step of BDF2 under a ``load`` (n, 3) [N] that stays; in one call.

        The same as the rule itself takes by :meth:`euler_step`; None where it fails, or takes more than one solve of a
        shell whose edges do not tell what the stresses see.
        """
        memory, last = state.memory, self._known(load)
        if last.push is None:
            return None
        x, v, before = state.coordinates, state.rates, 0.0
        moving = x, v, x, x
        if "order" in memory and memory["order"][0]:
            moving, before = (x, v, memory["move"], memory["gain"]), float(memory["step"][0])
        ends, rule = np.empty((5, x.size)), (float(dt), before, *_factors(damping))
        order, iterations, energy, seen = whole_step(
            self._record, moving, last.push, rule, self._limits, last.kept, ends
        )
        self._count_step(iterations)
        z, rates, move, gain, curvature = ends
        if not order or not (self._looks or self.sees(z, energy, seen)):
            return None
        changes = {"move": move, "gain": gain, "curvature": curvature}
        return MotionState(z, rates, changes | {"step": np.array([dt]), "order": np.array([float(order)])})

    def _count_step(self, iterations: int) -> None:
        self.count(iterations + 2)
        count_solves(self._trained.basis.shape[1], iterations)


def _factors(damping: Damping) -> tuple[float, float]:
    """Rayleigh's factors; kernels are compiled for each kind of number."""
    return float(damping.mass_factor), float(damping.stiffness_factor)
