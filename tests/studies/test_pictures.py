"""Pictures of the studies, drawn from the committed findings: no text lies on another or leaves the picture."""

import importlib
import re
from dataclasses import asdict
from itertools import pairwise

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from text_boxes import faults, save_square

from modalshell.compare.draw import draw_shapes
from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.compose import Page
from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.render.pareto import Mark, ParetoPanel, draw_pareto
from paper_figures import stability_atlas as stability_poster
from paper_figures.mesh_bias import twist_in_words
from paper_figures.model_colors import model_color, paler
from paper_figures.strangers_meshes import LETTERS, broken
from studies import spring_sheet_speed, stability_atlas, tradeoff
from studies.pages import committed
from studies.reproduce import studies

SHAPED = {
    "fabric_drape", "figure_3", "figure_4", "figure_5", "figure_7", "figure_8", "grown_leaf", "held_out_snaps",
    "shell_theory_shapes", "snap", "spring_sheet_speed", "stability_atlas", "strangers_meshes", "tradeoff",
}  # fmt: skip
"""Figures that need more than the committed findings: shapes, or keys of older pages."""
DRAWN = [figure for study in studies().values() for figure in study.FIGURES if figure not in SHAPED]


@pytest.fixture
def saved(monkeypatch):
    """The faults of every figure to be saved, and of every page of views that is painted; files hold a black square."""
    found, paint = [], Page.paint

    def checked(figure, file, **_):
        found.append(faults(figure))
        save_square(figure, file)

    def painted(page, images):
        made = paint(page, images)
        found.append(faults(page._figure))
        return made

    monkeypatch.setattr(Figure, "savefig", checked)
    monkeypatch.setattr(Page, "paint", painted)
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    return found


def test_most_pictures_are_drawn_here():
    assert len(DRAWN) > 18


@pytest.mark.slow
@pytest.mark.parametrize("figure", DRAWN)
def test_no_text_lies_on_another(figure, saved, tmp_path, monkeypatch):
    monkeypatch.setattr(StudyResult, "load", staticmethod(lambda _, study: committed(study)))
    importlib.import_module(f"paper_figures.{figure}").draw(tmp_path, tmp_path)
    assert saved
    assert [each for each in saved if each] == []


class Patches(dict):
    """Arrays of a result by any name: a square patch, which moves where a motion of ``frames`` is asked for."""

    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [1.0, 0.4, 0.0], [0.0, 0.4, 0.0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])

    def __init__(self, frames=0, **given):
        super().__init__(given)
        self.frames = frames

    def __contains__(self, name):
        return True

    def __missing__(self, name):
        if "faces" in name:
            return self.triangles
        if self.frames and name.endswith("positions"):
            return self.corners + 0.2 * np.sin(np.arange(self.frames))[:, None, None] * self.corners[::-1]
        return self.corners


def spring_sheets():
    """The rows of the page, with the published figures, which the page leaves to its table."""
    found = committed("spring_sheet_speed")
    published = {name: [low, high] for name, (low, high) in spring_sheet_speed.PUBLISHED.items()}
    return found.findings | {"published": published}, {}


def dance():
    """The rows of the page; the character is a patch of each colour."""
    return committed("dancing_character").findings, Patches(9, times=np.linspace(0.0, 8.0, 9))


def beams():
    """The rows of the page, and a patch for each model that they compare."""
    found = committed("v_beam_accuracy").findings
    keys = [f"soft_{key}_{row['gravity']:g}" for row in found["soft"]["rows"] for key in ("lma", "mwts", "ds")]
    return found, dict.fromkeys(keys, Patches.corners) | {"soft_faces": Patches.triangles}


def led_beam():
    """The rows of the page, with targets, which it leaves to its text."""
    rows = committed("manipulation").findings["rows"]
    targets = {"position": [1.0, 0.0, 0.1], "rotation_vector": [0.0, 0.1, 0.0]}
    turns = {f"case_{number}_turn": np.zeros(3) for number in range(1, len(rows) + 1)}
    return {"rows": [row | targets for row in rows]}, Patches(tip=1, **turns)


def atlas():
    """Maps of the rows with the longest names, with the atlas's own ranges, filled with all outcomes in turn."""
    planes = {key: asdict(plane) for key, plane in stability_atlas.SLICES.items()}
    outcomes, rows = list(stability_poster.COLORS), {}
    for name in sorted(stability_atlas.ROWS, key=len)[-4:]:
        rows[name] = {}
        for key, plane in planes.items():
            x, y = len(plane["x_values"]), len(plane["y_values"])
            classes = [[outcomes[(i + j) % len(outcomes)] for i in range(x)] for j in range(y)]
            rows[name][key] = {"classes": classes, "limits": [[] for _ in range(y)], "coloured": [None] * y}
    return {"rows": rows, "slices": planes}, {}


def tradeoffs():
    """The rows of the page, whole, and a patch for every shape."""
    scenes = committed("tradeoff").findings["scenes"]
    found = {name: one | {"case": name, "rows": [whole(row) for row in one["rows"]]} for name, one in scenes.items()}
    titles = {name: tradeoff.SCENES[name] for name in scenes}
    labels = {f"{name}: {row['label']}": Patches.corners for name, one in found.items() for row in one["rows"]}
    return {"scenes": found, "titles": titles}, Patches(**labels)


