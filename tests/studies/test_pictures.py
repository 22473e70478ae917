"""Pictures of the studies, drawn from the committed findings: no text lies on another or leaves the picture."""

import importlib
from itertools import pairwise

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from text_boxes import faults

from modalshell.compare.draw import draw_fronts
from modalshell.files.study_result import StudyResult
from modalshell.models.registry import models
from modalshell.render.curves import Curve, Panel, draw_curves
from modalshell.render.pareto import Mark, ParetoPanel, draw_pareto
from paper_figures.mesh_bias import twist_in_words
from paper_figures.model_colors import model_color, paler
from paper_figures.strangers_meshes import LETTERS, broken
from studies.pages import committed
from studies.reproduce import studies

ARRAYS = {
    "figure_3", "figure_4", "figure_5", "figure_7", "figure_8", "folded_map", "held_out_snaps", "shell_theory_shapes",
    "snap", "spring_sheet_speed", "stability_atlas", "strangers_meshes", "tradeoff",
}  # fmt: skip
"""Figures that need more than the committed findings: shapes, or keys of older pages."""
DRAWN = [figure for study in studies().values() for figure in study.FIGURES if figure not in ARRAYS]
QUICK = {"held_out_advice", "identification", "cloth_scaling"}


@pytest.fixture
def saved(monkeypatch):
    """The faults of every figure that is saved."""
    found, save = [], Figure.savefig

    def checked(figure, *arguments, **options):
        found.append(faults(figure))
        return save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", checked)
    return found


def test_most_pictures_are_drawn_here():
    assert len(DRAWN) > 18


@pytest.mark.parametrize(
    "figure", [pytest.param(name, marks=[] if name in QUICK else [pytest.mark.slow]) for name in DRAWN]
)
def test_no_text_lies_on_another(figure, saved, tmp_path, monkeypatch):
    monkeypatch.setattr(StudyResult, "load", staticmethod(lambda _, study: committed(study)))
    importlib.import_module(f"paper_figures.{figure}").draw(tmp_path, tmp_path)
    assert saved
    assert [each for each in saved if each] == []


@pytest.mark.slow
def test_no_text_of_the_paths_through_snaps_lies_on_another(saved, tmp_path):
    importlib.import_module("paper_figures.snap").draw_paths(committed("snap"), tmp_path)
    assert saved == [[]]


def whole(row):
    """A row of the committed page as the study writes it."""
    specs = [spec for spec in models().values() if row["label"].startswith(spec.name)]
    spec = max(specs, key=lambda spec: len(spec.name))
    size = row["label"].removeprefix(spec.name).strip()
    return row | {"outside_error": None, "key": spec.key, "rung": spec.name, "size": size}


@pytest.mark.slow
def test_no_label_of_the_fronts_lies_on_another(saved, tmp_path):
    scenes = committed("tradeoff").findings["scenes"]
    fronts = [{"case": name, "rows": [whole(row) for row in one["rows"]]} for name, one in scenes.items()]
    draw_fronts(fronts, tmp_path / "tradeoff.png")
    assert saved == [[]]


def test_labels_of_a_front_keep_off_points_and_dotted_lines(monkeypatch, tmp_path):
    kept = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: kept.append(figure))
    marks = [Mark(10.0**k, 10.0**-k, "a", "label", False, "#112233") for k in (0.0, 0.3, 1.0)]
    draw_pareto([ParetoPanel(marks, "t")], tmp_path / "x.png")
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


def test_a_model_has_one_colour():
    assert model_color("MD-ROM 8") == models()["md-rom"].color
    assert model_color("MD-ROM 8, twisted") == paler(models()["md-rom"].color)
    assert model_color("coarse DS") == models()["coarse-ds"].color
    assert model_color("DS") == model_color("Isotropic") == models()["ds"].color
    assert len({matplotlib.colors.to_hex(model_color("Isotropic 24x24", number)) for number in (0, 1, 2)}) == 3
