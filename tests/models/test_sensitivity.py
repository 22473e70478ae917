"""Derivatives of equilibria: Taylor slopes, the adjoint against the forward solve, closed forms."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scenes import PLAIN, with_rest_angles

import modalshell as ms
from modalshell.core import cost as work
from modalshell.core.timings import Timings
from modalshell.modes import Factoriser
from modalshell.shell import EXACT, constant_slopes
from modalshell.shell.split_fold_energy import SplitFoldEnergy
from modalshell.statics.newton import mixed_newton
from modalshell.statics.potential import Potential

GRAVITY = (0.0, 0.3, -2.0)
SHEET = ms.Isotropic(young=1e6, poisson=0.3, thickness=4e-3, density=60.0)


def model(material, **supports):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(12, 4))
    clamped = mesh.vertices[:, 0] < 0.01 if isinstance(material, ms.Isotropic) else mesh.vertices[:, 0] < 0.1
    return ms.DiscreteShell(ms.Shell(mesh, material, clamped, **supports))


CASES = [(PLAIN, name) for name in ("stretch", "shear", "flexure", "density")]
CASES += [(SHEET, name) for name in ("young", "poisson", "thickness", "density")]


@pytest.fixture(scope="module")
def states():
    return {material: model(material).equilibrium(gravity=GRAVITY) for material in (PLAIN, SHEET)}


@pytest.mark.slow
@pytest.mark.parametrize(("material", "name"), CASES)
def test_the_derivative_has_taylor_slope_two(states, material, name):
    state = states[material]
    slope = model(material).sensitivity(state, wrt=name)
    assert slope.shape == (*state.positions.shape, 1)
    value = getattr(material, name)
    errors = []
    for change in (0.08, 0.04, 0.02):
        near = replace(material, **{name: value * (1.0 + change)})
        answer = model(near).equilibrium(gravity=GRAVITY, start=state.positions)
        assert answer.converged
        errors.append(np.linalg.norm(answer.positions - state.positions - change * value * slope[..., 0]))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (np.abs(orders - 2.0) < 0.25).all(), orders


def test_the_derivative_by_gravity_has_taylor_slope_two(states):
    state, steps = states[SHEET], np.array([0.1, -0.05, 0.08])
    slope = model(SHEET).sensitivity(state, wrt="gravity")
    assert slope.shape == (*state.positions.shape, 3)
    errors = []
    for share in (1.0, 0.5, 0.25):
        answer = model(SHEET).equilibrium(gravity=np.array(GRAVITY) + share * steps, start=state.positions)
        errors.append(np.linalg.norm(answer.positions - state.positions - share * slope @ steps))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (np.abs(orders - 2.0) < 0.25).all(), orders


OTHERS = [(m, name) for m in (PLAIN, SHEET) for name in ("gravity", "load", "force", "rest_angles", "supports")]


@pytest.mark.by_default(
    "material1-shear",
    "material2-flexure",
    "material3-density",
    "material6-thickness",
    "material9-load",
    "material10-force",
    "material11-rest_angles",
    "material12-supports",
)
@pytest.mark.parametrize(("material", "name"), [*CASES, *OTHERS])
def test_the_adjoint_equals_the_forward_solve(states, material, name):
    state = states[material]
    weights = np.random.default_rng(0).standard_normal(state.positions.shape)
    forward = np.einsum("ni,nik->k", weights, model(material).sensitivity(state, wrt=name))
    adjoint = model(material).sensitivity(state, wrt=name, of=weights)
    np.testing.assert_allclose(adjoint, forward, rtol=1e-8)


@pytest.mark.parametrize("material", [PLAIN, SHEET])
def test_a_list_of_names_gives_their_columns_in_order(states, material):
    body, state = model(material), states[material]
    names = ["density", "gravity", "load"]
    together = body.sensitivity(state, wrt=names)
    apart = [body.sensitivity(state, wrt=name) for name in names]
    np.testing.assert_array_equal(together, np.concatenate(apart, axis=2))
    assert together.shape == (*state.positions.shape, 5)


def orders_of(errors):
    return np.log2(np.array(errors[:-1]) / errors[1:])


def solved(shell, load, start):
    """Positions in balance next to ``start``, held vertices where they are there."""
    problem = Potential(load, shell.rest_positions, shell, Factoriser(), Timings())
    answer = mixed_newton(problem, start, problem.scale_at(None), stresses=shell.predicted_stresses(start, 0.0 * start))
    assert answer.residual < 1e-8
    return answer.point


@pytest.mark.parametrize("material", [PLAIN, SHEET])
def test_the_derivative_by_forces_has_taylor_slope_two(states, material):
    body, state = model(material), states[material]
    push = 1e-2 * np.abs(state.loading.dead).max() * np.random.default_rng(3).standard_normal(state.positions.shape)
    slope = (body.sensitivity(state, wrt="force") @ push.ravel()).reshape(state.positions.shape)
    errors = []
    for share in (4.0, 2.0, 1.0):
        answer = body.equilibrium(gravity=GRAVITY, force=share * push, start=state.positions)
        errors.append(np.linalg.norm(answer.positions - state.positions - share * slope))
    assert (np.abs(orders_of(errors) - 2.0) < 0.25).all(), errors


@pytest.mark.by_default("material0")
@pytest.mark.parametrize("material", [PLAIN, SHEET])
def test_the_derivative_by_rest_angles_has_taylor_slope_two(states, material):
    body, state = model(material), states[material]
    shell = body.shell
    change = 0.01 * np.random.default_rng(4).standard_normal(len(shell.mesh.hinges))
    slope = body.sensitivity(state, wrt="rest_angles") @ change
    errors = []
    for share in (0.5, 0.25, 0.125):
        bent = with_rest_angles(shell, share * change)
        answer = solved(bent, state.loading.dead, state.positions)
        errors.append(np.linalg.norm(answer - state.positions - share * slope))
    assert (np.abs(orders_of(errors) - 2.0) < 0.25).all(), errors


@pytest.mark.by_default("material0")
@pytest.mark.parametrize("material", [PLAIN, SHEET])
def test_the_derivative_by_supports_has_taylor_slope_two(material):
    """One of two clamps is moved; ghosts that clamp an edge move with its ends."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(12, 4))
    x, row = mesh.vertices[:, 0], 0.01 if material is SHEET else 0.1
    shell = ms.Shell(mesh, material, (x < row) | (x > 1.0 - row))
    body = ms.DiscreteShell(shell)
    state = body.equilibrium(gravity=(0.0, 0.3, -2.0))
    held = np.flatnonzero(shell.clamped)
    steps = np.where(x[held] > 0.5, 1.0, 0.0)[:, None] * np.array([-1e-5, 2e-5, 3e-5])
    slope = body.sensitivity(state, wrt="supports") @ steps.ravel()
    np.testing.assert_allclose(slope[held], steps, atol=1e-12)
    errors = []
    for share in (1.0, 0.5, 0.25):
        moved = copy.copy(shell)
        if material is SHEET:
            energy = moved._energy = copy.copy(shell._energy)
            ghosts = energy._folds.ghosts.copy()
            ghosts[ghosts[:, 0] > 0.5] += share * np.array([-1e-5, 2e-5, 3e-5])
            energy._folds = replace(energy._folds, ghosts=ghosts)
        start = state.positions + share * slope
        answer = solved(moved, state.loading.dead, start)
        errors.append(np.linalg.norm(answer - start))
    assert (np.abs(orders_of(errors) - 2.0) < 0.25).all(), errors


