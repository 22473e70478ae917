"""Spring sheet: masses and springs, the classical cloth model."""

from __future__ import annotations

from typing import Literal, final

from modalshell.core.checks import checked_choice, checked_count, checked_kind, checked_number
from modalshell.core.errors import MeshError, OptionError
from modalshell.core.typing import Index
from modalshell.integrators.full import FullIntegrator, LinearImplicitEuler
from modalshell.models.base.full import FullModel
from modalshell.models.registry import ModelSpec, register
from modalshell.shell import Shell
from modalshell.springs.conjugate_gradients import ConjugateGradientEuler
from modalshell.springs.mesh_springs import REFERENCE_FOLD, shell_springs
from modalshell.springs.springs import Springs


@final
class SpringSheet(FullModel):
    """Springs in place of the material's energies; statics, integrators and constraints are those of DS.

    Springs along the edges resist stretch and shear as those of a discrete shell do, less the area energy. Springs
    across hinges resist bending only at second order: the energy of a *flat* sheet grows with the fourth power of the
    fold angle, so that it has no bending stiffness at rest, its bending modes have frequency zero, and no stiffness
    fits more than one curvature; they also stiffen the membrane. A sheet *curved* at rest is resisted by them at
    first order, folding and unfolding alike. ``studies/sheet_vs_shell.py`` measures what that costs.

    Parameters
    ----------
    shell : Shell
        Mesh, masses, supports and further energies; its material's, too, where ``springs`` are not given.
    springs : Springs, optional
        Springs between the mesh's vertices; by default those of :func:`modalshell.springs.shell_springs`.
    integrator : str or FullIntegrator
        As for :class:`DiscreteShell`, by default ``"bdf2"``. ``"linear_implicit"`` is the method of Baraff and Witkin
        [baraff1998].
    solver : {"factor", "cg"}
        How ``"linear_implicit"`` solves its equations: by a sparse factorisation, or by conjugate gradients on blocks
        of particles (:class:`modalshell.springs.ImplicitSprings`), each step from the last one's answer.
    iterations : int
        Largest number of conjugate-gradient iterations per step.
    allow_unstable_step, step_tolerance, backend : optional
        As for :class:`DiscreteShell`; ``step_tolerance`` is also the residual at which conjugate gradients stop.
    reference_fold : float
        Fold [rad] at which :func:`modalshell.springs.shell_springs` hold the hinges' energy.

    Attributes
    ----------
    springs : Springs
        The springs.

    Raises
    ------
    MeshError
        For springs between vertices that the mesh has not.
    """

    name = "springs"
    of_material = False

    def __init__(
        self,
        shell: Shell,
        springs: Springs | None = None,
        *,
        integrator: str | FullIntegrator = "bdf2",
        solver: Literal["factor", "cg"] = "factor",
        iterations: int = 1000,
        allow_unstable_step: bool = False,
        step_tolerance: float = 1e-6,
        backend: str | None = None,
        reference_fold: float = REFERENCE_FOLD,
    ) -> None:
        checked_kind("shell", shell, Shell).refuse_creases_in("a spring sheet")
        springs = shell_springs(shell, reference_fold) if springs is None else springs
        self.springs = checked_kind("springs", springs, Springs)
        count = len(shell.rest_positions)
        if len(self.springs) == 0 or self.springs.pairs.max() >= count:
            worst = self.springs.pairs.max(initial=-1)
            raise MeshError(f"springs must join the vertices 0 to {count - 1} of the mesh (got {worst})")
        checked_choice("solver", solver, ("factor", "cg"))
        rule = FullIntegrator.chosen(integrator)
        self.iterations = checked_count("iterations", iterations)
        if solver == "cg":
            if rule.key != LinearImplicitEuler.key:
                raise OptionError(f"conjugate gradients serve integrator='linear_implicit' only (got {rule.key!r})")
            if shell.energies:
                keys = ", ".join(type(each).key for each in shell.energies)
                raise OptionError(
                    f"solver='cg' knows springs alone (got further energies: {keys}): take solver='factor'"
                )
            rule = ConjugateGradientEuler(self.springs, shell, self.iterations)
        super().__init__(
            shell.with_elements([self.springs.element_set()]),
            integrator=rule,
            allow_unstable_step=allow_unstable_step,
            step_tolerance=checked_number("step_tolerance", step_tolerance, above=0.0, at_most=1e-2),
            backend=backend,
        )
        self._true_shell = shell
        self.solver: Literal["factor", "cg"] = solver

    @property
    def true_shell(self) -> Shell:
        """The shell that springs stand for."""
        return self._true_shell

    def holding(self, vertices: Index) -> SpringSheet:
        """The same model, with further vertices held."""
        return SpringSheet(
            self.shell.holding(vertices),
            self.springs,
            integrator=self.integrator,
            solver=self.solver,
            iterations=self.iterations,
            allow_unstable_step=self.allow_unstable_step,
            step_tolerance=self.step_tolerance,
            backend=self.factoriser.backend,
        )


register(
    ModelSpec(
        "springs", "springs", SpringSheet, "shell", 80, constraints=True, color="#a6761d", marker="*", bends=False
    )
)
