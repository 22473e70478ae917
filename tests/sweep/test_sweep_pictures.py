"""Pictures of a sweep's summary: curves, maps, or none."""

import numpy as np
import pytest


@pytest.mark.by_default("axes7-none")
@pytest.mark.parametrize(
    ("axes", "kind"),
    [
        ([5], "curves"),
        ([5, 3], "curves"),
        ([3, 3, 5], "curves"),
        ([4, 4], "map"),
        ([2, 4, 5], "map"),
        (["words"], "curves"),
        (["words", 4, 4], "map"),
        ([9, 3, 3, 3], "none"),
    ],
)
def test_pictures(tmp_path, monkeypatch, axes, kind):
    from modalshell.sweep import figure
    from modalshell.sweep.grid import Axis

    drawn = []
    for name in ("draw_curves", "draw_maps"):
        draw = getattr(figure, name)
        monkeypatch.setattr(figure, name, lambda *a, n=name, d=draw, **o: (drawn.append((n, a[0])), d(*a, **o)))
    made = [
        Axis(f"k{k}", ("one", "two") if size == "words" else tuple([0.0, 0.0, -1.0 * 2**i] for i in range(size)))
        for k, size in enumerate(axes)
    ]
    count = int(np.prod([len(axis.values) for axis in made]))
    rows = [{"case": k, "error": None if k == 1 else 0.1 * k} for k in range(count)]
    note = figure.draw_summary(rows, made, "error", tmp_path / "picture.png", "title", {})
    if kind == "none":
        assert "too many" in note
        assert drawn == []
        return
    assert note == ""
    assert (tmp_path / "picture.png").stat().st_size > 5000
    assert drawn[0][0] == ("draw_maps" if kind == "map" else "draw_curves")
    if kind == "map":
        cells = [name for panel in drawn[0][1] for row in panel.classes for name in row]
        assert (len(cells), cells.count("no value")) == (count, 1)
    else:
        assert sum(len(curve.x) for panel in drawn[0][1] for curve in panel.curves) == count - 1


@pytest.mark.slow
def test_long_names_of_curves_are_whole(tmp_path):
    """Those below the axes were cut at both borders."""
    from matplotlib.image import imread

    from modalshell.render.curves import Curve, Panel, draw_curves

    curves = [Curve([0, 1], [0, k], f"mesh.file = $_{{$.obj, loads.pressure.0.p = {k}", "red") for k in range(6)]
    picture = imread(draw_curves([Panel(curves, "", "x", "y")], tmp_path / "curves.png"))
    assert (picture[:, [0, 1, -2, -1], :3] == picture[0, 0, :3]).all()


@pytest.mark.parametrize(
    ("values", "label"),
    [((1.0, 2.0), "mesh.length [mm]"), (([0.0, 0.0, 1.0], [0.0, 0.0, 2.0]), "|mesh.length| [mm]")],
)
def test_axes_of_numbers_have_their_units(tmp_path, monkeypatch, values, label):
    from modalshell.sweep import figure
    from modalshell.sweep.grid import Axis

    panels = []
    monkeypatch.setattr(figure, "draw_curves", lambda drawn, *_, **__: panels.extend(drawn))
    rows = [{"error": 0.1}, {"error": 0.2}]
    axes = [Axis("mesh.length", values)]
    figure.draw_summary(rows, axes, "error", tmp_path / "p.png", "title", {"mesh.length": "mm", "error": "1"})
    assert panels[0].x_label == label


def _panels(tmp_path, monkeypatch, name, *given):
    from modalshell.sweep import figure

    drawn = []
    draw = getattr(figure, name)
    monkeypatch.setattr(figure, name, lambda panels, *a, **o: (drawn.extend(panels), draw(panels, *a, **o)))
    assert figure.draw_summary(*given, "displacement", tmp_path / "p.png", "title", {}) == ""
    return drawn


def test_what_has_not_converged_is_crossed_out(tmp_path, monkeypatch):
    """It stood in the picture as an answer like the others."""
    from modalshell.sweep.grid import Axis

    axes = [Axis("loads.pressure.0.p", (1.0, 2.0)), Axis("supports.0.kind", ("clamp", "pin"))]
    rows = [{"displacement": 0.1 * k, "converged": k != 2} for k in range(4)]
    (panel,) = _panels(tmp_path, monkeypatch, "draw_curves", rows, axes)
    crosses = panel.curves[-1]
    assert (crosses.label, crosses.marker, crosses.joined) == ("not converged", "x", False)
    assert list(zip(crosses.x, crosses.y, strict=True)) == [(2.0, 0.2)]
    axes = [Axis(key, tuple(float(k) for k in range(4))) for key in ("a", "b")]
    rows = [{"displacement": None if k == 0 else 0.1 * k, "converged": k != 7} for k in range(16)]
    (panel,) = _panels(tmp_path, monkeypatch, "draw_maps", rows, axes)
    assert [panel.classes[3][1], panel.classes[0][0]] == ["not converged", "no value"]


def test_tables_as_values_have_short_names(tmp_path, monkeypatch):
    """Whole tables in a legend hid the curves, and left the axes no room."""
    from modalshell.sweep.grid import Axis

    ply = {"young": [1e8, 1e8], "shear": 4e7, "poisson": 0.3, "density": 100.0, "angle": 0.0, "thickness": 1e-3}
    plies = [[ply] * 3, [ply | {"angle": 30.0}] * 3]
    materials = ({"kind": "card", "name": "denim"}, *({"kind": "laminate", "plies": stack} for stack in plies))
    axes = [Axis("loads.pressure.0.p", (1.0, 2.0)), Axis("material", materials)]
    rows = [{"displacement": 0.1 * k, "converged": True} for k in range(6)]
    (panel,) = _panels(tmp_path, monkeypatch, "draw_curves", rows, axes)
    names = [curve.label for curve in panel.curves]
    assert names[0].startswith("material = kind card, denim")
    assert len(set(names)) == 3
    assert max(map(len, names)) < 50
    sheets = tuple({"young": young, "poisson": 0.3, "thickness": 1e-3} for young in (1e7, 1e8))
    (panel,) = _panels(tmp_path, monkeypatch, "draw_curves", rows[:4], [axes[0], Axis("material", sheets)])
    assert [curve.label for curve in panel.curves] == ["material = young 1e+07", "material = young 1e+08"]
