"""Tables of factors that bend or jump within steps, which rules of order two feel as straight lines there."""

from itertools import pairwise

import numpy as np
import pytest

import modalshell as ms
from modalshell.loads.averaged import averaged

STEP = 1 / 60


@pytest.fixture(scope="module")
def mesh():
    return ms.flat_beam(length=1.0, width=0.2, cells=(10, 2))


def shell(mesh, clamped):
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    return ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6 if clamped else None)


def pushed(times, factors, sel="x > 0.999", force=0.02):
    return [ms.Scaled(ms.PointForce(sel=sel, force=(0.0, 0.0, force)), (times, factors))]


def table(times, factors):
    return lambda time: float(np.interp(time, times, factors))


def moved_by(times, factors, end):
    """Speed and way at an ``end`` of a mass of one under a table, by Simpson's rule, which is exact for squares."""
    marks = sorted({0.0, end, *(float(time) for time in times if 0.0 < time < end)})
    speed = way = 0.0
    for a, b in pairwise(marks):
        for at, weight in ((a, 1.0), (0.5 * (a + b), 4.0), (b, 1.0)):
            pushed = (b - a) / 6.0 * weight * np.interp(at, times, factors)
            speed, way = speed + pushed, way + pushed * (end - at)
    return speed, way


@pytest.mark.parametrize("at_ends", [0, 5])
@pytest.mark.parametrize("seed", range(4))
def test_straight_lines_take_a_mass_where_the_table_takes_it(seed, at_ends):
    """Speeds were off by a sixth of the table's slope, so that a mass that moved on was ever farther off."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.05, 3.5, 12))
    for knot in rng.permutation(11)[:at_ends]:
        end = np.round(times[knot])
        if (times[knot - 1] if knot else 0.0) < end < times[knot + 1]:
            times[knot] = end
    factors = rng.standard_normal(12)
    at_time = averaged(table(times, factors), times, 1.0)
    values = np.array([at_time(time) for time in np.arange(np.ceil(times[-1]) + 5.0)])
    for step in range(len(values) - 1):
        assert at_time(step + 0.3) == pytest.approx(0.7 * values[step] + 0.3 * values[step + 1], rel=1e-12, abs=1e-12)
    speeds = np.concatenate([[0.0], np.cumsum(0.5 * (values[:-1] + values[1:]))])
    ways = np.concatenate([[0.0], np.cumsum(speeds[:-1] + values[:-1] / 3.0 + values[1:] / 6.0)])
    bent = {int(step) for time in times for step in (np.floor(time), np.ceil(time)) if time != np.round(time)}
    straight = [end for end in range(1, len(values)) if end not in bent]
    found = np.column_stack([speeds, ways])[straight]
    assert found == pytest.approx(np.array([moved_by(times, factors, end) for end in straight]), rel=1e-12, abs=1e-12)


def test_a_jump_at_an_end_is_shared_by_both_steps_and_one_at_the_start_by_none():
    jump = [1.0, 1.0 + 1e-9]
    assert averaged(table(jump, [1.0, 0.0]), jump, 0.5)(1.0) == pytest.approx(0.5, abs=1e-8)
    start = [0.0, 1e-9]
    assert averaged(table(start, [1.0, 0.0]), start, 0.5)(0.0) == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("size", [7, 33, 480])
def test_a_rise_from_the_start_is_one_line_however_many_knots_its_table_has(size):
    times = np.linspace(0.0, 8.3, size)
    at_end = averaged(table(times, 2.0 * times + 1.0), times, 1.0)
    assert [at_end(float(end)) for end in range(7)] == pytest.approx([1.0, 3.0, 5.0, 7.0, 9.0, 11.0, 13.0], rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("jump", [0.0, 1e-9, 0.4])
def test_rises_of_many_knots_keep_their_impulse_when_they_end(seed, jump):
    rng = np.random.default_rng(seed)
    times = np.concatenate([np.linspace(0.0, rng.uniform(0.3, 6.0), 60), np.linspace(7.0, 9.0, 4)])
    factors = np.concatenate([np.cumsum(rng.uniform(0.1, 1.0, 60)), [1.0, -2.0, 0.5, 0.0]])
    if jump:
        times = np.insert(times, 60, times[59] + jump)
        factors = np.insert(factors, 60, 0.0)
    at_end = averaged(table(times, factors), times, 1.0)
    values = np.array([at_end(end) for end in np.arange(12.0)])
    assert values.sum() - 0.5 * values[0] == pytest.approx(np.trapezoid(factors, times), rel=1e-9)


def test_a_smoothly_sampled_load_starts_as_its_line_does(mesh):
    """Linear modes were 61, 17 and 8 % off in the first three frames, as their first step felt a third of the rise."""
    model, times = ms.LinearModal(ms.solve_modes(shell(mesh, clamped=True), count=2)), np.linspace(0.0, 2.0, 481)
    line, fine = (ms.simulate(model, duration=0.1, dt=STEP, loads=pushed(at, at)) for at in ([0.0, 2.0], times))
    moved = line.positions - mesh.vertices
    assert np.abs(fine.positions - line.positions)[1].max() < 1e-8 * np.abs(moved[1]).max()
    assert np.abs(fine.positions - line.positions).max() < 1e-8 * np.abs(moved).max()


@pytest.mark.slow
def test_a_rise_that_begins_with_a_step_and_ends_within_one_leaves_the_error_that_is_stated(mesh):
    """Its impulse was off by a sixth of its rise in a step, and the motion by five times as much as now."""
    model = ms.LinearModal(ms.solve_modes(shell(mesh, clamped=True), count=6))

    def run(parts):
        loads = pushed([0.1, 0.12], [0.0, 1.0])
        return ms.simulate(model, duration=0.4, dt=STEP / parts, loads=loads, store_every=parts)

    found, true = run(1), run(128)
    assert np.abs(found.positions - true.positions).max() <= found.step_error


@pytest.mark.by_default("factors0-0.02", "factors1-0.03", "factors2-0.02")
@pytest.mark.parametrize("end", [0.02, 0.03])
@pytest.mark.parametrize("factors", [[0, 1, 1, 1], [0, 1, 0, 0], [0, 1, 0.5, 0]])
def test_a_rise_that_ends_within_a_step_leaves_the_error_that_is_stated(mesh, end, factors):
    """Its impulse was short by a sixth of a step's rise, and up to eight times the stated error off."""
    model = ms.LinearModal(ms.solve_modes(shell(mesh, clamped=True), count=2))
    times = [0.0, end, end + (1e-4 if factors[2] == 0 else 0.5 * end), 2.0 * end]

    def run(parts):
        return ms.simulate(model, duration=0.3, dt=STEP / parts, loads=pushed(times, factors), store_every=parts)

    found, true = run(1), run(32)
    error = np.abs(found.positions - true.positions).max()
    assert error <= found.step_error
    assert error < 0.05 * np.abs(true.positions - mesh.vertices).max()


