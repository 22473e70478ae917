"""Clamps of one row on materials of hinges are told: the sheet turns about them."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.scene.remarks import hinged_clamp_remark

HINGES = "stretch = 200.0\nshear = 200.0\nflexure = 0.05\ndensity = 0.2"
THEORY = "young = 1e6\npoisson = 0.3\nthickness = 0.01\ndensity = 10.0"
SCENE = """
[mesh]
shape = "flat_beam"
length = 1.0
width = 0.2
cells = [10, 2]
[material]
{material}
[supports]
clamped = "x < {reach}"
[loads]
gravity = [0.0, 0.0, -1.0]
[model]
name = "ds"
"""


def built(tmp_path, material, reach):
    file = tmp_path / "strip.toml"
    file.write_text(SCENE.format(material=material, reach=reach))
    return ms.load_scene(file).build_shell()


def test_a_scene_of_hinges_held_by_one_row_says_that_it_turns_there(tmp_path):
    with pytest.warns(ms.ModalShellWarning, match=r"one row of vertices at 2 edges of the rim.*second row"):
        shell = built(tmp_path, HINGES, 0.05)
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -1e-3))
    assert answer.positions[:, 2].min() < -0.9  # it hangs
    built(tmp_path, HINGES, 0.15)
    built(tmp_path, THEORY, 0.05)


@pytest.mark.parametrize("family", ["alternating", "delaunay", "equilateral"])
def test_rows_by_rows_and_supports_that_pin_are_told_apart(family):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4), family=family)
    x = mesh.vertices[:, 0]
    row, end = x < 1e-9, x > 1.0 - 0.12
    assert "4 edges" in hinged_clamp_remark(mesh, [ms.Clamp(row)])
    assert "4 edges" in hinged_clamp_remark(mesh, [ms.Clamp(row), ms.Clamp(end)])
    assert hinged_clamp_remark(mesh, [ms.Clamp(end)]) == ""
    assert hinged_clamp_remark(mesh, [ms.Pin(row)]) == ""
    assert hinged_clamp_remark(mesh, [ms.Clamp(row), ms.Pin(x < 0.12)]) == ""
    assert "4 edges" in hinged_clamp_remark(mesh, [ms.Clamp(row), ms.Fix(x < 0.12, "z")])
    assert hinged_clamp_remark(mesh, [ms.Clamp(np.arange(len(x)) == 0)]) == ""
