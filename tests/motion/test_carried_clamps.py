"""Supports that move carry along what clamps the edges next to them: every model ends as a rigid copy of its rest."""

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.models.registry import MODELS
from modalshell.scene.models import model_tables

ISOTROPIC = ms.Isotropic(young=1e9, poisson=0.3, thickness=0.01, density=1000.0)
HINGES = ms.Material(stretch=2000.0, shear=2000.0, flexure=5.0, density=0.2)
MATERIALS = {"split folds": ISOTROPIC, "hinges": HINGES}
SUPPORTS = {
    "clamped row": [ms.Clamp("x < 1e-6")],
    "clamped rows": [ms.Clamp("x < 0.2")],
    "pinned rows": [ms.Pin("x < 0.2")],
    "clamp and fixed tip": [ms.Clamp("x < 1e-6"), ms.Fix("x > 0.99", axes="z")],
    "clamp and symmetry": [ms.Clamp("x < 1e-6"), ms.Symmetry("y < -0.0999", normal=(0, 1, 0))],
    "clamp and roller": [ms.Clamp("x < 1e-6"), ms.Roller("x > 0.99", direction=(1, 0, 0))],
}
ENDS = {
    "lifted": ([0.0, 0.0, 0.3], [0.0, 0.0, 0.0]),
    "pushed and tilted": ([0.4, -0.1, 0.0], [0.0, -1.1, 0.0]),
    "thrown and turned": ([-0.2, 0.3, 0.1], [0.5, 0.4, -0.9]),
}
DURATION = 0.5


def shell_of(material, supports):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2), family="alternating")
    first, *others = SUPPORTS[supports]
    if material is HINGES and first.clamps:  # hinges turn about one row
        first = ms.Clamp("x < 0.2")
    return ms.Shell(mesh, material, supports=[first, *others])


def path_to(end):
    moved, turned = ENDS[end]
    return ms.SupportPath([0.0, DURATION], [[0, 0, 0], moved], [[0, 0, 0], turned], pivot=(0.1, 0.0, 0.2))


def built(key, shell):
    """A model of a small shell; coarse ones on as many vertices."""
    from modalshell.models import CoarseMesh
    from modalshell.models.factory import ModelFactory

    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2), family="alternating")
    coarse = CoarseMesh(mesh, "8x2", shell.material)
    factory = ModelFactory(shell, lambda: shell.gravity_force((0.0, 0.0, -1.0)), lambda *_: coarse)
    table, few = model_tables()[key], {"modes": 3, "rank": 4, "motions": 4}
    return table(**{name: few[name] for name in table.__struct_fields__ if name in few}).build(factory)


def first_of(shell):
    """First angular frequency [rad/s]."""
    return 2.0 * np.pi * float(ms.solve_modes(shell, 1).frequencies[0])


def settled(model, path):
    """A motion that has come to rest: damped near the critical of its first mode."""
    first = first_of(model.shell)
    rest = 20.0 / first
    return ms.simulate(model, duration=DURATION + rest, dt=DURATION / 25, damping=(2.0 * first, 1e-4), supports=path)


def settled_at_all_ends(model):
    """A motion to one end after the other, where it comes to rest; the numbers of frames at rest, and the path."""
    first, dt = first_of(model.shell), DURATION / 12
    each = 12 + int(np.ceil(14.0 / first / dt))  # steps to an end and at it
    poses = np.array([np.zeros((2, 3)), *ENDS.values()])

    def pose(time):
        last = min(int(time / (each * dt)), len(ENDS) - 1)
        s = min(time / DURATION - last * each * dt / DURATION, 1.0)
        return poses[last] + s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * (poses[last + 1] - poses[last])

    duration = len(ENDS) * each * dt
    path = ms.SupportPath.from_function(pose, duration, step=0.25 * dt, pivot=(0.1, 0.0, 0.2))
    run = ms.simulate(model, duration=duration, dt=dt, damping=(2.0 * first, 1e-4), supports=path)
    return run, each * np.arange(1, len(ENDS) + 1), path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("material", "supports", "end"),
    [
        ("split folds", "clamped row", "thrown and turned"),
        ("split folds", "pinned rows", "pushed and tilted"),
        ("hinges", "clamped rows", "lifted"),
        ("hinges", "pinned rows", "thrown and turned"),
    ],
)
def test_discrete_shells_end_as_rigid_copies(material, supports, end):
    shell, path = shell_of(MATERIALS[material], supports), path_to(end)
    run = settled(ms.DiscreteShell(shell), path)
    assert run.outcome == ms.Outcome.COMPLETED, run.message
    np.testing.assert_allclose(run.positions[-1], path.at(10.0).to_world(shell.rest_positions), atol=1e-5)
    assert run.energies[-1, 1] < 1e-6 * run.energies[:, 1].max()


