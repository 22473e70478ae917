"""Derivatives of reduced models' equilibria: Taylor slopes, adjoint against forward, what has none."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from scenes import PLAIN, with_rest_angles

import modalshell as ms
from modalshell.models.base.reduced_sensitivity import ModalTangent
from modalshell.models.reduction.reduced_energy import ReducedEnergy

SHEET = ms.Isotropic(young=1e6, poisson=0.3, thickness=4e-3, density=60.0)
GRAVITY = np.array([0.0, 0.3, -2.0])
MAKERS = {
    "lma": ms.LinearModal,
    "mwts": ms.ModalWarping,
    "consistent": lambda basis: ms.ModalWarping(basis, consistent_force=True),
    "rsw": ms.RotationStrain,
}


def model(kind, material):
    mesh = ms.v_beam(length=1.0, width=0.23, fold=140.0, cells=(12, 4))
    shell = ms.Shell(mesh, material, mesh.vertices[:, 0] < (0.01 if material.__class__ is ms.Isotropic else 0.1))
    return ms.ModalDerivatives(shell, count=5) if kind == "md" else MAKERS[kind](ms.solve_modes(shell, count=6))


def gravity(material):
    return GRAVITY if isinstance(material, ms.Isotropic) else 0.3 * GRAVITY


@pytest.fixture(scope="module")
def known():
    found = {}

    def solved(kind, material):
        if (kind, id(material)) not in found:
            body = model(kind, material)
            found[kind, id(material)] = body, body.equilibrium(gravity=gravity(material))
        return found[kind, id(material)]

    return solved


CONSTANTS = [(PLAIN, name) for name in ("stretch", "shear", "flexure", "density")]
CONSTANTS += [(SHEET, name) for name in ("young", "poisson", "thickness", "density")]
CASES = [(kind, *case) for kind in MAKERS for case in CONSTANTS]
CASES += [("md", SHEET, "young"), ("md", SHEET, "density"), ("md", PLAIN, "density")]


def remainders(body, state, name, value, answer):
    """Norms of what the derivative leaves of the answers at smaller and smaller changes, over that of the answer."""
    slope = body.sensitivity(state, wrt=name)[..., 0]
    errors = []
    for change in (0.04, 0.02, 0.01):
        errors.append(np.linalg.norm(answer(1.0 + change) - state.positions - change * value * slope))
    return np.array(errors) / np.linalg.norm(state.positions - body.shell.rest_positions)


@pytest.mark.by_default("lma-material3-density", "mwts-material13-poisson")
@pytest.mark.parametrize(("kind", "material", "name"), CASES)
def test_the_derivative_by_a_constant_has_taylor_slope_two(known, kind, material, name):
    body, state = known(kind, material)
    value, load = getattr(material, name), gravity(material)

    def answer(factor):
        other = model(kind, replace(material, **{name: value * factor}))
        return other.equilibrium(gravity=load, start=state.positions).positions

    errors = remainders(body, state, name, value, answer)
    if kind == "lma" and name == "density":  # linear: nothing is left
        assert errors.max() < 1e-12
    else:
        orders = np.log2(errors[:-1] / errors[1:])
        assert (np.abs(orders - 2.0) < 0.2).all(), orders


@pytest.mark.by_default("consistent", "rsw")
@pytest.mark.parametrize("kind", [*MAKERS, "md"])
def test_the_derivative_by_the_load_has_taylor_slope_two(known, kind):
    body, state = known(kind, SHEET)

    def answer(factor):
        return body.equilibrium(gravity=factor * GRAVITY, start=state.positions).positions

    errors = remainders(body, state, "load", 1.0, answer)
    if kind == "lma":
        assert errors.max() < 1e-12
    else:
        assert (np.abs(np.log2(errors[:-1] / errors[1:]) - 2.0) < 0.2).all(), errors
    slope = body.sensitivity(state, wrt="gravity") @ GRAVITY
    np.testing.assert_allclose(slope, body.sensitivity(state, wrt="load")[..., 0], atol=1e-9 * np.abs(slope).max())


@pytest.mark.by_default("consistent", "md")
@pytest.mark.parametrize("kind", [*MAKERS, "md"])
def test_the_adjoint_equals_the_forward_solve(known, kind):
    body, state = known(kind, SHEET)
    names = ["young", "density", "gravity", "load"]
    names += ["thickness", "poisson", "rest_angles"]
    names += [] if kind == "mwts" else ["force"]
    weights = np.random.default_rng(0).standard_normal(state.positions.shape)
    forward = np.einsum("ni,nik->k", weights, body.sensitivity(state, wrt=names))
    np.testing.assert_allclose(body.sensitivity(state, wrt=names, of=weights), forward, rtol=1e-8)


def on_the_same_span(body, shell):
    """MD-ROM on another shell, its span as it was."""
    other = copy.copy(body)
    other.shell, other.energy = shell, ReducedEnergy(shell, body._vectors)
    return other


@pytest.mark.by_default("material0-stretch", "material1-shear", "material2-flexure")
@pytest.mark.parametrize(("material", "name"), [case for case in CONSTANTS if case[1] != "density"])
def test_the_derivative_of_the_derivative_basis_at_a_held_span_has_taylor_slope_two(known, material, name):
    body, state = known("md", material)
    value, load = getattr(material, name), state.loading.dead

    def answer(factor):
        other = body.shell.with_material(replace(material, **{name: value * factor}))
        push = other.total_load(gravity(material))
        return on_the_same_span(body, other).equilibrium(force=push, start=state.positions).positions

    assert np.abs(load).max() > 0.0
    errors = remainders(body, state, name, value, answer)
    assert (np.abs(np.log2(errors[:-1] / errors[1:]) - 2.0) < 0.2).all(), errors


@pytest.mark.parametrize("material", [PLAIN, SHEET])
def test_the_derivative_by_rest_angles_at_a_held_span_has_taylor_slope_two(known, material):
    body, state = known("md", material)
    change = 0.02 * np.random.default_rng(4).standard_normal(len(body.shell.mesh.hinges))
    slope = body.sensitivity(state, wrt="rest_angles") @ change
    errors = []
    for share in (1.0, 0.5, 0.25):
        bent = on_the_same_span(body, with_rest_angles(body.shell, share * change))
        answer = bent.equilibrium(force=state.loading.dead, start=state.positions)
        errors.append(np.linalg.norm(answer.positions - state.positions - share * slope))
    assert (np.abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 2.0) < 0.25).all(), errors


@pytest.mark.parametrize("kind", MAKERS)
def test_the_derivative_by_rest_angles_of_modal_models_has_taylor_slope_two(known, kind):
    """Their couples act on the modal coordinates, wherever these are."""
    body, state = known(kind, SHEET)
    change = 0.2 * np.random.default_rng(4).standard_normal(len(body.shell.mesh.hinges))
    slope = body.sensitivity(state, wrt="rest_angles") @ change
    energy, rest = body.shell.elastic_energy, body.shell.rest_positions
    modes = np.ascontiguousarray(body.basis.modes.T).reshape(-1, *rest.shape)
    couples = np.array([energy.pulled_by_rest_angles(rest, mode) @ change for mode in modes])
    tangent, q = ModalTangent(body, state), state.coordinates

    def answer(share):
        found = q.copy()
        for _ in range(30):
            left = body.modal_force(found, state.loading.dead) - share * couples - body.basis.eigenvalues * found
            tangent._q = found
            found = found + np.linalg.solve(tangent.tangent(), left)
        return rest + body.raw_displacement(found)

    errors = [np.linalg.norm(answer(share) - state.positions - share * slope) for share in (1.0, 0.5, 0.25)]
    if kind == "lma":
        assert max(errors) < 1e-9 * np.linalg.norm(slope)
    else:
        assert (np.abs(np.log2(np.array(errors[:-1]) / errors[1:]) - 2.0) < 0.25).all(), errors


@pytest.mark.parametrize("material", [PLAIN, SHEET])
def test_with_all_modes_the_derivative_by_rest_angles_is_that_of_the_shell(material):
    """Linear modal analysis on every mode is the linear shell; the discrete shell is, under next to no load."""
    mesh = ms.v_beam(length=1.0, width=0.3, fold=140.0, cells=(4, 2))
    shell = ms.Shell(mesh, material, mesh.vertices[:, 0] < (0.01 if material is SHEET else 0.3))
    full = ms.solve_modes(shell, shell.unknowns.count)
    small = (0.0, 0.0, -1e-6)
    slopes = []
    for body in (ms.LinearModal(full), ms.DiscreteShell(shell)):
        slopes.append(body.sensitivity(body.equilibrium(gravity=small), wrt="rest_angles"))
    assert np.linalg.norm(slopes[0] - slopes[1]) < 1e-5 * np.linalg.norm(slopes[1])


def test_a_sheet_that_the_span_holds_has_the_derivatives_of_the_shell():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 3))
    shell = ms.Shell(mesh, replace(SHEET, thickness=0.02), mesh.vertices[:, 0] < 0.01)
    weights = np.zeros_like(mesh.vertices)
    weights[-1, 2] = 1.0
    slopes = []
    for body in (ms.ModalDerivatives(shell, count=6), ms.DiscreteShell(shell)):
        state = body.equilibrium(gravity=(0.0, 0.0, -3.0))
        slopes.append(body.sensitivity(state, wrt=["young", "thickness"], of=weights))
    np.testing.assert_allclose(slopes[0], slopes[1], rtol=0.03)


@pytest.mark.parametrize("kind", ["lma", "consistent", "rsw", "md"])
def test_the_derivative_by_forces_is_the_answer_to_small_ones(known, kind):
    body, state = known(kind, SHEET)
    push = 1e-6 * np.abs(state.loading.dead).max() * np.random.default_rng(3).standard_normal(state.positions.shape)
    slope = (body.sensitivity(state, wrt="force") @ push.ravel()).reshape(push.shape)
    answers = [body.equilibrium(force=state.loading.dead + side * push, start=state.positions) for side in (1, -1)]
    moved = 0.5 * (answers[0].positions - answers[1].positions)
    assert np.linalg.norm(slope - moved) < 1e-3 * np.linalg.norm(moved)


def test_repeated_eigenvalues_do_no_harm():
    """A square sheet clamped all around has modes in pairs."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(8, 8), family="union-jack")
    edge = (np.abs(mesh.vertices[:, :2] - (0.5, 0.0)) > 0.499).any(axis=1)

    def answer(poisson):
        body = ms.LinearModal(ms.solve_modes(ms.Shell(mesh, replace(SHEET, poisson=poisson), edge), count=3))
        push = np.zeros_like(mesh.vertices)
        push[:, 2] = 1e-3 * mesh.vertices[:, 0]
        return body, body.equilibrium(force=push)

    body, state = answer(0.3)
    assert body.basis.eigenvalues[2] == pytest.approx(body.basis.eigenvalues[1], rel=1e-8)
    slope = body.sensitivity(state, wrt="poisson")[..., 0]
    moved = (answer(0.301)[1].positions - answer(0.299)[1].positions) / 0.002
    assert np.linalg.norm(slope - moved) < 1e-4 * np.linalg.norm(moved)


