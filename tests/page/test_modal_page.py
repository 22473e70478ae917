"""Pages of modal bases: what is in the file, and the page itself in a headless browser without a network."""

import base64
import json
import re
from dataclasses import replace
from io import BytesIO

import msgspec
import numpy as np
import pytest
from matplotlib.image import imread
from scenes import cantilever, held

import modalshell as ms
from modalshell.commands import pages
from modalshell.export import compress
from modalshell.files.provenance import repository_file
from modalshell.page import farthest, recorded, shell_page
from modalshell.run.run_shell import ShellRun
from modalshell.shell.damping import Damping

GRAVITY = (0.0, 0.0, -3.0)


@pytest.fixture(scope="module")
def v_basis():
    return ms.solve_modes(held(ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(40, 8)), 0.026), 8)


def content(page):
    return json.loads(re.search(r"^const data = (.*);$", page.text, re.MULTILINE).group(1))


def test_a_page_stands_alone_and_is_small(v_basis, tmp_path):
    file = tmp_path / "beam.html"
    page = v_basis.page(file, title="beam <1>", gravity=GRAVITY)
    text = file.read_text()
    assert text == page.text
    assert len(text) < 150_000
    for foreign in ("http:", "https:", "//cdn", "eval(", "Function(", "import(", "$data", "$picture", "$title"):
        assert foreign not in text
    assert "beam &lt;1&gt;" in text
    assert "default-src 'none'" in text
    assert 'srcdoc="&lt;!doctype html' in page._repr_html_()
    assert len(repr(page)) < 100


def test_a_page_holds_the_basis_to_half_precision(v_basis):
    data = content(v_basis.page(gravity=GRAVITY, damping=(0.25, 0.002), dt=0.01))
    live = data["live"]
    for name, exact in (("phi", v_basis.modes), ("psi", v_basis.rotations)):
        halves = np.frombuffer(base64.b64decode(live[name]["halves"]), "<f2").astype(float).reshape(-1, v_basis.count)
        shown = halves * live[name]["scales"]
        assert (np.abs(shown - exact).max(axis=0) <= 2.0**-11 * np.abs(exact).max(axis=0)).all()
    rest = np.frombuffer(base64.b64decode(data["rest"]), "<f4").reshape(-1, 3) + data["centre"]
    np.testing.assert_allclose(rest, v_basis.shell.rest_positions, atol=1e-7)
    np.testing.assert_array_equal(
        np.frombuffer(base64.b64decode(data["faces"]), "<u2"), v_basis.shell.mesh.faces.ravel()
    )
    assert (data["gravity"], live["damping"], live["dt"]) == ([0.0, 0.0, -3.0], [0.25, 0.002], 0.01)
    assert live["force"] is None
    assert live["held"] == np.flatnonzero(v_basis.shell.clamped).tolist()
    assert v_basis.shell.rest_positions[data["tip"], 0] == 1.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gravity": (0.0, np.nan, 0.0)}, "gravity must be finite"),
        ({"force": np.zeros((3, 3))}, "force must have shape"),
        ({"dt": 0.0}, "dt must be a finite number above 0"),
        ({"damping": (1.0,)}, "damping must have shape"),
    ],
)
def test_wrong_options_are_refused(v_basis, options, message):
    with pytest.raises(ms.ModalShellError, match=message):
        v_basis.page(**options)


def test_too_many_modes_are_refused():
    with pytest.raises(ms.OptionError, match=r"at most 100 shapes \(got 101\)"):
        ms.solve_modes(cantilever((24, 6)), 101).page()


def notes(file):
    return re.findall(r'<p class="notes">(.*)</p>', file.read_text(encoding="utf-8"))


def picture(page):
    return imread(BytesIO(page.locator("canvas").screenshot()))[..., :3]


