"""Springs: energies through the shell's own kernels, springs from meshes, implicit steps, and the rung."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import grid_model, grid_of, shaken
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.core.errors import MaterialError, MeshError, OptionError, SupportError
from modalshell.integrators.state import MotionState
from modalshell.models.base.model import Damping
from modalshell.shell import EXACT, GAUSS_NEWTON, PROJECTED
from modalshell.springs import GridVerlet, ImplicitSprings, Springs, mesh_springs, shell_springs


def brute_force(positions, springs):
    """Energy and force by the definition, one spring at a time."""
    energy, force = 0.0, np.zeros_like(positions)
    for (i, j), rest, stiffness in zip(springs.pairs, springs.rest_lengths, springs.stiffness, strict=True):
        arm = positions[j] - positions[i]
        length = np.linalg.norm(arm)
        energy += 0.5 * stiffness * (length - rest) ** 2
        pull = stiffness * (length - rest) / length * arm
        force[i] += pull
        force[j] -= pull
    return energy, force


def test_springs_of_a_grid_are_those_of_the_definition():
    """Every pair of masses at a family's offset, and no other."""
    grid = grid_of((5, 4))
    springs = grid.springs()
    place = grid.rest_positions() / grid.spacing
    expected = {}
    for i in range(grid.count):
        for j in range(i + 1, grid.count):
            offset = tuple(sorted(np.abs(np.rint(place[j] - place[i])[:2]).astype(int)))
            name = {(0, 1): "structural", (1, 1): "shear", (0, 2): "flexion"}.get(offset)
            if name is not None:
                expected[i, j] = (getattr(grid, name), grid.spacing * np.hypot(*offset))
    found = {
        tuple(pair): (k, length)
        for pair, k, length in zip(springs.pairs.tolist(), springs.stiffness, springs.rest_lengths, strict=True)
    }
    assert found.keys() == expected.keys()
    for pair, (stiffness, length) in expected.items():
        assert found[pair] == (stiffness, pytest.approx(length, rel=1e-14))


def test_energy_and_force_are_those_of_the_definition():
    model = grid_model(grid_of((4, 5)))
    x = shaken(grid_of((4, 5)), 0.02)
    energy, force = brute_force(x, model.springs)
    assert model.shell.energy(x) == pytest.approx(energy, rel=1e-13)
    np.testing.assert_allclose(model.shell.force(x), force, rtol=0, atol=1e-13 * np.abs(force).max())


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**16))
def test_derivatives_have_the_slopes_of_taylor(seed):
    """What the gradient leaves of an energy difference shrinks as h^2, what the Hessian leaves as h^3.

    Summed over several directions: along a single one the next term of the series may happen to vanish.
    """
    rng = np.random.default_rng(seed)
    shell = grid_model(grid_of((4, 4))).shell
    x = shaken(grid_of((4, 4)), 0.01, seed)
    energy, gradient, data = shell.energy_gradient_hessian(x, EXACT)
    stiffness = shell.pattern.matrix(data)
    steps = 0.1 * np.logspace(-2.5, -4.0, 5)
    first, second = np.zeros(5), np.zeros(5)
    for d in rng.standard_normal((8, *x.shape)):
        curvature = float(d.ravel() @ (stiffness @ d.ravel()))
        left = np.array([shell.energy(x + h * d) - energy - h * np.vdot(gradient, d) for h in steps])
        first += np.abs(left)
        second += np.abs(left - 0.5 * steps**2 * curvature)
    assert np.polyfit(np.log(steps), np.log(first), 1)[0] == pytest.approx(2.0, abs=0.1)
    assert np.polyfit(np.log(steps), np.log(second), 1)[0] == pytest.approx(3.0, abs=0.15)


