"""The model that switches itself without supports: near DS in shape and place, momenta kept through its switches."""

import numpy as np
import pytest
from scenes import stopped_and_resumed
from scipy.spatial.transform import Rotation
from test_free_shells import GRAVITY, MATERIALS, bent, centres, shell_of

import modalshell as ms
from modalshell.integrators.free_parts import FreeParts
from modalshell.models.auto.checks import FlownCheck
from modalshell.motion.stepping import Motion

DT, ERROR = 1.0 / 120.0, 0.05
WIND = [ms.Wind((2.0, 1.0, 3.0))]
PUSH = [
    ms.Scaled(ms.LineForce("x < 1e-6", (0.0, 0.0, 2.0)), ([0.0, 0.02, 0.08, 0.1], [0.0, 1.0, 1.0, 0.0])),
    ms.Scaled(ms.LineForce("x > 0.999", (0.0, 0.4, -1.0)), ([0.0, 0.02, 0.08, 0.1], [0.0, 1.0, 1.0, 0.0])),
]
LET_GO = {"damping": (0.0, 0.02), "gravity": GRAVITY}


def panel(energy):
    return ms.Shell(ms.cylinder_panel(length=0.6, radius=0.5, angle=60.0, cells=(6, 6)), MATERIALS[energy])


def scenes(energy):
    """Shells with what moves them: a panel falls in a wind, a bent sheet is let go, a sheet is pushed and spins."""
    sheet = shell_of(energy)
    return {
        "wind": (panel(energy), {"gravity": GRAVITY, "loads": WIND, "damping": (0.0, 0.001)}),
        "let go": (sheet, {"start": bent(sheet, 0.3), **LET_GO}),
        "push": (sheet, {"loads": PUSH, **LET_GO}),
    }


def frames_of(shell, model, load, dt, steps, start=None):
    """Levels, positions and momenta of a motion."""
    motion, parts, seen = (
        Motion(model, load, dt=dt, damping=ms.Damping(0.0, 0.02), start=start),
        FreeParts.of(shell),
        [],
    )
    for _ in range(steps):
        state = motion.state
        seen.append(
            (int(state.memory["level"][0]), state.coordinates, parts.momenta(state.coordinates, state.rates)[0])
        )
        motion.advance()
    levels, x, p = zip(*seen, strict=True)
    return np.array(levels), np.array(x), np.array(p)


@pytest.mark.slow
@pytest.mark.parametrize(("energy", "scene"), [("hinges", "wind"), ("plate", "let go"), ("hinges", "push")])
def test_it_holds_the_error_in_shape_and_in_the_world(energy, scene):
    shell, options = scenes(energy)[scene]
    runs = [ms.simulate(model, duration=0.5, dt=DT, **options) for model in (ms.Auto(shell), ms.DiscreteShell(shell))]
    check = FlownCheck(shell, FreeParts.of(shell), shell.loading(), ms.Damping())
    pairs = list(zip(*(run.positions for run in runs), strict=True))
    largest = max(check.moved(y) for _, y in pairs)
    assert largest > 1e-4 * shell.size * np.sqrt(shell.mass.sum())
    assert max(check.apart(x, y) for x, y in pairs) <= ERROR * largest
    off, moved = (np.sqrt(np.sum(shell.mass[:, None] * part**2, axis=(1, 2))) for part in
                  (runs[0].positions - runs[1].positions, runs[1].positions - shell.rest_positions))  # fmt: skip
    assert off.max() <= ERROR * moved.max()


@pytest.mark.slow
def test_centre_and_momenta_go_through_switches():
    """From DS to MWTS as a bent sheet comes to rest, and from MWTS to DS as one is pushed."""
    shell = shell_of("hinges")
    scale = shell.mass.sum() * shell.size**2
    levels, x, p = frames_of(shell, ms.Auto(shell), shell.loading(GRAVITY), DT, 120, bent(shell, 0.12))
    assert set(np.diff(levels)) == {-1, 0}
    time = DT * np.arange(len(x))[:, None]
    fall = 0.5 * GRAVITY * time**2
    np.testing.assert_allclose(centres(shell, x) - centres(shell, x[:1]), fall, atol=1e-6 * np.abs(fall).max())
    pull = shell.mass.sum() * GRAVITY * time
    np.testing.assert_allclose(p[:, 0], pull, rtol=0, atol=1e-6 * np.abs(pull).max())
    assert np.abs(p[:, 1]).max() <= 1e-6 * scale
    loads = [ms.Scaled(ms.LineForce("x < 1e-6", (0.0, 0.0, 0.5)), ([0.0, 0.1, 0.2], [0.0, 1.0, 0.0]))]
    levels, x, p = frames_of(shell, ms.Auto(shell, 14), shell.loading(None, None, loads), DT, 60)
    assert 1 in np.diff(levels)
    after = p[28:]  # the push is over, and what the rule keeps of it for a few steps
    assert np.abs(after[:, 1]).max() > 1e-3 * scale
    np.testing.assert_allclose(after[:, 1], after[:1, 1].repeat(len(after), axis=0), atol=1e-6 * np.abs(after).max())


