"""Contacts of coarse discrete shells and of the hybrid against DS, and supports that move with contacts."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.motion.stepping import Motion

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.15))
GIVEN = {"dt": 1 / 60, "gravity": GRAVITY, "damping": (3.0, 0.0)}
TURNED = ms.SupportPath([0.0, 0.5], [(0.0, 0.0, 0.0), (0.0, 0.2, 0.0)], [(0.0, 0.0, 0.0), (0.3, 0.0, 0.6)])
"""Supports that turn about an axis across the strip and a little about the strip itself."""


def shell_of(cells, **held):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    return ms.Shell(mesh, material, **(held or {"clamped": "x < 1e-6"}))


@pytest.fixture(scope="module")
def shells():
    return shell_of((20, 4)), shell_of((10, 2))


@pytest.fixture(scope="module")
def models(shells):
    fine, coarse = shells
    basis = ms.solve_modes(fine, 8)
    hybrid = ms.HybridStress.trained(fine, gravity=GRAVITY, coarse=coarse, modes=16, motions=8)
    return {
        "DS": ms.DiscreteShell(fine, integrator="bdf2"),
        "coarse DS": ms.CoarseDiscreteShell(fine, coarse),
        "hybrid": hybrid,
        "LMA": ms.LinearModal(basis),
        "MWTS": ms.ModalWarping(basis),
        "RSW": ms.RotationStrain(basis),
    }


@pytest.fixture(scope="module")
def run_of(models):
    kept = {}

    def made(name, **given):
        key = name, *given
        if key not in kept:
            kept[key] = ms.simulate(models[name], duration=0.8, contacts=[FLOOR], **GIVEN, **given)
        return kept[key]

    return made


def off(run, truth, shell, begin=20):
    """Largest error of frames from one on."""
    pairs = zip(run.positions[begin:], truth.positions[begin:], strict=True)
    return max(ms.measure.displacement_error(x, y, shell) for x, y in pairs)


@pytest.mark.slow
def test_a_contact_of_fine_vertices_next_to_held_coarse_ones_puts_these_out():
    """It was refused, as if its coarse vertices, which cannot move, had been given."""
    fine, coarse = shell_of((8, 2)), shell_of((4, 1))
    contacts = [ms.Contact(ms.Plane((0.0, 0.0, 1.0), -1e-4), sel="x < 0.2")]
    answer = ms.CoarseDiscreteShell(fine, coarse).equilibrium(gravity=(0.0, 0.0, -0.1), contacts=contacts)
    assert answer.converged
    assert answer.deepest < 1e-12
    assert answer.positions[fine.mesh.vertices[:, 0] < 0.2, 2].min() >= -1e-4 - 1e-12


@pytest.mark.slow
def test_steps_in_parts_state_the_whole_impulse_of_a_coarse_shell():
    """Half of it was stated: what touches sums up the parts of a step, and was summed up again."""
    model, given = ms.CoarseDiscreteShell(shell_of((8, 2)), shell_of((4, 1))), {"gravity": (0.0, 0.0, -3.0)}
    impulses = []
    for tolerance in (None, 1e-3):
        floor = ms.Contact(ms.Plane((0, 0, 1), -0.01))
        run = ms.simulate(model, duration=0.16, dt=1 / 125, contacts=[floor], tolerance=tolerance, **given)
        impulses.append(run.contact_forces[..., 2].sum() / 125)
    assert impulses[1] == pytest.approx(impulses[0], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["coarse DS", "hybrid"])
def test_a_coarse_shell_falls_on_a_table_as_the_fine_one(models, shells, run_of, name):
    run, truth = run_of(name), run_of("DS")
    assert run.unconverged_steps == 0
    assert off(run, truth, shells[0]) < 5e-3
    assert run.deepest[-1] < 1e-9  # a plane is prolonged as a plane, and near the border of what touches almost so
    assert run.deepest.max() < 1e-5
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-9 * np.ptp(run.energies[:, 2])
    assert run.contact_forces[-1].sum(axis=0) == pytest.approx(truth.contact_forces[-1].sum(axis=0), rel=0.02, abs=1e-4)
    assert (run.contact_forces[-1][~run.in_contact[-1]] == 0.0).all()
    rest = models[name].equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert rest.converged
    exact = models["DS"].equilibrium(gravity=GRAVITY, contacts=[FLOOR])  # the motion swings about it for long
    assert ms.measure.displacement_error(rest.positions, exact.positions, shells[0]) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "error", "begin"),
    [("coarse DS", 3e-3, 20), ("hybrid", 3e-3, 20), ("LMA", 0.06, 40), ("MWTS", 0.02, 40), ("RSW", 0.02, 40)],
)
def test_supports_move_a_shell_over_a_table(shells, run_of, name, error, begin):
    """At the same steps, of order two by DS where contacts stay: 0.011 off short ones, and RSW, of order one, 0.025."""
    run, truth = run_of(name, supports=TURNED), run_of("DS", supports=TURNED)
    assert run.unconverged_steps == 0
    assert off(run, truth, shells[0], begin) < error
    assert run.positions[..., 2].min() >= -0.15 - 1e-4
    assert run.in_contact[-1].any()
    force = run.contact_forces[-1].sum(axis=0)
    assert force[2] > 0.0
    np.testing.assert_allclose(force[:2], 0.0, atol=1e-12)  # in the world's axes, where the table's normal is


@pytest.mark.slow
def test_supports_that_hold_single_components_move_with_contacts():
    fine = shell_of((10, 2), supports=[ms.Fix("x < 1e-6", "xyz"), ms.Fix("x > 1 - 1e-6", "yz")])
    model, path = ms.DiscreteShell(fine), ms.SupportPath([0.0, 0.4], [(0.0, 0.0, 0.0), (0.0, 0.0, -0.12)])
    run = ms.simulate(model, duration=0.7, contacts=[ms.Contact(ms.Plane((0, 0, 1), -0.1))], supports=path, **GIVEN)
    assert run.unconverged_steps == 0
    free = fine.mesh.vertices[:, 0] > 1e-6
    assert run.positions[:, free & (fine.mesh.vertices[:, 0] < 1.0 - 1e-6), 2].min() >= -0.1 - 1e-9
    assert run.in_contact[-1].sum() >= 3
    # The same seen by somebody who moves with the supports.
    back = ms.SupportPath([0.0, 0.4], [(0.0, 0.0, 0.0), (0.0, 0.0, 0.12)])
    lifted = ms.Contact(ms.Plane((0, 0, 1), -0.1), motion=back)
    seen = ms.simulate(model, duration=0.7, contacts=[lifted], **GIVEN)
    moved = seen.positions[-1] - [0.0, 0.0, 0.12]
    assert ms.measure.displacement_error(run.positions[-1], moved, fine.mesh) < 0.01  # it does not feel the inertia


@pytest.mark.slow
def test_a_table_that_leaves_gives_the_hybrid_its_steps_back(models, shells):
    gone = ms.Contact(ms.Plane((0, 0, 1), -0.15), motion=ms.SupportPath([0.2, 0.6], [(0, 0, 0), (0, 0, -1.0)]))
    given = {"duration": 1.2, "contacts": [gone], **GIVEN}
    motion = ms.simulate(models["hybrid"], **given)
    truth = ms.simulate(models["DS"], **given)
    assert motion.unconverged_steps == 0
    assert motion.in_contact.any()
    assert not motion.in_contact[-1].any()
    assert ms.measure.displacement_error(motion.positions[-1], truth.positions[-1], shells[0]) < 0.03


@pytest.mark.slow
def test_a_roller_presses_a_coarse_strip_down_as_a_fine_one(models, shells):
    path = ms.SupportPath([0.0, 0.4], [(0, 0, 0), (0, 0, -0.2)])
    roller = ms.Contact(ms.Cylinder((0.7, -1.0, 0.11), (0.7, 1.0, 0.11), 0.1), motion=path)
    given = {"duration": 0.8, "dt": 1 / 60, "damping": (3.0, 0.0), "contacts": [roller]}
    run, truth = (ms.simulate(models[name], **given) for name in ("coarse DS", "DS"))
    assert run.unconverged_steps == 0
    assert off(run, truth, shells[0]) < 0.06
    assert run.contact_forces[-1].sum() == pytest.approx(truth.contact_forces[-1].sum(), rel=0.06)


@pytest.mark.slow
def test_fine_vertices_dip_into_a_ball_as_deep_as_coarse_edges_do(models):
    ball = ms.Contact(ms.Sphere((0.7, 0.0, -0.21), 0.2))
    run = ms.simulate(models["coarse DS"], duration=0.8, contacts=[ball], **GIVEN)
    assert run.unconverged_steps == 0
    assert 0.0 < run.deepest.max() < 0.1**2 / (4.0 * 0.2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["coarse DS", "hybrid"])
def test_a_resumed_motion_has_the_same_bits(models, shells, name):
    rough = ms.Contact(ms.Plane((0, 0, 1), -0.15), friction=0.3)

    def motion():
        loading = shells[0].loading(GRAVITY, None, None)
        return Motion(models[name], loading, dt=1 / 60, contacts=[rough], supports=TURNED)

    whole, first, second = motion(), motion(), motion()
    for _ in range(24):
        whole.advance()
    for _ in range(16):
        first.advance()
    second.restore(first.snapshot())
    for _ in range(8):
        second.advance()
    assert whole.touched().touches.any()
    assert whole.positions().tobytes() == second.positions().tobytes()


@pytest.mark.slow
def test_a_free_coarse_shell_falls_on_a_floor_with_its_momentum():
    fine, coarse = (shell_of(cells, clamped=None) for cells in ((16, 4), (8, 2)))
    model = ms.CoarseDiscreteShell(fine, coarse)
    start = fine.mesh.vertices + np.array([0.0, 0.0, 0.05])
    run = ms.simulate(model, duration=0.3, dt=1 / 120, gravity=GRAVITY, start=start, contacts=[ms.Contact(ms.Plane())])
    assert run.unconverged_steps == 0
    assert run.deepest.max() < 1e-9
    assert np.diff(run.energies.sum(axis=1)).max() <= 1e-9 * np.ptp(run.energies[:, 2])
    weight = fine.mass.sum() * 9.81
    assert run.contact_forces[-1].sum(axis=0) == pytest.approx([0.0, 0.0, weight], rel=1e-3, abs=1e-3 * weight)


def test_pressure_blows_a_coarse_strip_onto_a_table(models, shells):
    given = {"loads": [ms.Pressure(-6.0)], "contacts": [FLOOR]}
    state, truth = (models[name].equilibrium(**given) for name in ("coarse DS", "DS"))
    assert state.converged
    assert ms.measure.displacement_error(state.positions, truth.positions, shells[0]) < 5e-3


def test_the_hybrid_answers_itself_where_nothing_touches(models):
    model = models["hybrid"]
    state = model.equilibrium(gravity=(0, 0, -1.0), contacts=[FLOOR])
    assert np.array_equal(state.positions, model.equilibrium(gravity=(0, 0, -1.0)).positions)
    assert not state.in_contact.any()
    pressed = model.equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    assert "answered by coarse DS: contacts press on the shell" in pressed.message
    assert pressed.in_contact.any()
    run = ms.simulate(model, duration=0.4, contacts=[FLOOR], **GIVEN)
    assert run.in_contact[-1].any()
    assert "answered by coarse DS: contacts press on the shell" in run.message


def test_fast_colliders_and_starts_inside_are_refused(models):
    ball = ms.Contact(ms.Sphere((0.0, 0.0, -0.6), 0.02), motion=ms.SupportPath([0.0, 0.1], [(0, 0, 0), (0, 0, 0.5)]))
    inside = ms.Contact(ms.Plane((0, 0, 1), 0.1))
    for name in ("coarse DS", "hybrid", "RSW"):
        with pytest.raises(ms.OptionError, match="more than its smallest radius"):
            ms.simulate(models[name], duration=0.2, contacts=[ball], **GIVEN)
        with pytest.raises(ms.OptionError, match="inside contact 0"):
            ms.simulate(models[name], duration=0.2, contacts=[inside], **GIVEN)


@pytest.mark.by_default("MWTS")
@pytest.mark.parametrize("name", ["coarse DS", "MWTS", "MD-ROM"])
def test_models_in_the_frame_of_supports_say_that_these_lead_vertices_into_a_collider(name):
    """DS alone said it."""
    fine, coarse = shell_of((10, 2)), shell_of((6, 1))
    way = ms.SupportPath([0.0, 0.1], [(0.0, 0.0, 0.0), (0.0, 0.0, -0.01)])
    model = {
        "coarse DS": lambda: ms.CoarseDiscreteShell(fine, coarse),
        "MWTS": lambda: ms.ModalWarping(ms.solve_modes(fine, 4)),
        "MD-ROM": lambda: ms.ModalDerivatives(fine, count=3),
    }[name]()
    low, high = (ms.Contact(ms.Plane((0, 0, 1), -height)) for height in (0.005, 0.02))
    told, fine_there = (
        ms.simulate(model, duration=0.1, dt=1 / 60, contacts=[one], supports=way).message for one in (low, high)
    )
    assert "supports lead vertices into contact 0, which does not push on these" in told
    assert "lead vertices" not in fine_there


@pytest.mark.slow
def test_a_motion_says_how_deep_vertices_between_coarse_ones_are():
    fine = ms.flat_beam(length=0.4, width=0.12, cells=(12, 4))
    shell = ms.Shell(fine, ms.Isotropic(young=2e6, poisson=0.3, thickness=2e-3, density=300.0), "x < 0.001")
    coarse = ms.coarse_shell(shell, ms.flat_beam(length=0.4, width=0.12, cells=(6, 2)))
    ball = [ms.Contact(ms.Sphere((0.33, 0.02, -0.15), 0.1))]
    options = {"duration": 0.25, "dt": 1 / 120, "gravity": (0.0, 0.0, -3.0), "contacts": ball}
    run = ms.simulate(ms.CoarseDiscreteShell(shell, coarse), **options)
    assert run.deepest.max() > 1e-3
    assert f"vertices are up to {run.deepest.max():.2g} m inside a collider" in run.message
    assert "inside" not in ms.simulate(ms.DiscreteShell(shell), **options).message


def test_a_body_that_passes_between_coarse_vertices_is_said_to_have():
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=1000.0)
    fine, coarse = (
        ms.Shell(ms.flat_beam(length=1.0, width=0.1, cells=cells), sheet, "x < 1e-6") for cells in ((48, 4), (12, 2))
    )
    way = ms.SupportPath([0.0, 0.5], [(0, 0, 0), (0, 0, -0.08)])
    punch = ms.Contact(ms.Cylinder((0.8, -1.0, 0.03), (0.8, 1.0, 0.03), 0.03), motion=way)
    run = ms.simulate(ms.CoarseDiscreteShell(fine, coarse), duration=0.5, dt=1 / 60, contacts=[punch])
    assert "inside a collider" in run.message
    assert "may have passed through it" in run.message