STAND_INS = {
    "fabric_drape": lambda: (committed("fabric_drape").findings, Patches()),
    "figure_3": lambda: (committed("large_mesh").findings | {"modes": 4}, Patches(6, times=np.linspace(0.0, 4.0, 6))),
    "figure_4": lambda: (committed("flat_vs_v_beam").findings, Patches()),
    "figure_5": beams,
    "figure_7": led_beam,
    "figure_8": dance,
    "grown_leaf": lambda: (committed("grown_leaf").findings, Patches()),
    "held_out_snaps": lambda: (
        committed("held_out_snaps").findings,
        Patches(
            errors=np.linspace(0.001, 0.05, 72).reshape(24, 3),
            film_DS=np.zeros((2, 4, 3)),
            film_hybrid=np.zeros((2, 4, 3)),
        ),
    ),
    "shell_theory_shapes": lambda: (committed("error_budget").findings, Patches()),
    "snap": lambda: (committed("snap").findings, Patches(4)),
    "spring_sheet_speed": spring_sheets,
    "stability_atlas": atlas,
    "strangers_meshes": lambda: (committed("strangers_meshes").findings, Patches()),
    "tradeoff": tradeoffs,
}
"""What is drawn in the place of results whose shapes are not committed: their findings, and patches for shapes."""


def test_every_other_picture_has_a_stand_in():
    assert set(STAND_INS) == SHAPED


@pytest.mark.slow
@pytest.mark.parametrize("figure", STAND_INS)
def test_no_text_of_a_picture_of_shapes_lies_on_another(figure, saved, tmp_path, monkeypatch):
    findings, arrays = STAND_INS[figure]()
    module = importlib.import_module(f"paper_figures.{figure}")
    for name in ("write_film", "film"):
        monkeypatch.setattr(module, name, lambda path, *_, **__: path, raising=False)
    monkeypatch.setattr(module, "body", lambda _: {"#112233": (arrays["positions"], arrays["faces"])}, raising=False)
    record = {"parameters": {"modes": 12, "shown": [0.005, 0.03, 0.15], "sizes": {"Cusick": [0.15, 0.09]}}}
    monkeypatch.setattr(
        StudyResult, "load", staticmethod(lambda _, study: StudyResult(study, findings, arrays, record))
    )
    module.draw(tmp_path, tmp_path)
    assert saved
    assert [each for each in saved if each] == []


def test_shapes_of_several_scenes_are_drawn_under_the_name_of_each(monkeypatch, tmp_path):
    rows = [{"label": "DS", "key": "ds", "rung": "DS", "worst_error": 0.0, "final_error": 0.0, "frame_ms": 1.0}]
    more = [rows[0] | {"label": "LMA 4", "key": "lma", "rung": "LMA", "final_error": 0.1, "worst_error": 0.1}, *rows]
    patch = {"DS": Patches.corners, "LMA 4": Patches.corners}
    given = [({"case": name, "rows": some}, patch, Patches.triangles) for name, some in (("a", rows), ("b", more))]
    drawn, paint = [], Page.paint
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    monkeypatch.setattr(Page, "paint", lambda page, images: drawn.append(page) or paint(page, images))
    cases = ((given, ["one", "two"], ["one", "two"]), (given, None, ["a", "b"]), (given[1:], None, []))
    for shapes, titles, expected in cases:
        draw_shapes(shapes, tmp_path / "shapes.png", titles)
        assert list(drawn[-1].headings) == expected
        assert {caption for caption, _ in drawn[-1].captions} == ({"DS"} if len(shapes) > 1 else {"DS", "LMA 4"})
    assert drawn[-1].font >= 16


def whole(row):
    """A row of the committed page as the study writes it."""
    specs = [spec for spec in models().values() if row["label"].startswith(spec.name)]
    spec = max(specs, key=lambda spec: len(spec.name))
    size = row["label"].removeprefix(spec.name).strip()
    errors = {"outside_error": None, "final_error": row["worst_error"]}
    return row | errors | {"key": spec.key, "rung": spec.name, "size": size}


def test_labels_of_a_front_keep_off_points_and_dotted_lines(monkeypatch, tmp_path):
    kept = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: kept.append(figure))
    marks = [Mark(10.0**k, 10.0**-k, "a", "label", False, "#112233") for k in (0.0, 0.3, 1.0)]
    draw_pareto([ParetoPanel(marks, "a mesh of the name $_{$")], tmp_path / "x.png")
    (axes,) = kept[0].axes
    kept[0].canvas.draw()
    renderer = kept[0].canvas.get_renderer()
    places = axes.transData.transform([[mark.x, mark.y] for mark in marks])
    line = np.concatenate([a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(places)])
    assert len(axes.texts) == 3
    for text in axes.texts:
        box = text.get_window_extent(renderer)
        assert not box.count_contains(line)


