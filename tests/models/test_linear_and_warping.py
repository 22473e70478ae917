"""LMA and MWTS: closed forms, statics, steps, and the V-beam of the paper against discrete shells."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse.linalg as spla
from scenes import held
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell import (
    DiscreteShell,
    LinearModal,
    Material,
    ModalWarping,
    Shell,
    flat_beam,
    leaf,
    measure,
    solve_modes,
)
from modalshell.integrators.state import MotionState
from modalshell.shell.damping import Damping

V_BEAM = json.loads((Path(__file__).resolve().parents[1] / "data" / "v_beam_static.json").read_text(encoding="utf-8"))
MODELS = [LinearModal, ModalWarping]


def warped_by_quadrature(basis, q):
    """u_i = (integral of expm(r [w_i]) over r in 0..1) (Phi q)_i by Gauss-Legendre and scipy's expm."""
    linear, w = ((matrix @ q).reshape(-1, 3) for matrix in (basis.modes, basis.rotations))
    skew = np.array([[[0, -z, y], [z, 0, -x], [-y, x, 0]] for x, y, z in w])
    nodes, weights = np.polynomial.legendre.leggauss(30)
    average = sum(0.5 * c * scipy.linalg.expm(0.5 * (1.0 + r) * skew) for r, c in zip(nodes, weights, strict=True))
    return np.einsum("nij,nj->ni", average, linear)


def imbalance(basis, q, load):
    """|Lambda q - Phi^T R^T f| / |Phi^T f| in the norm of Lambda^-1, with SciPy's rotations."""
    rotation = Rotation.from_rotvec((basis.rotations @ q).reshape(-1, 3))
    p = basis.modes.T @ rotation.apply(load, inverse=True).ravel()
    root = np.sqrt(basis.eigenvalues)
    return np.linalg.norm((basis.eigenvalues * q - p) / root) / np.linalg.norm((basis.modes.T @ load.ravel()) / root)


def flat_cantilever(poisson=0.0):
    mesh = flat_beam(length=1.0, width=0.2, cells=(40, 8), family="alternating")
    material = Material.from_physical(young=1e9, poisson=poisson, thickness=1e-3, density=1000.0, mesh=mesh)
    clamped = mesh.vertices[:, 0] < 0.0376
    shell = Shell(mesh, material, clamped)
    length = 1.0 - mesh.vertices[clamped, 0].max()
    unit = (1e9 * 1e-9 / 12.0) / (1000.0 * 1e-3 * length**3)  # gravity at Gamma = 1
    return shell, unit


@pytest.fixture(scope="module")
def flat():
    shell, unit = flat_cantilever()
    return solve_modes(shell, 8), unit


@pytest.fixture(scope="module")
def coarse():
    """A shell with few enough unknowns to take all its modes."""
    shell = held(leaf(cells=(6, 4)), 0.2)
    return solve_modes(shell, shell.free_unknowns.size)


# ---- LMA


def test_linear_statics_with_all_modes_is_the_full_solve(coarse):
    shell = coarse.shell
    force = np.random.default_rng(0).standard_normal(shell.rest_positions.shape)
    gravity = np.array([1.0, -2.0, 3.0])
    answer = LinearModal(coarse).equilibrium(gravity=gravity, force=force)
    free = shell.free_unknowns
    load = (force + shell.mass[:, None] * gravity).ravel()[free]
    exact = np.zeros(shell.rest_positions.size)
    exact[free] = spla.spsolve(shell.stiffness().tocsc()[free][:, free], load)
    u = (answer.positions - shell.rest_positions).ravel()
    np.testing.assert_allclose(u, exact, rtol=0, atol=1e-9 * np.abs(exact).max())
    assert answer.converged
    assert answer.status == "distorted"  # by forces of a newton on every vertex


