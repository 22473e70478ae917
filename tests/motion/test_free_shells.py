"""Shells without supports in motion: every rung keeps their centres and momenta, wherever they turn."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.integrators.state import MotionState
from modalshell.models.reduced_rotation_strain import trained_on_loads
from modalshell.motion.stepping import Motion

GRAVITY = np.array([0.0, 0.0, -9.81])
TIME, TURN = 0.5, np.radians(80.0)
HINGES = ms.Material(stretch=2e5, shear=2e5, flexure=0.07, density=2.0)
PLATE = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=1000.0)


def mesh_of(cells=(8, 4)):
    return ms.flat_beam(length=1.0, width=0.5, cells=cells)


def sheet(material=HINGES, cells=(8, 4)):
    return ms.Shell(mesh_of(cells), material)


def two_sheets(material=HINGES, cells=(6, 3), clamped=()):
    one = mesh_of(cells)
    vertices = np.vstack([one.vertices, 0.8 * one.vertices + (0.2, 0.1, 0.4)])
    mesh = ms.TriangleMesh(vertices, np.vstack([one.faces, one.faces + len(one.vertices)]))
    return ms.Shell(mesh, material, clamped, loose_parts=True)


QUIET = [pytest.mark.filterwarnings("ignore:no basis"), pytest.mark.filterwarnings("ignore:modes are spent")]
MATERIALS = {"hinges": HINGES, "plate": PLATE}
MAKERS = {
    "LMA": lambda shell: ms.LinearModal(modes_of(shell)),
    "MWTS": lambda shell: ms.ModalWarping(modes_of(shell)),
    "MWTS, implicit Euler": lambda shell: ms.ModalWarping(modes_of(shell), integrator="implicit_euler"),
    "consistent MWTS": lambda shell: ms.ModalWarping(modes_of(shell), consistent_force=True),
    "RSW": lambda shell: ms.RotationStrain(modes_of(shell)),
    "reduced RSW": lambda shell: reduced_about(shell, couple(shell)),
    "MD-ROM": lambda shell: ms.ModalDerivatives(shell, 14 + 6 * int(shell.mesh.components.max())),
    "MD-ROM, SDIRK2": lambda shell: ms.ModalDerivatives(shell, 14, integrator="sdirk2"),
    "rigid": ms.RigidShell,
    "DS": ms.DiscreteShell,
    "DS, BDF2": lambda shell: ms.DiscreteShell(shell, integrator="bdf2"),
    "coarse DS": lambda shell: ms.CoarseDiscreteShell(shell, sheet(shell.material, (5, 3))),
    "springs": ms.SpringSheet,
    "hybrid": lambda shell: hybrid_of(shell, couple(shell)),
    "auto": ms.Auto,
}
"""Every rung that takes free shells."""
ON_PLATES = {"LMA", "RSW", "rigid", "DS", "coarse DS"}
"""Rungs that are tried on shell theory by default, the others on hinges; all on both with the slow tests."""
SLOW = {
    (energy, name): name == "hybrid" or (energy == "plate") != (name in ON_PLATES)
    for energy in MATERIALS
    for name in MAKERS
}
CASES = [
    pytest.param(energy, name, marks=[pytest.mark.slow] * SLOW[energy, name] + QUIET * (name == "hybrid"))
    for energy in MATERIALS
    for name in MAKERS
    if (energy, name) != ("plate", "springs")
]
ONCE = [case for case in CASES if not SLOW[case.values] or case.values[1] == "hybrid"]
"""Every rung on the energy on which it is tried by default."""
KEPT = {}


def modes_of(shell, count=14):
    if ("modes", id(shell)) not in KEPT:
        KEPT["modes", id(shell)] = ms.solve_modes(shell, count + 6 * int(shell.mesh.components.max()))
    return KEPT["modes", id(shell)]


def reduced_about(shell, load):
    """Reduced RSW as scenes have it, trained on shares of a load."""
    return trained_on_loads(modes_of(shell), np.array([share * load for share in (0.2, 0.4, 0.6, 0.8, 1.0)]))


def hybrid_of(shell, load, coarse=None):
    """A small hybrid on a coarse sheet; it is wrong more often than a large one, and handed over then."""
    return ms.HybridStress.trained(
        shell, force=load, coarse=coarse or sheet(shell.material, (5, 3)), modes=16, motions=6
    )


@cache
def shell_of(energy):
    return sheet(MATERIALS[energy])


@cache
def model_of(energy, name):
    return MAKERS[name](shell_of(energy))


def arms_of(shell, x, part=slice(None)):
    mass = shell.mass[part]
    return x[part] - mass @ x[part] / mass.sum()


def couple(shell):
    """Dead forces that turn a flat shell about y by TURN in TIME, were their torque to stay."""
    arms = arms_of(shell, shell.rest_positions)
    force = np.zeros_like(arms)
    force[:, 2] = -shell.mass * arms[:, 0]
    inertia = shell.mass @ (arms[:, 0] ** 2 + arms[:, 2] ** 2)
    return force * (2.0 * TURN / TIME**2 * inertia / np.cross(arms, force).sum(axis=0)[1])


def momenta(shell, frames, dt, part=slice(None)):
    """Discrete angular momenta ``sum m x_n x x_{n+1} / h`` (F - 1, 3) about the centre, and their scale."""
    mass, arms = shell.mass[part], [arms_of(shell, x, part) for x in frames]
    pairs = list(pairwise(arms))
    found = np.array([mass @ np.cross(a, b) for a, b in pairs]) / dt
    sizes = [mass @ (np.linalg.norm(a, axis=1) * np.linalg.norm(b - a, axis=1)) for a, b in pairs]
    return found, max(sizes) / dt


def centres(shell, frames, part=slice(None)):
    return np.array([shell.mass[part] @ x[part] for x in frames]) / shell.mass[part].sum()


def run_of(model, dt=1.0 / 30.0, time=TIME, **options):
    run = ms.simulate(model, duration=time, dt=dt, **options)
    assert run.unconverged_steps == 0
    return run


def bent(shell, k=1.2):
    """A shell bent to an arc about y, and twisted."""
    x, y, _ = shell.rest_positions.T
    return np.column_stack([np.sin(k * (x - 0.5)) / k + 0.5, y, (1.0 - np.cos(k * (x - 0.5))) / k + 0.1 * x * y])


@pytest.mark.by_default("plate-rigid")
@pytest.mark.parametrize(("energy", "name"), CASES)
def test_gravity_bends_nothing_and_the_fall_is_exact(energy, name):
    shell = shell_of(energy)
    run = run_of(model_of(energy, name), gravity=GRAVITY)
    fallen = 0.5 * GRAVITY * run.times[:, None, None] ** 2
    np.testing.assert_allclose(run.positions, shell.rest_positions + fallen, rtol=0, atol=1e-9)


@pytest.mark.by_default("hinges-MWTS, implicit Euler", "hinges-MD-ROM, SDIRK2", "hinges-auto", "plate-coarse DS")
@pytest.mark.parametrize(("energy", "name"), CASES)
def test_a_sheet_falls_while_a_couple_turns_it(energy, name):
    shell, load = shell_of(energy), couple(shell_of(energy))
    run = run_of(model_of(energy, name), gravity=GRAVITY, force=load)
    fall = 0.5 * 9.81 * TIME**2
    exact = centres(shell, run.positions[:1]) + 0.5 * GRAVITY * run.times[:, None] ** 2
    np.testing.assert_allclose(centres(shell, run.positions), exact, rtol=0, atol=1e-6 * fall)
    turn, _ = Rotation.align_vectors(arms_of(shell, run.positions[-1]), arms_of(shell, run.positions[0]))
    assert 55.0 < np.degrees(turn.magnitude()) < 80.0  # the torque falls as the sheet turns
    found, _ = momenta(shell, run.positions, run.times[1])
    torques = np.array([np.cross(arms_of(shell, x), load).sum(axis=0) for x in run.positions])
    step = run.times[1]
    # Kicks of the torque at every frame, as by Verlet's rule, are the integral to second order.
    kicked = np.cumsum(np.vstack([0.5 * torques[:1], torques[1:-1]]), axis=0) * step
    first_order = name in ("MWTS, implicit Euler", "springs")
    np.testing.assert_allclose(found, kicked, rtol=0, atol=(4e-2 if first_order else 1e-2) * np.abs(found).max())


@pytest.mark.by_default("plate-rigid")
@pytest.mark.parametrize(("energy", "name"), ONCE)
def test_a_bent_sheet_springs_back_without_turning(energy, name):
    shell = shell_of(energy)
    if name == "rigid":
        pytest.skip("it does not bend")
    run = run_of(model_of(energy, name), start=bent(shell))
    found, scale = momenta(shell, run.positions, run.times[1])
    assert scale > 1e-2
    assert np.abs(found).max() <= 1e-6 * scale
    moved = centres(shell, run.positions)
    np.testing.assert_allclose(moved, moved[:1].repeat(len(moved), axis=0), rtol=0, atol=1e-9)


def spun(model, spin, velocity=(0.0, 0.0, 0.0)):
    """State of a model at rest, set in motion as a rigid body about the world's axes."""
    state, shell = model.start_motion(), model.shell
    if isinstance(model, ms.DiscreteShell):
        rates = np.cross(spin, arms_of(shell, shell.rest_positions)) + velocity
    elif isinstance(model, ms.RigidShell):
        rates = np.concatenate([velocity, spin])
    elif isinstance(model, ms.ModalDerivatives):
        speed = np.cross(spin, arms_of(shell, shell.rest_positions)) + velocity
        rigid = model.basis.modes.modes[:, :6].T @ (np.repeat(shell.mass, 3) * speed.ravel())
        rates = model.flight.whole(np.zeros(model.basis.size))
        rates[:6] = rigid
    else:
        speed = np.cross(spin, arms_of(shell, shell.rest_positions)) + velocity
        rates = model.basis.modes.T @ (np.repeat(shell.mass, 3) * speed.ravel())
    return MotionState(state.coordinates, np.asarray(rates, dtype=float), state.memory)