def test_reduced_hessian_is_positive_semi_definite_where_the_exact_one_is_not():
    shell = grid_model(grid_of((5, 5))).shell
    x = 0.7 * shaken(grid_of((5, 5)), 0.02)
    lowest = {}
    for kind in (EXACT, GAUSS_NEWTON, PROJECTED):
        values = np.linalg.eigvalsh(shell.pattern.matrix(shell.energy_gradient_hessian(x, kind)[2]).toarray())
        lowest[kind] = values[0] / values[-1]
    assert lowest[EXACT] < -1e-2
    assert lowest[GAUSS_NEWTON] > -1e-14
    assert lowest[PROJECTED] > -1e-14
    # Where every spring is stretched nothing is left out.
    x = 1.5 * grid_of((5, 5)).rest_positions()
    exact, projected = (shell.energy_gradient_hessian(x, kind)[2] for kind in (EXACT, PROJECTED))
    np.testing.assert_allclose(exact, projected, rtol=0, atol=1e-12 * exact.max())


@pytest.mark.parametrize("drawn", [False, True])
def test_edges_of_a_shell_keep_its_shear_energy(drawn):
    """Of one drawn out of its shape without stress, too: springs had none on the mesh."""
    mesh = ms.sheet(cells=(6, 5))
    rng = np.random.default_rng(3)
    rest = mesh.vertices * [0.8, 1.1, 1.0] if drawn else None
    shell = ms.Shell(mesh, ms.Material(0.0, rng.uniform(1.0, 2.0, len(mesh.edges)), 0.0, 1.0), rest=rest)
    springs = shell_springs(shell)
    x = mesh.vertices + 0.02 * rng.standard_normal(mesh.vertices.shape)
    assert ms.SpringSheet(shell, springs).shell.energy(x) == pytest.approx(shell.energy(x), rel=1e-13)


@pytest.mark.parametrize("fold", [180.0, 150.0, 90.0])
def test_springs_across_hinges_hold_the_hinges_energy_at_the_reference_fold(fold):
    """One hinge, folded by the reference fold both ways: the mean energy is that of the hinge."""
    half, reference = np.radians(fold) / 2.0, 0.3
    faces = [[0, 1, 2], [1, 0, 3]]

    def hinge(angle):
        ahead = np.array([0.3, 0.0, 0.0])
        arm = 0.8 * np.array([0.0, np.sin(angle), -np.cos(angle)])
        return np.array([[0.0, 0, 0], [1.0, 0, 0], arm + ahead, arm * [1, -1, 1] + 2 * ahead])

    mesh = ms.TriangleMesh(hinge(half), faces)
    shell = ms.Shell(mesh, ms.Material(0.0, 0.0, 2.0, 1.0))
    sheet = ms.SpringSheet(shell, shell_springs(shell, reference))
    energies = [sheet.shell.energy(hinge(half + sign * 0.5 * reference)) for sign in (1, -1)]
    assert np.mean(energies) == pytest.approx(shell.energy(hinge(half + 0.5 * reference)), rel=1e-12)
    # Of fourth order where flat, of second where folded.
    ratio = sheet.shell.energy(hinge(half + 2e-3)) / sheet.shell.energy(hinge(half + 1e-3))
    assert ratio == pytest.approx(16.0 if fold == 180.0 else 4.0, rel=0.02)


def test_springs_over_the_same_pair_add_up():
    """A fan of three triangles about a vertex: hinges span the outer triangle's edges."""
    points = [[0.0, 0, 0], [1, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]]
    mesh = ms.TriangleMesh(points, [[0, 1, 2], [0, 2, 3], [0, 3, 1]])
    springs = mesh_springs(mesh, 2.0, 3.0)
    assert len(springs) == 6
    assert springs.stiffness.sum() == 2.0 * 6 + 3.0 * 3


