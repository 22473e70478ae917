"""Linearised implicit Euler of a sheet of springs, solved by conjugate gradients."""

from __future__ import annotations

from functools import partial
from typing import final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.thread_safety import PerThread
from modalshell.core.typing import Array
from modalshell.integrators.full.base import Body
from modalshell.integrators.full.linear_implicit_euler import LinearImplicitEuler, LinearisedEuler
from modalshell.integrators.state import MotionState
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.springs.implicit import ImplicitSprings
from modalshell.springs.springs import Springs


@final
class ConjugateGradientEuler(LinearisedEuler):
    """:class:`LinearImplicitEuler` of springs by conjugate gradients on blocks of particles [baraff1998].

    Order one. As stable as implicit Euler while one linearisation serves a step. Each step starts from the last one's
    change of velocity. It belongs to one sheet, so that no key is registered for it: :class:`modalshell.SpringSheet`
    makes it for ``solver="cg"``. ``shell`` has its masses and held vertices, ``iterations`` are the most per step.
    """

    key = LinearImplicitEuler.key
    name = f"{LinearImplicitEuler.name} by CG"

    def __init__(self, springs: Springs, shell: Shell, iterations: int) -> None:
        self.iterations = iterations
        _ = shell.free_unknowns  # refuses supports of single components
        self._springs = springs
        self._stepper = PerThread(partial(ImplicitSprings, springs, shell.mass, shell.clamped))

    def start(self, body: Body, positions: Array) -> MotionState:
        """State at rest, with no change of velocity to start from; OptionError for another model than the sheet."""
        if getattr(body, "springs", None) is not self._springs:
            raise OptionError("this integrator belongs to another sheet of springs: pass solver='cg' instead of it")
        state = super().start(body, positions)
        state.memory["change"] = np.zeros_like(positions)
        return state

    def step(
        self, body: Body, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None
    ) -> tuple[MotionState, bool]:
        """Solve one system of linear equations by iteration."""
        stepper = self._stepper()
        stepper.place(state.coordinates, state.rates, state.memory.get("change"))
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
        return MotionState(stepper.positions, stepper.velocities, {"change": stepper.change}), found.converged
