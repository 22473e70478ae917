"""Pages of scenes show what the scene says: as recorded where a live model would leave something out."""

import base64
import json
import re
import sys
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.commands.pages import scene_page
from modalshell.files.provenance import repository_file
from modalshell.page.shell_page import recorded, shell_page
from modalshell.run.run_scene import run_in_memory
from modalshell.scene import ShellScene
from modalshell.springs import SheetGrid

FOLDER = repository_file("studies/scenes/v_beam.toml").parent
PAGES = sorted(FOLDER.glob("*.html"))
LIVE = {"flat_beam", "flock"}
"""Committed pages that compute their scene live."""
SHEET = "young = 1e6\npoisson = 0.3\nthickness = 2e-3\ndensity = 100.0"
SUPPORTS = 'clamped = "x < 0.03"'


def content(page):
    return json.loads(re.search(r"^const data = (.*);$", page.text, re.MULTILINE).group(1))


def frames_of(data):
    """Positions (F, n, 3) that a page plays."""
    record = data["record"]
    halves = np.frombuffer(base64.b64decode(record["shapes"]["halves"]), "<f2").astype(float)
    shapes = halves.reshape(-1, len(record["shapes"]["scales"])) * record["shapes"]["scales"]
    amounts = np.frombuffer(base64.b64decode(record["amounts"]), "<f4").reshape(len(record["times"]), -1)
    rest = np.frombuffer(base64.b64decode(data["rest"]), "<f4").reshape(-1, 3) + data["centre"]
    return rest + (amounts @ shapes.T).reshape(len(amounts), -1, 3)


@pytest.mark.slow
def test_a_scene_that_a_live_model_shows_whole_is_live(scene_file):
    data = content(scene_page(ms.load_scene(scene_file())))
    assert data["record"] is None
    assert data["live"]["dt"] == pytest.approx(1 / 30)


@pytest.mark.slow
def test_a_static_scene_by_another_model_shows_its_answer_and_how_far_the_live_model_is_off(scene_file):
    changes = ('name = "mwts"', 'name = "ds"'), ("[motion]\nduration = 1\n", ""), ("-9.81", "-0.5")
    scene = ms.load_scene(scene_file(*changes)).require_shell()
    page, built = scene_page(scene), scene.build()
    (shown,) = frames_of(content(page))
    truth = built.equilibrium().positions
    assert ms.measure.displacement_error(shown, truth, built.shell) < 2e-3
    basis = ms.solve_modes(built.shell, 8)
    live = ms.ModalWarping(basis).equilibrium(gravity=(0, 0, -0.5)).positions
    off = ms.measure.displacement_error(live, truth, built.shell)
    assert f"MWTS is {100 * off:.2g} % off this answer" in page.text
    assert content(page)["live"] is not None


def test_a_live_model_far_from_the_answer_is_left_out(scene_file):
    # LMA's rest of a limp strip under its full weight is no shape of MWTS.
    changes = ('name = "mwts"', 'name = "lma"'), ("[motion]\nduration = 1\n", ""), ("-9.81", "-60.0")
    page = scene_page(ms.load_scene(scene_file(*changes)))
    data = content(page)
    assert data["live"] is None
    assert len(data["record"]["times"]) == 1
    assert "No live model is offered" in page.text


def test_a_page_says_what_keeps_the_scene_s_own_model_from_being_offered(scene_file):
    gust = "[[loads.wind]]\nvelocity = [0, 0, 3]\ntimes = [0.0, 0.1, 0.2]\nfactors = [0, 1, 0]\n"
    page = scene_page(ms.load_scene(scene_file(("duration = 1\n", "duration = 0.3\n"), more=gust)))
    assert content(page)["live"] is None
    said = (
        r"MWTS, which a page can compute, is .* % off this answer; live, "
        r"loads that change stay .* at their largest\."
    )
    assert re.search(said, page.text)


@pytest.mark.slow
def test_the_shell_of_a_page_and_its_modes_are_made_once(scene_file, monkeypatch):
    """The scene's own model was built on another shell, with modes of its own."""
    made, build, solve = [], ShellScene.build_shell, ms.solve_modes
    monkeypatch.setattr(ShellScene, "build_shell", lambda scene: made.append("shell") or build(scene))
    monkeypatch.setattr(ms, "solve_modes", lambda *given: made.append("modes") or solve(*given))
    monkeypatch.setattr(sys.modules["modalshell.models.factory"], "model_basis", lambda *_: pytest.fail("once more"))
    coloured = scene_file(("duration = 1\n", "duration = 0.1\n"), more='[output]\ncolor = "energy_density"\n')
    page = scene_page(ms.load_scene(coloured))
    assert content(page)["record"] is not None
    assert sorted(made) == ["modes", "shell"]