@pytest.mark.by_default("bdf2", "linear_implicit")
@pytest.mark.parametrize("integrator", ["composite", "bdf2", "linear_implicit"])
def test_supports_that_move_evenly_from_before_the_start_are_at_rest(integrator):
    """DS began at rest in the world, which jerked it; models that move in the frame of supports began at theirs."""
    shell, times, speed = shell_of(ISOTROPIC, "clamped row"), np.linspace(-30.0, 30.0, 61), np.array([0.7, 0.2, -0.3])
    model, given = ms.DiscreteShell(shell, integrator=integrator), {"gravity": (0.0, 0.0, -1.0), "dt": 0.01}
    path = ms.SupportPath(times, np.outer(times, speed))
    still, moved = (ms.simulate(model, duration=0.05, supports=each, **given) for each in (None, path))
    way = np.outer(still.times, speed)[:, None]
    np.testing.assert_allclose(moved.positions, still.positions + way, atol=1e-12)


def cases_by_turns():
    """Every model on every support, of one material or the other."""
    keys = [key for key, spec in MODELS.items() if spec.bends]
    pairs = product(enumerate(keys), enumerate(SUPPORTS))
    return [(key, list(MATERIALS)[(i + j) % len(MATERIALS)], supports) for (i, key), (j, supports) in pairs]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::modalshell.core.errors.ModalShellWarning")
@pytest.mark.parametrize(("key", "material", "supports"), cases_by_turns())
def test_every_model_on_every_support_ends_as_a_rigid_copy(key, material, supports):
    shell = shell_of(MATERIALS[material], supports)
    try:
        run, ends, path = settled_at_all_ends(built(key, shell))
    except (ms.SupportError, ms.OptionError) as refused:  # of models that take clamps, or split folds, alone
        pytest.skip(str(refused))
    assert run.outcome in (ms.Outcome.COMPLETED, ms.Outcome.STEPS_NOT_CONVERGED), run.message
    for end in ends:
        carried = path.at(float(run.times[end])).to_world(shell.rest_positions)
        np.testing.assert_allclose(run.positions[end], carried, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "of_modes"),
    [
        ("implicit", "implicit_euler"),
        ("linear_implicit", "implicit_euler"),
        ("bdf2", "exponential"),
        ("composite", "exponential"),
    ],
)
def test_steps_of_a_carried_clamp_follow_the_linear_modes_where_the_motion_is_small(integrator, of_modes):
    shell = shell_of(ISOTROPIC, "clamped row")
    path = ms.SupportPath([0.0, 0.1], [[0, 0, 0], [0, 0, 0.004]], [[0, 0, 0], [0.0, 0.004, 0.0]])
    # Without damping by the mass, which is relative to the supports in modal models and absolute in full ones.
    options = {"duration": 0.1, "dt": 4e-4, "damping": (0.0, 1e-4), "supports": path}
    modal = ms.simulate(ms.LinearModal(ms.solve_modes(shell, 8), integrator=of_modes), **options)
    full = ms.simulate(ms.DiscreteShell(shell, integrator=integrator), **options).positions
    carried = np.array([path.at(float(time)).to_world(shell.rest_positions) for time in modal.times])
    assert np.abs(full - modal.positions).max() < 0.02 * np.abs(modal.positions - carried).max()


SHORT = {
    "duration": 0.02,
    "damping": (1.0, 1e-5),
    "supports": ms.SupportPath([0.0, 0.02], [[0, 0, 0], [0, 0, 0.05]], [[0, 0, 0], [0.0, -0.2, 0.1]]),
    "store_every": 10**9,
}


