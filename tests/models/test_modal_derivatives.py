"""MD-ROM: modal derivatives, the reduced energy, statics against discrete shells, steps, cubature."""

import numpy as np
import pytest
from scenes import leaf

import modalshell as ms
from modalshell.models.reduction.derivatives import modal_derivatives
from modalshell.models.reduction.reduced_energy import ReducedEnergy
from modalshell.modes.attachments import orthonormal_extension
from modalshell.shell import GAUSS_NEWTON, MIXED
from modalshell.shell.damping import Damping
from modalshell.shell.elements import ElementSum


def strip(thickness=1e-2, cells=(40, 8)):
    """A flat cantilever of L = 1, W = 0.2, and the gravity at Gamma = rho_A g L^3 / D = 1."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells, family="alternating")
    material = ms.Material.from_physical(young=1e9, poisson=0.0, thickness=thickness, density=1000.0, mesh=mesh)
    clamped = mesh.vertices[:, 0] < 1.5 / cells[0]
    length = 1.0 - mesh.vertices[clamped, 0].max()
    return ms.Shell(mesh, material, clamped), 1e9 * thickness**2 / 12.0 / (1000.0 * length**3)


def theory_strip(cells=(40, 8), poisson=0.0, family="delaunay"):
    """The same of shell theory."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells, family=family)
    material = ms.Isotropic(young=1e9, poisson=poisson, thickness=1e-2, density=1000.0)
    return ms.Shell(mesh, material, mesh.vertices[:, 0] < 1e-9), 1e9 * 1e-4 / (12.0 * (1.0 - poisson**2) * 1000.0)


def twisting(shell, gravity):
    """Gravity, and a couple of opposite forces at the tip's corners."""
    load = shell.gravity_force(gravity)
    tip = np.flatnonzero(shell.rest_positions[:, 0] > 0.999)
    order = tip[np.argsort(shell.rest_positions[tip, 1])]
    weight = np.linalg.norm(load.sum(axis=0))
    load[order[[0, -1]], 2] += np.array([3.7, -3.7]) * weight
    return load, order


@pytest.fixture(scope="module")
def flat():
    shell, unit = strip()
    return ms.ModalDerivatives(shell), unit


@pytest.fixture(scope="module", params=["discrete shell", "shell theory"])
def sparse(request):
    shell, unit = (
        strip(cells=(24, 4)) if request.param == "discrete shell" else theory_strip((24, 4), 0.3, "alternating")
    )
    return ms.ModalDerivatives(shell, 5, cubature=True), ms.ModalDerivatives(shell, 5), unit


@pytest.fixture(scope="module", params=["discrete shell", "shell theory"])
def curved(request):
    """A shell with curvature at rest, where modes bend and stretch at once."""
    mesh = ms.cylinder_panel(cells=(10, 8))
    material = ms.Material(200.0, 20.0, 0.05, 0.2)
    if request.param == "shell theory":
        material = ms.Isotropic(young=50000.0, poisson=0.3, thickness=0.05, density=4.0)
    return ms.ModalDerivatives(ms.Shell(mesh, material, mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 0.16), 4)


# ---- derivatives and basis


def test_derivatives_solve_their_equation(curved):
    """K psi = -(dK/dq_j) phi_i with dK/dq_j from second differences of the force at another step."""
    basis, shell = curved.basis, curved.shell
    phi, free = basis.modes.modes, shell.free_unknowns
    stiffness = shell.stiffness().tocsc()[free][:, free]
    pairs = list(zip(*np.triu_indices(4), strict=True))
    assert basis.derivatives.shape[1] == len(pairs) == 10
    step = 1e-2 / np.abs(phi).max()

    def force(q):
        return shell.force(shell.rest_positions + (phi @ q).reshape(-1, 3)).ravel()[free]

    for column, (i, j) in enumerate(pairs):
        e, f = step * np.eye(4)[[i, j]]

        def second(share, e=e, f=f):
            a, b = share * e, share * f
            return (force(a + b) - force(a - b) - force(b - a) + force(-a - b)) / (4.0 * (share * step) ** 2)

        extrapolated = (4.0 * second(0.05) - second(0.1)) / 3.0  # minus D^3 E [phi_i, phi_j]
        left = stiffness @ basis.derivatives[free, column]
        assert np.linalg.norm(left - extrapolated) < 1e-4 * np.linalg.norm(extrapolated)