@pytest.mark.slow
def test_the_page_moves_as_the_models_do(v_basis, open_file):
    force = np.zeros_like(v_basis.shell.rest_positions)
    force[-1, 1] = 0.02
    load = v_basis.shell.gravity_force(GRAVITY) + force
    full = ms.RotationStrain(v_basis)
    reduced = ms.ReducedRotationStrain.trained(
        full, loads=np.array([load, 0.5 * load]), mixtures=8, aside=0.1, rank=8, samples=32
    )
    page, errors = open_file(v_basis.page(gravity=GRAVITY, force=force, reduced=reduced.on_page()))
    models = {"mwts": ms.ModalWarping(v_basis), "lma": ms.LinearModal(v_basis), "rsw": reduced}
    for name, model in models.items():
        script = f"shell.state.paused = true; shell.state.model = '{name}'; shell.release(); shell.steps(200)"
        coordinates = page.evaluate(f"() => {{ {script}; return [...shell.state.q]; }}")
        state = model.start_motion()
        for _ in range(200):
            state, _ = model.step(state, 1.0 / 60.0, load, Damping(0.5, 0.001))
        expected = state.coordinates
        np.testing.assert_allclose(coordinates, expected, atol=1e-3 * np.abs(expected).max())

        assert page.evaluate("shell.settle()")
        positions = np.reshape(page.evaluate("[...shell.positions()]"), (-1, 3))
        answer = model.equilibrium(gravity=GRAVITY, force=force)
        assert answer.converged
        assert ms.measure.displacement_error(positions, answer.positions, v_basis.shell) < 1e-3
        numbers = page.evaluate("shell.numbers(shell.state.q)")
        assert numbers["area"] == pytest.approx(ms.measure.area_change(answer.positions, v_basis.shell.mesh), abs=1e-4)
    exact = full.equilibrium(gravity=GRAVITY, force=force).positions
    assert ms.measure.displacement_error(positions, exact, v_basis.shell) < 2e-3  # those of reduced RSW, the last
    assert errors == []


@pytest.mark.slow
def test_the_page_obeys_its_controls(v_basis, open_file, wait_until):
    page, errors = open_file(v_basis.page(gravity=GRAVITY))
    page.click("#settle")
    assert page.inner_text("#shape") == "Settled."
    page.click("#pause")
    settled = page.evaluate("[...shell.state.q]")
    still = picture(page)
    assert 0.01 < (still.min(axis=2) < 0.9).mean() < 0.5  # the shell is there, all of it
    assert not (still[0] < 0.9).any()
    assert not (still[-1] < 0.9).any()

    page.select_option("#model", "lma")
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert np.abs(picture(page) - still).max() > 0.1
    assert page.evaluate("[...shell.state.q]") == settled
    page.select_option("#model", "mwts")

    page.locator("#count").fill("3")
    page.click("#settle")
    assert not any(page.evaluate("[...shell.state.q]")[3:])
    page.locator("#count").fill("8")

    page.locator("#azimuth").fill("90")
    page.locator("#elevation").fill("0")
    page.locator("#gravity").fill("10")
    assert page.evaluate("shell.state.gravity") == pytest.approx([0.0, 10.0, 0.0], abs=1e-9)

    page.locator("#bars button").nth(1).click()
    assert "Mode 2:" in page.inner_text("#shape")
    assert page.is_visible("#amplitude")
    page.locator("#bars button").nth(1).click()
    assert not page.is_visible("#amplitude")

    page.click("#release")
    assert page.evaluate("shell.state.time") < 1.0
    page.locator("#gravity").fill("0")
    page.click("#settle")
    tip = page.evaluate("shell.screen(data.tip)")
    page.mouse.move(*tip)
    page.mouse.down()
    page.mouse.move(tip[0], tip[1] + 80.0, steps=4)
    wait_until(page, "Math.abs(shell.state.q[0]) > 1e-3")
    page.mouse.up()
    assert page.evaluate("shell.state.pull") is None
    before = page.evaluate("shell.camera.azimuth")
    page.mouse.move(20, 20)
    page.mouse.down()
    page.mouse.move(120, 20, steps=4)
    page.mouse.up()
    assert page.evaluate("shell.camera.azimuth") != before
    distance = page.evaluate("shell.camera.distance")
    page.mouse.wheel(0, 200)
    wait_until(page, f"shell.camera.distance > {distance}")
    assert errors == []