def stepped(model, state, dt, steps):
    """Frames of a motion without loads."""
    frames, none = [model.positions(state)], np.zeros_like(model.shell.rest_positions)
    for _ in range(steps):
        state, solved = model.step(state, dt, none, ms.Damping())
        assert solved
        frames.append(model.positions(state))
    return np.array(frames), state


@pytest.mark.by_default("hinges-rigid")
@pytest.mark.parametrize("name", ["LMA", "MWTS", "consistent MWTS", "RSW", "MD-ROM", "rigid", "DS", "DS, BDF2"])
@pytest.mark.parametrize("energy", MATERIALS)
def test_a_tumbling_sheet_keeps_its_angular_momentum(energy, name):
    shell, model = shell_of(energy), model_of(energy, name)
    frames, _ = stepped(model, spun(model, (1.0, 0.4, 3.0), (0.3, 0.0, 0.1)), 1.0 / 60.0, 60)
    found, scale = momenta(shell, frames, 1.0 / 60.0)
    # The first step of the full rules begins at the momentum of its rates, too.
    np.testing.assert_allclose(found, found[:1].repeat(len(found), axis=0), rtol=0, atol=1e-6 * scale)
    moved = centres(shell, frames) - centres(shell, frames[:1])
    np.testing.assert_allclose(moved, np.arange(61)[:, None] / 60.0 * [0.3, 0.0, 0.1], rtol=0, atol=1e-9)


