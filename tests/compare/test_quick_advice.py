"""Advice by error bars: right against DS, without an answer of DS."""

import pytest

import modalshell as ms
from modalshell.commands.cli import main

SCENE = """
[mesh]
shape = "v_beam"
fold = 150.0
cells = [20, 4]
[material]
stretch = 2000.0
shear = 2000.0
flexure = 0.05
density = 0.2
[supports]
clamped = "x < 0.051"
[loads]
gravity = [0.0, 2.0, %g]
[model]
name = "lma"
"""


@pytest.fixture
def shell():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    return ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.051")


def test_the_rung_it_names_meets_the_error_and_those_before_it_do_not(shell, monkeypatch):
    gravity = (0.0, 2.0, -15.0)
    monkeypatch.setattr(ms.DiscreteShell, "equilibrium", None)
    advice = ms.quick_advice(shell, gravity=gravity, error=0.01, modes=(2, 6))
    monkeypatch.undo()
    assert advice.chosen is advice.rows[-1].candidate
    exact = ms.DiscreteShell(shell).equilibrium(gravity=gravity)
    factory = ms.compare.candidates.case_factory(ms.compare.Case("a", shell, shell.gravity_force(gravity)))
    errors = []
    for row in advice.rows:
        answer = row.candidate.build(factory)[0].equilibrium(gravity=gravity)
        errors.append(ms.measure.displacement_error(answer.positions, exact.positions, shell))
        assert row.bars[-1].displacement == pytest.approx(errors[-1], rel=0.05)
    assert errors[-1] <= 0.01
    assert min(errors[:-1], default=1.0) > 0.01
    assert advice.explanation.startswith(f"Take {advice.chosen.label}: at rest it is within ")
    assert advice.snap is None or advice.snap > 1.5


def test_before_a_snap_it_names_ds(shell):
    """DS leaves its branch at 41.5."""
    advice = ms.quick_advice(shell, gravity=(0.0, 13.0, -48.5), error=0.05)
    assert advice.model_table == {"name": "ds"}
    assert 0.7 < advice.snap < 1.0
    assert "expected to leave its branch" in advice.explanation
    assert len(advice.rows) == 2  # the first rung, and the most exact one


def test_the_command_names_it_and_writes_a_scene(tmp_path, capsys):
    scene, out = tmp_path / "scene.toml", tmp_path / "new.toml"
    scene.write_text(SCENE % -50.0)
    with pytest.raises(SystemExit) as ended:
        main(["advise", str(scene), "--quick", "--error", "0.05", "--write", str(out)])
    assert ended.value.code == 0
    assert "Take DS" in capsys.readouterr().out
    assert ms.load_scene(out).model.spec.key == "ds"


def test_an_error_of_nothing_is_refused(shell):
    with pytest.raises(ms.OptionError, match="error must be"):
        ms.quick_advice(shell, gravity=(0.0, 0.0, -1.0), error=0.0)