@pytest.mark.slow
def test_a_browser_without_webgl_shows_a_picture(v_basis, browser, tmp_path):
    context = browser.new_context(offline=True, java_script_enabled=False)
    page = context.new_page()
    page.goto(v_basis.page(tmp_path / "page.html") and (tmp_path / "page.html").as_uri())
    assert page.is_visible("#missing")
    drawn = imread(BytesIO(page.locator("#picture").screenshot()))[..., :3]
    assert (np.ptp(drawn, axis=2) > 0.05).mean() > 0.01
    context.close()


@pytest.mark.slow
def test_the_page_of_a_clip_plays_it(v_basis, open_file, wait_until):
    run = ms.simulate(ms.ModalWarping(v_basis), duration=1.0, dt=1 / 30, gravity=GRAVITY)
    motion = compress(run)
    page, errors = open_file(
        shell_page(
            motion.rest_positions,
            motion.faces,
            title="clip",
            tip=farthest(motion.displacements(), motion.amplitudes),
            record=recorded(motion.times, motion.displacements(), motion.amplitudes, label="Recorded motion"),
        )
    )
    page.click("#pause")
    for frame in (0, 11, 30):
        seen = page.evaluate(f"() => {{ shell.playAt(shell.scene.times[{frame}]); return [...shell.positions()]; }}")
        assert np.abs(np.reshape(seen, (-1, 3)) - run.positions[frame]).max() < 1e-3
    page.locator("#moment").fill("0.5")
    wait_until(page, "document.getElementById('time').textContent === '0.50 s'")
    assert not page.is_visible("#model")
    assert not page.is_visible("#settle")
    assert (picture(page).min(axis=2) < 0.9).mean() > 0.01
    assert errors == []


@pytest.mark.slow
def test_every_scene_has_a_page(tmp_path, monkeypatch):
    def load(file, load=ms.load_scene):
        scene = load(file)
        if file.stem in ("creature", "folded_strip"):  # the longest
            scene = replace(scene, motion=msgspec.structs.replace(scene.motion, duration=0.5))
        scenes[file.stem] = scene
        return scene

    def solve(shell, count, solve=ms.solve_modes):
        """Once for both scenes of the creature at rest, whose shells are the same."""
        if len(shell.mass) < 10_000:
            return solve(shell, count)
        if count not in solved:
            solved[count] = solve(shell, count)
        return solved[count]

    def ended(run, files, resumed, result=ShellRun.result):
        """Their runs are whole, and leave their files; test_run.py runs those that are live."""
        trajectory = (found := result(run, files, resumed)).trajectory
        scene = scenes[run.name]
        assert trajectory.status in ("completed", "converged")
        assert trajectory.times[-1] == pytest.approx(0.0 if scene.motion is None else scene.motion.duration)
        assert trajectory.positions.dtype == scene.output.positions
        assert [path.name for path in files] == [f"{run.name}.npz", f"{run.name}.json"]
        assert all(path.stat().st_size > 500 for path in files)
        ran.append(run.name)
        return found

    scenes, ran = {}, []
    monkeypatch.setattr(ShellRun, "result", ended)
    solved = {}
    monkeypatch.setattr(pages.ms, "load_scene", load)
    monkeypatch.setattr(pages.ms, "solve_modes", solve)
    written = pages.write_pages(tmp_path)
    folder = repository_file("studies/scenes/v_beam.toml").parent
    assert [file.stem for file in written] == [file.stem for file in sorted(folder.glob("*.toml"))]
    assert ran == [name for name in scenes if name not in ("flat_beam", "flock")]
    sizes = {file.stem: file.stat().st_size for file in written}
    assert 500_000 < sizes["creature"] < 4_000_000  # a record in motion, with a colour for each frame
    committed = {file.stem for file in folder.glob("*.html")}
    assert committed == {name for name, size in sizes.items() if size <= 500_000}  # larger ones are not
    assert sizes["v_beam"] < 170_000  # live models, and the record of its answer
    assert '"reduced"' in (tmp_path / "v_beam.html").read_text()
    for name in committed:  # what a committed page says is what the code says today
        said, today = (
            [re.sub(r"steps add a damping ratio .*?; ", "", note.casefold()) for note in notes(at / f"{name}.html")]
            for at in (folder, tmp_path)  # but for what steps add up to, which is that of a whole motion
        )
        assert said == today, name