@pytest.mark.parametrize("table", ["[rest]\nrest_curvature = 0.5", '[[creases]]\nsel = "x < 0.5"\nyield_moment = 1e-3'])
def test_a_scene_without_modes_plays_its_run(scene_file, table):
    """Own stresses and creases leave no vibration modes about the mesh, but DS answers."""
    changes = (
        ('name = "mwts"', 'name = "ds"'),
        ("stretch = 20.0\nshear = 20.0\nflexure = 0.05\ndensity = 0.2", SHEET),
        ("duration = 1\n", "duration = 0.1\n"),
        ("[motion]", f"{table}\n[motion]"),
    )
    scene = ms.load_scene(scene_file(*changes)).require_shell()
    page = scene_page(scene)
    data, shell = content(page), scene.build_shell()
    assert data["live"] is None
    assert "No live model is offered: they move in vibration modes, which the shell has not here." in page.text
    run = run_in_memory(scene)
    assert ms.measure.displacement_error(frames_of(data)[-1], run.positions[-1], shell) < 2e-3
    with pytest.raises(ms.OptionError, match=r"vibration modes|knows no creases: take ms\.Disc"):
        scene_page(ms.load_scene(scene_file(*changes[1:])))


@pytest.mark.slow
def test_a_page_plays_supports_that_move(scene_file):
    moved = "times = [0.0, 0.5, 1.0]\ntranslations = [[0, 0, 0], [0, 0.3, 0], [0, 0, 0]]\n"
    scene = ms.load_scene(scene_file(("[loads]", f"{moved}[loads]"))).require_shell()
    page = scene_page(scene)
    data = content(page)
    seen, held = frames_of(data), data["live"]["held"]
    middle = int(np.argmin(np.abs(np.array(data["record"]["times"]) - 0.5)))
    shift = (seen[middle] - seen[0])[held]
    np.testing.assert_allclose(shift, np.tile([0.0, 0.3, 0.0], (len(held), 1)), atol=2e-3)
    assert "live, the supports rest" in page.text


@pytest.mark.slow
def test_a_page_pulls_and_steps_as_hard_and_as_far_in_every_unit(scene_file):
    still = ("[motion]\nduration = 1\n", "")
    plain = content(scene_page(ms.load_scene(scene_file(still, ("-9.81", "-0.5")))))
    slow = [(f"{key} = {value}", f"{key} = {1e-6 * value}") for key, value in (("stretch", 20.0), ("flexure", 0.05))]
    slow += [("shear = 20.0", "shear = 2e-5"), ("-9.81", "-0.5e-6")]
    units = '[units]\nlength = "m"\nmass = "kg"\ntime = "ms"\n'
    other = content(scene_page(ms.load_scene(scene_file(still, *slow, more=units))))
    assert other["earth"] == pytest.approx(1e-6 * plain["earth"])
    for name, factor in (("pull", 1e-6), ("dt", 1e3), ("frequencies", 1e-3)):
        assert other["live"][name] == pytest.approx(factor * np.array(plain["live"][name])), name
    assert other["live"]["damping"] == pytest.approx(np.array([1e-3, 1e3]) * plain["live"]["damping"])


def test_a_coloured_scene_shows_its_field_and_loads_that_change(scene_file):
    wind = "[[loads.wind]]\nvelocity = [0.0, 1.0, 4.0]\ntimes = [0.0, 0.5]\nfactors = [0.0, 2.0]\n"
    more = '[output]\ncolor = "energy_density"\n'
    scene = ms.load_scene(scene_file(("[model]", f"{wind}[model]"), more=more)).require_shell()
    data = content(scene_page(scene))
    tones = data["record"]["tones"]
    halves = np.frombuffer(base64.b64decode(tones["values"]["halves"]), "<f2").astype(float)
    values = halves.reshape(-1, len(tones["values"]["scales"])) * tones["values"]["scales"]
    amounts = np.frombuffer(base64.b64decode(tones["amounts"]), "<f4").reshape(len(data["record"]["times"]), -1)
    low, high = tones["range"]
    assert tones["label"] == "energy density [J/m^2]"
    assert (amounts @ values.T).max() == pytest.approx(high, abs=0.02 * (high - low))
    assert (amounts @ values.T).min() == pytest.approx(low, abs=0.02 * (high - low))


@pytest.mark.slow
def test_a_scene_whose_steps_are_divided_plays_its_run_and_says_so(scene_file):
    page = scene_page(ms.load_scene(scene_file(("duration = 1", "duration = 0.2\ntolerance = 1e-3"))))
    assert len(content(page)["record"]["times"]) > 2
    assert "live, steps are taken whole" in page.text