@pytest.mark.slow
def test_weights_among_the_loads_go_with_the_density():
    body, push = model(SHEET), [ms.SelfWeight((0.0, 0.3, -2.0))]
    state = body.equilibrium(loads=push)
    apart = body.sensitivity(model(SHEET).equilibrium(gravity=GRAVITY), wrt="density")
    np.testing.assert_allclose(body.sensitivity(state, wrt="density"), apart, atol=1e-9 * np.abs(apart).max())


def test_springs_have_no_derivative_by_the_material():
    sheet = ms.SpringSheet(model(PLAIN).shell)
    state = sheet.equilibrium(gravity=(0.0, 0.0, -0.02))
    assert np.abs(sheet.sensitivity(state, wrt="density")).max() > 0.0
    for name, told in (("flexure", "springs have stiffnesses of their own"), ("rest_angles", "no rest angles")):
        with pytest.raises(ms.OptionError, match=told):
            sheet.sensitivity(state, wrt=name)


def test_one_factorisation_serves_an_adjoint_of_many_parameters(states, monkeypatch):
    """Its cost is that of one Newton step: no energy is built anew."""
    made = []
    monkeypatch.setattr(Factoriser, "symmetric", counted(Factoriser.symmetric, made))
    monkeypatch.setattr(SplitFoldEnergy, "__init__", counted(SplitFoldEnergy.__init__, made))
    body, state = model(SHEET), states[SHEET]
    made.clear()
    names = ["young", "poisson", "thickness", "density", "gravity", "rest_angles", "supports"]
    assert np.isfinite(body.sensitivity(state, wrt=names, of=np.ones_like(state.positions))).all()
    assert len(made) == 1