@pytest.fixture(scope="module")
def hybrid():
    return ms.HybridStress.trained(folded(), gravity=(0, 0, -70), modes=28, motions=24)


def folded(**changed):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(16, 4))
    return ms.Shell(mesh, replace(ms.Material(2000.0, 2000.0, 0.05, 0.2), **changed), mesh.vertices[:, 0] < 0.1)


def retrained(hybrid, name, factor):
    """The trained model on another material: its stresses span the same, orthonormal in the other energy."""
    shell = folded(**{name: getattr(folded().material, name) * factor})
    trained = hybrid._trained
    weight = np.concatenate([elements.weight for elements in shell.elements[:2]])
    lower = np.linalg.cholesky(trained.stresses.T @ (trained.stresses / (2.0 * weight)[:, None]))
    return ms.HybridStress(shell, shell, replace(trained, stresses=np.linalg.solve(lower, trained.stresses.T).T))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stretch", "shear", "flexure", "density"])
def test_the_derivative_of_the_trained_rung_has_taylor_slope_two(hybrid, name):
    load = (0.0, 0.0, -20.0)
    state = hybrid.equilibrium(gravity=load)
    assert state.coordinates is not None

    def answer(factor):
        return retrained(hybrid, name, factor).equilibrium(gravity=load, start=state.positions).positions

    errors = remainders(hybrid, state, name, getattr(folded().material, name), answer)
    assert (np.abs(np.log2(errors[:-1] / errors[1:]) - 2.0) < 0.2).all(), errors
    weights = np.random.default_rng(0).standard_normal(state.positions.shape)
    forward = np.einsum("ni,nik->k", weights, hybrid.sensitivity(state, wrt=name))
    np.testing.assert_allclose(hybrid.sensitivity(state, wrt=name, of=weights), forward, rtol=1e-8)