def test_a_scene_with_contacts_or_bars_plays_its_run_and_says_so(scene_file):
    floor = '[[contacts]]\nkind = "plane"\nnormal = [0.0, 0.0, 1.0]\noffset = -0.3\n'
    changes = ('name = "mwts"', 'name = "ds"'), ("duration = 1", "duration = 0.2")
    page = scene_page(ms.load_scene(scene_file(*changes, more=floor)))
    assert len(content(page)["record"]["times"]) > 2
    assert "live, nothing is touched" in page.text
    (body,) = content(page)["bodies"]
    corners = np.frombuffer(base64.b64decode(body["rest"]), "<f4").reshape(-1, 3)
    way = np.frombuffer(base64.b64decode(body["poses"]), "<f4")[9:]
    assert (corners + way)[:, 2] + content(page)["centre"][2] == pytest.approx(-0.3, abs=0.01)
    text = scene_file(("duration = 1", "duration = 0.6")).read_text()
    file = scene_file()
    file.write_text(f"bar = true\n{text}")
    barred = scene_page(ms.load_scene(file))
    bars = content(barred)["record"]["bars"]
    assert len(bars["times"]) == len(bars["texts"]) > 0
    assert all(text.endswith("% from DS") for text in bars["texts"])
    assert "Error bar: " in barred.text
    assert "bars" not in content(page)["record"]


def test_committed_pages_record_what_they_must():
    assert PAGES
    for file in PAGES:
        text = file.read_text(encoding="utf-8")
        recorded = '"record": {' in text
        assert recorded != (file.stem in LIVE), file.name
        assert recorded == ("Shown is the scene&#x27;s own" in text), file.name


def drawn(page):
    return imread(BytesIO(page.locator("canvas").screenshot()))[..., :3]


def check_frame(shown):
    """The shell is within a picture."""
    inner = shown[3:-3, 3:-3]  # without the line of the panel, where the picture ends within a pixel
    for side in (inner[:2], inner[-2:], inner[:, :2], inner[:, -2:]):
        assert side.min() > 0.98, "the shell leaves the picture"


def check_page(open_page, file, size, moving, framed=True):
    """A page moves where it should, holds the whole shell in either size, and has no error and no cut text."""
    page, errors = open_page(file, SIZES[size])
    page.wait_for_timeout(300)
    before, changed = drawn(page), 0.0
    for _ in range(8 if moving else 3):
        if changed > 0.003 and not framed:
            break  # a flock takes long to draw, and nothing else is watched in it
        page.wait_for_timeout(150)
        now = drawn(page)
        changed = max(changed, (np.abs(now - before).max(axis=2) > 0.1).mean())
        if framed:
            check_frame(now)
        assert (now.min(axis=2) < 0.9).mean() > 0.005, "nothing is drawn"
    assert changed > 0.003 if moving else changed == 0.0
    check_layout(page)
    width, height = next(one for name, one in SIZES.items() if name != size)  # an open page is made as wide or narrow
    page.set_viewport_size({"width": width, "height": height})
    page.wait_for_timeout(300)
    check_layout(page)
    if framed:
        check_frame(drawn(page))
    assert errors == []


def check_layout(page):
    """Half of a window is the picture, and no text is cut."""
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert page.evaluate("view.clientHeight >= 0.5 * innerHeight")
    cut = """[...document.querySelectorAll('#panel *')].filter(one => one.offsetParent !== null
             && one.getBoundingClientRect().right > innerWidth + 1).map(one => one.id || one.tagName)"""
    assert page.evaluate(cut) == []


SIZES = {"wide": (960, 600), "phone": (390, 844)}
BY_TURNS = [pytest.param(file, list(SIZES)[place % 2], id=file.stem) for place, file in enumerate(PAGES)]
"""Pages, which open in either size by turns."""


@pytest.mark.slow
@pytest.mark.parametrize(("file", "size"), BY_TURNS)
def test_pages_move_where_their_scene_does_and_hold_the_whole_shell(open_page, file, size):
    moving = file.stem == "flock" or "\n[motion]" in file.with_suffix(".toml").read_text()
    check_page(open_page, file, size, moving, framed=file.stem != "flock")  # birds fly in and out


def page_of(kind, basis, folder):
    """The file of a page that a command or a method makes: a basis's, a run's, a still run's, a spring sheet's."""
    model = ms.ModalWarping(basis)
    gravity = (0.0, 0.0, -4.0)
    if kind == "basis":
        return basis.page(gravity=gravity).save(folder / "basis.html")
    if kind == "springs":
        pinned = np.zeros((24, 24), dtype=bool)
        pinned[0, [0, -1]] = True
        springs = {"structural": 200.0, "shear": 100.0, "flexion": 5.0, "drag": 0.5}
        size = {"shape": (24, 24), "spacing": 1.0 / 23, "particle_mass": 0.2 / 24**2}
        grid = SheetGrid(**size, **springs, pinned=pinned, gravity=np.array([0.0, 0.0, -9.81]))
        return grid.page().save(folder / "springs.html")
    run = ms.simulate(model, duration=2.0, dt=1 / 30, gravity=gravity)
    ms.save_trajectory(run, folder / "run.npz")
    with pytest.raises(SystemExit) as ended:
        main(["export", str(folder / "run.npz"), "--to", "page"])
    assert not ended.value.code
    return folder / "run.html"


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "size"), [("basis", "phone"), ("run", "wide"), ("springs", "phone")])
def test_pages_of_other_kinds_move_and_hold_the_whole_shell(open_page, v_basis, tmp_path, kind, size):
    check_page(open_page, page_of(kind, v_basis, tmp_path), size, moving=True)


