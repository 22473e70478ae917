"""A load of another package takes one file: a class with a key, which scenes then know."""

import numpy as np
import pytest
from guide import source

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.loads import LOADS

MODULE = source("toy_ramp.py")

TABLE = '[[loads.ramp]]\nsel = "x > 0.5"\nslope = [0, 0, -1e-3]\n'
STILL = ("[motion]\nduration = 1\n", "")
FLAT = ('"v_beam"', '"flat_beam"')
WEIGHTLESS = ("[loads]\ngravity = [0, 0, -9.81]\n", "")


@pytest.fixture
def toy(install_modules):
    install_modules("ramp = toy_ramp", toy_ramp=MODULE)
    yield
    LOADS.pop("ramp", None)


def command(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    assert end.value.code == 0


@pytest.mark.slow
@pytest.mark.usefixtures("toy")
def test_a_load_of_another_package_runs_by_scene(scene_file, tmp_path):
    file = scene_file(FLAT, WEIGHTLESS, STILL, ("[model]", f"{TABLE}[model]"))
    command("run", file, "--out", tmp_path / "out")
    shell = ms.load_scene(file).build_shell()
    x = shell.rest_positions[:, 0]
    force = np.where(x > 0.5, x, 0.0)[:, None] * [0.0, 0.0, -1e-3]
    direct = ms.ModalWarping(ms.solve_modes(shell, 8)).equilibrium(force=force)
    np.testing.assert_array_equal(ms.load_trajectory(tmp_path / "out" / "scene.npz").positions[-1], direct.positions)
    assert (direct.positions - shell.rest_positions)[:, 2].min() < -0.01
    command("tradeoff", file, "--modes", "4", "--out", tmp_path / "out")
    table = (tmp_path / "out" / "scene_tradeoff.md").read_text()
    assert "MWTS 4" in table
    assert "RSW 4" in table


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("slope", "slop", "loads.ramp[0].slop: unknown key; did you mean 'slope'"),
        ("[0, 0, -1e-3]", "[0, 0]", "loads.ramp[0].slope: must be a list"),
        ("x > 0.5", "x > 5", "loads.ramp[0].sel: selects no vertex"),
        ("slope", "power = 0.5\nslope", "loads.ramp[0].power: must be an integer"),
        ("loads.ramp", "loads.rump", "loads.rump: unknown key; did you mean 'ramp'"),
    ],
)
def test_its_table_is_checked_as_others_are(scene_file, old, new, message):
    file = scene_file(FLAT, WEIGHTLESS, STILL, ("[model]", f"{TABLE.replace(old, new, 1)}[model]"))
    with pytest.raises(ms.SceneError) as refused:
        ms.load_scene(file).build()
    assert message in str(refused.value)


def test_forces_of_a_scene_are_those_of_python(scene_file):
    tables = '[[loads.point]]\nsel = "x > 0.99"\nforce = [0, 0, -1e-3]\n'
    tables += '[[loads.line]]\nsel = "x > 0.99"\nforce = [0, 0.01, 0]\n'
    built = ms.load_scene(scene_file(FLAT, WEIGHTLESS, STILL, ("[model]", f"{tables}[model]"))).build()
    mesh = built.shell.mesh
    expected = ms.PointForce("x > 0.99", (0, 0, -1e-3)).force(mesh) + ms.LineForce("x > 0.99", (0, 0.01, 0)).force(mesh)
    np.testing.assert_array_equal(built.force, expected)
