"""``[material]`` by kind: sheets that are not isotropic, from scene files."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.scene import load_scene

SCENE = """
[mesh]
shape = "sheet"
length = 0.4
width = 0.3
cells = [8, 6]

[material]
{material}

[[supports]]
kind = "clamp"
sel = "x < 1e-6"

[loads]
gravity = [0.0, 0.0, -9.81]

[model]
name = "ds"
"""
ORTHOTROPIC = """kind = "orthotropic"
young = [10e9, 1e9]
shear = 0.7e9
poisson = 0.35
thickness = 2e-3
density = 600.0
direction = {direction}
"""


def scene(tmp_path, material):
    file = tmp_path / "scene.toml"
    file.write_text(SCENE.format(material=material))
    return load_scene(file)


@pytest.mark.parametrize("direction", ["30.0", "[1.0, 0.5, 0.0]"])
def test_an_orthotropic_scene_is_the_sheet_in_python(tmp_path, direction):
    shell = scene(tmp_path, ORTHOTROPIC.format(direction=direction)).build_shell()
    sheet = ms.Orthotropic(
        young=(10e9, 1e9),
        shear=0.7e9,
        poisson=0.35,
        thickness=2e-3,
        density=600.0,
        direction=30.0 if direction == "30.0" else (1.0, 0.5, 0.0),
    )
    same = ms.Shell(shell.mesh, sheet, clamped="x < 1e-6")
    x = shell.rest_positions + 1e-3 * np.random.default_rng(0).normal(size=shell.rest_positions.shape)
    assert shell.energy(x) == same.energy(x)


def test_a_fabric_scene_is_the_fabric_in_python(tmp_path):
    text = """kind = "fabric"
stretch = [2000.0, 1500.0, 300.0]
bending = [64e-6, 97e-6, 33e-6, 1e-6]
density = 0.324
"""
    shell = scene(tmp_path, text).build_shell()
    sheet = ms.Fabric(stretch=(2000.0, 1500.0, 300.0), bending=(64e-6, 97e-6, 33e-6, 1e-6), density=0.324)
    x = shell.rest_positions + 1e-3 * np.random.default_rng(0).normal(size=shell.rest_positions.shape)
    assert shell.energy(x) == ms.Shell(shell.mesh, sheet, clamped="x < 1e-6").energy(x)


@pytest.mark.parametrize(
    ("material", "match"),
    [
        ('kind = "wood"', r"material.kind: must be one of .*orthotropic"),
        (ORTHOTROPIC.format(direction='"x"'), "material.direction"),
        (ORTHOTROPIC.format(direction="0.0").replace("0.35", "4.0"), "material.poisson: is too large"),
        (ORTHOTROPIC.format(direction="0.0").replace("[10e9, 1e9]", "10e9"), "material.young"),
        (ORTHOTROPIC.format(direction="0.0") + "ply = 1", "ply"),
    ],
)
def test_a_wrong_sheet_is_refused_by_its_key(tmp_path, material, match):
    with pytest.raises(ms.SceneError, match=match):
        scene(tmp_path, material).build_shell()