def test_tables_that_bend_at_ends_alone_keep_their_bits(mesh):
    times, factors = np.arange(6) * STEP, [0.0, 1.0, 0.3, 0.3, -2.0, 0.0]
    at_end, plain = averaged(table(times, factors), times, STEP), table(times, factors)
    for count in range(8):
        assert at_end(count * STEP) == plain(count * STEP)
    load = ms.Scaled(ms.PointForce(sel="x > 0.5", force=(0.0, 0.0, 1.0)), lambda time: time)
    load = load.applied(mesh, np.ones(len(mesh.vertices)))
    assert load.averaged(STEP) is load  # of a function nothing is known


def free_model(mesh, kind):
    body = shell(mesh, clamped=False)
    if kind == "rigid":
        return ms.RigidShell(body)
    if kind not in ("LMA", "MWTS"):
        return ms.DiscreteShell(body, integrator=kind)
    return (ms.LinearModal if kind == "LMA" else ms.ModalWarping)(ms.solve_modes(body, count=8))


@pytest.mark.parametrize("kind", ["rigid", "LMA", "MWTS"])
def test_a_free_shell_gets_the_impulse_of_a_push_that_ends_with_a_frame(mesh, kind):
    model = free_model(mesh, kind)
    force = 0.09 / len(mesh.vertices)
    run = ms.simulate(model, duration=0.2, dt=STEP, loads=pushed([0, 0.1, 0.1001], [1, 1, 0], "x > -1", force))
    momentum = model.shell.mass @ (run.positions[-1] - run.positions[-2]) / STEP
    assert momentum == pytest.approx([0.0, 0.0, 0.09 * 0.10005], rel=1e-9, abs=1e-12)


TABLES = {
    "bend": ([0.21, 0.4], [0.0, 5.0]),
    "jump": ([0.2099, 0.2101], [0.0, 1.0]),
    "jump at an end": ([0.2, 0.2 + 1e-9], [0.0, 1.0]),
    "many": ([0.203, 0.206, 0.2098, 0.22, 0.31], [0.0, 3.0, -2.0, 4.0, 1.0]),
    "in the first step": ([0.003, 0.011, 0.05], [0.0, 2.0, 1.0]),
}


def run_of_table(mesh, kind, name):
    """Run of a free shell by its weight times a table, and its error at the end [m]."""
    times, factors = TABLES[name]
    loads = [ms.Scaled(ms.SelfWeight((0.0, 0.0, 0.1)), (times, factors))]
    run = ms.simulate(free_model(mesh, kind), duration=0.55, dt=STEP, loads=loads)
    way = 0.1 * moved_by(times, factors, 0.55)[1]
    return run, np.abs(run.positions[-1, :, 2] - mesh.vertices[:, 2] - way).max()