@pytest.mark.by_default("rigid")
@pytest.mark.parametrize("name", ["MWTS", "RSW", "MD-ROM", "MD-ROM, SDIRK2", "rigid", "DS", "DS, BDF2"])
def test_tumbling_is_of_second_order(name):
    model = model_of("hinges", name)
    ends = [stepped(model, spun(model, (1.0, 0.4, 3.0)), 0.5 / n, n)[0][-1] for n in (10, 20, 40, 80)]
    errors = [np.linalg.norm(a - b) for a, b in pairwise(ends)]
    np.testing.assert_allclose(np.log2([a / b for a, b in pairwise(errors)]), 2.0, rtol=0, atol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LMA", "MWTS", "RSW", "MD-ROM"])
def test_a_turning_sheet_under_a_couple_meets_ds(name):
    shell, load = shell_of("plate"), couple(shell_of("plate"))
    runs = [run_of(model_of("plate", rung), gravity=GRAVITY, force=load, dt=1.0 / 120.0) for rung in (name, "DS")]
    np.testing.assert_allclose(runs[0].positions[-1], runs[1].positions[-1], rtol=0, atol=2e-3)
    assert shell.mesh.size > 0.9


def coarse_of_loose(shell):
    """Coarse DS on hinges whose stiffness is calibrated."""
    return ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, two_sheets(cells=(4, 2)).mesh))


