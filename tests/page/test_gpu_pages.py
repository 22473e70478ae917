"""Pages whose state lives on the GPU: the sheet against GridVerlet, the flock against Flock and Crowd."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.pages import scene_page
from modalshell.crowd import Crowd, Flap, Flight, Flock
from modalshell.files.provenance import repository_file
from modalshell.springs import GridVerlet, SheetGrid


def hung_sheet(cells, **changes):
    pinned = np.zeros((cells, cells), bool)
    pinned[0, [0, -1]] = True
    options = {
        "shape": (cells, cells),
        "spacing": 1.0 / (cells - 1),
        "particle_mass": 0.2 / cells**2,
        "structural": 200.0,
        "shear": 100.0,
        "flexion": 5.0,
        "drag": 0.5,
        "pinned": pinned,
        "gravity": np.array([0.0, 0.0, -9.81]),
    }
    return SheetGrid(**(options | changes))


def test_a_sheet_of_a_quarter_million_masses_is_a_small_page(tmp_path):
    page = hung_sheet(512).page(tmp_path / "sheet.html", title="cloth")
    assert len(page.text) < 60_000
    assert (tmp_path / "sheet.html").read_text() == page.text
    for foreign in ("http:", "https:", "eval("):
        assert foreign not in page.text


def test_what_a_page_of_a_sheet_cannot_step_is_refused():
    grid = hung_sheet(8)
    with pytest.raises(ms.OptionError, match="a step of at most"):
        grid.page(dt=1.01 * grid.stable_step())
    with pytest.raises(ms.OptionError, match="no dashpots"):
        hung_sheet(8, spring_damping=0.1).page()


@pytest.mark.slow
def test_the_sheet_is_stepped_as_in_single_precision(open_file):
    grid = hung_sheet(64)
    dt = 0.5 * grid.stable_step()
    page, errors = open_file(grid.page())
    script = "sheet.state.paused = true; sheet.restart(); sheet.steps(1000); return [...sheet.positions()];"
    seen = np.reshape(page.evaluate(f"() => {{ {script} }}"), (-1, 4))
    np.testing.assert_array_equal(seen[:, 3] > 0.5, grid.pinned.ravel())
    positions = seen[:, :3] + [0.5, 0.5, 0.0]
    single, double = (GridVerlet(grid, dtype) for dtype in (np.float32, np.float64))
    for sheet in (single, double):
        sheet.step(1000, dt)
    rounding = np.abs(single.positions - double.positions).max()
    moved = np.abs(double.positions - grid.rest_positions()).max()
    assert rounding < 0.01 * moved
    assert np.abs(positions - double.positions).max() < 2.0 * rounding
    assert errors == []


@pytest.mark.slow
def test_the_sheet_obeys_its_controls(open_file):
    page, errors = open_file(hung_sheet(24).page())
    page.click("#pause")
    page.click("#restart")
    assert page.evaluate("sheet.state.count") == 0
    page.locator("#gravity").fill("-2")
    assert page.evaluate("sheet.state.gravity") == [0, 0, -2]
    page.mouse.move(*page.evaluate("() => projected([0, 0, 0]).slice(0, 2)"))
    page.mouse.down()
    held = page.evaluate("sheet.state.grab")
    assert held[0] in range(10, 14)
    assert held[1] in range(10, 14)
    page.mouse.move(300, 200, steps=3)
    page.evaluate("sheet.steps(50)")
    positions = np.reshape(page.evaluate("[...sheet.positions()]"), (24, 24, 4))
    np.testing.assert_allclose(positions[held[1], held[0], :3], page.evaluate("sheet.state.target"), atol=1e-6)
    page.mouse.up()
    assert page.evaluate("sheet.state.grab") == [-1, -1]
    page.click("#free")
    assert not np.reshape(page.evaluate("[...sheet.positions()]"), (-1, 4))[:, 3].any()
    assert errors == []


def flight(count=500, **changes):
    mesh = ms.paper_bird(wing=0.26)
    material = ms.Material(stretch=2000.0, shear=2000.0, flexure=5e-3, density=0.08)
    basis = ms.solve_modes(ms.Shell(mesh, material, mesh.vertices[:, 2] <= 0.0), 6)
    rules = {
        "radius": 2.0,
        "seed": 1,
        "speed": 2.6,
        "speed_variation": 0.15,
        "rotation_speed": 2.5,
        "neighbour_distance": 1.1,
        "field_of_view": 300.0,
        "weights": (2.0, 1.2, 0.6),
        "bounds": [[-3.5, -2.5, -1.0], [3.5, 2.5, 1.0]],
        "target": (1.0, 0.0, 0.3),
    }
    crowd = Crowd(basis, count, damping=(2.0, 1e-3))
    crowd.levels[:] = 1
    flap = Flap(basis, amplitude=0.08, frequency=2.0, largest_load_factor=1.5)
    return Flight(Flock.random(count, **(rules | changes)), crowd, flap, seed=1)


CAMERA = ((0.0, -8.8, 0.6), (0.0, 0.0, -0.45))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("steps", "changes"),
    [
        (100, {"radius": 8.0, "bounds": None}),
        (20, {}),  # dense: in double precision, too, rounding soon decides who is a neighbour
    ],
)
def test_the_flock_flies_as_the_boids_and_shells_do(open_file, steps, changes):
    ours = flight(**changes)
    page, errors = open_file(ours.page(camera=CAMERA))
    page.evaluate(f"() => {{ flock.state.paused = true; flock.restart(); flock.steps({steps}); }}")
    for _ in range(steps):
        ours.advance(1.0 / 60.0)
    assert ours.flock.neighbourhood().counts.mean() > 5.0
    positions = np.reshape(page.evaluate("flock.positions()"), (-1, 3))
    assert np.linalg.norm(positions - ours.flock.positions, axis=1).max() < 1e-3
    expected = ours.crowd.coordinates
    coordinates = np.reshape(page.evaluate("flock.coordinates()"), expected.shape)
    np.testing.assert_allclose(coordinates, expected, atol=2e-3 * np.abs(expected).max())
    assert errors == []


@pytest.mark.slow
def test_the_flock_is_drawn_and_obeys_its_controls(open_file, wait_until):
    page, errors = open_file(flight(60).page(camera=CAMERA, title="birds"))
    page.locator("#flap").fill("0")
    assert page.evaluate("flock.state.flap") == 0
    page.locator("#alignment").fill("3")
    assert page.evaluate("flock.state.weights") == [2, 3, 0.6, 1]
    time = page.evaluate("flock.state.time")
    wait_until(page, f"flock.state.time > {time}")
    page.click("#pause")
    page.click("#restart")
    assert page.evaluate("flock.state.time") == 0
    np.testing.assert_allclose(page.evaluate("flock.positions()"), flight(60).flock.positions.ravel(), rtol=1e-6)
    assert errors == []


def test_a_scene_of_a_flock_is_a_page():
    page = scene_page(ms.load_scene(repository_file("studies/scenes/flock.toml")))
    assert len(page.text) < 250_000
    assert "drawElementsInstanced" in page.text


def test_too_many_birds_and_odd_cameras_are_refused():
    ours = flight(2)
    with pytest.raises(ms.OptionError, match="away from what it looks at"):
        ours.page(camera=((1.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    with pytest.raises(ms.OptionError, match="camera must be finite"):
        ours.page(camera=((np.nan, 0.0, 0.0), (1.0, 0.0, 0.0)))
    with pytest.raises(ms.OptionError, match="at most 20,000 birds"):
        flight(20_001).page(camera=CAMERA)