def test_derivatives_are_the_second_order_of_static_paths(curved):
    """DS under the loads t K Phi q moves by t Phi q + t^2 psi(q, q) / 2 + O(t^3)."""
    basis, shell = curved.basis, curved.shell
    phi = basis.modes.modes
    q = np.array([1.0, 0.5, -0.7, 0.3]) * 0.05 / np.abs(phi).max()
    rows, columns = np.triu_indices(4)
    second = basis.derivatives @ (np.where(rows == columns, 0.5, 1.0) * q[rows] * q[columns])
    push = shell.stiffness() @ (phi @ q)
    push[np.repeat(shell.clamped, 3)] = 0.0
    truth, sizes, errors = ms.DiscreteShell(shell), np.array([0.02, 0.04, 0.08]), []
    for t in sizes:
        both = [
            truth.equilibrium(force=(s * t * push).reshape(-1, 3)).positions - shell.rest_positions for s in (1, -1)
        ]
        even = 0.5 * (both[0] + both[1]).ravel()
        errors.append(np.linalg.norm(even - t**2 * second) / np.linalg.norm(t**2 * second))
    assert errors[0] < 0.01
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.3)


def test_differences_are_accurate_and_symmetric(flat, curved):
    for model in (flat[0], curved):
        assert model.basis.difference_error < 1e-4
        assert model.basis.asymmetry < 1e-7


def test_basis_is_orthonormal_and_diagonal(flat, curved):
    for model, size in ((flat[0], 44), (curved, 14)):
        basis, mass = model.basis, np.repeat(model.shell.mass, 3)
        u = basis.vectors
        assert basis.size == size
        np.testing.assert_allclose(u.T @ (mass[:, None] * u), np.eye(size), atol=1e-12)
        stiffness = u.T @ (model.shell.stiffness() @ u)
        scaled = stiffness / np.sqrt(np.outer(basis.eigenvalues, basis.eigenvalues))
        np.testing.assert_allclose(scaled, np.eye(size), atol=1e-6)
        np.testing.assert_array_equal(u[:, : basis.modes.count], basis.modes.modes)
        assert not u.reshape(-1, 3, size)[model.shell.clamped].any()
        # Every derivative lies in the span.
        left = basis.derivatives - u @ (u.T @ (mass[:, None] * basis.derivatives))
        assert (np.linalg.norm(left, axis=0) < 1e-5 * np.linalg.norm(basis.derivatives, axis=0)).all()


def test_dependent_vectors_are_dropped():
    random = np.random.default_rng(0)
    mass = random.uniform(0.5, 2.0, 30)
    leading = np.linalg.qr(np.sqrt(mass)[:, None] * random.standard_normal((30, 3)))[0] / np.sqrt(mass)[:, None]
    new = random.standard_normal((30, 2))
    further = np.hstack([new, 1e6 * new @ [[1.0], [2.0]], leading[:, :1], np.zeros((30, 1))])
    basis = orthonormal_extension(leading, further, mass)
    assert basis.shape == (30, 5)
    np.testing.assert_allclose(basis.T @ (mass[:, None] * basis), np.eye(5), atol=1e-12)


# ---- reduced energy


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sparse", "which"),
    [("discrete shell", "cubature"), ("discrete shell", "full"), ("shell theory", "cubature")],
    indirect=["sparse"],
)
def test_gradient_and_hessian_by_taylor(which, sparse):
    model = sparse[0 if which == "cubature" else 1]
    energy = model.energy
    random = np.random.default_rng(1)
    root = np.sqrt(model.basis.eigenvalues)
    # Fields on the vertices, so that the signs of eigenvectors do not matter.
    mass = np.sqrt(np.repeat(model.shell.mass, 3))
    z, d = (model.basis.vectors.T @ (mass * random.standard_normal(mass.size)) / root for _ in range(2))
    value, gradient, hessian = energy.hessian(z)
    assert value == pytest.approx(energy.value(z), rel=1e-12)
    np.testing.assert_allclose(energy.gradient(z)[1], gradient, rtol=0, atol=1e-10 * np.abs(gradient).max())
    steps = np.logspace(-1.0, -2.5, 4)
    first = [
        sum(abs(energy.value(z + s * d) - value - s * gradient @ d - 0.5 * h**2 * d @ hessian @ d) for s in (h, -h))
        for h in steps
    ]
    second = [np.linalg.norm((energy.gradient(z + h * d)[1] - gradient - h * hessian @ d) / root) for h in steps]
    assert 2.8 < np.polyfit(np.log(steps), np.log(first), 1)[0] < 4.1
    assert np.polyfit(np.log(steps), np.log(second), 1)[0] == pytest.approx(2.0, abs=0.2)