def test_bad_springs_are_refused():
    mesh = ms.sheet(cells=(3, 3))
    with pytest.raises(MaterialError, match="structural must be one number or"):
        mesh_springs(mesh, np.ones(3), 1.0)
    with pytest.raises(MaterialError, match="stiffness"):
        mesh_springs(mesh, -1.0, 1.0)
    shell = ms.Shell(mesh, ms.Material(1.0, 1.0, 1.0, 1.0))
    with pytest.raises(MaterialError, match="reference_fold"):
        shell_springs(shell, 2.0)
    with pytest.raises(MaterialError, match="shear and flexure"):
        shell_springs(ms.SpringSheet(shell).shell)
    with pytest.raises(MeshError, match=r"join the vertices 0 to 15"):
        ms.SpringSheet(shell, Springs([[0, 16]], [1.0], [1.0], [0.0]))
    with pytest.raises(OptionError, match="one of 'factor', 'cg'"):
        ms.SpringSheet(shell, integrator="linear_implicit", solver="lu")
    with pytest.raises(OptionError, match="linear_implicit"):
        ms.SpringSheet(shell, solver="cg")
    springs = Springs([[0, 1]], [1.0], [1.0], [0.0])
    with pytest.raises(MaterialError, match="mass"):
        ImplicitSprings(springs, [1.0, 0.0])
    with pytest.raises(MeshError, match="join the particles"):
        ImplicitSprings(springs, [1.0])
    with pytest.raises(SupportError):
        ImplicitSprings(springs, [1.0, 1.0], [True, True])
    with pytest.raises(OptionError, match="dashpots"):
        GridVerlet(grid_of(spring_damping=0.1))
    with pytest.raises(OptionError, match="float64 or float32"):
        GridVerlet(grid_of(), np.int64)


# Implicit steps