@pytest.mark.slow
def test_bars_stand_beside_the_time(open_page, scene_file, tmp_path):
    text = scene_file(("duration = 1", "duration = 2")).read_text()
    file = scene_file()
    file.write_text(f"bar = true\n{text}")
    made = scene_page(ms.load_scene(file))
    shown = tmp_path / "barred.html"
    shown.write_text(made.text, encoding="utf-8")
    bars = content(made)["record"]["bars"]
    page, _ = open_page(shown)
    at = """time => {
        shell.state.paused = true; shell.state.time = time; shell.playAt(time); shell.numbers(shell.state.q);
    }"""
    page.evaluate(at, 0.0)
    assert page.inner_text("#time") == "0.00 s"
    for k in (0, len(bars["times"]) - 1):
        page.evaluate(at, bars["times"][k] + 0.01)
        assert page.inner_text("#time") == f"{bars['times'][k] + 0.01:.2f} s, {bars['texts'][k]}"


@pytest.mark.slow
def test_keys_folding_the_link_and_the_dark_serve_a_page(open_page, wait_until):
    page, _ = open_page(FOLDER / "leaf.html", SIZES["phone"], color_scheme="dark")
    page.wait_for_timeout(300)
    assert drawn(page)[0, 0].max() < 0.2
    assert not page.is_visible("#model")  # folded on a phone
    page.click("#fold")
    assert page.is_visible("#model")
    assert page.evaluate("document.getElementById('panel').clientHeight <= 0.45 * innerHeight")
    page.locator("canvas").focus()
    page.keyboard.press("d")
    wait_until(page, "document.documentElement.dataset.theme === 'light'")
    page.keyboard.press(" ")
    assert page.evaluate("shell.state.paused")
    before = page.evaluate("shell.camera.azimuth")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("shell.camera.azimuth") != before
    page.locator("#moment").fill("1.3")
    page.select_option("#model", "lma")
    page.evaluate("() => { shell.steps(40); }")
    expected = page.evaluate("() => [...shell.state.q]")
    page.click("#link")
    again = page.context.new_page()
    again.goto(page.url)
    again.wait_for_selector("canvas")
    assert again.evaluate("shell.state.model") == "lma"
    assert again.evaluate("shell.state.paused")
    np.testing.assert_allclose(again.evaluate("() => [...shell.state.q]"), expected, rtol=1e-5, atol=1e-12)
    assert again.evaluate("shell.camera.azimuth") == pytest.approx(page.evaluate("shell.camera.azimuth"), abs=1e-5)
    broken = page.context.new_page()
    broken.goto(page.url.split("#")[0] + "#model=none&time=x&q=1,2&count=-5&distance=NaN&centre=1,2")
    broken.wait_for_selector("canvas")
    assert broken.evaluate("shell.positions().every(Number.isFinite)")
    assert broken.evaluate("shell.state.model") == "scene"


@pytest.mark.parametrize(("dt", "slowed"), [(5e-4, 100), (0.05, None)])
def test_a_page_of_a_brief_motion_is_slowed(dt, slowed):
    """At real speed 20 ms went round fifty times a second; other pages are as they were."""
    mesh = ms.sheet(cells=(2, 2))
    shape = np.ones((1, *mesh.vertices.shape))
    record = recorded(dt * np.arange(41), shape, np.linspace(0.0, 1.0, 41)[:, None], label="motion")
    page = shell_page(np.array(mesh.vertices), mesh.faces, title="brief", tip=0, record=record)
    assert content(page).get("slowed") == slowed


@pytest.mark.slow
def test_lengths_of_a_page_have_the_digits_of_its_size_and_no_sign_of_a_zero(open_page):
    page, _ = open_page(FOLDER / "leaf.html")
    assert page.evaluate("[-1e-19, -2e-6, -0.0312, 0.25].map(length)") == [
        "0.00 mm", "0.00 mm", "-31.20 mm", "0.250 m",
    ]  # fmt: skip
    assert page.evaluate("data.size = 1e-3, length(5.809e-5)") == "0.0581 mm"