def hybrid_of_loose(shell, clamped=()):
    """A hybrid on two coarse sheets."""
    coarse = two_sheets(cells=(4, 2), clamped=clamped)
    return hybrid_of(shell, np.ones_like(shell.rest_positions) * shell.mass[:, None], coarse)


LOOSE = {"coarse DS, hinges": coarse_of_loose, "hybrid, two sheets": hybrid_of_loose}


@pytest.mark.by_default("consistent MWTS")
@pytest.mark.parametrize(
    "name",
    [
        *["MWTS", "consistent MWTS", "RSW", "MD-ROM", "DS", "DS, BDF2", "springs", "coarse DS, hinges"],
        pytest.param("hybrid, two sheets", marks=[pytest.mark.slow, *QUIET]),
    ],
)
@pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")
def test_loose_parts_fly_by_themselves(name):
    shell = two_sheets()
    model = (MAKERS | LOOSE)[name](shell)
    force = np.zeros_like(shell.rest_positions)
    half = len(force) // 2
    force[:half] = couple(sheet(cells=(6, 3)))
    start = shell.rest_positions.copy()
    start[half:] = bent(shell)[half:]
    run = run_of(model, gravity=GRAVITY, force=force, start=start)
    for part in (slice(0, half), slice(half, None)):
        exact = centres(shell, run.positions[:1], part) + 0.5 * GRAVITY * run.times[:, None] ** 2
        np.testing.assert_allclose(centres(shell, run.positions, part), exact, rtol=0, atol=1e-6)
    found, scale = momenta(shell, run.positions, run.times[1], slice(half, None))
    assert np.abs(found).max() <= 1e-6 * scale
    found, scale = momenta(shell, run.positions, run.times[1], slice(0, half))
    assert np.abs(found).max() > 0.3 * scale


@pytest.mark.by_default("LMA")
@pytest.mark.parametrize(
    "name",
    [
        *["LMA", "MWTS", "RSW", "MD-ROM", "DS", "DS, BDF2", "springs"],
        pytest.param("hybrid, one clamped", marks=[pytest.mark.slow, *QUIET]),
    ],
)
@pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")
def test_a_loose_part_flies_beside_a_clamped_one(name):
    shell = two_sheets(clamped=[0, 7, 14, 21])
    loose = shell.mesh.components == 1
    run = run_of(
        (MAKERS | {"hybrid, one clamped": lambda one: hybrid_of_loose(one, [0, 5, 10])})[name](shell),
        gravity=GRAVITY,
        start=np.where(loose[:, None], bent(shell), shell.rest_positions),
    )
    exact = centres(shell, run.positions[:1], loose) + 0.5 * GRAVITY * run.times[:, None] ** 2
    np.testing.assert_allclose(centres(shell, run.positions, loose), exact, rtol=0, atol=1e-6)
    found, scale = momenta(shell, run.positions, run.times[1], loose)
    assert scale > 1e-2
    assert np.abs(found).max() <= 1e-6 * scale
    held = run.positions[:, [0, 7, 14, 21]]
    np.testing.assert_array_equal(held, np.broadcast_to(shell.rest_positions[[0, 7, 14, 21]], held.shape))


@pytest.mark.by_default("plate-coarse DS")
@pytest.mark.parametrize(("energy", "name"), ONCE)
def test_moving_and_turning_the_scene_changes_nothing(energy, name):
    shell = shell_of(energy)
    turn = Rotation.from_rotvec((0.3, -0.8, 1.4)).as_matrix()
    moved = ms.Shell(
        ms.TriangleMesh(shell.rest_positions @ turn.T + (3.0, -2.0, 5.0), shell.mesh.faces), shell.material
    )
    if name in ("coarse DS", "hybrid"):
        pytest.skip("their coarse meshes turn with the scene in test_turned_scenes")
    load = couple(shell)
    run = run_of(model_of(energy, name), gravity=GRAVITY, force=load, time=0.3)
    other = run_of(MAKERS[name](moved), gravity=turn @ GRAVITY, force=load @ turn.T, time=0.3)
    np.testing.assert_allclose(other.positions, run.positions @ turn.T + (3.0, -2.0, 5.0), rtol=0, atol=1e-9)