def test_reduced_energy_is_that_of_the_shell(curved):
    shell, u = curved.shell, curved.basis.vectors
    z = np.random.default_rng(2).standard_normal(u.shape[1]) / np.sqrt(curved.basis.eigenvalues)
    x = shell.rest_positions + (u @ z).reshape(-1, 3)
    value, gradient, hessian = curved.energy.hessian(z)
    assert value == pytest.approx(shell.energy(x), rel=1e-12)
    np.testing.assert_allclose(gradient, -u.T @ shell.force(x).ravel(), rtol=0, atol=1e-10 * np.abs(gradient).max())
    np.testing.assert_allclose(hessian, u.T @ (shell.stiffness(x) @ u), rtol=0, atol=1e-10 * np.abs(hessian).max())
    stresses = curved.energy.predicted_stresses(z, np.zeros_like(z))
    mixed, exact = (curved.energy.hessian(z, how, stresses)[2] for how in (MIXED, 1))
    np.testing.assert_allclose(mixed, exact, rtol=0, atol=1e-10 * np.abs(exact).max())
    assert np.linalg.eigvalsh(curved.energy.hessian(z, GAUSS_NEWTON)[2])[0] > 0.0


def test_weighted_parts_add_up(curved):
    """A split of the elements with factors sums to what the parts sum to."""
    shell, u = curved.shell, curved.basis.vectors
    z = np.random.default_rng(3).standard_normal(u.shape[1]) / np.sqrt(curved.basis.eigenvalues)
    energy = shell.elastic_energy
    counts = [len(e.stencils) for e in shell.elements] if isinstance(energy, ElementSum) else None
    internal = None
    if counts is None:  # all combinations of the shares, of which each part would seek its own minimum: none
        energy, counts = energy.halved(), [len(stencils) for stencils in energy.element_stencils]
        internal = np.zeros((energy.share_stiffness.shape[0], 0))
    even, odd, every = ([np.arange(k, count, step) for count in counts] for k, step in ((0, 2), (1, 2), (0, 1)))
    whole, *parts = (
        ReducedEnergy(shell, u, energy.part(chosen, [np.full(c.size, 2.0) for c in chosen], internal))
        for chosen in (every, even, odd)
    )
    results = [part.hessian(z) for part in parts]
    for k, together in enumerate(whole.hessian(z)):
        summed = results[0][k] + results[1][k]
        np.testing.assert_allclose(summed, together, rtol=0, atol=1e-12 * np.abs(together).max())