@pytest.mark.by_default("bend-MWTS", "jump at an end-rigid", "many-rigid", "in the first step-LMA")
@pytest.mark.parametrize("kind", ["rigid", "LMA", "MWTS"])
@pytest.mark.parametrize("name", TABLES)
def test_a_free_shell_is_where_its_table_takes_it(mesh, kind, name):
    """It was off by a sixth of a step's square times the change of its acceleration, and did not say so."""
    assert run_of_table(mesh, kind, name)[1] < 1e-9


@pytest.mark.by_default("bend-bdf2", "jump at an end-bdf2")
@pytest.mark.parametrize("kind", ["bdf2", "composite"])
@pytest.mark.parametrize("name", ["bend", "jump", "jump at an end"])
def test_implicit_steps_of_a_free_shell_know_their_error_under_a_table(mesh, kind, name):
    """Of a push at rest they stated a hundredth: no more than twice the motion seen some steps before."""
    run, error = run_of_table(mesh, kind, name)
    assert 0.2 * run.step_error < error / mesh.moment_length < 2.1 * run.step_error


@pytest.mark.slow
@pytest.mark.parametrize("times", [[0.0, 0.1, 0.1001], [0.0, 0.1, 0.1 + 1e-9], [0.0, 0.09, 0.0905]])
def test_a_load_that_stops_within_a_step_or_at_its_end_keeps_second_order_and_the_error_says_so(mesh, times):
    model, loads = ms.ModalWarping(ms.solve_modes(shell(mesh, clamped=True), count=6)), pushed(times, [1, 1, 0])

    def run(parts):
        return ms.simulate(model, duration=0.5, dt=STEP / parts, loads=loads, damping=(0.1, 1e-3))

    true, errors = run(64), []
    for parts in (1, 2):
        found = run(parts)
        errors.append(np.abs(found.positions[::parts] - true.positions[::64]).max())
        assert errors[-1] <= found.step_error
    assert errors[0] < 0.01 * np.abs(true.positions - mesh.vertices).max()
    assert errors[1] < 0.45 * errors[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "times"),
    [("bdf2", [0.103, 0.1035, 0.108, 0.1081]), ("composite", [0.043, 0.0431, 0.0977, 0.0978])],
)
def test_implicit_steps_feel_a_push_within_them_and_know_their_error(mesh, integrator, times):
    """One of 5 ms within a step was not felt at all, with an error stated of nothing."""
    loads = pushed(times, [0, 4, 4, 0], force=0.01)

    def run(rule, parts):
        model = ms.DiscreteShell(shell(mesh, clamped=True), integrator=rule)
        return ms.simulate(model, duration=0.3, dt=STEP / parts, loads=loads, damping=(0.1, 1e-3), store_every=parts)

    found, true = run(integrator, 1), run("composite", 8)
    error = np.abs(found.positions - true.positions).max()
    assert error <= 1.4 * found.step_error  # an estimate, of what is smooth
    assert error < 0.12 * np.abs(true.positions - mesh.vertices).max()


@pytest.mark.by_default("implicit", "linear_implicit")
@pytest.mark.parametrize("integrator", ["bdf2", "composite", "implicit", "linear_implicit"])
def test_implicit_steps_of_a_free_shell_give_it_the_impulse_of_a_push(mesh, integrator):
    # After the first steps, in which rules of several steps keep an impulse to their order alone.
    body, times, factors = shell(mesh, clamped=False), [0.093, 0.0931, 0.1477, 0.1478], [0, 1, 1, 0]
    model = ms.DiscreteShell(body, integrator=integrator)
    force = 0.09 / len(mesh.vertices)
    run = ms.simulate(model, duration=0.3, dt=STEP, loads=pushed(times, factors, "x > -1", force))
    momentum = body.mass @ (run.positions[-1] - run.positions[-2]) / STEP
    assert momentum == pytest.approx([0.0, 0.0, 0.09 * np.trapezoid(factors, times)], rel=1e-4, abs=1e-12)


def test_plain_means_over_steps_have_the_impulse_of_the_table():
    times, factors = [0.0, 0.3, 1.7, 2.2], [0.0, 2.0, -1.0, 0.0]
    at_end = averaged(table(times, factors), times, 0.5, within=True)
    total = sum(at_end(time) for time in np.arange(1, 8) * 0.5) * 0.5
    assert total == pytest.approx(np.trapezoid(factors, times), rel=1e-12)


@pytest.mark.parametrize("lasts", [1e-4, 1e-8, 1e-11])
def test_plain_means_over_steps_take_jumps_at_their_ends_on_one_side(lasts):
    """A jump as short as what counts as the end of a step was half in the step after it, too."""
    times, factors = [0.0, lasts, 1.0, 1.0 + lasts, 2.0 - lasts, 2.0], [0.0, 1.0, 1.0, -3.0, -3.0, 0.0]
    at_end = averaged(table(times, factors), times, 0.1, within=True)
    total = sum(at_end(time) for time in np.arange(1, 31) * 0.1) * 0.1
    assert total == pytest.approx(np.trapezoid(factors, times), abs=1e-6)