def test_linear_statics_converges_to_the_full_solve_with_the_modes(v_shell):
    free = v_shell.free_unknowns
    load = v_shell.gravity_force((0.0, 0.0, -1.0)).ravel()
    exact = np.zeros(load.size)
    exact[free] = spla.spsolve(v_shell.stiffness().tocsc()[free][:, free], load[free])
    errors = []
    for count in (2, 8, 32):
        answer = LinearModal(solve_modes(v_shell, count)).equilibrium(gravity=(0.0, 0.0, -1.0))
        errors.append(
            np.linalg.norm((answer.positions - v_shell.rest_positions).ravel() - exact) / np.linalg.norm(exact)
        )
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 5e-3


def test_linear_statics_is_linear(v_basis):
    model = LinearModal(v_basis)
    rest = v_basis.shell.rest_positions
    first, second = (model.equilibrium(gravity=(0.0, 0.0, -g)).positions - rest for g in (1.0, 100.0))
    np.testing.assert_allclose(second, 100.0 * first, rtol=1e-12, atol=1e-13 * np.abs(second).max())


def test_linear_drop_of_a_strip_is_an_eighth_of_gamma():
    mesh = flat_beam(length=0.4, width=0.04, cells=(46, 4), family="equilateral")
    thickness = 1e-3
    material = Material.from_physical(young=1e9, poisson=0.0, thickness=thickness, density=1000.0, mesh=mesh)
    clamped = mesh.vertices[:, 0] < 1.5 * 0.4 / 46
    shell = Shell(mesh, material, clamped)
    length = 0.4 - mesh.vertices[clamped, 0].max()
    gravity = 2.0 * (1e9 * thickness**3 / 12.0) / (1000.0 * thickness * length**3)
    answer = LinearModal(solve_modes(shell, 8)).equilibrium(gravity=(0.0, 0.0, -gravity))
    tip = mesh.vertices[:, 0] > 0.4 - 1e-9
    assert -answer.positions[tip, 2].mean() / length == pytest.approx(2.0 / 8.0, rel=0.03)


# ---- MWTS