def test_all_elements_with_all_shares_are_the_energy(curved):
    shell, u = curved.shell, curved.basis.vectors
    z = np.random.default_rng(3).standard_normal(u.shape[1]) / np.sqrt(curved.basis.eigenvalues)
    energy = shell.elastic_energy
    if isinstance(energy, ElementSum):
        counts, shares = [len(e.stencils) for e in shell.elements], None
    else:
        energy, counts = energy.halved(), [len(stencils) for stencils in energy.element_stencils]
        shares = np.random.default_rng(4).standard_normal(energy.share_stiffness.shape)
    part = energy.part([np.arange(count) for count in counts], [np.ones(count) for count in counts], shares)
    for found, expected in zip(ReducedEnergy(shell, u, part).hessian(z), curved.energy.hessian(z), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


# ---- statics


@pytest.mark.parametrize(("gamma", "tolerance"), [(1.0, 0.001), (4.0, 0.002), (16.0, 0.005)])
def test_flat_strip_under_gravity(flat, gamma, tolerance):
    model, unit = flat
    gravity = (0.0, 0.0, -gamma * unit)
    answer = model.equilibrium(gravity=gravity)
    assert (answer.converged, answer.status) == (True, "converged")
    truth = ms.DiscreteShell(model.shell).equilibrium(gravity=gravity)
    assert ms.measure.displacement_error(answer.positions, truth.positions, model.shell) < tolerance
    np.testing.assert_allclose(model.coordinates_of(answer.positions), answer.coordinates, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("poisson", "tolerances"),
    [pytest.param(0.0, (1e-4, 1e-4, 1e-3), marks=pytest.mark.slow), (0.3, (1e-4, 0.01, 0.05))],
    ids=["without", "with anticlastic curvature"],
)
def test_strip_of_shell_theory(poisson, tolerances):
    """Poisson's ratio curves the strip across too, which modes of the flat strip hold less well."""
    shell, unit = theory_strip(poisson=poisson)
    model = ms.ModalDerivatives(shell)
    for gamma, tolerance in zip((1.0, 4.0, 16.0), tolerances, strict=True):
        gravity = (0.0, 0.0, -gamma * unit)
        answer = model.equilibrium(gravity=gravity)
        truth = ms.DiscreteShell(shell).equilibrium(gravity=gravity)
        assert answer.converged
        assert ms.measure.displacement_error(answer.positions, truth.positions, shell) < tolerance


def test_flat_strip_under_gravity_and_twist(flat):
    model, unit = flat
    load, order = twisting(model.shell, (0.0, 0.0, -4.0 * unit))
    truth = ms.DiscreteShell(model.shell).equilibrium(force=load).positions
    across = truth[order[-1]] - truth[order[0]]
    assert np.degrees(np.arctan2(-across[2], across[1])) == pytest.approx(28.0, abs=2.0)
    answer = model.equilibrium(force=load)
    assert answer.converged
    assert ms.measure.displacement_error(answer.positions, truth, model.shell) < 0.05


def test_modes_without_derivatives_lock(flat):
    model, unit = flat
    gravity = (0.0, 0.0, -4.0 * unit)
    alone = ReducedEnergy(model.shell, model.basis.modes.modes)
    z = np.zeros(8)
    push = model.basis.modes.modes.T @ model.shell.gravity_force(gravity).ravel()
    for _ in range(200):  # plain Newton, shortened until the potential falls
        value, gradient, hessian = alone.hessian(z)
        step = np.linalg.solve(hessian, push - gradient)
        share = 1.0
        while share > 1e-6 and alone.value(z + share * step) - push @ (z + share * step) > value - push @ z:
            share *= 0.5
        z = z + share * step
    assert np.linalg.norm(alone.gradient(z)[1] - push) < 1e-6 * np.linalg.norm(push)
    locked = model.shell.rest_positions + (model.basis.modes.modes @ z).reshape(-1, 3)
    truth = ms.DiscreteShell(model.shell).equilibrium(gravity=gravity)
    assert ms.measure.displacement_error(locked, truth.positions, model.shell) > 0.3


def test_an_answer_is_a_minimum_of_the_potential(flat):
    model, unit = flat
    load = model.shell.gravity_force((4.0 * unit, 0.3 * unit, -unit))
    answer = model.equilibrium(force=load)
    _, gradient, hessian = model.energy.hessian(answer.coordinates)
    push = model.basis.vectors.T @ load.ravel()
    root = np.sqrt(model.basis.eigenvalues)
    assert answer.residual == pytest.approx(
        np.linalg.norm((gradient - push) / root) / np.linalg.norm(push / root), 1e-3
    )
    assert answer.residual < 1e-7
    assert np.linalg.eigvalsh(hessian)[0] > 0.0


@pytest.mark.slow
def test_a_compressed_strip_leaves_its_flat_saddle(flat):
    """Past buckling (Gamma of about 8) the flat state is an equilibrium but no minimum."""
    model, unit = flat
    answer = model.equilibrium(gravity=(-12.0 * unit, 0.0, 0.0))
    assert answer.converged
    assert np.linalg.eigvalsh(model.energy.hessian(answer.coordinates)[2])[0] > 0.0
    assert np.abs(answer.positions[:, 2]).max() > 0.05


def test_statics_from_a_start_and_without_load(flat):
    model, unit = flat
    cold = model.equilibrium(gravity=(0.0, 0.0, -4.0 * unit))
    near = model.equilibrium(gravity=(0.0, 0.0, -3.0 * unit))
    warm = model.equilibrium(gravity=(0.0, 0.0, -4.0 * unit), start=near.positions)
    assert warm.converged
    np.testing.assert_allclose(warm.positions, cold.positions, rtol=0, atol=1e-7)
    idle = model.equilibrium()
    assert idle.converged
    np.testing.assert_array_equal(idle.positions, model.shell.rest_positions)


def test_absurd_loads_do_not_raise(curved):
    answer = curved.equilibrium(gravity=(0.0, 0.0, -1e9))
    assert np.isfinite(answer.positions).all()
    assert answer.outcome in (ms.Outcome.DISTORTED, ms.Outcome.NOT_CONVERGED)


# ---- motion


@pytest.mark.parametrize("damping", [Damping(), Damping(2.0, 1e-3)])
def test_a_step_is_implicit_euler(curved, damping):
    model, dt = ms.ModalDerivatives(curved.shell, 4, integrator="implicit"), 0.02
    load = model.shell.gravity_force((0.0, 0.3, -2.0))
    state = model.start_motion()
    for _ in range(5):
        before = state
        state, converged = model.step(before, dt, load, damping)
        assert converged
        np.testing.assert_allclose(state.coordinates - before.coordinates, dt * state.rates, rtol=0, atol=1e-12)
        shell, (x, begin) = model.shell, (model.positions_at(s.coordinates) for s in (state, before))
        damped = shell.damped(shell.changes(begin), damping.stiffness_factor, dt)
        viscous = damped.energy_gradient(x)[1] - shell.energy_gradient(x)[1]
        drag = damping.mass_factor * state.rates + viscous.ravel() @ model.basis.vectors
        forces = model.basis.vectors.T @ load.ravel() - model.energy.gradient(state.coordinates)[1] - drag
        left = (state.rates - before.rates) / dt - forces
        root = np.sqrt(model.basis.eigenvalues + 1.0 / dt**2)
        assert np.linalg.norm(left / root) < 1e-5 * np.linalg.norm(state.rates / dt / root)


@pytest.mark.slow
def test_damped_motion_comes_to_the_equilibrium(flat):
    model, unit = flat
    gravity = (0.0, 0.0, -4.0 * unit)
    rest = model.equilibrium(gravity=gravity).positions
    run = ms.simulate(model, duration=15.0, dt=0.1, gravity=gravity, damping=(4.0, 0.01))
    assert run.unconverged_steps == 0
    assert ms.measure.displacement_error(run.positions[-1], rest, model.shell) < 1e-4


def test_free_motion_keeps_its_energy_at_small_steps(curved):
    start = curved.equilibrium(gravity=(0.0, 0.0, -2.0)).positions
    losses = []
    for dt in (4e-3, 1e-3):
        state = curved.start_motion(start)
        energy = curved.elastic_energy(state)
        still = np.zeros_like(start)
        for _ in range(round(0.04 / dt)):
            state, converged = curved.step(state, dt, still, Damping())
            assert converged
        losses.append(1.0 - (curved.elastic_energy(state) + curved.kinetic_energy(state)) / energy)
    assert 0.0 < losses[1] < losses[0]  # implicit Euler takes energy, at first order
    assert losses[1] < 0.35 * losses[0]


@pytest.mark.slow
def test_moving_supports_are_felt_as_inertial_loads(curved):
    """Against DS, whose clamped vertices are carried along: MD-ROM lives in their frame."""
    path = ms.SupportPath.from_function(
        lambda t: ((0.0, 0.2 * np.sin(np.pi * t / 0.6) ** 2, 0.0), (0.0, 0.4 * np.sin(np.pi * t / 0.6) ** 2, 0.0)), 0.6
    )
    a, b = (
        ms.simulate(model, duration=0.3, dt=0.0025, gravity=(0.0, 0.0, -2.0), supports=path)
        for model in (curved, ms.DiscreteShell(curved.shell))
    )
    assert a.unconverged_steps == 0
    carried = np.array([path.at(t).to_world(curved.shell.rest_positions) for t in b.times])
    assert np.abs(a.positions - b.positions).max() < 0.1 * np.abs(b.positions - carried).max()


# ---- cubature


@pytest.mark.slow
def test_cubature_is_positive_and_sparse(sparse):
    model = sparse[0]
    found = model.cubature
    assert (found.factors > 0.0).all()
    assert found.factors.size == sum(group.size for group in found.chosen)
    assert found.share < 0.35
    assert found.seconds > 0.0


@pytest.mark.by_default("discrete shell")
def test_cubature_keeps_held_out_answers(sparse):
    found = sparse[0].cubature
    assert found.training_errors.max() <= 0.005
    assert found.held_out_errors.size == 6
    assert found.held_out_error <= 0.02


@pytest.mark.by_default("discrete shell-1.0", "discrete shell-16.0")
@pytest.mark.parametrize("gamma", [1.0, 4.0, 16.0])
def test_cubature_keeps_gravity_answers(sparse, gamma):
    few, every, unit = sparse
    gravity = (0.0, 0.0, -gamma * unit)
    a, b = (model.equilibrium(gravity=gravity) for model in (few, every))
    assert a.converged
    assert ms.measure.displacement_error(a.positions, b.positions, few.shell) < 0.02


@pytest.mark.by_default("discrete shell")
def test_cubature_steps_like_the_whole(sparse):
    few, every, unit = sparse
    a, b = (
        ms.simulate(model, duration=1.0, dt=0.02, gravity=(0.0, 0.0, -4.0 * unit), damping=(1.0, 0.0))
        for model in (few, every)
    )
    assert a.unconverged_steps == 0
    assert ms.measure.displacement_error(a.positions[-1], b.positions[-1], few.shell) < 0.02


@pytest.mark.by_default("discrete shell")
def test_cubature_of_a_given_size_on_given_loads(sparse):
    shell, unit = sparse[1].shell, sparse[2]
    loads = [shell.gravity_force((0.0, 0.1 * g * unit, -g * unit)) for g in (1.0, 2.0, 4.0, 3.0)]
    model = ms.ModalDerivatives(shell, 3, cubature=60, training_loads=loads)
    assert model.cubature.factors.size <= 60
    assert model.cubature.held_out_errors.size == 1
    assert model.cubature.held_out_error < 0.05


# ---- refusals


def test_free_shells_without_elastic_modes_are_refused():
    with pytest.raises(ms.OptionError, match="ask for more modes"):
        ms.ModalDerivatives(leaf((6, 4)), 6)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"count": 0}, ms.OptionError),
        ({"cubature": -3}, ms.OptionError),
        ({"cubature": 2.5}, ms.OptionError),
        ({"backend": "none such"}, ms.OptionError),
        ({"training_loads": [np.zeros((3, 3))] * 4}, ms.LoadError),
        ({"training_loads": []}, ms.OptionError),
        ({"training_loads": [np.zeros((125, 3))] * 4}, ms.OptionError),
    ],
)
def test_bad_options_are_refused(sparse, options, error):
    with pytest.raises(error):
        ms.ModalDerivatives(sparse[1].shell, **options)


