"""Contacts of modal models against discrete shells, in statics and motion; their small complementarity problem."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact.base import Collider
from modalshell.contact.complementarity import complementary
from modalshell.contact.gap_kernels import common_normal, forms_of, packed
from modalshell.motion.stepping import Motion

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.15))
MODELS = {"LMA": ms.LinearModal, "MWTS": ms.ModalWarping, "RSW": ms.RotationStrain}


@pytest.fixture(scope="module")
def shell():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    return ms.Shell(mesh, material, clamped="x < 1e-6")


@pytest.fixture(scope="module")
def basis(shell):
    return ms.solve_modes(shell, count=8)


@pytest.fixture(scope="module")
def truth(shell):
    return ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=[FLOOR])


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_small_problems_are_solved_exactly(seed, symmetric):
    random = np.random.default_rng(seed)
    half = random.standard_normal((12, 5))
    matrix = half @ half.T + 1e-3 * np.eye(12)  # more rows than modes
    if not symmetric:
        skew = random.standard_normal((12, 12))
        matrix += 1e-3 * (skew - skew.T)
    gaps, forces = random.standard_normal(12), np.zeros(12)
    complementary(np.ascontiguousarray(matrix.T), gaps, forces, 1e-12, symmetric)
    after = matrix @ forces + gaps
    assert forces.min() >= 0.0
    assert after.min() >= -1e-9
    assert np.abs(forces * after).max() <= 1e-7 * np.abs(forces).max()


@pytest.mark.by_default("RSW-0.005-0.01")
@pytest.mark.parametrize(("name", "error", "force"), [("LMA", 0.12, 0.05), ("MWTS", 0.02, 0.02), ("RSW", 0.005, 0.01)])
def test_a_cantilever_on_a_table_rests_as_its_discrete_shell(shell, basis, truth, name, error, force):
    state = MODELS[name](basis).equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert state.converged
    assert state.deepest <= 1e-9
    assert ms.measure.displacement_error(state.positions, truth.positions, shell) < error
    assert state.contact_forces[:, 2].sum() == pytest.approx(truth.contact_forces[:, 2].sum(), rel=force)
    assert (state.contact_forces[~state.in_contact] == 0.0).all()
    assert state.in_contact.sum() >= 3


@pytest.mark.parametrize("name", MODELS)
def test_a_load_that_reaches_no_contact_gives_the_free_answer(basis, name):
    model = MODELS[name](basis)
    free = model.equilibrium(gravity=(0, 0, -0.5))
    state = model.equilibrium(gravity=(0, 0, -0.5), contacts=[FLOOR])
    assert state.converged
    assert not state.in_contact.any()
    np.testing.assert_allclose(state.positions, free.positions, atol=1e-7)


def test_a_curved_collider_under_a_modal_model(shell, basis):
    ball = ms.Contact(ms.Sphere((0.7, 0.0, -0.21), 0.2))
    truth = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=[ball])
    state = ms.RotationStrain(basis).equilibrium(gravity=GRAVITY, contacts=[ball])
    assert state.converged
    assert state.deepest <= 1e-9
    assert ms.measure.displacement_error(state.positions, truth.positions, shell) < 0.05


@pytest.mark.by_default("LMA-exponential", "MWTS-implicit_euler")
@pytest.mark.parametrize(
    ("name", "integrator"), [("LMA", "exponential"), ("MWTS", "implicit_euler"), ("RSW", "exponential")]
)
def test_motion_comes_to_rest_on_the_table(shell, basis, name, integrator):
    model = MODELS[name](basis, integrator=integrator)
    run = ms.simulate(model, duration=1.5, dt=1 / 60, gravity=GRAVITY, damping=(8.0, 0.0), contacts=[FLOOR])
    assert run.unconverged_steps == 0
    assert run.positions[..., 2].min() >= -0.15 - 1e-8
    rest = model.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert ms.measure.displacement_error(run.positions[-1], rest.positions, shell) < 0.01
    allowed = 1e-3 if name == "MWTS" else 2e-9  # its modal force has no potential
    assert np.diff(run.energies.sum(axis=1)).max() <= allowed * np.ptp(run.energies[:, 2])
    assert run.deepest.max() <= 1e-9
    assert run.contact_forces[-1].sum(axis=0) == pytest.approx(rest.contact_forces.sum(axis=0), rel=0.1, abs=1e-3)


@pytest.mark.by_default("collider0-RSW", "collider1-LMA")
@pytest.mark.parametrize("name", ["LMA", "RSW"])
@pytest.mark.parametrize("collider", [ms.Plane((0, 0, 1), -0.15), ms.Sphere((0.7, 0.0, -0.21), 0.2)])
def test_undamped_motion_on_a_collider_never_gains_energy(basis, name, collider):
    contacts = [ms.Contact(collider)]
    run = ms.simulate(MODELS[name](basis), duration=1.0, dt=1 / 60, gravity=GRAVITY, contacts=contacts)
    rises, touches = np.diff(run.energies.sum(axis=1)), run.in_contact.any(axis=1)
    rise = rises[touches[:-1] | touches[1:]].max() / np.ptp(run.energies[:, 2])  # between, the rule itself gains some
    assert touches.any()
    assert run.unconverged_steps == 0
    assert rise <= (1e-13 if name == "LMA" else 2e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LMA", "MWTS"])
def test_compiled_frames_are_those_that_ask_for_gaps_and_rows(basis, name, monkeypatch):
    """A sphere among a box, and the same without a compiled form: one problem has one answer, solved closely."""
    for module in ("modal_rows", "modal"):
        monkeypatch.setattr(f"modalshell.contact.{module}.FAR", 1e-8)

    class Bare(Collider):
        def __init__(self, inner):
            self.inner = inner

        def gap(self, x, t=0.0):
            return self.inner.gap(x, t)

        def surface(self, corners):
            return self.inner.surface(corners)

    colliders = ms.Sphere((0.6, 0.02, -0.26), 0.2), ms.Box((1.0, 0, -0.5), (0.2, 0.3, 0.25), rounding=0.05)
    frames = {}
    for kind, wrap in (("compiled", lambda one: one), ("asked", Bare)):
        contacts = [ms.Contact(wrap(one)) for one in colliders]
        model = MODELS[name](basis, integrator="implicit_euler")
        frames[kind] = ms.simulate(model, duration=0.7, dt=1 / 60, gravity=GRAVITY, contacts=contacts)
    compiled, asked = frames.values()
    assert compiled.in_contact.any()
    assert np.array_equal(compiled.in_contact, asked.in_contact)
    np.testing.assert_allclose(compiled.positions, asked.positions, atol=1e-7)


@pytest.mark.parametrize("reduced", [False, True])
def test_rotation_strain_knows_its_derivatives_at_contacts(basis, reduced):
    model = ms.RotationStrain(basis)
    if reduced:
        model = ms.ReducedRotationStrain.trained(model, [GRAVITY], mixtures=40)
    q = np.array([0.1, -0.02, 0.01, 0.03, -0.01, 0.0, 0.005, 0.002])
    chosen = np.array([40, 90, 104, 90])
    rows = model.contact_rows(q, chosen)
    direction = np.array([0.3, -0.2, 0.1, 0.4, 0.2, -0.1, 0.05, 0.3])
    errors = []
    for step in (1e-3, 1e-4):
        ends = [model.warped_positions(q + side * step * direction)[chosen] for side in (1.0, -1.0)]
        errors.append(np.abs((ends[0] - ends[1]) / (2.0 * step) - rows @ direction).max())
    assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.1)


def test_a_resumed_modal_motion_has_the_same_bits(shell, basis):
    def motion():
        loading = shell.loading(GRAVITY, None, None)
        return Motion(ms.ModalWarping(basis), loading, dt=1 / 60, contacts=[FLOOR])

    whole, first, second = motion(), motion(), motion()
    for _ in range(30):
        whole.advance()
    for _ in range(20):
        first.advance()
    second.restore(first.snapshot())
    for _ in range(10):
        second.advance()
    assert whole.positions()[:, 2].min() <= -0.15 + 1e-8
    assert whole.positions().tobytes() == second.positions().tobytes()


@pytest.mark.parametrize("frames", [40, 160])
def test_a_resumed_motion_takes_derivatives_where_the_whole_one_did(shell, basis, frames):
    """As it falls, and at rest, where derivatives of earlier frames serve."""

    def motion():
        loading = shell.loading(GRAVITY, None, None)
        return Motion(ms.RotationStrain(basis), loading, dt=1 / 60, damping=(8.0, 0.0), contacts=[FLOOR])

    whole, second = motion(), motion()
    for _ in range(frames):
        whole.advance()
    second.restore(whole.snapshot())
    taken = [whole.state.memory["derivatives_at"]]
    for _ in range(5):
        for one in (whole, second):
            one.advance()
        taken.append(whole.state.memory["derivatives_at"])
    assert whole.touched().touches.any()
    assert np.array_equal(taken[0], taken[-1]) == (frames == 160)
    assert whole.positions().tobytes() == second.positions().tobytes()
    assert whole.state.memory["derivatives_at"].tobytes() == second.state.memory["derivatives_at"].tobytes()


def test_a_moving_collider_pushes_a_modal_model(shell, basis):
    path = ms.SupportPath([0.0, 0.5], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.2)])
    table = ms.Contact(ms.Plane((0, 0, 1), -0.05), sel="x > 0.5", motion=path)
    run = ms.simulate(ms.RotationStrain(basis), duration=0.8, dt=1 / 60, damping=(2.0, 0.0), contacts=[table])
    assert run.unconverged_steps == 0
    tip = shell.mesh.vertices[:, 0].argmax()
    assert run.positions[-1, tip, 2] > 0.1
    far = shell.mesh.vertices[:, 0] > 0.5
    assert all(table.distance(x[far], t).min() >= -1e-6 for x, t in zip(run.positions, run.times, strict=True))


def test_what_modal_models_do_not_take_is_refused_by_name(shell, basis):
    model = ms.ModalWarping(basis)
    with pytest.raises(ms.OptionError, match=r"statics of MWTS take contacts without friction \(contact 0 has 0.2\)"):
        model.equilibrium(contacts=[ms.Contact(ms.Plane((0, 0, 1), -1), friction=0.2)])
    with pytest.raises(ms.OptionError, match="contact 0 has friction or restitution, which motions of MWTS"):
        ms.simulate(model, duration=0.1, contacts=[ms.Contact(ms.Plane((0, 0, 1), -1), restitution=0.2)])
    with pytest.raises(ms.OptionError, match=r"vertex \d+ begins .* inside contact 0"):
        model.equilibrium(contacts=[ms.Contact(ms.Plane((0, 0, 1), 0.1))])
    free = ms.Shell(shell.mesh, shell.material)
    with pytest.raises(ms.OptionError, match="statics of MWTS take contacts of shells that supports hold"):
        ms.ModalWarping(ms.solve_modes(free, count=12)).equilibrium(contacts=[FLOOR])
    with pytest.raises(ms.OptionError, match="rigid takes no contacts"):
        ms.RigidShell(shell).equilibrium(contacts=[FLOOR])


@pytest.fixture(scope="module")
def strips():
    """A limp and a stiff strip, their modes, and DS under their weight."""

    def made(young):
        mesh = ms.sheet(length=0.6, width=0.15, cells=(24, 6))
        shell = ms.Shell(
            mesh, ms.Isotropic(young=young, poisson=0.3, thickness=1e-3, density=900.0), clamped="x < 0.001"
        )
        return shell, ms.solve_modes(shell, count=12)

    return {"limp": made(5e7), "stiff": made(2e9)}


@pytest.mark.slow
@pytest.mark.parametrize(("model", "error"), [(ms.RotationStrain, 0.01), (ms.LinearModal, 0.3)])
def test_more_vertices_than_modes_may_touch_at_rest(strips, model, error):
    shell, basis = strips["limp"]
    given = {"gravity": (0, 0, -9.81), "contacts": [ms.Contact(ms.Plane((0, 0, 1), -0.1))]}
    state, truth = model(basis).equilibrium(**given), ms.DiscreteShell(shell).equilibrium(**given)
    assert state.converged
    assert state.iterations <= 15
    assert state.in_contact.sum() > 90
    assert state.deepest < 1e-10
    assert ms.measure.displacement_error(state.positions, truth.positions, shell) < error


@pytest.mark.by_default("ModalWarping")
@pytest.mark.parametrize("model", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_statics_of_modes_do_not_pass_through_a_box(strips, model):
    shell, basis = strips["stiff"]
    box = ms.Contact(ms.Box((0.45, 0.07, -0.15), (0.08, 0.2, 0.08), rounding=0.01))
    given = {"gravity": (0, 0, -9.81), "contacts": [box]}
    state, truth = model(basis).equilibrium(**given), ms.DiscreteShell(shell).equilibrium(**given)
    assert state.converged
    assert state.positions[:, 2].min() > -0.08
    assert ms.measure.displacement_error(state.positions, truth.positions, shell) < 0.1


@pytest.mark.by_default("MWTS")
@pytest.mark.parametrize("name", MODELS)
def test_many_more_vertices_than_modes_rest_on_a_table(name):
    """A limp sheet of which three quarters lie on a table: all that are inside are candidates."""
    mesh = ms.sheet(length=0.6, width=0.15, cells=(24, 6))
    limp = ms.Shell(mesh, ms.Isotropic(young=5e7, poisson=0.3, thickness=5e-4, density=900.0), clamped="x < 0.001")
    model, table = MODELS[name](ms.solve_modes(limp, count=6)), [ms.Contact(ms.Plane((0, 0, 1), -0.02))]
    state = model.equilibrium(gravity=GRAVITY, contacts=table)
    assert state.converged
    assert state.iterations <= 10
    assert state.deepest <= 1e-9
    assert state.in_contact.sum() > 100
    run = ms.simulate(model, duration=1.0, dt=1 / 60, gravity=GRAVITY, damping=(5.0, 0.0), contacts=table)
    assert run.unconverged_steps == 0
    assert run.deepest.max() <= 2e-9
    assert ms.measure.displacement_error(run.positions[-1], state.positions, limp) < 1e-3


def normal_of(contacts, time):
    return common_normal(packed(contacts, forms_of(contacts), time, None))


def test_derivatives_along_a_common_normal_are_those_along_three_axes(basis):
    model = ms.RotationStrain(basis)
    q, vertices = 0.05 * np.arange(1.0, 9.0), np.arange(12, 20)
    turn, slant = ms.SupportPath([0.0, 1.0], np.zeros((2, 3)), [[0.0, 0.3, 0.0]] * 2), np.array([0.6, 0.0, 0.8])
    rows = model.contact_rows(q, vertices)
    points, along = model.contact_frame(q, vertices, slant[None])
    assert np.allclose(along[:, 0], slant @ rows, rtol=0.0, atol=1e-13)
    assert np.allclose(points, model.warped_positions(q)[vertices], rtol=0.0, atol=1e-13)
    planes = [ms.Contact(ms.Plane((0.0, 0.0, 1.0), -height), motion=turn) for height in (0.2, 0.3)]
    normal = normal_of(planes, 0.5)
    assert np.allclose(normal, planes[0].gap(np.zeros((1, 3)), 0.5)[1][0], rtol=0.0, atol=1e-15)
    assert normal_of([planes[0], ms.Contact(ms.Plane())], 0.5) is None
    assert normal_of([ms.Contact(ms.Sphere((0.0, 0.0, 0.0), 1.0))], 0.0) is None


@pytest.mark.by_default("MWTS")
@pytest.mark.parametrize("name", [*MODELS, "MD-ROM", "linear_implicit"])
def test_a_step_that_leads_through_a_ball_is_told(shell, basis, name):
    """A ball lies between two frames of the tip; such motions ended as completed, but for those of DS."""
    if name in MODELS:
        model = MODELS[name](basis)
    else:
        kept = {"integrator": name} if name == "linear_implicit" else {"count": 4}
        model = (ms.DiscreteShell if name == "linear_implicit" else ms.ModalDerivatives)(shell, **kept)
    given = {"duration": 0.4, "dt": 1 / 15, "gravity": (0.0, 0.0, -30.0)}
    tip = ms.simulate(model, **given).positions[:, np.argmax(shell.rest_positions @ [1.0, -1e-3, 0.0])]
    frame = int(np.argmax(np.linalg.norm(np.diff(tip, axis=0), axis=1)))
    ball = ms.Contact(ms.Sphere(0.5 * (tip[frame] + tip[frame + 1]), 5e-3))
    run = ms.simulate(model, contacts=[ball], **given)
    assert not run.in_contact[: frame + 2].any()
    assert "of 6 steps did not converge" in run.message