def test_the_trained_rung_has_the_derivatives_of_the_shell(hybrid):
    """Within a few times its training error."""
    state, body = hybrid.equilibrium(gravity=(0.0, 0.0, -20.0)), ms.DiscreteShell(folded())
    exact = body.equilibrium(gravity=(0.0, 0.0, -20.0))
    for name in ("shear", "flexure", "load"):
        slope, wanted = hybrid.sensitivity(state, wrt=name), body.sensitivity(exact, wrt=name)
        assert np.linalg.norm(slope - wanted) < 0.2 * np.linalg.norm(wanted)


def test_what_has_no_derivative_is_refused(known):
    body, state = known("md", SHEET)
    with pytest.raises(ms.OptionError, match="span of a reduced model ends at its supports"):
        body.sensitivity(state, wrt="supports")
    sampled = ms.ModalDerivatives(body.shell, count=2, cubature=8)
    answer = sampled.equilibrium(gravity=0.1 * GRAVITY)
    assert np.isfinite(sampled.sensitivity(answer, wrt=["young", "density"])).all()
    for name in ("thickness", "rest_angles"):
        with pytest.raises(ms.OptionError, match=f"weights were trained at one value of {name}"):
            sampled.sensitivity(answer, wrt=name)
    body, state = known("mwts", SHEET)
    with pytest.raises(ms.OptionError, match="consistent_force=True"):
        body.sensitivity(state, wrt="force")
    with pytest.raises(ms.OptionError, match="wrt must be one of young, poisson, thickness, density, gravity"):
        body.sensitivity(state, wrt="stretch")
    with pytest.raises(ms.OptionError, match="coordinates"):
        body.sensitivity(replace(state, coordinates=None), wrt="young")
    follower = body.equilibrium(loads=[ms.Pressure(0.01)])
    with pytest.raises(ms.OptionError, match="under dead loads alone"):
        body.sensitivity(follower, wrt="young")
    rigid = ms.RigidShell(body.shell)
    with pytest.raises(ms.OptionError, match="has no derivatives"):
        rigid.sensitivity(state, wrt="young")
    with pytest.raises(ms.OptionError, match="a name or a list of names"):
        body.sensitivity(state, wrt=["young", 3])
