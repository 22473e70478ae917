"""The nonlinear solver and the continuation stand once: constants in one file each, one method for all algebra."""

import ast
from pathlib import Path

import numpy as np
import pytest

import modalshell as ms
from modalshell.integrators.full.implicit_rule import EulerStart
from modalshell.models.coarse import profile_step
from modalshell.shell import EXACT
from modalshell.statics import mixed_newton as method
from modalshell.statics.continuation import Steps
from modalshell.statics.newton import NewtonIterate

PACKAGE = Path(ms.__file__).parent
SOLVERS = sorted(
    {
        *(PACKAGE / "statics").glob("*.py"),
        *(PACKAGE / "integrators").rglob("*.py"),
        *(PACKAGE / "models" / "base").glob("*.py"),
        *(PACKAGE / "models" / "coarse").glob("profile_*.py"),
        *(PACKAGE / "models" / "hybrid").glob("*st*.py"),
        PACKAGE / "compare" / "path.py",
    }
)
ARC_LENGTH = PACKAGE / "statics" / "path.py"


def constants(path):
    """Names of numbers that a module defines, without the underscore of private ones."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        for target in getattr(node, "targets", [getattr(node, "target", None)]):
            for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(name, ast.Name) and name.id.isupper():
                    names.add(name.id.lstrip("_"))
    return names


def holders(words):
    """Files that define a constant whose name has one of some words in it."""
    return {path for path in SOLVERS for name in constants(path) if set(name.split("_")) & words}


def test_the_constants_of_the_solver_stand_in_one_file():
    own = constants(PACKAGE / "statics" / "mixed_newton.py")
    assert {"STALLED", "LOOSE", "NEAR", "SADDLES", "DESCENT", "EASY", "FIRST_MOVE", "LARGEST_TURN"} <= own
    for path in SOLVERS:
        if path.name != "mixed_newton.py":
            # Paths aim at a residual of their own: their points carry derivatives.
            assert not constants(path) & own - ({"GOAL"} if path == ARC_LENGTH else set()), path


def test_the_constants_of_continuation_stand_in_one_file():
    assert holders({"GROWTH", "SHRINK", "SMALLEST"}) - {ARC_LENGTH} == {
        PACKAGE / "statics" / "continuation.py",
        PACKAGE / "statics" / "bifurcation.py",  # the least load at which the end of a branch is looked for
    }


def test_steps_grow_with_success_and_shrink_with_failure_to_an_end():
    steps, taken = Steps(0.25), []
    while steps.fraction < 1.0:
        steps.limit()
        taken.append(steps.target)
        steps.accept()
    assert taken == [0.25, 0.75, 1.0]
    steps, sizes = Steps(), [1.0]
    while steps.refuse():
        sizes.append(steps.step)
    assert sizes == [4.0**-k for k in range(5)]
    steps.accept(0.5)
    assert steps.fraction == 0.5
    assert steps.step == 2.0 * sizes[-1]


def strip():
    """A soft strip clamped at its end, and its weight."""
    mesh = ms.flat_beam(cells=(8, 2))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.2)
    return shell, shell.gravity_force((0.0, 0.0, -9.81))


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_it_stops_after_so_many_steps(steps):
    """The residual after each step falls, and the point is that of the last one."""
    shell, load = strip()
    problem = ms.DiscreteShell(shell).followable(load).problem
    state = NewtonIterate(problem, shell.rest_positions, problem.scale_at(None))
    found = method.iterate(state, method.Rules(0.0, 0.0, 0.0, 0, steps))
    assert found.iterations == steps
    assert not found.solved
    reached = problem.measure(problem.residual(state.x)) / problem.scale_at(None)
    assert found.residual == pytest.approx(reached, rel=1e-9)


def held_beam(mesh, stiffness=2000.0):
    """A beam clamped at its end, its membrane stiff."""
    material = ms.Material(stiffness, stiffness, 0.05, 0.2)
    return ms.Shell(mesh, material, mesh.vertices[:, 0] < 0.15)


def test_profile_and_sparse_algebra_agree_on_steps_of_many_iterations(monkeypatch):
    """Long steps under a load that crumples the beam: one method, two storages."""
    shell, counts = held_beam(ms.v_beam(fold=150.0, cells=(10, 4))), []
    compiled_step = profile_step.implicit_step

    def counted(*arguments):
        counts.append(compiled_step(*arguments))
        return counts[-1]

    monkeypatch.setattr(profile_step, "implicit_step", counted)
    load = shell.gravity_force((0.0, 40.0, -200.0))
    compiled = ms.CoarseDiscreteShell(shell, shell, step_tolerance=1e-9, integrator="implicit")  # one solve a step
    sparse = ms.DiscreteShell(shell, step_tolerance=1e-9, integrator="implicit")
    one, other = compiled.start_motion(), sparse.start_motion()
    for _ in range(8):
        one, solved = compiled.step(one, 1 / 30, load, ms.Damping(0.5, 0.0))
        other, expected = sparse.step(other, 1 / 30, load, ms.Damping(0.5, 0.0))
        assert solved
        assert expected
        apart = np.abs(compiled.positions(one) - sparse.positions(other)).max()
        assert apart < 1e-5 * shell.size
    assert len(counts) == 8  # none was left to the sparse solver
    assert max(iterations for iterations, _ in counts) > 15  # more than mixed Newton alone takes


@pytest.mark.slow
def test_compiled_steps_end_at_minima():
    """Where a flat strip is compressed beyond buckling, the exact Hessian with the inertia is positive definite."""
    shell = held_beam(ms.flat_beam(cells=(8, 3)))
    step, rng, hard = profile_step.profile_step(shell), np.random.default_rng(1), 0
    for trial in range(40):
        dt, pull = 10.0 ** rng.uniform(-1.0, 1.5), 10.0 ** rng.uniform(2.0, 4.0)
        load = shell.gravity_force((-pull, 0.01 * pull * (trial % 2), 0.0))
        x, rates = shell.rest_positions, np.zeros_like(shell.rest_positions)
        start = EulerStart(x, rates, dt, 1.0, rates, x, x, 0.0)
        moved, solved = step(start, load, ms.Damping(0.5, 0.0), 1e-2)
        hard += np.abs(moved - x)[:, 2].max() > 0.1
        hessian = shell.energy_gradient_hessian(moved, EXACT)[2]
        hessian[shell.pattern.diagonal] += np.repeat(shell.mass, 3) * (1.0 / dt**2 + 0.5 / dt)
        root = np.sqrt(np.repeat(shell.mass[shell.free], 3))
        matrix = shell.pattern.free_matrix(hessian).toarray() / root[:, None] / root
        assert not solved or np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0] > -1e-6 / dt**2
    assert hard > 5


@pytest.mark.by_default("0.0")
@pytest.mark.parametrize("gravity", [0.0, 1e-170, 10.0, 1e4])
def test_compiled_steps_of_a_flat_hybrid_are_finite(gravity):
    """No hinge is bent at rest, and the load may be none at all."""
    shell = held_beam(ms.flat_beam(cells=(8, 2)))
    hybrid = ms.HybridStress.trained(shell, gravity=(0.0, 3.0, -10.0), modes=8, motions=4)
    state = hybrid.start_motion()
    for _ in range(3):
        state, solved = hybrid.step(state, 1 / 30, shell.gravity_force((0.0, 0.3 * gravity, -gravity)), ms.Damping(0.5))
        assert solved
        assert np.isfinite(state.coordinates).all()
    if gravity < 1.0:
        assert state.coordinates.ndim == 1  # the reduced steps hold a shell at rest
