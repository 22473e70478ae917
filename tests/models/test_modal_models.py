"""What modal models have in common: free shells, no load at all, and what is refused."""

import numpy as np
import pytest
from scenes import leaf

from modalshell import (
    CoarseDiscreteShell,
    DiscreteShell,
    LinearModal,
    Material,
    ModalDerivatives,
    ModalWarping,
    ReducedRotationStrain,
    RigidShell,
    RotationStrain,
    Shell,
    flat_beam,
    solve_modes,
)
from modalshell.core.errors import LoadError, SolverError
from modalshell.shell.damping import Damping

MODELS = [LinearModal, ModalWarping, RotationStrain]


@pytest.fixture(scope="module")
def free_basis():
    return solve_modes(leaf(), 14)


@pytest.mark.parametrize("model", MODELS)
def test_a_pushed_free_shell_has_no_equilibrium(free_basis, model):
    answer = model(free_basis).equilibrium(gravity=(0.0, 0.0, -1.0))
    assert not answer.converged
    assert "no equilibrium" in answer.status
    assert answer.residual == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_a_balanced_load_on_a_free_shell_has_one(free_basis, model):
    shell = free_basis.shell
    expected = np.zeros(14)
    expected[7] = 1e-4 / np.abs(free_basis.modes[:, 7]).max()
    force = expected[7] * free_basis.eigenvalues[7] * np.repeat(shell.mass, 3) * free_basis.modes[:, 7]
    answer = model(free_basis).equilibrium(force=force.reshape(-1, 3))
    assert answer.converged
    assert np.abs(answer.positions - shell.rest_positions).max() == pytest.approx(1e-4, rel=1e-2)
    np.testing.assert_allclose(answer.coordinates, expected, rtol=0, atol=1e-2 * expected[7])


@pytest.mark.parametrize("model", MODELS)
def test_a_free_shell_falls_as_a_body(free_basis, model):
    rung = model(free_basis)
    load = free_basis.shell.gravity_force((0.0, 3.0, -9.81))
    state = rung.start_motion()
    for _ in range(20):
        state, _ = rung.step(state, 0.01, load, Damping())
    fallen = 0.5 * 0.2**2 * np.array([0.0, 3.0, -9.81])
    np.testing.assert_allclose(rung.positions(state), free_basis.shell.rest_positions + fallen, rtol=0, atol=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_no_load_is_rest(v_basis, model):
    for loads in ({}, {"gravity": (0.0, 0.0, 0.0)}, {"force": np.zeros_like(v_basis.shell.rest_positions)}):
        answer = model(v_basis).equilibrium(**loads)
        assert answer.converged
        np.testing.assert_array_equal(answer.positions, v_basis.shell.rest_positions)


@pytest.mark.parametrize(
    "options",
    [
        {"gravity": (0.0, 0.0)},
        {"gravity": (0.0, 0.0, np.nan)},
        {"gravity": "down"},
        {"force": np.zeros((3, 3))},
        {"force": "push"},
    ],
    ids=repr,
)
@pytest.mark.parametrize("model", MODELS)
def test_bad_loads_are_refused(v_basis, model, options):
    with pytest.raises(LoadError):
        model(v_basis).equilibrium(**options)


@pytest.mark.parametrize("start", [np.zeros((2, 3)), "here", [[np.nan, 0.0, 0.0]]], ids=["shape", "text", "nan"])
def test_bad_starts_are_refused(v_basis, start):
    with pytest.raises(LoadError):
        ModalWarping(v_basis).equilibrium(gravity=(0.0, 0.0, -1.0), start=start)


def test_a_load_that_is_not_finite_names_its_vertex(v_basis):
    force = np.zeros_like(v_basis.shell.rest_positions)
    force[11, 2] = np.inf
    with pytest.raises(LoadError, match=r"\b11\b"):
        LinearModal(v_basis).equilibrium(force=force)


@pytest.mark.filterwarnings("ignore:mode 3 belongs to a repeated eigenvalue")
@pytest.mark.parametrize("model", MODELS)
def test_statics_without_stiffness_is_refused(model):
    mesh = flat_beam(cells=(4, 2))
    basis = solve_modes(Shell(mesh, Material(0.0, 0.0, 0.0, 1.0), mesh.vertices[:, 0] < 0.3), 3)
    with pytest.raises(SolverError, match="elastic mode 0 has no stiffness"):
        model(basis).equilibrium(gravity=(0, 0, -1))


@pytest.mark.parametrize("kind", ["LMA", "MWTS", "RSW", "reduced RSW", "MD-ROM", "DS", "coarse DS", "rigid"])
def test_positions_are_new_arrays(v_basis, kind):
    full, shell = RotationStrain(v_basis), v_basis.shell
    model = {
        "LMA": lambda: LinearModal(v_basis),
        "MWTS": lambda: ModalWarping(v_basis),
        "RSW": lambda: full,
        "reduced RSW": lambda: ReducedRotationStrain.trained(full, [(0.0, 0.0, -1.0)], rank=4, mixtures=8),
        "MD-ROM": lambda: ModalDerivatives(shell, 2),
        "DS": lambda: DiscreteShell(shell),
        "coarse DS": lambda: CoarseDiscreteShell(shell, shell),
        "rigid": lambda: RigidShell(shell),
    }[kind]()
    state = model.start_motion()
    first, second = model.positions(state), model.positions(state)
    assert not np.shares_memory(first, second)
    assert not np.shares_memory(first, state.coordinates)
    assert not np.shares_memory(first, shell.rest_positions)


def test_damping_may_change_from_step_to_step(v_basis):
    model = LinearModal(v_basis)
    load = v_basis.shell.gravity_force((0.0, 0.0, -1.0))
    start = model.start_motion()
    stepped = [model.step(start, 0.1, load, Damping(factor))[0].rates for factor in (0.0, 5.0, 0.0)]
    assert np.abs(stepped[1]).max() < 0.9 * np.abs(stepped[0]).max()
    np.testing.assert_array_equal(stepped[2], stepped[0])


def test_spans_that_share_nothing_are_no_reason_for_warnings():
    """The derivative of one span's mode along the other's is zero: its change was divided by that."""
    mesh = flat_beam(length=1.0, width=0.2, cells=(10, 2))
    shell = Shell(mesh, Material(2e3, 2e3, 0.05, 0.2), "abs(x - 0.45) < 0.06")
    derivatives = ModalDerivatives(shell, count=4).basis.derivatives
    assert np.isfinite(derivatives).all()