@pytest.mark.slow
def test_where_steps_are_too_long_it_adds_no_more_than_its_error_to_that_of_ds():
    """A stiff panel in a wind: DS itself is off by more than a twentieth of its bend."""
    shell, strength, steps = panel("hinges"), 6.0, 60
    options = {"gravity": GRAVITY, "loads": [ms.Wind(tuple(strength * np.array([2.0, 1.0, 3.0])))]}
    options |= {"damping": (0.0, 0.001), "duration": 0.5}
    check = FlownCheck(shell, FreeParts.of(shell), shell.loading(), ms.Damping())
    truth = ms.simulate(ms.DiscreteShell(shell), dt=1.0 / 480.0, store_every=8, **options).positions
    bend = max(check.moved(x) for x in truth)

    def off(model, dt, every):
        run = ms.simulate(model, dt=dt, store_every=every, **options)
        told = truth[:: round(60.0 * dt * every)]
        return max(check.apart(x, y) for x, y in zip(run.positions, told, strict=True)) / bend

    exact = off(ms.DiscreteShell(shell), 1.0 / steps, 1)
    assert exact > 0.05
    assert off(ms.Auto(shell), 1.0 / steps, 1) < exact + ERROR
    assert off(ms.Auto(shell), 1.0 / 120.0, 2) < ERROR


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")
def test_several_free_parts_fly_each_by_itself():
    """Two panels in a wind that meets them at other angles: near DS in shape, each with its own momenta."""
    one = ms.cylinder_panel(length=0.6, radius=0.5, angle=60.0, cells=(4, 4))
    turn = Rotation.from_rotvec([0.9, 0.4, -0.3]).as_matrix()
    places = np.concatenate([one.vertices, one.vertices @ turn.T + [3.0, 0.0, 0.0]])
    mesh = ms.TriangleMesh(places, np.concatenate([one.faces, one.faces + len(one.vertices)]))
    shell = ms.Shell(mesh, MATERIALS["hinges"], loose_parts=True)
    parts = FreeParts.of(shell)
    assert len(parts.parts) == 2
    options = {"gravity": GRAVITY, "loads": WIND, "damping": (0.0, 0.001), "duration": 0.25, "dt": DT}
    runs = [ms.simulate(model, **options) for model in (ms.Auto(shell, 12), ms.DiscreteShell(shell))]
    assert "MWTS" in runs[0].message
    check = FlownCheck(shell, parts, shell.loading(), ms.Damping())
    largest = max(check.moved(x) for x in runs[1].positions)
    assert max(check.apart(x, y) for x, y in zip(*(run.positions for run in runs), strict=True)) <= ERROR * largest
    moved = [part.mean(runs[1].positions[-1][part.vertices] - mesh.vertices[part.vertices]) for part in parts.parts]
    assert np.linalg.norm(moved[0] - moved[1]) > 0.05 * np.linalg.norm(moved[0])
    for part in parts.parts:
        ends = [part.mean(run.positions[-1][part.vertices]) for run in runs]
        np.testing.assert_allclose(*ends, rtol=0, atol=1e-3 * np.linalg.norm(moved))


@pytest.mark.slow
def test_a_fall_stays_on_the_cheapest_level():
    run = ms.simulate(ms.Auto(panel("plate")), duration=0.5, dt=DT, gravity=GRAVITY)
    assert run.message == "steps by MWTS 100 %"


@pytest.mark.slow
def test_ds_itself_has_a_small_bar_in_flight():
    """The bar of another frame would not: loads are turned, balanced, and reactions are none."""
    shell = panel("plate")
    loading = shell.loading(GRAVITY, None, WIND)
    exact = ms.simulate(ms.DiscreteShell(shell), duration=0.3, dt=DT, gravity=GRAVITY, loads=WIND)
    cheap = ms.simulate(ms.ModalWarping(ms.solve_modes(shell, 8)), duration=0.3, dt=DT, gravity=GRAVITY, loads=WIND)
    check, found = FlownCheck(shell, FreeParts.of(shell), loading, ms.Damping()), []
    for run in (exact, cheap):
        frames = run.positions[19:22]
        bar = check.bar_under(run.times[19:22], frames, loading.dead)[0]
        found.append(check.off(bar, frames[1]) / check.moved(frames[1]))
        assert bar.margin > 0.5
    assert found[0] < 0.02
    assert found[1] > 0.05


def test_a_flight_that_was_stopped_resumes_to_the_same_bits(tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text("""
[mesh]
shape = "flat_beam"
length = 1.0
width = 0.5
cells = [8, 4]
[material]
stretch = 2e5
shear = 2e5
flexure = 0.07
density = 2.0
[loads]
gravity = [0.0, 0.0, -9.81]
[[loads.wind]]
velocity = [2.0, 1.0, 3.0]
[model]
name = "auto"
[motion]
duration = 0.4
dt = 0.01
""")
    whole, resumed = stopped_and_resumed(scene, tmp_path, 25)
    assert resumed.resumed > 20
    assert np.array_equal(resumed.trajectory.positions, whole.trajectory.positions)
    assert resumed.trajectory.message == whole.trajectory.message


def test_statics_of_a_free_shell_is_that_of_ds_and_parts_held_in_part_are_refused():
    shell = shell_of("plate")
    assert ms.Auto(shell).equilibrium(gravity=GRAVITY).outcome is ms.Outcome.NO_EQUILIBRIUM
    hinged = ms.Shell(shell.mesh, shell.material, supports=[ms.Pin("x < 1e-6")])
    with pytest.raises(ms.OptionError, match="must be held by their supports, or have none"):
        ms.Auto(hinged)
    with pytest.raises(ms.OptionError, match="no level of a coarse shell in free flight"):
        ms.Auto(shell, triangles=40)