@pytest.mark.parametrize("material", [PLAIN, SHEET])
def test_an_adjoint_costs_at_most_one_and_a_half_newton_steps(states, material):
    """In counted work, by every constant; what follows from the rest shape alone is made once a shell."""
    body, state = model(material), states[material]
    weights = np.ones_like(state.positions)
    problem = body._statics(state.loading.dead)
    with work.counted() as newton:
        gradient, hessian = problem.linearise(state.positions, EXACT)
        problem.moved(state.positions, problem.factor(hessian).solve(-gradient))
    for name in (name for of, name in CASES if of is material):
        with work.counted() as adjoint:
            body.sensitivity(state, wrt=name, of=weights)
        assert adjoint.factorisations == newton.factorisations == 1
        assert adjoint.solves <= newton.solves
        assert adjoint.cost <= 1.5 * newton.cost


def test_derivatives_by_poissons_ratio_of_all_states_share_what_the_rest_shape_gives(states, monkeypatch):
    made, body, state = [], model(SHEET), states[SHEET]
    for function in ("fold_moments", "plane_stress"):
        monkeypatch.setattr(constant_slopes, function, counted(getattr(constant_slopes, function), made))
    first = body.sensitivity(state, wrt="poisson")
    assert made
    made.clear()
    shifted = replace(state, positions=state.positions + 1e-6)
    np.testing.assert_allclose(body.sensitivity(shifted, wrt="poisson"), first, rtol=1e-2, atol=1e-4)
    assert not made


def counted(function, calls):
    def call(*given, **named):
        calls.append(function.__name__)
        return function(*given, **named)

    return call


def test_loads_that_follow_the_shell_are_felt():
    """Under a follower pressure the tangent has its stiffness."""
    body, push = model(SHEET), [ms.Pressure(0.1)]
    state = body.equilibrium(loads=push)
    slope = body.sensitivity(state, wrt="young")[..., 0]
    stiffer = replace(SHEET, young=1.001e6)
    answer = model(stiffer).equilibrium(loads=push, start=state.positions)
    difference = (answer.positions - state.positions) / 1e3
    assert np.linalg.norm(slope - difference) < 5e-3 * np.linalg.norm(difference)


def test_a_small_cantilever_gives_the_closed_forms():
    """Small deflections go as 1 / E and 1 / h^2 under the sheet's own weight."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(20, 2))
    body = ms.DiscreteShell(ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < 0.01))
    state = body.equilibrium(gravity=(0.0, 0.0, -0.001))
    drop = state.positions[:, 2].min()
    tip = np.zeros_like(state.positions)
    tip[state.positions[:, 2].argmin(), 2] = 1.0
    for name, power in (("young", -1.0), ("thickness", -2.0), ("density", 1.0)):
        (slope,) = body.sensitivity(state, wrt=name, of=tip)
        assert slope * getattr(SHEET, name) / drop == pytest.approx(power, rel=2e-3)


def test_components_held_by_supports_do_not_move():
    mesh = ms.sheet(length=1.0, width=1.0, cells=(8, 8))
    edge = (np.abs(mesh.vertices[:, :2] - 0.5) > 0.49).any(axis=1)
    shell = ms.Shell(mesh, SHEET, supports=[ms.Fix(edge, axes="z"), ms.Pin([0]), ms.Fix([8], axes="y")])
    body = ms.DiscreteShell(shell)
    state = body.equilibrium(gravity=(0.0, 0.0, -1.0))
    assert state.converged
    slope = body.sensitivity(state, wrt="young")[..., 0]
    assert np.abs(slope[edge, 2]).max() == 0.0
    assert np.abs(slope).max() > 0.0


def test_what_has_no_derivative_is_refused(states):
    body, state = model(PLAIN), states[PLAIN]
    with pytest.raises(ms.OptionError, match="wrt must be one of stretch, shear, flexure, density"):
        body.sensitivity(state, wrt="young")
    with pytest.raises(ms.OptionError, match="must be a converged equilibrium"):
        body.sensitivity(replace(state, outcome=ms.Outcome.NOT_CONVERGED), wrt="flexure")
    with pytest.raises(ms.OptionError, match="of must have shape"):
        body.sensitivity(state, wrt="flexure", of=np.ones(3))
    with pytest.raises(ms.OptionError, match="state must be what equilibrium"):
        body.sensitivity(replace(state, loading=None), wrt="flexure")
    faces = len(body.shell.mesh.faces)
    uneven = model(replace(PLAIN, stretch=np.full(faces, 20.0)))
    with pytest.raises(ms.OptionError, match="one number for the whole mesh"):
        uneven.sensitivity(uneven.equilibrium(gravity=GRAVITY), wrt="stretch")
