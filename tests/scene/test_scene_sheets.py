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


def test_a_laminate_scene_is_the_laminate_in_python(tmp_path):
    moduli = "young = [140e9, 10e9], shear = 5e9, poisson = 0.3, density = 1600.0, thickness = 1e-4"
    plies = ", ".join(f"{{ {moduli}, angle = {angle} }}" for angle in (0.0, 90.0, 90.0, 0.0))
    shell = scene(tmp_path, f'kind = "laminate"\nplies = [{plies}]\ndirection = 20.0').build_shell()
    ply = ms.Orthotropic(young=(140e9, 10e9), shear=5e9, poisson=0.3, thickness=1e-4, density=1600.0)
    sheet = ms.Laminate([ms.Ply(ply, angle, 1e-4) for angle in (0.0, 90.0, 90.0, 0.0)], 20.0)
    x = shell.rest_positions + 1e-3 * np.random.default_rng(0).normal(size=shell.rest_positions.shape)
    assert shell.energy(x) == ms.Shell(shell.mesh, sheet, clamped="x < 1e-6").energy(x)


def test_a_laminate_scene_takes_isotropic_plies(tmp_path):
    """A ply of one young is the same in all directions, and needs no angle."""
    wood = "{ young = [10e9, 1e9], shear = 1e9, poisson = 0.3, density = 600.0, thickness = 1e-3, angle = 30.0 }"
    metal = "{ young = 70e9, poisson = 0.3, density = 2700.0, thickness = 2e-4 }"
    shell = scene(tmp_path, f'kind = "laminate"\nplies = [{metal}, {wood}, {metal}]').build_shell()
    core = ms.Orthotropic(young=(10e9, 1e9), shear=1e9, poisson=0.3, thickness=1e-3, density=600.0)
    skin = ms.Ply(ms.Isotropic(young=70e9, poisson=0.3, thickness=2e-4, density=2700.0), 0.0, 2e-4)
    sheet = ms.Laminate([skin, ms.Ply(core, 30.0, 1e-3), skin])
    x = shell.rest_positions + 1e-3 * np.random.default_rng(0).normal(size=shell.rest_positions.shape)
    assert shell.energy(x) == ms.Shell(shell.mesh, sheet, clamped="x < 1e-6").energy(x)


def test_a_card_in_a_scene(tmp_path):
    built = scene(tmp_path, 'kind = "card"\nname = "royal-target"\ndirection = [0, 1, 0]')
    sheet = built.build_shell().material
    card = ms.card("royal-target")
    assert sheet.bending == card.bending
    assert sheet.direction == (0.0, 1.0, 0.0)
    text = SCENE.format(material='kind = "card"\nname = "royal-target"') + '[units]\nlength = "mm"\nmass = "t"\n'
    (tmp_path / "scene.toml").write_text(text)
    with pytest.raises(ms.SceneError, match=r"material.name: 'royal-target' is a card in m, kg and s"):
        load_scene(tmp_path / "scene.toml").build_shell()


@pytest.mark.parametrize(
    ("material", "match"),
    [
        ('kind = "card"\nname = "denim"', r"material: card must be one of|material.name"),
        ('kind = "card"\nname = "steel-0.1mm"\ndirection = 3.0', "material.direction: must be left out"),
        ('kind = "laminate"\nplies = [{ kind = "isotropic", young = 1e9 }]', r"material.plies\[0\].kind: unknown key"),
        (
            'kind = "laminate"\nplies = [{ young = 1e9, shear = 1e8, poisson = 0.3, density = 1e3, thickness = 1e-3 }]',
            r"material.plies\[0\]: must have young = \[E1, E2\] and a shear modulus, or one young alone",
        ),
        (
            'kind = "laminate"\nplies = [{ young = [1e9, 1e8], poisson = 0.3, density = 1e3, thickness = 1e-3 }]',
            r"material.plies\[0\]: must have .* \(got young = \(1000000000.0, 100000000.0\), shear = None\)",
        ),
        ('kind = "isotropic"', r"material.kind: an isotropic sheet has no kind: leave it out, and give young, poisson"),
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