def test_bad_loads_are_refused(curved):
    with pytest.raises(ms.LoadError):
        curved.equilibrium(gravity=(0.0, np.nan, 0.0))
    with pytest.raises(ms.LoadError):
        curved.equilibrium(start=np.zeros((2, 3)))


def test_derivatives_take_any_factorisation(curved):
    modes = ms.solve_modes(curved.shell, 4, backend="superlu")
    other = modal_derivatives(modes, backend="superlu").derivatives
    np.testing.assert_allclose(
        other, curved.basis.derivatives, rtol=0, atol=1e-6 * np.abs(curved.basis.derivatives).max()
    )


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["bdf2", "composite"])
def test_motions_as_small_as_rounding_are_damped_as_asked(integrator):
    """The membrane's forces by the rounding of positions are beyond a share of the motion's own."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 4))
    sheet = ms.Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0)
    shell = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 1e-9)
    model = ms.ModalDerivatives(shell, count=3, integrator=integrator)
    modes = ms.solve_modes(shell, 1)
    omega, mode = 2.0 * np.pi * modes.frequencies[0], modes.modes[:, 0].reshape(-1, 3)
    start = shell.rest_positions + 1e-8 * mode / np.abs(mode).max()
    dt, ratio = 2.0 * np.pi / omega / 80, 0.03
    run = ms.simulate(model, duration=240 * dt, dt=dt, damping=(2.0 * ratio * omega, 0.0), start=start)
    assert run.unconverged_steps == 0
    energies = run.energies[:, :2].sum(axis=1)
    # Over whole periods, as energy falls unevenly within one.
    assert -np.log(energies[240] / energies[80]) / (2.0 * omega * 160 * dt) == pytest.approx(ratio, rel=0.01)
