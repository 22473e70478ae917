"""Implicit Euler steps of small discrete shells in one compiled function.

The kernels add element blocks straight into the storage of a profile factorisation; blocks above the diagonal and those
of held vertices have no place there. Of the milliseconds that a step of a few hundred unknowns takes through
SciPy nearly all is the interpreter's.
"""

from __future__ import annotations

import functools
from typing import final

import numpy as np

from modalshell.core.cost import count_elements, count_factorisation, count_solves
from modalshell.core.thread_safety import PerThread
from modalshell.core.typing import Array
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.integrators.state import Damping
from modalshell.linalg import ProfileAnalysis
from modalshell.models.coarse.profile_newton import Body, Elements, Start, implicit_step, make_room
from modalshell.shell import Sheet, Shell
from modalshell.shell.kernels.generated import flexure, shear, stretch

KERNELS = (stretch, shear, flexure)
"""Kernels of the element sets that a shell must have, in this order."""
_PRODUCTS = 3e8
"""Multiplications of a factorisation above which sparse ones are quicker."""


@final
class ProfileStep:
    """Steps of implicit Euler of one discrete shell without further energies, compiled.

    Parameters
    ----------
    shell : Shell
        The shell, with the element sets of a :class:`Material` alone; see :func:`profile_step`.
    analysis : ProfileAnalysis
        Profile of the stiffness of its free unknowns.
    """

    def __init__(self, shell: Shell, analysis: ProfileAnalysis) -> None:
        self._shell, free = shell, shell.free
        self._unknowns, self._products = 3 * free.size, analysis.products
        self._undamped = (np.empty(0),) * len(KERNELS)
        self._elements = sum(e.rest.size for e in shell.elements)
        place = np.full(len(shell.mass), -1, dtype=np.int64)
        place[free[analysis.order]] = np.arange(free.size)
        strides = np.zeros(len(place), dtype=np.int64)
        strides[free[analysis.order]] = analysis.strides

        def elements(index: int) -> Elements:
            given = shell.elements[index]
            of = place[given.stencils]
            rows, columns = np.broadcast_arrays(of[:, :, None], of[:, None, :])
            slots = np.full(rows.shape, -1)
            kept = (columns >= 0) & (columns <= rows)
            slots[kept] = analysis.places(3 * rows[kept], 3 * columns[kept])
            return Elements(given.stencils.copy(), given.rest.copy(), given.weight.copy(), slots)

        # Writeable copies: kernels are compiled for one kind of argument alone.
        self._body = Body(
            shell.rest_positions.copy(),
            float(shell.size),
            np.array(shell.mesh.faces, dtype=np.int64),
            shell.mass.copy(),
            free[analysis.order],
            analysis.first,
            analysis.starts,
            strides,
            *(elements(index) for index in range(len(KERNELS))),
        )
        self._room = PerThread(functools.partial(make_room, self._body))

    def __call__(self, start: EulerStart, load: Array, damping: Damping, tolerance: float) -> tuple[Array, bool]:
        """Positions (n, 3) [m] after a step under ``load`` (n, 3) [N], and whether the step's equations are solved.

        The held vertices rest. ``tolerance`` is the residual over the push of load and inertia.
        """
        rate = damping.stiffness_factor
        resistances = self._undamped
        if rate or self._shell.has_dashpots:
            resistances = tuple(elements.resistance(rate) for elements in self._shell.elements)
        moved, iterations, solved = implicit_step(
            self._body, self._room(), Start(start.origin, start.rates, start.near, start.viscous_at), load, start.dt,
            damping.mass_factor, resistances, tolerance,
        )  # fmt: skip
        count_elements(3 * (iterations + 1) * self._elements)  # gradient, Hessian and stresses
        count_factorisation(self._unknowns, iterations, self._products)
        count_solves(self._unknowns, iterations)
        return moved, bool(solved)


def profile_step(shell: Shell) -> ProfileStep | None:
    """The compiled step of a shell; None for energies, supports or sizes that it does not serve."""
    if isinstance(shell.material, Sheet) or tuple(e.kernel for e in shell.elements) != KERNELS:
        return None
    if shell.unknowns.matrix is not None:  # supports of single components
        return None
    analysis = ProfileAnalysis(shell.pattern.free_matrix(np.ones(shell.pattern.size)), shell.rest_positions[shell.free])
    return ProfileStep(shell, analysis) if analysis.products <= _PRODUCTS else None
