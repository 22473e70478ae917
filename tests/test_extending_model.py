"""A model of another package takes two files: its own, and a module that registers its record."""

import numpy as np
import pytest
from guide import source

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.models.registry import MODELS, register

MODEL = source("toy_model.py")
RECORD = source("toy_record.py")
TOY = ('name = "mwts"', 'name = "scaled"\nfactor = 0.5\nmodes = 4')
STILL = ("[motion]\nduration = 1\n", "")
WEAK = ("-9.81", "-0.5")


@pytest.fixture
def toy(install_modules):
    install_modules("scaled = toy_record", toy_model=MODEL, toy_record=RECORD)
    yield
    MODELS.pop("scaled", None)


def command(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    assert end.value.code == 0


@pytest.mark.usefixtures("toy")
def test_a_model_of_another_package_runs_by_scene_and_stands_on_the_ladder(scene_file, tmp_path):
    file = scene_file(TOY, STILL, WEAK)
    command("run", file, "--out", tmp_path / "out")
    shell = ms.load_scene(file).build_shell()
    linear = ms.LinearModal(ms.solve_modes(shell, 4)).equilibrium(gravity=(0, 0, -0.5)).positions
    run = ms.load_trajectory(tmp_path / "out" / "scene.npz").positions[-1]
    np.testing.assert_allclose(run - shell.rest_positions, 0.5 * (linear - shell.rest_positions), atol=1e-15)
    command("tradeoff", file, "--modes", "4", "--out", tmp_path / "out")
    assert "scaled 4" in (tmp_path / "out" / "scene_tradeoff.md").read_text()
    assert list(ms.models())[1:3] == ["lma", "scaled"]


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("factor", "facto", "model.facto: unknown key; did you mean 'factor'"),
        ("0.5", '"x"', "model.factor: must be a number"),
        ('"scaled"', '"scald"', "model.name: must be one of rigid, lma, scaled, mwts"),
    ],
)
def test_its_table_is_checked_as_others_are(scene_file, old, new, message):
    with pytest.raises(ms.SceneError) as refused:
        ms.load_scene(scene_file((TOY[0], TOY[1].replace(old, new, 1)), STILL, WEAK))
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"key": "lma"}, "there is a model 'lma'"),
        ({"name": "DS"}, "there is"),
        ({"key": "A b"}, "key must be"),
        ({"needs": "x"}, "needs must be"),
    ],
)
def test_records_that_cannot_be_are_refused(changed, message):
    values = {"key": "toy", "name": "toy", "builder": ms.RigidShell, "needs": "shell", "cost": 1.0} | changed
    with pytest.raises(ms.OptionError, match=message):
        register(ms.ModelSpec(**values))
    assert "toy" not in ms.models()
