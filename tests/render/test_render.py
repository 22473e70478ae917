"""Pictures and films: which back end draws, what the pictures hold, and what is refused."""

from __future__ import annotations

import importlib.util
import os
import sys
import warnings

import numpy as np
import pytest
from counting import lines_run

from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.render import ShadedSurface, View, backend, choose_backend, draw_views, look_at, stage, write_film
from modalshell.render.backend import RENDERER_VARIABLE, WINDOW_VARIABLE, drawing_hint, open_painter
from modalshell.render.camera import frame_points

CRASH = (sys.executable, "-c", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
OK = "print('modalshell-probe ok')"


def grid(cells: tuple[int, int] = (24, 5), bend: float = 1.5, fold: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Strip along x of length 1, bent down to a circle of curvature `bend`."""
    s, t = (a.ravel() for a in np.meshgrid(np.linspace(0, 1, cells[0] + 1), np.linspace(-0.1, 0.1, cells[1] + 1)))
    vertices = np.column_stack([np.sin(bend * s) / bend, t, (np.cos(bend * s) - 1) / bend - fold * np.abs(t)])
    index = np.arange(len(s)).reshape(cells[1] + 1, cells[0] + 1)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    return vertices, np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


@pytest.fixture(scope="module")
def detected():
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)
        patch.setenv(RENDERER_VARIABLE, "")
        patch.setenv(WINDOW_VARIABLE, os.environ.get(WINDOW_VARIABLE, ""))
        if not os.environ[WINDOW_VARIABLE]:
            del os.environ[WINDOW_VARIABLE]
        yield choose_backend(), os.environ.get(WINDOW_VARIABLE)


def use(name: str, detected, monkeypatch) -> None:
    if name == "pyvista":
        if detected[0] != "pyvista":
            pytest.skip("PyVista renders nothing on this machine: no OpenGL (apt-get install libegl1 libgl1-mesa-dri)")
        if detected[1]:
            monkeypatch.setenv(WINDOW_VARIABLE, detected[1])
    monkeypatch.setenv(RENDERER_VARIABLE, name)


@pytest.fixture(params=["pyvista", "built-in"])
def drawn_by(request, detected, monkeypatch):
    use(request.param, detected, monkeypatch)
    return request.param


@pytest.fixture
def unprobed(monkeypatch):
    monkeypatch.setenv(RENDERER_VARIABLE, "")
    monkeypatch.setenv(WINDOW_VARIABLE, "")


def pixels(path) -> np.ndarray:
    from matplotlib.image import imread

    return np.round(255 * imread(path)[:, :, :3]).astype(int)


def inked(image: np.ndarray) -> np.ndarray:
    return (image < 250).any(axis=2)


def rim(ink: np.ndarray, width: int) -> np.ndarray:
    return np.concatenate([part.ravel() for part in (ink[:width], ink[-width:], ink[:, :width], ink[:, -width:])])


# ---- which back end ----


@pytest.mark.usefixtures("unprobed")
def test_without_pyvista_the_rasteriser_draws_and_no_probe_runs(monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "pyvista" else find_spec(name))
    monkeypatch.setattr(backend, "PROBE_COMMAND", CRASH)
    assert choose_backend() == "built-in"  # and warns of nothing
    assert "modalshell[vtk]" in drawing_hint()


@pytest.mark.by_default("blank", "absent")
@pytest.mark.parametrize(
    "probe",
    [
        CRASH,
        (sys.executable, "-c", "import no_such_module"),
        (sys.executable, "-c", "print('modalshell-probe blank')"),
        ("/no/such/python",),
    ],
    ids=["crash", "import", "blank", "absent"],
)
@pytest.mark.usefixtures("unprobed")
def test_nothing_renders(probe, monkeypatch):
    monkeypatch.setattr(backend, "PROBE_COMMAND", probe)
    with pytest.warns(ModalShellWarning, match="apt-get install libegl1 libgl1-mesa-dri"):
        assert choose_backend() == "built-in"
    assert os.environ[RENDERER_VARIABLE] == ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert choose_backend() == "built-in"


@pytest.mark.usefixtures("unprobed")
def test_hanging_probe_is_given_up(monkeypatch, tmp_path):
    waits = f"import time; time.sleep(60); open({str(tmp_path / 'through')!r}, 'w')"
    monkeypatch.setattr(backend, "PROBE_COMMAND", (sys.executable, "-c", waits))
    monkeypatch.setattr(backend, "PROBE_SECONDS", 0.3)
    with pytest.warns(ModalShellWarning):
        assert choose_backend() == "built-in"
    assert not (tmp_path / "through").exists()  # nobody waited for it


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="off-screen windows are chosen on Linux alone")
@pytest.mark.parametrize("window", ["vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"])
@pytest.mark.usefixtures("unprobed")
def test_window_that_works_is_kept(window, monkeypatch):
    code = f"import os\nif os.environ.get('{WINDOW_VARIABLE}') == '{window}': {OK}"
    monkeypatch.setattr(backend, "PROBE_COMMAND", (sys.executable, "-c", code))
    assert choose_backend() == "pyvista"
    assert os.environ[WINDOW_VARIABLE] == window


@pytest.mark.usefixtures("unprobed")
def test_users_window_is_tried_first_and_probed_once(monkeypatch, tmp_path):
    monkeypatch.setenv(WINDOW_VARIABLE, "mine")
    log = tmp_path / "log"
    code = f"import os; open({str(log)!r}, 'a').write(os.environ['{WINDOW_VARIABLE}'] + ' '); {OK}"
    monkeypatch.setattr(backend, "PROBE_COMMAND", (sys.executable, "-c", code))
    for _ in range(3):
        assert choose_backend() == "pyvista"
    assert log.read_text() == "mine "
    assert os.environ[WINDOW_VARIABLE] == "mine"


@pytest.mark.parametrize("name", ["pyvista", "built-in"])
def test_named_renderer_skips_probe(name, monkeypatch):
    monkeypatch.setenv(RENDERER_VARIABLE, name)
    monkeypatch.setattr(backend, "PROBE_COMMAND", CRASH)
    assert choose_backend() == name


def test_unknown_renderer(monkeypatch):
    monkeypatch.setenv(RENDERER_VARIABLE, "vulkan")
    with pytest.raises(OptionError, match="'vulkan'"):
        choose_backend()


# ---- pictures ----


@pytest.mark.slow
def test_every_cell_is_filled_and_nothing_is_clipped(drawn_by, tmp_path):
    flat, faces = grid(bend=1e-6)
    bent = grid(bend=2.5, fold=0.5)[0]
    rest = ShadedSurface(flat, faces, "0.5", opacity=0.5, style="outline")
    views = [
        View([ShadedSurface(flat, faces)]),
        View([ShadedSurface(bent, faces, smooth=True, edges=True), rest]),
        View([ShadedSurface(bent, faces, "tab:red", opacity=0.5)], camera=(0, -1, 0)),
        View([ShadedSurface(bent, faces, "k", edges=True)], camera=(0, 0, 1)),
    ]
    image = pixels(draw_views(views, tmp_path / "new" / "page.png", columns=2, size=(480, 360)))
    assert image.shape == (360, 480, 3)
    for cell in (image[:180, :240], image[:180, 240:], image[180:, :240], image[180:, 240:]):
        ink = inked(cell)
        assert ink.mean() > 0.015, drawn_by
        assert not rim(ink, 4).any()
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["page.png"]


@pytest.mark.by_default("built-in")
def test_transparent_overlay_mixes_colours(drawn_by, tmp_path):
    upper, faces = grid(bend=1e-6)
    lower = upper - np.array([0, 0, 0.05])
    blue = ShadedSurface(lower, faces, (0.0, 0.0, 1.0), opacity=0.5)
    red = ShadedSurface(upper, faces, (1.0, 0.0, 0.0), opacity=0.5)
    image = pixels(draw_views([View([red, blue], camera=(0, 0, 1))], tmp_path / "o.png", size=(300, 200)))
    middle = image[100, 150]
    # Half red over half blue over white, under lights of strength near one.
    assert middle == pytest.approx([191, 64, 128], abs=30)
    assert middle[0] > middle[2] + 30 > middle[1] + 30
    assert drawn_by


@pytest.mark.by_default("built-in")
def test_back_faces_are_as_bright_as_front_faces(drawn_by, tmp_path):
    vertices, faces = grid(bend=1e-6)
    shades = []
    for name, wound in (("front", faces), ("back", faces[:, ::-1])):
        image = pixels(draw_views([View([ShadedSurface(vertices, wound)])], tmp_path / f"{name}.png", size=(300, 200)))
        shades.append(image[100, 150])
    assert shades[0] == pytest.approx(shades[1], abs=2)
    assert shades[0].min() > 90, drawn_by


def test_both_back_ends_draw_the_same_picture(detected, monkeypatch, tmp_path):
    vertices, faces = grid(bend=2.0, fold=0.8)
    folded = View([ShadedSurface(vertices, faces, "tab:blue", label="bent")], title="Bent strip", subtitle="both")
    images = []
    for name in ("built-in", "pyvista"):
        use(name, detected, monkeypatch)
        images.append(pixels(draw_views([folded, folded], tmp_path / f"{name}.png", size=(600, 300))))
    assert np.abs(images[0] - images[1]).mean() < 1.0


def test_text_stays_outside_the_cells(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    vertices, faces = grid()
    long = "a title of many words that cannot stand in one line above so narrow a cell"
    values = np.linspace(0.0, 1.0, len(vertices))
    views = [
        View([ShadedSurface(vertices, faces, c, label=c)], title=long, subtitle=long) for c in ("red", "green", "blue")
    ]
    views.append(View([ShadedSurface(vertices, faces, scalars=values, label="height [m]")], title=long))
    image = pixels(draw_views(views, tmp_path / "t.png", size=(900, 600), title=r"All of $\part$", columns=2))
    ink = inked(image)
    # Text ends before the borders of the picture, and below the last cell the legend has its own band.
    assert not rim(ink, 2).any()
    strong = ink[-40:]
    assert 0.005 < strong.mean() < 0.2


def test_unlinked_cameras_show_each_shape_large(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    vertices, faces = grid()
    views = [View([ShadedSurface(vertices, faces)]), View([ShadedSurface(0.1 * vertices, faces)])]
    shares = []
    for linked in (True, False):
        image = pixels(draw_views(views, tmp_path / "u.png", size=(400, 200), columns=2, link_cameras=linked))
        shares.append(inked(image[:, 200:]).mean() / inked(image[:, :200]).mean())
    assert shares[0] < 0.1
    assert shares[1] == pytest.approx(1.0, abs=0.1)


def test_frame_is_tight():
    points = np.random.default_rng(3).normal(size=(200, 3))
    camera = frame_points(points, (1.0, -2.0, 0.7), 1.5)
    reach = np.abs(camera.project(points)[:, :2]).max()
    assert reach == pytest.approx(0.88, abs=1e-9)
    assert camera.axes @ camera.axes.T == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.slow
def test_no_line_of_the_fallback_runs_for_each_triangle(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    counts = []
    for cells in ((8, 8), (8, 8), (78, 40)):  # the first draws what is kept, too
        views = [View([ShadedSurface(*grid(cells=cells), opacity=0.6)])]
        counts.append(lines_run(lambda views=views: draw_views(views, tmp_path / "q.png")))
    assert counts[1] > 10
    assert counts[2] < counts[1] + 500  # of 49 times as many triangles, 6,112 more


# ---- films ----


def test_film(drawn_by, tmp_path):
    import imageio_ffmpeg

    faces = grid()[1]
    frames = np.stack([grid(bend=bend)[0] for bend in np.linspace(0.1, 2.5, 7)])
    surfaces = [ShadedSurface(frames[0], faces), ShadedSurface(frames[0], faces, "0.55", opacity=0.6, style="outline")]
    seen = []
    path = write_film(
        tmp_path / "f.mp4", surfaces, [frames, None], fps=25, size=(258, 194), title="Bending",
        on_frame=lambda done, total: seen.append((done, total)),
    )  # fmt: skip
    assert seen == [(k, 7) for k in range(1, 8)]
    assert imageio_ffmpeg.count_frames_and_secs(str(path))[0] == 7
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    assert tuple(meta["size"]) == (258, 194)
    assert meta["fps"] == pytest.approx(25)
    images = [np.frombuffer(data, np.uint8).reshape(194, 258, 3).astype(int) for data in reader]
    for image in images:
        ink = (image < 230).any(axis=2)
        assert ink.mean() > 0.02, drawn_by
        assert not rim(ink, 3).any()
    assert np.abs(images[0] - images[-1]).mean() > 1.0
    assert [p.name for p in tmp_path.iterdir()] == ["f.mp4"]


@pytest.mark.slow
def test_frames_that_come_one_by_one_make_the_same_film(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    faces = grid()[1]
    frames = np.stack([grid(bend=bend)[0] for bend in (0.1, 1.0, 2.0)])
    camera = look_at((1.0, -2.0, 1.0), (0.5, 0.0, 0.0), 0.6, 128 / 96)
    surface = ShadedSurface(frames[0], faces, scalars=frames[0][:, 0])
    options = {"camera": camera, "size": (128, 96)}
    whole = write_film(tmp_path / "whole.mp4", [surface], [frames], **options)
    streamed = write_film(tmp_path / "streamed.mp4", [surface], [(shape for shape in frames)], total=3, **options)
    assert streamed.read_bytes() == whole.read_bytes()


def test_films_without_titles_and_scalars_need_no_matplotlib(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    for name in ("colors", "figure", "font_manager", "backends.backend_agg"):
        monkeypatch.setitem(sys.modules, f"matplotlib.{name}", None)
    stage._font.cache_clear()
    vertices, faces = grid(bend=0.5)
    film = write_film(
        tmp_path / "plain.mp4", [ShadedSurface(vertices, faces)], [[vertices] * 2], size=(96, 64), texts=["0 s", "1 s"]
    )
    assert film.stat().st_size > 0


def test_threads_make_the_same_film(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    frames, films = np.stack([grid(bend=bend)[0] for bend in np.linspace(0.1, 2.0, 7)]), []
    surface = ShadedSurface(frames[0], grid()[1], scalars=frames[0][:, 0])
    opened = []
    monkeypatch.setattr(
        backend, "open_painter", lambda *size, **how: opened.append(open_painter(*size, **how)) or opened[-1]
    )
    for cores in (1, 2, 3):
        monkeypatch.setattr(backend, "usable_cores", lambda cores=cores: cores)
        scalars = [frames[:, :, 2]]
        films.append(write_film(tmp_path / f"{cores}.mp4", [surface], [frames], size=(128, 96), scalars=scalars))
    assert len(opened) == 1 + 2 + 3
    assert films[0].read_bytes() == films[1].read_bytes() == films[2].read_bytes()


def test_interrupted_film_leaves_no_file(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    vertices, faces = grid()

    def stop(done: int, _total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_film(
            tmp_path / "f.mp4",
            [ShadedSurface(vertices, faces)],
            [np.stack([vertices] * 4)],
            size=(128, 96),
            on_frame=stop,
        )
    assert list(tmp_path.iterdir()) == []


# ---- refusals ----


def test_positions_that_are_not_finite(tmp_path):
    vertices, faces = grid()
    frames = np.stack([vertices] * 4)
    frames[2, 7, 1] = np.nan
    with pytest.raises(OptionError, match="frame 2, vertex 7"):
        write_film(tmp_path / "f.mp4", [ShadedSurface(vertices, faces)], [frames])
    with pytest.raises(OptionError, match="vertex 7"):
        ShadedSurface(frames[2], faces)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.zeros((4, 2))}, r"\(n, 3\).*\(4, 2\)"),
        ({"faces": np.array([[0, 1, 9999]])}, r"face 0 is \[0, 1, 9999\]"),
        ({"faces": np.zeros((2, 3))}, "float64"),
        ({"opacity": 0.0}, "opacity"),
        ({"scalars": np.zeros(3)}, r"\(3,\)"),
        ({"style": "dots"}, "dots"),
    ],
)
def test_surfaces_refused(change, message):
    vertices, faces = grid()
    with pytest.raises(OptionError, match=message):
        ShadedSurface(**{"vertices": vertices, "faces": faces, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"views": []}, "at least one View"),
        ({"path": "picture.jpg"}, r"\.png"),
        ({"size": (10, 900)}, "10"),
        ({"size": (64, 64), "columns": 1}, "larger"),
        ({"columns": 0}, "columns"),
        ({"colormap": "none such"}, "none such"),
    ],
)
def test_pictures_refused(change, message, tmp_path):
    vertices, faces = grid()
    view = View([ShadedSurface(vertices, faces)], title="t")
    options = {"views": [view, view], "path": tmp_path / "p.png", **change}
    with pytest.raises(OptionError, match=message):
        draw_views(options.pop("views"), options.pop("path"), **options)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"path": "f.avi"}, r"\.mp4"),
        ({"size": (101, 100)}, "even"),
        ({"fps": 0}, "fps"),
        ({"camera": (0, 0, 0)}, "camera"),
        ({"motions": [np.zeros((0, 4, 3))]}, r"\(F, n, 3\)"),
        ({"total": 1}, "place a camera"),
        ({"motions": []}, "one entry a surface"),
    ],
)
def test_films_refused(change, message, tmp_path):
    vertices, faces = grid()
    surfaces = [ShadedSurface(vertices, faces)]
    options = {"path": tmp_path / "f.mp4", "surfaces": surfaces, "motions": [vertices[None]], **change}
    with pytest.raises(OptionError, match=message):
        write_film(**options)


@pytest.mark.slow
def test_colours_refused(detected, monkeypatch, tmp_path):
    use("built-in", detected, monkeypatch)
    vertices, faces = grid()
    with pytest.raises(OptionError, match="colour"):
        draw_views([View([ShadedSurface(vertices, faces, "no colour")])], tmp_path / "p.png")
    with pytest.raises(OptionError, match="camera"):
        View([ShadedSurface(vertices, faces)], camera=(0.0, 0.0, 0.0))
