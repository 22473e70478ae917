"""Derivatives of equilibria: Taylor slopes, the adjoint against the forward solve, closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PLAIN

import modalshell as ms

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


@pytest.mark.parametrize(("material", "name"), [*CASES, (SHEET, "gravity")])
def test_the_adjoint_equals_the_forward_solve(states, material, name):
    state = states[material]
    weights = np.random.default_rng(0).standard_normal(state.positions.shape)
    forward = np.einsum("ni,nik->k", weights, model(material).sensitivity(state, wrt=name))
    adjoint = model(material).sensitivity(state, wrt=name, of=weights)
    np.testing.assert_allclose(adjoint, forward, rtol=1e-8)


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