@pytest.mark.parametrize(
    "name", ["BONEPhalanges_Basic_Left.stl", "burnerplate_mesh.stl", "CrossCap", "ConicSpiralOfManyTurns", "x" * 30]
)
def test_a_long_name_is_broken_and_not_cut(name):
    first, rest = broken(name)
    assert first + rest == name
    assert len(first) <= LETTERS


@pytest.mark.parametrize(
    "name", ["BONEPhalanges_|B_3_R_2.stl", "burnerplate_|mesh.stl", "colored_|airplane.ply", "bunny10k_|textured.obj"]
)
def test_a_name_is_broken_between_words_into_lines_that_fit(name):
    lines = broken(name.replace("|", ""))
    assert "|".join(lines) == name
    assert max(map(len, lines)) <= LETTERS


def test_the_picture_of_mesh_bias_says_pure_twist_in_words():
    rows = committed("mesh_bias").findings["rows"]
    hinges = [abs(row["error"]) for row in rows if (row["problem"], row["energy"]) == ("twisted", "hinges")]
    told = twist_in_words(rows)
    assert "exact to rounding" in told
    assert f"{100 * min(hinges):.0f} to {100 * max(hinges):.0f} % off" in told


def test_the_checker_sees_texts_on_one_another_and_cut_ones():
    figure = Figure(figsize=(3, 2), dpi=100)
    axes = figure.add_subplot()
    axes.set(xticks=[], yticks=[])
    axes.text(0.5, 0.5, "one")
    axes.text(0.52, 0.5, "two")
    figure.text(0.9, 0.02, "a long line that ends outside")
    assert sorted(faults(figure)) == ["'a long line that ends outside' leaves the picture", "'one' lies on 'two'"]


def test_categories_are_dots_side_by_side_with_bars_and_one_legend(tmp_path, monkeypatch):
    kept = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: kept.append(figure))
    curves = [
        Curve([0, 1], [1.0, 2.0], "a", "#112233", joined=False, low=[0.5, 1.5], high=[1.5, 2.5]),
        Curve([0, 1], [1.0, 2.0], "b", "#445566", joined=False),
    ]
    panel = Panel(curves, "t", "x", "y", x_ticks={0.0: "first", 1.0: "second"})
    draw_curves([panel, panel], tmp_path / "x.png", one_legend=True)
    (figure,) = kept
    assert len(figure.axes) == 2
    lines = figure.axes[0].get_lines()
    assert all(line.get_linestyle() == "None" for line in lines)
    assert lines[0].get_xdata()[0] < 0.0 < lines[1].get_xdata()[0]
    (bars,) = figure.axes[0].collections
    assert [path.vertices[:, 1].tolist() for path in bars.get_paths()] == [[0.5, 1.5], [1.5, 2.5]]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["a", "b"]
    assert figure.axes[0].get_legend() is None


def test_curves_of_a_legend_differ_by_marker_too_and_few_decades_have_plain_ticks(tmp_path, monkeypatch):
    """Red and green of one marker look alike to many readers, and 6 times a power of ten is no number to read."""
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: drawn.append(self))
    red, green = "#c8322b", "#2f9e44"
    curves = [
        Curve([600.0, 2400.0], [0.013, 0.019], "a", red), Curve([600.0, 2400.0], [0.014, 0.018], "b", green),
        Curve([600.0, 2400.0], [0.015, 0.016], "c", red, dashed=True), Curve([600.0], [0.02], "d", "black", marker="x"),
    ]  # fmt: skip
    wide = Panel([Curve([1.0, 1e4], [1.0, 2.0], "a", green)], "", "", "", log_x=True)
    draw_curves([Panel(curves, "", "", "", log=True, log_x=True), wide], tmp_path / "a.png")
    few, many = drawn[0].axes
    assert [line.get_marker() for line in few.lines] == ["o", "s", "o", "x"]
    assert [line.get_marker() for line in many.lines] == ["o"]
    drawn[0].canvas.draw()
    for axis in (few.xaxis, few.yaxis):
        low, high = axis.get_view_interval()
        texts = [text.get_text() for text, at in zip(axis.get_ticklabels(), axis.get_majorticklocs(), strict=True)
                 if low <= at <= high]  # fmt: skip
        assert len(texts) >= 2
        assert all(re.fullmatch(r"[0-9.]+", text) for text in texts)
    assert any("10^" in text.get_text() for text in many.xaxis.get_ticklabels())
    draw_curves([Panel(curves[:1], "", "", ""), Panel(curves[1:2], "", "", "")], tmp_path / "a.png", one_legend=True)
    assert [axes.lines[0].get_marker() for axes in drawn[1].axes] == ["o", "s"]


def test_a_model_has_one_colour():
    assert model_color("MD-ROM 8") == models()["md-rom"].color
    assert model_color("MD-ROM 8, twisted") == paler(models()["md-rom"].color)
    assert model_color("coarse DS") == models()["coarse-ds"].color
    assert model_color("DS") == model_color("Isotropic") == models()["ds"].color
    assert len({matplotlib.colors.to_hex(model_color("Isotropic 24x24", number)) for number in (0, 1, 2)}) == 3
