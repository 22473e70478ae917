"""Linearised implicit Euler of a sheet of springs, its equations solved by conjugate gradients."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np

from modalshell.errors import OptionError
from modalshell.integrators.full.base import Body, FullIntegrator
from modalshell.integrators.full.linear_implicit_euler import LinearImplicitEuler
from modalshell.integrators.state import Damping, Memory, MotionState
from modalshell.sharing import PerThread
from modalshell.shell import Shell
from modalshell.springs.implicit import ImplicitSprings
from modalshell.springs.springs import Springs
from modalshell.typing import Array


@final
@dataclass(frozen=True)
class VelocityChange(Memory):
    """The last step's change of velocity (n, 3) [m/s], from which the next one's solution starts."""

    change: Array

    def turned(self, rotation: Array) -> VelocityChange:
        """The same in a frame that ``rotation`` (3, 3) leads to."""
        return VelocityChange(self.change @ rotation.T)


@final
class ConjugateGradientEuler(FullIntegrator):
    """:class:`LinearImplicitEuler` of springs by conjugate gradients on blocks of particles [baraff1998].

    Order one. As stable as implicit Euler while one linearisation serves a step. Each step starts from the last one's
    answer. It belongs to one sheet, so that no key is registered for it: :class:`modalshell.SpringSheet` makes it for
    ``solver="cg"``.

    Parameters
    ----------
    springs : Springs
        The springs of the sheet.
    shell : Shell
        Its masses and held vertices.
    iterations : int
        Most iterations in a step.
    """

    key = LinearImplicitEuler.key
    name = f"{LinearImplicitEuler.name} by CG"

    def __init__(self, springs: Springs, shell: Shell, iterations: int) -> None:
        self.iterations = iterations
        self._springs = springs
        self._stepper = PerThread(partial(ImplicitSprings, springs, shell.mass, shell.clamped))

    def start(self, body: Body, positions: Array) -> MotionState:
        """State at rest, with no change of velocity to start from; OptionError for another model than the sheet."""
        if getattr(body, "springs", None) is not self._springs:
            raise OptionError("this integrator belongs to another sheet of springs: pass solver='cg' instead of it")
        state = super().start(body, positions)
        state.memory = VelocityChange(np.zeros_like(positions))
        return state

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Solve one system of linear equations by iteration."""
        stepper, kept = self._stepper(), state.memory
        stepper.place(state.coordinates, state.rates, kept.change if isinstance(kept, VelocityChange) else None)
        with body.costs.part("conjugate gradients"):
            found = stepper.step(
                dt,
                load,
                drag=damping.mass_factor,
                stiffness_damping=damping.stiffness_factor,
                held=held,
                iterations=self.iterations,
                tolerance=body.step_tolerance,
            )
        after = MotionState(stepper.positions, stepper.velocities, VelocityChange(stepper.change))
        return after, found.converged