@pytest.mark.by_default("1e-06", "0.01")
@pytest.mark.parametrize("scale", [1e-6, 0.01, 0.3, 1.0])
def test_warped_displacement_is_the_integral_of_rotations(v_basis, scale):
    model = ModalWarping(v_basis)
    q = np.random.default_rng(1).standard_normal(8)
    q *= scale * np.pi / np.linalg.norm(model.rotation_vectors(q), axis=1).max()
    expected = warped_by_quadrature(v_basis, q)
    np.testing.assert_allclose(model.displacement(q), expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    state = MotionState(q, np.zeros(8))
    np.testing.assert_allclose(model.positions(state), v_basis.shell.rest_positions + expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("scale", [1e-6, 0.3, 1.0])
def test_modal_force_is_the_load_turned_back(v_basis, scale):
    model = ModalWarping(v_basis)
    rng = np.random.default_rng(2)
    q, load = rng.standard_normal(8), rng.standard_normal(v_basis.shell.rest_positions.shape)
    q *= scale * np.pi / np.linalg.norm(model.rotation_vectors(q), axis=1).max()
    rotation = Rotation.from_rotvec((v_basis.rotations @ q).reshape(-1, 3))
    expected = v_basis.modes.T @ rotation.apply(load, inverse=True).ravel()
    np.testing.assert_allclose(model.modal_force(q, load), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.by_default("flat")
@pytest.mark.parametrize("scene", ["v_beam", "flat"])
def test_warping_meets_the_linear_answer_at_second_order(scene, v_basis, flat):
    basis = v_basis if scene == "v_beam" else flat[0]
    loads = np.logspace(-2.0, -4.0, 5) * (1.0 if scene == "v_beam" else 10.0 * flat[1])
    differences = []
    for g in loads:
        a, b = (model(basis).equilibrium(gravity=(0.0, 0.0, -g)) for model in MODELS)
        assert a.converged
        assert b.converged
        differences.append(np.linalg.norm(a.positions - b.positions))
    assert np.polyfit(np.log(loads), np.log(differences), 1)[0] == pytest.approx(2.0, abs=0.1)


@pytest.mark.by_default("0.5", "4.0")
@pytest.mark.parametrize("gamma", [0.5, 4.0, 16.0, 50.0])
def test_warped_statics_balances(flat, gamma):
    basis, unit = flat
    shell = basis.shell
    answer = ModalWarping(basis).equilibrium(gravity=(0.0, 0.0, -gamma * unit))
    assert answer.converged
    assert answer.status == "converged"
    load = shell.gravity_force((0.0, 0.0, -gamma * unit))
    assert imbalance(basis, answer.coordinates, load) < 1e-8
    assert answer.residual < 1e-8
    expected = shell.rest_positions + warped_by_quadrature(basis, answer.coordinates)
    np.testing.assert_allclose(answer.positions, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("gamma", [200.0, 400.0, 1000.0, 1e4])
def test_warped_statics_says_where_it_has_no_answer(flat, gamma):
    """Phi^T R^T f has no potential: at such loads the answer is a true fixed point of a hanging beam, or none."""
    basis, unit = flat
    load = basis.shell.gravity_force((0.0, 0.0, -gamma * unit))
    answer = ModalWarping(basis).equilibrium(gravity=(0.0, 0.0, -gamma * unit))
    assert np.isfinite(answer.positions).all()
    if answer.converged:
        assert answer.status == "converged"
        assert imbalance(basis, answer.coordinates, load) < 1e-8
        turns = np.linalg.norm((basis.rotations @ answer.coordinates).reshape(-1, 3), axis=1)
        assert turns.max() < np.pi
        x = answer.positions[basis.shell.rest_positions[:, 0] > 0.999]
        assert -1.0 < x[:, 2].mean() < -0.7
    else:
        assert any(reason in answer.status for reason in ("no fixed point", "wound up", "unstable"))


def test_warped_statics_at_gamma_400_does_not_pretend(flat):
    """The fixed point of the flat beam winds up or cycles past Gamma of about 64 (Gamma = rho_A g L^3 / D)."""
    basis, unit = flat
    answer = ModalWarping(basis).equilibrium(gravity=(0.0, 0.0, -400.0 * unit))
    load = basis.shell.gravity_force((0.0, 0.0, -400.0 * unit))
    turned = np.linalg.norm((basis.rotations @ answer.coordinates).reshape(-1, 3), axis=1).max()
    honest = answer.converged and imbalance(basis, answer.coordinates, load) < 1e-8 and turned < np.pi
    refused = not answer.converged and answer.status not in ("", "converged")
    assert honest or refused


def test_warped_statics_from_a_start_finds_the_same_answer(v_basis):
    model = ModalWarping(v_basis)
    gravity = (0.0, 0.0, -10.0)
    cold = model.equilibrium(gravity=gravity)
    near = model.equilibrium(gravity=(0.0, 0.0, -8.0))
    warm = model.equilibrium(gravity=gravity, start=near.positions)
    assert warm.converged
    np.testing.assert_allclose(warm.positions, cold.positions, rtol=0, atol=1e-7)


# ---- the V-beam


@pytest.fixture(scope="module")
def v_answers(v_shell, v_basis):
    return {
        g: {
            model.name: model.equilibrium(gravity=(0.0, 0.0, -g))
            for model in (DiscreteShell(v_shell), LinearModal(v_basis), ModalWarping(v_basis))
        }
        for g in (4.0, 10.0, 20.0)
    }


@pytest.mark.parametrize("row", V_BEAM["rows"], ids=lambda row: f"g={row['gravity']:g}")
def test_v_beam_errors_are_those_of_the_prototype(v_shell, v_answers, v_ridge_tip, row):
    answers = v_answers[row["gravity"]]
    assert all(answer.converged for answer in answers.values())
    rest = v_shell.rest_positions
    truth = answers["DS"].positions
    errors = {name: np.linalg.norm(a.positions - truth) / np.linalg.norm(truth - rest) for name, a in answers.items()}
    assert truth[v_ridge_tip, 2] == pytest.approx(row["tip"], rel=0.03)
    assert errors["LMA"] == pytest.approx(row["error_lma"], rel=0.03)
    assert errors["MWTS"] == pytest.approx(row["error_mwts"], rel=0.03)
    assert errors["MWTS"] < errors["LMA"]
    for name in ("LMA", "MWTS"):
        package = measure.displacement_error(answers[name].positions, truth, v_shell, weighted=False)
        assert package == pytest.approx(errors[name], rel=1e-12)


def test_v_beam_areas_are_those_of_the_prototype(v_shell, v_answers):
    mesh = v_shell.mesh

    def growth(x):
        corners = x[mesh.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return 0.5 * np.linalg.norm(normals, axis=1).sum() / mesh.area - 1.0

    changes = {name: growth(answer.positions) for name, answer in v_answers[20.0].items()}
    assert changes["DS"] == pytest.approx(V_BEAM["area_change_at_20"]["DS"], abs=2e-4)
    for name in ("LMA", "MWTS"):
        assert changes[name] == pytest.approx(V_BEAM["area_change_at_20"][name], rel=0.03)
        assert measure.area_change(v_answers[20.0][name].positions, mesh) == pytest.approx(changes[name], rel=1e-12)


def test_v_beam_is_symmetric(v_shell, v_answers):
    """No mode couples to the load across the plane of symmetry, and the vertices mirror each other."""
    rest = v_shell.rest_positions
    mirror = [int(np.argmin(np.linalg.norm(rest - vertex * (1, -1, 1), axis=1))) for vertex in rest]
    for name in ("DS", "LMA", "MWTS"):
        x = v_answers[10.0][name].positions
        np.testing.assert_allclose(x[mirror] * (1, -1, 1), x, rtol=0, atol=1e-6)


# ---- motion


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("damping", [Damping(), Damping(0.3, 0.002)])
def test_a_step_is_implicit_euler_mode_by_mode(v_basis, model, damping):
    """v+ = (v + h (p - lambda q)) / d, q+ = q + h v+, d = 1 + h (xi + zeta lambda) + h^2 lambda, and q+ without v+."""
    rung = model(v_basis, integrator="implicit_euler")
    rng = np.random.default_rng(3)
    q, v = 0.02 * rng.standard_normal(8), rng.standard_normal(8)
    load = v_basis.shell.gravity_force((1.0, 2.0, -9.81))
    h, eigenvalues = 1.0 / 30.0, v_basis.eigenvalues
    rotation = Rotation.from_rotvec((v_basis.rotations @ q).reshape(-1, 3))
    turned = rotation.apply(load, inverse=True) if model is ModalWarping else load
    p = v_basis.modes.T @ turned.ravel()
    c = damping.mass_factor + damping.stiffness_factor * eigenvalues
    d = 1.0 + h * c + h**2 * eigenvalues
    expected_v = (v + h * (p - eigenvalues * q)) / d
    expected_q = (1 - h**2 * eigenvalues / d) * q + h * (1 - (h * c + h**2 * eigenvalues) / d) * v + h**2 / d * p
    state, converged = rung.step(MotionState(q, v), h, load, damping)
    assert converged
    np.testing.assert_allclose(state.rates, expected_v, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(state.coordinates, expected_q, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("damping", [Damping(0.5, 0.0), Damping(0.0, 2e-3), Damping(0.3, 1e-3)])
def test_rayleigh_damping_decays_every_mode_at_its_rate(v_basis, damping):
    """q'' + (xi + zeta lambda) q' + lambda q = 0: exactly by a few steps, by implicit Euler as these get small."""
    rung, euler = LinearModal(v_basis), LinearModal(v_basis, integrator="implicit_euler")
    eigenvalues = v_basis.eigenvalues[:3]
    rate = damping.mass_factor + damping.stiffness_factor * eigenvalues
    omega = np.sqrt(eigenvalues - 0.25 * rate**2)
    duration = 2.0 * np.pi / omega[0]
    exact = np.exp(-0.5 * rate * duration) * (np.cos(omega * duration) + 0.5 * rate / omega * np.sin(omega * duration))
    load = np.zeros_like(v_basis.shell.rest_positions)
    found = []
    for model, steps in ((rung, 7), (euler, 2000), (euler, 4000), (euler, 8000)):
        state = model.start_motion()
        state.coordinates = np.ones(8)
        for _ in range(steps):
            state, _ = model.step(state, duration / steps, load, damping)
        found.append(state.coordinates[:3])
    np.testing.assert_allclose(found[0], exact, rtol=0, atol=1e-12)
    ends = found[1:]
    errors = [np.abs(end - exact).max() for end in ends]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)
    coarse, fine = 2.0 * ends[1] - ends[0], 2.0 * ends[2] - ends[1]  # Richardson, twice
    np.testing.assert_allclose((4.0 * fine - coarse) / 3.0, exact, rtol=0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("model", MODELS)
def test_damped_motion_comes_to_rest_in_the_static_answer(v_basis, model):
    rung = model(v_basis)
    load = v_basis.shell.gravity_force((0.0, 0.0, -4.0))
    state = rung.start_motion()
    assert not state.coordinates.any()
    np.testing.assert_array_equal(rung.positions(state), v_basis.shell.rest_positions)
    for _ in range(600):
        state, _ = rung.step(state, 1.0 / 30.0, load, Damping(2.0, 0.0))
    static = rung.equilibrium(gravity=(0.0, 0.0, -4.0))
    np.testing.assert_allclose(rung.positions(state), static.positions, rtol=0, atol=1e-6)


@pytest.mark.parametrize("integrator", ["exponential", "implicit_euler"])
@pytest.mark.parametrize("dt", [1e-3, 1.0, 1e3])
def test_steps_of_any_length_are_stable(v_basis, dt, integrator):
    """Unconditionally stable in q for bounded p: the energy of free motion falls by implicit Euler, else it stays."""
    rung = LinearModal(v_basis, integrator=integrator)
    rng = np.random.default_rng(4)
    state = rung.start_motion()
    state.coordinates, state.rates = rng.standard_normal((2, 8))
    load = np.zeros_like(v_basis.shell.rest_positions)
    energies = []
    for _ in range(20):
        energies.append(state.rates @ state.rates + state.coordinates @ (v_basis.eigenvalues * state.coordinates))
        state, _ = rung.step(state, dt, load, Damping())
    if integrator == "implicit_euler":
        assert all(after < before or after < 1e-100 for before, after in pairwise(energies))
    else:
        np.testing.assert_allclose(energies, energies[0], rtol=1e-9)


@pytest.mark.parametrize("model", MODELS)
def test_motion_starts_where_it_is_told(v_basis, model):
    rung = model(v_basis)
    q = np.array([1e-3, -2e-3, 0.0, 1e-3, 0.0, 0.0, 0.0, 1e-3])
    for larger in (1.0, 5.0):
        positions = v_basis.shell.rest_positions + rung.displacement(larger * q)
        np.testing.assert_allclose(rung.start_motion(positions).coordinates, larger * q, rtol=0, atol=1e-10)


@pytest.mark.parametrize(("model", "most"), [(LinearModal, 1.0), (ModalWarping, 0.11), (ms.RotationStrain, 0.02)])
def test_motion_starts_at_the_nearest_shape_and_says_what_that_lacks(model, most):
    """Modes projected a shape of DS that their own shapes come near to: RSW started 26 % off it without a word."""
    mesh = ms.sheet(length=0.3, width=0.1, cells=(8, 3))
    sheet = ms.Isotropic(young=2e7, poisson=0.3, thickness=2e-3, density=400.0)
    shell = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 1e-6)
    asked = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -20.0)).positions
    run = ms.simulate(model(ms.solve_modes(shell, 8)), duration=0.05, dt=0.01, gravity=(0.0, 0.0, -20.0), start=asked)
    off = ms.measure.displacement_error(run.positions[0], asked, shell)
    assert off < most
    told = f"the motion begins {100.0 * off:.2g} % of the start's displacement off it, as near as {model.name} comes"
    assert (told in run.message) == (off > 0.05)