@pytest.fixture(scope="module")
def end_of_short():
    """Where that motion ends, extrapolated from steps of second order."""
    model = ms.DiscreteShell(shell_of(ISOTROPIC, "clamped row"))
    coarse, fine = (ms.simulate(model, dt=dt, **SHORT).positions[-1] for dt in (1.6e-4, 8e-5))
    return (4.0 * fine - coarse) / 3.0


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["explicit", "verlet"])
def test_explicit_steps_carry_the_clamp(integrator, end_of_short):
    model = ms.DiscreteShell(shell_of(ISOTROPIC, "clamped row"), integrator=integrator)
    dt = 0.02 / np.ceil(0.02 / (0.3 * model.stable_step(ms.Damping(1.0, 1e-5))))
    found = ms.simulate(model, dt=dt, **SHORT).positions[-1]
    np.testing.assert_allclose(found, end_of_short, atol=1e-4)


def test_energy_of_a_posed_shell_is_that_of_the_shell_at_rest():
    shell = shell_of(ISOTROPIC, "clamped row")
    rng = np.random.default_rng(3)
    x = shell.rest_positions + 1e-3 * rng.standard_normal(shell.rest_positions.shape)
    turn = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix()

    def place(points):
        return points @ turn.T + np.array([3.0, -1.0, 0.5])

    posed = shell.posed(place)
    assert posed.energy(place(x)) == pytest.approx(shell.energy(x), rel=1e-9)
    np.testing.assert_allclose(posed.force(place(x)), shell.force(x) @ turn.T, atol=1e-6 * np.abs(shell.force(x)).max())
    assert shell_of(HINGES, "clamped row").posed(place).energy(x) == shell_of(HINGES, "clamped row").energy(x)


def test_the_pull_of_a_moving_clamp_is_the_gradients_derivative_at_rest():
    """Taylor's remainder is of second order in the way."""
    shell = shell_of(ISOTROPIC, "clamped row")
    x, errors = shell.rest_positions, []
    for size in (1e-3, 5e-4, 2.5e-4):
        moved = shell.posed(lambda points, size=size: points + size * np.array([0.1, 0.3, 1.0]) * points[:, :1])
        change = moved.energy_gradient(x)[1] - shell.energy_gradient(x)[1]
        errors.append(np.abs(change - shell.elastic_energy.pull(x, moved.elastic_energy)).max())
    slopes = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(slopes, 2.0, atol=0.3)


@pytest.mark.slow
def test_fields_of_a_carried_shell_are_those_in_its_own_frame():
    shell, path = shell_of(ISOTROPIC, "clamped row"), path_to("thrown and turned")
    model = ms.ModalWarping(ms.solve_modes(shell, 3))
    options = {"duration": 0.6, "dt": 0.02, "damping": (40.0, 0.0), "supports": path}
    run = ms.simulate(model, fields=["von_mises"], **options)
    whole = shell.fields(path.at(float(run.times[10])).to_shell(run.positions[10])).von_mises
    np.testing.assert_allclose(run.fields["von_mises"][10], whole, rtol=1e-9)
    assert run.fields["von_mises"][-1].max() < 2.0 * run.fields["von_mises"][5:15].max()


def test_a_pose_knows_the_velocity_of_what_it_carries():
    path = ms.SupportPath(
        [0, 0.5, 1.0], [[0, 0, 0], [0, 0.3, 0.2], [0.1, 0, 0]], [[0, 0, 0], [0.4, 1.0, 0], [0, 2.0, 1.0]]
    )
    random = np.random.default_rng(3)
    x, v, time = random.standard_normal((5, 3)), random.standard_normal((5, 3)), 0.37

    def carried(lead):
        return path.at(time + lead).to_world(x + lead * v)

    slopes = [(carried(h) - carried(-h)) / (2.0 * h) - path.at(time).world_velocities(x, v) for h in (1e-2, 5e-3)]
    assert np.log2(np.abs(slopes[0]).max() / np.abs(slopes[1]).max()) == pytest.approx(2.0, abs=0.1)
    assert not path.at(2.0).velocity.any()