@pytest.mark.by_default("plate-coarse DS")
@pytest.mark.parametrize(("energy", "name"), ONCE)
def test_a_turned_start_moves_as_the_turned_motion(energy, name):
    shell, model = shell_of(energy), model_of(energy, name)
    turn = Rotation.from_rotvec((2.0, -0.8, 1.4)).as_matrix()
    if name in ("coarse DS", "hybrid"):
        pytest.skip("coarse DS samples displacements of the start")
    first = bent(shell)
    run = run_of(model, start=first, gravity=GRAVITY, time=0.3)
    other = run_of(model, start=first @ turn.T + (1.0, 2.0, 3.0), gravity=turn @ GRAVITY, time=0.3)
    np.testing.assert_allclose(other.positions, run.positions @ turn.T + (1.0, 2.0, 3.0), rtol=0, atol=1e-9)


@pytest.mark.by_default("MWTS, implicit Euler", "MD-ROM", "coarse DS")
@pytest.mark.parametrize(
    "name",
    [
        *["MWTS", "MWTS, implicit Euler", "RSW", "MD-ROM", "rigid", "DS", "DS, BDF2", "coarse DS"],
        pytest.param("hybrid", marks=[pytest.mark.slow, *QUIET]),
    ],
)
def test_a_resumed_motion_has_the_same_bits(name):
    shell, model = shell_of("hinges"), model_of("hinges", name)
    loading = shell.loading(GRAVITY, couple(shell), None)
    one, two = (Motion(model, loading, dt=1.0 / 30.0, start=bent(shell)) for _ in range(2))
    for _ in range(5):
        one.advance()
    two.restore(one.snapshot())
    for _ in range(5):
        one.advance()
        two.advance()
    np.testing.assert_array_equal(one.positions(), two.positions())
    np.testing.assert_array_equal(one.state.rates, two.state.rates)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["LMA", "MWTS", "RSW", "MD-ROM", "rigid"])
def test_energies_of_a_falling_turning_sheet_add_up(name):
    shell, model = shell_of("plate"), model_of("plate", name)
    motion = Motion(model, shell.loading(GRAVITY, couple(shell), None), dt=1.0 / 480.0)
    sums = []
    for _ in range(240):
        motion.advance()
        sums.append(motion.energies().sum())
    assert np.abs(sums).max() <= 1e-3 * motion.energies()[0]


@pytest.mark.by_default("LMA", "consistent MWTS")
@pytest.mark.parametrize("name", ["LMA", "MWTS", "consistent MWTS", "RSW", "MD-ROM"])
def test_velocities_are_those_of_the_positions(name):
    shell, model = shell_of("plate"), model_of("plate", name)
    # MD-ROM has a membrane that rings, too, unless it starts as a load without resultants bends it.
    start = bent_by_a_mode(model) if name == "MD-ROM" else bent(shell)
    motion = Motion(model, shell.loading(GRAVITY, couple(shell), None), dt=1.0 / 2000.0, start=start)
    frames, speeds = [], []
    for _ in range(100):
        motion.advance()
        frames.append(motion.positions())
        speeds.append(motion.model.velocities(motion.state, motion.model.positions(motion.state), 1e-6))
    middle = (frames[-1] - frames[-3]) * 1000.0
    np.testing.assert_allclose(speeds[-2], middle, rtol=0, atol=1e-2 * np.abs(middle).max())


def bent_by_a_mode(model, turn=0.5):
    """Positions of MD-ROM at rest under the load of its first elastic mode, which turns a vertex by about ``turn``."""
    modes, first = model.basis.modes, model.basis.modes.rigid_modes
    size = turn / np.linalg.norm(modes.rotations[:, first].reshape(-1, 3), axis=1).max()
    load = model.shell.mass[:, None] * modes.modes[:, first].reshape(-1, 3)
    answer = model.equilibrium(force=size * modes.eigenvalues[first] * load)
    assert answer.converged
    return answer.positions


@pytest.mark.parametrize("energy", MATERIALS)
def test_derivatives_of_free_modes_bend_along_the_static_path(energy):
    """Forces at ``phi q + psi q^2 / 2`` are ``K phi q``, and what balances its torque, to third order in q."""
    model = model_of(energy, "MD-ROM")
    shell, modes = model.shell, model.basis.modes
    mass, rigid = np.repeat(shell.mass, 3), modes.modes[:, :6]
    phi, psi = modes.modes[:, 6], model.basis.derivatives[:, 0]
    assert np.abs(rigid.T @ (mass * psi)).max() <= 1e-9 * np.sqrt(psi @ (mass * psi))
    left = []
    for q in np.array([0.4, 0.2, 0.1, 0.05]) / np.linalg.norm(modes.rotations[:, 6].reshape(-1, 3), axis=1).max():
        force = shell.energy_gradient(shell.rest_positions + (q * phi + 0.5 * q**2 * psi).reshape(-1, 3))[1].ravel()
        force = force - q * modes.eigenvalues[6] * mass * phi
        left.append(np.linalg.norm(force - mass * (rigid @ (rigid.T @ force))))
    slopes = np.log2([a / b for a, b in pairwise(left)])
    assert slopes[-1] > 2.8


