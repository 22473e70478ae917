"""Other engines in a comparison: rows with errors and cost, a table, and marks in the picture."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PLAIN

import modalshell as ms
from modalshell.compare import engine_runs as engines
from modalshell.compare.draw import pareto_panel
from modalshell.compare.engines import EngineAnswer
from modalshell.core.units import UnitSystem

SHEET = ms.Isotropic(young=1e7, poisson=0.0, thickness=3e-3, density=1000.0)


@pytest.fixture
def shell():
    mesh = ms.flat_beam(length=0.3, width=0.03, cells=(8, 2))
    return ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < 1e-9)


@pytest.fixture
def answers(monkeypatch):
    """One engine that is off by 10 %, one that is missing."""
    found = [EngineAnswer("Missing", "not installed: pip install it")]

    def answered(engine, shell, loads):
        if engine is engines.ENGINES[1]:
            return found[0]
        exact = ms.DiscreteShell(shell).equilibrium(force=loads[0][1]).positions
        off = shell.rest_positions + 1.1 * (exact - shell.rest_positions)
        return EngineAnswer(engine.name, "counts", "Fake 1", 0.01, 2.0, 1e-3, 5.0, off[None])

    monkeypatch.setattr(engines, "answered", answered)
    monkeypatch.setattr(engines, "ENGINES", engines.ENGINES[:2])


@pytest.mark.usefixtures("answers")
def test_engines_are_rows_of_a_tradeoff(shell, tmp_path):
    found = ms.tradeoff(shell, gravity=(0.0, 0.0, -1.0), modes=[2], loads=[1.0], engines=True)
    fake, missing = found.engines
    assert fake["error"] == pytest.approx(0.1, rel=1e-3)
    assert missing["error"] is None
    table = found.table()
    engine = engines.ENGINES[0]
    assert f"| {engine.name} | counts | +1.0 % | 10 % | 5 | 0.001 | 2 | Fake 1 |" in table
    assert "| Missing | not installed: pip install it | - | - | - | - | - |  |" in table
    marks = [mark for mark in pareto_panel(found.findings(), "").marks if mark.group == engine.name]
    assert [(mark.x, mark.y) for mark in marks] == [(5.0, pytest.approx(10.0, rel=1e-3))]
    assert (marks[0].color, marks[0].marker) == (engine.color, engine.marker)
    assert all(path.stat().st_size for path in found.save(tmp_path))


@pytest.mark.slow
def test_without_engines_nothing_is_told(shell):
    found = ms.tradeoff(shell, gravity=(0.0, 0.0, -1.0), modes=[2], loads=[1.0])
    assert found.engines == []
    assert "engine" not in found.table()
    assert engines.engine_lines([]) == []


def test_no_two_engines_and_no_engine_and_model_look_alike():
    looks = [(one.color, one.marker) for one in engines.ENGINES]
    assert len(set(looks)) == len(looks)
    assert not {color for color, _ in looks} & {spec.color for spec in ms.models().values()}


def test_a_shell_of_hinges_is_beyond_the_engines():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    shell = ms.Shell(mesh, PLAIN, mesh.vertices[:, 0] < 0.13)
    case = ms.compare.case.make_case(shell, (0.0, 0.0, -0.1), None, ())
    rows = engines.engine_rows(case, np.array(mesh.vertices))
    assert all(row["outcome"].startswith("cannot express") for row in rows)


@pytest.mark.usefixtures("answers")
def test_a_stable_step_is_told_in_seconds_whatever_the_unit_of_time(shell):
    case = replace(ms.compare.case.make_case(shell, (0.0, 0.0, -1.0), None, ()), units=UnitSystem(time="ms"))
    assert engines.engine_rows(case, None)[0]["step"] == pytest.approx(1e-6)  # of 1e-3 ms


def test_a_load_on_what_supports_hold_is_nothing_to_compare():
    mesh = ms.flat_beam(cells=(6, 2))
    rests = [ms.Clamp(mesh.vertices[:, 0] < 0.2), ms.Fix(np.ones(len(mesh.vertices), bool), axes="z")]
    held = ms.Shell(mesh, SHEET, supports=rests)
    with pytest.raises(ms.OptionError, match="no load moves the shell"):
        ms.compare.case.make_case(held, (0.0, 0.0, -1.0), None, ())