def dense_step(model, x, v, load, dt, drag, zeta):
    """Baraff and Witkin's equation with dense matrices, compressed springs without their part across."""
    shell = model.shell
    mass = np.repeat(shell.mass, 3)
    stiffness = shell.pattern.matrix(shell.energy_gradient_hessian(x, PROJECTED)[2]).toarray()
    damping = shell.pattern.matrix(shell.damping_matrix(x, zeta)).toarray() + np.diag(drag * mass)
    force = (load + shell.force(x)).ravel() - damping @ v.ravel()
    matrix = np.diag(mass) + dt * damping + dt**2 * stiffness
    free, right = shell.free_unknowns, dt * (force - dt * (stiffness @ v.ravel()))
    change = np.zeros(mass.size)
    change[free] = np.linalg.solve(matrix[np.ix_(free, free)], right[free])
    return change.reshape(-1, 3)


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_implicit_step_solves_the_equation_of_baraff_and_witkin(threads):
    grid = grid_of((7, 6), [(0, 0), (0, 5)], spring_damping=0.05)
    model = grid_model(grid)
    x, v = shaken(grid, 0.02), shaken(grid, 0.5, 1) - grid.rest_positions()
    load = 0.01 * np.random.default_rng(2).standard_normal(x.shape)
    expected = dense_step(model, x, v, load, 0.02, 0.7, 0.001)
    stepper = ImplicitSprings(grid.springs(), model.shell.mass, grid.pinned.ravel(), threads=threads)
    stepper.place(x, v)
    done = stepper.step(0.02, load, drag=0.7, stiffness_damping=0.001, iterations=500, tolerance=1e-13)
    assert done.converged
    assert set(done.seconds) == {"force", "matrix update", "acceleration", "velocity", "position"}
    np.testing.assert_allclose(stepper.change, expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(stepper.velocities, v + expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(stepper.positions, x + 0.02 * (v + expected), rtol=0, atol=1e-12)
    few = ImplicitSprings(grid.springs(), model.shell.mass, grid.pinned.ravel())
    few.place(x, v)
    done = few.step(0.02, load, drag=0.7, iterations=2, tolerance=1e-12)
    assert (done.iterations, done.converged) == (2, False)


def test_both_solvers_and_both_ways_to_hold_agree():
    """Factorisation and conjugate gradients, on supports that move."""
    grid = grid_of((6, 6), [(0, k) for k in range(6)], spring_damping=0.02)
    path = ms.SupportPath([0.0, 0.2, 0.4], translations=[[0, 0, 0], [0.1, 0.0, 0.05], [0, 0, 0]])
    ends = []
    for options in ({"solver": "factor"}, {"solver": "cg", "step_tolerance": 1e-12}):
        model = grid_model(grid, integrator="linear_implicit", **options)
        run = ms.simulate(model, duration=0.4, dt=0.02, gravity=(0, 0, -9.81), damping=(0.5, 1e-3), supports=path)
        assert run.status == "completed"
        ends.append(run.positions[-1])
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(ends[0][:6], grid.rest_positions()[:6], rtol=0, atol=1e-12)


@pytest.mark.parametrize("size", [1e-9, 1e-3])
@pytest.mark.parametrize("led", [False, True])
def test_conjugate_gradients_set_a_sheet_at_rest_in_motion(size, led):
    """Without load or velocity nothing but the springs, or the supports, says how small a residual is."""
    grid = grid_of((6, 6), [(0, k) for k in range(6)])
    x = grid.rest_positions() if led else shaken(grid, size)
    held = x[grid.pinned.ravel()] + [0.0, -size, 0.0] if led else None
    moved = []
    for options in ({"solver": "factor"}, {"solver": "cg"}):
        model = grid_model(grid, integrator="linear_implicit", **options)
        state, solved = model.step(MotionState(x, np.zeros_like(x)), 0.02, np.zeros_like(x), Damping(), held)
        assert solved
        moved.append(state.coordinates - x)
    assert np.linalg.norm(moved[1] - moved[0]) < 1e-4 * np.linalg.norm(moved[0])


def test_one_newton_step_nears_implicit_euler_as_the_step_shrinks():
    """Both of first order; their difference over one step is of third."""
    grid = grid_of((5, 5), [(0, 0), (0, 4)])
    x, differences = shaken(grid, 0.01), []
    steps = 0.2 * grid.stable_step() / 2.0 ** np.arange(4)
    for dt in steps:
        ends = []
        for integrator in ("implicit", "linear_implicit"):
            model = grid_model(grid, integrator=integrator, step_tolerance=1e-12)
            ends.append(model.step(MotionState(x, np.ones_like(x)), dt, np.zeros_like(x), Damping())[0].coordinates)
        differences.append(np.abs(ends[0] - ends[1]).max())
    orders = np.log2(np.array(differences[:-1]) / differences[1:])
    assert (orders > 2.7).all()


def swung(ratio, **options):
    """A sheet let go at 1/30 s, pinned at two corners, of a stiffness ``ratio`` times mass over step squared."""
    dt, mass = 1.0 / 30.0, 0.01
    stiffness = ratio * mass / dt**2
    grid = grid_of((8, 8), [(0, 0), (0, 7)], structural=stiffness, shear=0.5 * stiffness, flexion=0.1 * stiffness)
    run = ms.simulate(grid_model(grid, **options), duration=3.0, dt=dt, gravity=(0.0, 0.0, -9.81), damping=(1.0, 0.0))
    assert run.status == "completed"
    return run


@pytest.mark.parametrize(
    "ratio", [1e2, pytest.param(1e5, marks=pytest.mark.slow), pytest.param(1e8, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("integrator", ["bdf2", "implicit"])
def test_implicit_rules_are_stable_at_a_frames_step(ratio, integrator):
    """Energy never rises above where the sheet was let go, and by implicit Euler the sheet comes to hang."""
    run = swung(ratio, integrator=integrator)
    assert run.energies.sum(axis=1).max() < 1e-6
    if integrator == "implicit":
        assert run.energies[-1].sum() == pytest.approx(-2.2, rel=0.02)
        assert run.energies[-1, 0] < 0.01 * run.energies[:, 0].max()


@pytest.mark.by_default("100.0-cg", "100000.0-factor")
@pytest.mark.parametrize("solver", ["factor", "cg"])
@pytest.mark.parametrize("ratio", [1e2, 1e5, 1e8])
def test_one_linearisation_a_step_stays_bounded(ratio, solver):
    """It stretches a stiff sheet that turns, by the square of the turn, and so it rises in energy; it never runs away.

    From a stiffness of 1e8 it also holds the fall back: the sheet has not come to hang after three seconds.
    """
    run = swung(ratio, integrator="linear_implicit", solver=solver, step_tolerance=1e-9, iterations=5000)
    assert np.abs(run.positions).max() < 0.72
    assert run.energies[-1, 0] < 0.05 * run.energies[:, 0].max()
    if ratio < 1e6:
        assert run.energies[-1].sum() == pytest.approx(-2.2, rel=0.05)


def test_pulls_between_equal_and_opposite_pairs():
    """Every implicit step keeps the momentum of a free sheet."""
    grid = grid_of((6, 7))
    stepper = ImplicitSprings(grid.springs(), np.full(grid.count, 0.01))
    rates = np.random.default_rng(4).standard_normal((grid.count, 3))
    stepper.place(shaken(grid, 0.02), rates)
    for _ in range(20):
        stepper.step(0.03, (0.0, 0.0, 0.0), iterations=200, tolerance=1e-13)
    np.testing.assert_allclose(stepper.velocities.sum(axis=0), rates.sum(axis=0), rtol=0, atol=1e-10)


# The rung


def hanging(**options):
    """A panel curved at rest, held along one side, without wrinkles."""
    mesh = ms.cylinder_panel(length=0.5, radius=0.4, angle=80.0, cells=(6, 6))
    shell = ms.Shell(mesh, ms.Material(0.0, 4.0, 0.01, 0.2), clamped=mesh.vertices[:, 0] < 0.1)
    return ms.SpringSheet(shell, **options)


@pytest.mark.by_default("linear_implicit")
@pytest.mark.parametrize(
    "options",
    [
        {"integrator": "explicit"},
        pytest.param({"integrator": "verlet"}, marks=pytest.mark.slow),
        {"integrator": "implicit"},
        {"integrator": "linear_implicit"},
        {"integrator": "linear_implicit", "solver": "cg", "step_tolerance": 1e-9},
    ],
    ids=lambda options: "-".join(str(value) for value in options.values()),
)
def test_every_integrator_comes_to_rest_at_the_equilibrium(options):
    load = {"gravity": (0.0, 0.0, -2.0)}
    model = hanging(**options)
    explicit = options["integrator"] in ("explicit", "verlet")
    damping = (6.0, 0.0)
    dt = 0.9 * model.stable_step(Damping(*damping)) if explicit else 1.0 / 30.0
    run = ms.simulate(model, duration=8.0, dt=dt, damping=damping, store_every=10_000, **load)
    assert run.status == "completed"
    # The panel can dent aside, too: where statics begin from rest itself, rounding decides.
    start = model.shell.rest_positions.copy()
    start[model.shell.free] += 1e-4 * np.random.default_rng(0).standard_normal((len(model.shell.free), 3))
    answer = hanging().equilibrium(**load, start=start)
    assert answer.converged
    assert np.abs(answer.positions - model.shell.rest_positions).max() > 0.02
    np.testing.assert_allclose(run.positions[-1], answer.positions, rtol=0, atol=1e-6)


def test_a_flat_sheet_hangs_although_it_has_no_bending_stiffness():
    mesh = ms.sheet(cells=(8, 8))
    shell = ms.Shell(mesh, ms.Material(50.0, 10.0, 1e-3, 0.2), clamped=mesh.vertices[:, 0] < 0.01)
    model = ms.SpringSheet(shell, shell_springs(shell, 0.4))
    assert not model.shell.stiffness()[2::3][:, 2::3].toarray().any()
    answer = model.equilibrium(gravity=(0.0, 0.0, -9.81))
    assert answer.converged
    assert answer.positions[:, 2].min() == pytest.approx(-1.0, abs=0.05)


def test_a_flat_sheet_without_a_load_is_at_no_saddle():
    """Its Hessian is zero out of the plane, and was taken for one that curves down."""
    mesh = ms.sheet(length=0.3, width=0.2, cells=(6, 4))
    shell = ms.Shell(mesh, ms.Material(100.0, 100.0, 0.05, 0.2), clamped="x < 0.01 or x > 0.29")
    state = ms.SpringSheet(shell).equilibrium()
    assert (state.outcome, state.stable) == (ms.Outcome.CONVERGED, None)
    assert state.message.startswith("in balance, but some shapes resist no small push")


@pytest.mark.slow
def test_a_stiff_flat_strip_without_bending_stiffness_finds_its_minimum():
    mesh = ms.flat_beam(cells=(20, 4))
    shell = ms.Shell(mesh, ms.Material(200.0, 10.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.06)
    model = ms.SpringSheet(shell, shell_springs(shell, 0.1))
    load = {"gravity": (0.0, 0.0, -2.0)}
    answer = model.equilibrium(**load)
    assert answer.converged
    assert answer.residual < 1e-7
    energies = [
        model.shell.energy(x) - np.vdot(model.shell.gravity_force(load["gravity"]), x)
        for x in (answer.positions, shell.rest_positions)
    ]
    assert energies[0] < energies[1]


def test_turned_scenes_have_turned_answers():
    """Under a load so light that the sheet has one equilibrium; where it buckles, the last bits choose among some."""
    turn = Rotation.from_rotvec([0.4, -0.7, 1.1])
    answers = []
    for rotation in (Rotation.identity(), turn):
        mesh = ms.TriangleMesh(rotation.apply(np.array(hanging().shell.rest_positions)), hanging().shell.mesh.faces)
        shell = ms.Shell(mesh, ms.Material(0.0, 4.0, 0.01, 0.2), clamped=hanging().shell.clamped)
        answers.append(ms.SpringSheet(shell).equilibrium(gravity=rotation.apply((0.0, 0.0, -0.2))).positions)
    np.testing.assert_allclose(turn.apply(answers[0]), answers[1], rtol=0, atol=1e-8)


def test_dashpots_damp_strain_rates_only():
    """The force of the dashpots is their matrix times the velocity, none in rigid motion; energy falls by it."""
    grid = grid_of((5, 5), spring_damping=0.3)
    shell = grid_model(grid).shell
    assert shell.has_dashpots
    x, v = shaken(grid, 0.01), shaken(grid, 1.0, 1)
    force = shell.damping_force(x, v, 0.02)
    matrix = shell.pattern.matrix(shell.damping_matrix(x, 0.02))
    np.testing.assert_allclose(force.ravel(), -(matrix @ v.ravel()), rtol=0, atol=1e-12 * np.abs(force).max())
    rigid = np.cross([0.3, -1.0, 0.5], x) + np.array([1.0, 2.0, 3.0])
    assert np.abs(shell.damping_force(x, rigid, 0.02)).max() < 1e-13
    assert np.vdot(force, v) < 0.0
    model = grid_model(grid, integrator="verlet")
    run = ms.simulate(model, duration=0.2, dt=0.5 * model.stable_step(), start=x)
    assert run.energies[-1].sum() < 0.8 * run.energies[0].sum()
    assert "steps have taken" not in run.message  # dashpots have


def test_scenes_name_the_springs(scene_file):
    path = scene_file(
        ('shape = "v_beam"\ncells = [12, 4]', 'shape = "sheet"\ncells = [6, 6]'),
        ("x < 0.1", "x < 0.2"),
        ("-9.81", "-1"),
        ('name = "mwts"', 'name = "springs"\nintegrator = "linear_implicit"\nsolver = "cg"\nreference_fold = 0.4'),
        ("duration = 1", "duration = 0.2"),
    )
    built = ms.load_scene(path).build()
    assert isinstance(built.model, ms.SpringSheet)
    assert (built.model.integrator.key, built.model.solver) == ("linear_implicit", "cg")
    expected = shell_springs(built.shell, 0.4)
    np.testing.assert_array_equal(built.model.springs.stiffness, expected.stiffness)
    motion = built.start_motion()
    motion.advance()
    assert motion.unconverged == 0