def test_a_free_md_rom_has_no_rest_under_gravity():
    answer = model_of("plate", "MD-ROM").equilibrium(gravity=GRAVITY)
    assert answer.outcome is ms.Outcome.NO_EQUILIBRIUM


@pytest.mark.slow
def test_md_rom_trains_and_flies_by_few_elements():
    shell = shell_of("plate")
    model, load = ms.ModalDerivatives(shell, 9, cubature=True), couple(shell)
    assert model.cubature.held_out_error < 0.02
    run, whole = (run_of(one, gravity=GRAVITY, force=load) for one in (model, ms.ModalDerivatives(shell, 9)))
    np.testing.assert_allclose(run.positions, whole.positions, rtol=0, atol=1e-3)


@pytest.mark.by_default("MD-ROM-1.0")
@pytest.mark.parametrize(("rung", "radius"), [("RSW", np.inf), ("MD-ROM", 1.0)])
def test_modes_fly_in_a_wind_as_ds(rung, radius):
    """The wind drives a flat sheet along, and turns a curved one: errors fall with the step's square."""
    mesh = mesh_of()
    x, y, _ = mesh.vertices.T
    if np.isfinite(radius):
        arc = [radius * np.sin(x / radius), y, radius - radius * np.cos(x / radius)]
        mesh = ms.TriangleMesh(np.column_stack(arc), mesh.faces)
    shell, wind = ms.Shell(mesh, HINGES), ms.Wind((2.0, 1.0, 3.0))
    model = MAKERS[rung](shell)
    errors = []
    for dt in (1.0 / 60.0, 1.0 / 120.0):
        run, truth = (run_of(one, gravity=GRAVITY, loads=[wind], dt=dt) for one in (model, ms.DiscreteShell(shell)))
        moved = np.abs(truth.positions[-1] - shell.rest_positions - 0.5 * GRAVITY * TIME**2).max()
        errors.append(np.abs(run.positions[-1] - truth.positions[-1]).max() / moved)
        assert moved > 0.05
    assert errors[1] <= 5e-4
    assert errors[0] >= 2.8 * errors[1]


def test_fast_spin_is_told():
    model = model_of("plate", "MWTS")
    slowest = np.sqrt(model.basis.eigenvalues[6])
    slow, fast = (spun(model, (0.0, 0.0, share * slowest)) for share in (0.1, 1.0))
    assert model.remark(slow) == ""
    assert "take DS" in model.remark(fast)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")
@pytest.mark.parametrize("clamped", [False, True], ids=["both free", "one clamped"])
def test_a_reduced_warp_flies_and_bends_as_rsw(clamped):
    mesh = two_sheets().mesh
    held = clamped & (mesh.components == 0) & (mesh.vertices[:, 0] < 0.2)
    shell = two_sheets(clamped=held)
    x, y, _ = (shell.rest_positions - 0.5).T
    load = np.column_stack([0.0 * x, 0.1 * x, x**2 + y**3]) * 20.0 * shell.mass[:, None]
    full, reduced = ms.RotationStrain(modes_of(shell)), reduced_about(shell, load)
    exact, found = (run_of(model, gravity=GRAVITY, force=load).positions for model in (full, reduced))
    part = slice(len(mesh_of((6, 3)).vertices), None)
    np.testing.assert_allclose(centres(shell, found, part), centres(shell, exact, part), rtol=0, atol=1e-9)
    rest = arms_of(shell, shell.rest_positions, part)
    turns = [Rotation.align_vectors(arms_of(shell, x, part), rest)[0] for x in exact]
    bends = [np.abs(arms_of(shell, x, part) - turn.apply(rest)).max() for x, turn in zip(exact, turns, strict=True)]
    swung = clamped * np.abs(exact - shell.rest_positions)[:, : part.start].max()
    assert max(bends) > 0.02
    assert np.abs(found - exact).max() < 0.05 * max(*bends, swung)
