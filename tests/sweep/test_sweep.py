"""Sweeps: the case files, what a restart does, and what becomes of cases that go wrong."""

import csv
import json
import os
import re

import numpy as np
import pytest
from scenes import LOADED_BEAM, SWEEP_AXES

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.files.lock import acquire_lock
from modalshell.sweep.case import run_case
from modalshell.sweep.grid import load_sweep
from modalshell.sweep.store import CaseFolder
from modalshell.sweep.summary import unit_rows

FILES = ("beams_sweep.csv", "beams_sweep.png", "beams_sweep_runs.csv", "beams_sweep_units.csv")


@pytest.fixture
def here(monkeypatch):
    """Cases are computed in this process, which has no workers to start."""
    monkeypatch.setattr("modalshell.sweep.driver.run_locally", in_this_process)


def in_this_process(tasks, _workers, _limit):
    yield from map(run_case, tasks)


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def case_files(folder):
    return sorted(path for path in (folder / "beams_cases").iterdir() if path.suffix == ".json")


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """A sweep with a truth, computed in this process: its file, folder and result."""
    folder = tmp_path_factory.mktemp("swept")
    (folder / "base.toml").write_text(LOADED_BEAM)
    file = folder / "beams.toml"
    file.write_text(
        f'scene = "base.toml"\n[axes]\n{SWEEP_AXES}\n"material.flexure" = [0.05, 0.1]\n[truth]\nname = "ds"\n'
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("modalshell.sweep.driver.run_locally", in_this_process)
        return file, folder / "out", ms.run_sweep(file, out=folder / "out")


def copied(swept, tmp_path):
    """The sweep again beside a copy of its results."""
    import shutil

    shutil.copytree(swept[1], tmp_path / "out")
    return swept[0], tmp_path / "out"


@pytest.mark.slow
def test_rows_are_what_the_scenes_give(swept, tmp_path):
    _, folder, result = swept
    assert result.counts() == {"converged": 12}
    assert (result.computed, result.stored) == (12, 0)  # the truths are on the grid
    rows = rows_of(folder / "beams_sweep.csv")
    assert [row["model.name"] for row in rows] == ["lma", "lma", "mwts", "mwts", "ds", "ds"] * 2
    assert [json.loads(row["loads.gravity"])[2] for row in rows] == [-1] * 6 + [-2] * 6
    for number in (2, 8):  # mwts and lma
        scene = LOADED_BEAM.replace("-4.0", rows[number]["loads.gravity"].strip("[]").split(",")[2])
        (tmp_path / "one.toml").write_text(scene.replace("mwts", rows[number]["model.name"]))
        built = ms.load_scene(tmp_path / "one.toml").build()
        answer = built.equilibrium()
        moved = np.linalg.norm(answer.positions - built.shell.rest_positions, axis=1).max()
        row = rows[number]
        assert float(row["displacement"]) == pytest.approx(moved, rel=1e-9)
        assert float(row["area_change"]) == pytest.approx(ms.measure.area_change(answer.positions, built.shell.mesh))
        assert float(row["elastic_energy"]) == pytest.approx(built.shell.energy(answer.positions), rel=1e-7)
        assert (row["converged"], row["iterations"]) == ("true", str(answer.iterations))
        truth = ms.DiscreteShell(built.shell).equilibrium(gravity=built.gravity, force=built.force)
        expected = ms.measure.displacement_error(answer.positions, truth.positions, built.shell)
        assert float(row["error"]) == pytest.approx(expected, rel=1e-4)
    assert {row["error"] for row in rows if row["model.name"] == "ds"} == {"0.0"}
    assert all(float(row["error"]) > 1e-3 for row in rows if row["model.name"] != "ds")
    assert [path.name for path in result.files] == list(FILES)
    units = {row["column"]: row["unit"] for row in rows_of(result.files[3])}
    assert set(units) == set(rows[0])
    assert (units["displacement"], units["elastic_energy"], units["error"]) == ("m", "J", "1")
    assert {row["versions"].split(",")[0] for row in rows_of(result.files[2])} == {f"modalshell {ms.__version__}"}


def test_workers_find_the_same_bits(swept, tmp_path):
    file, folder, _ = swept
    steps = []
    ms.run_sweep(file, out=tmp_path, workers=2, on_step=lambda *step: steps.append(step))
    assert steps == [(done, 12) for done in range(1, 13)]
    for name in ("beams_sweep.csv", "beams_sweep.png"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_a_restart_does_what_is_missing_alone(swept, tmp_path):
    file, folder = copied(swept, tmp_path)
    whole = (folder / "beams_sweep.csv").read_bytes()
    stored = {path: path.read_bytes() for path in case_files(folder)}
    assert len(stored) == 12
    assert ms.run_sweep(file, out=folder).computed == 0
    missing, cut, flipped = list(stored)[2:5]
    missing.unlink()
    cut.write_bytes(stored[cut][:-40])
    place = stored[flipped].index(b'"displacement":') + 20
    flipped.write_bytes(stored[flipped][:place] + b"1" + stored[flipped][place + 1 :])
    (folder / "beams_cases" / f".{'0' * 64}.1.part.json").write_bytes(b"half")
    result = ms.run_sweep(file, out=folder)
    assert (result.computed, result.stored) == (3, 9)
    assert (folder / "beams_sweep.csv").read_bytes() == whole
    assert case_files(folder) == list(stored)
    for path in stored.keys() - {missing, cut, flipped}:
        assert path.read_bytes() == stored[path]


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_a_changed_sweep_keeps_what_is_the_same(swept, tmp_path):
    file, folder = copied(swept, tmp_path)
    (tmp_path / "base.toml").write_text(LOADED_BEAM)
    changed = tmp_path / "beams.toml"
    changed.write_text(file.read_text().replace("[0, 0, -2]", "[0, 0, -3]").replace("0.1]", "0.1, 0.2]"))
    result = ms.run_sweep(changed, out=folder)
    assert (len(result.rows), result.computed, result.stored) == (18, 12, 6)
    assert len(case_files(folder)) == 24


@pytest.mark.usefixtures("here")
def test_scenes_that_cannot_be_solved_are_results(write, tmp_path):
    file = write('"model.modes" = [4, 9999]', 'truth = { name = "md-rom", modes = 9999 }')
    result = ms.run_sweep(file, out=tmp_path / "out")
    assert result.counts() == {"converged": 1, "refused": 1}
    refused = result.rows[1]
    assert "9999" in refused["message"]
    assert refused["displacement"] is None
    assert [row["error"] for row in result.rows] == [None, None]
    assert "9999" in result.rows[0]["truth_message"]
    assert result.note == "no picture: no case has a value of 'error'"
    again = ms.run_sweep(file, out=tmp_path / "out", retry=True)
    assert (again.computed, again.rows) == (0, result.rows)


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_motions_are_summed_up(write, tmp_path):
    motion = "[motion]\nduration = 1.2\ndt = 0.02\ndamping = [0.5, 0.0]\nstore_every = 2\n"
    file = write('"model.name" = ["lma", "mwts"]', 'truth = { name = "ds" }', scene=LOADED_BEAM + motion)
    rows = ms.run_sweep(file, out=tmp_path / "out").rows
    (tmp_path / "base.toml").write_text(LOADED_BEAM + motion)
    run = ms.run_scene(tmp_path / "base.toml", out=tmp_path / "run").trajectory
    moved = np.linalg.norm(run.positions - run.rest_positions, axis=2).max(axis=1)
    assert rows[1]["frames"] == len(run.times) == 31
    assert rows[1]["displacement"] == pytest.approx(moved[-1], rel=1e-9)
    assert rows[1]["peak_displacement"] == pytest.approx(moved.max(), rel=1e-9)
    assert rows[1]["peak_displacement"] > rows[1]["displacement"]
    assert rows[1]["kinetic_energy"] == pytest.approx(run.energies[-1, 0], rel=1e-9)
    assert all(0.0 < row["error"] < 1.0 for row in rows)


SABOTAGE = """
import os, time
import modalshell.sweep.case as case
solved = case._solved
def sabotaged(built):
    modes = built.scene.model.modes
    with open(os.environ["SABOTAGE_LOG"], "a") as log:
        log.write(f"{modes} ")
    if modes == 3: os.kill(os.getpid(), 11)
    if modes == 5: raise IndexError("a slip")
    if modes == 6: time.sleep(600)
    return solved(built)
case._solved = sabotaged
"""


@pytest.fixture
def sabotage(tmp_path, monkeypatch):
    """Workers die at three modes, fail at five and never end at six; the file lists the cases they were given."""
    (tmp_path / "sitecustomize.py").write_text(SABOTAGE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("SABOTAGE_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


@pytest.mark.slow
def test_a_case_that_kills_its_process_does_not_end_the_sweep(write, tmp_path, sabotage, monkeypatch):
    file = write('"model.modes" = [2, 3, 4, 5]')
    result = ms.run_sweep(file, out=tmp_path / "out", workers=1)
    assert [row["outcome"] for row in result.rows] == ["converged", "failed", "converged", "failed"]
    assert sorted(sabotage.read_text().split()) == list("233345")
    crashed, _, failed = result.rows[1:]
    assert crashed["message"] == "3 processes died at it (exit status -11: Fatal Python error: Segmentation fault)"
    assert failed["message"] == "IndexError: a slip"
    monkeypatch.setattr("modalshell.sweep.driver.run_locally", in_this_process)
    assert ms.run_sweep(file, out=tmp_path / "out").computed == 0
    again = ms.run_sweep(file, out=tmp_path / "out", retry=True)
    assert (again.computed, again.counts()) == (2, {"converged": 4})


@pytest.mark.slow
@pytest.mark.usefixtures("sabotage")
def test_a_case_that_takes_too_long_is_given_up(write, tmp_path):
    result = ms.run_sweep(write('"model.modes" = [6]'), out=tmp_path / "out", workers=1, time_limit=0.5)
    assert (result.rows[0]["outcome"], result.rows[0]["message"]) == ("stopped", "took longer than 0.5 s")


def test_workers_that_do_not_start_are_an_error(write, tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text("import os; os.write(2, b'no licence'); os._exit(3)")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(ms.WorkerError, match="exit status 3: no licence"):
        ms.run_sweep(write(), out=tmp_path / "out", workers=1)


def test_two_drivers_may_not_share_a_folder(write, tmp_path):
    with CaseFolder(tmp_path / "out" / "beams_cases"), pytest.raises(ms.OptionError, match="in use by another process"):
        ms.run_sweep(write(), out=tmp_path / "out")
    os.close(acquire_lock(tmp_path / "out" / "beams_cases" / "lock"))  # and a lock that is let go is free


@pytest.mark.usefixtures("here")
def test_a_stopped_sweep_says_how_to_go_on(write, tmp_path, capsys, monkeypatch):
    write_case = CaseFolder.write
    stored = []

    def stop(folder, outcome):
        write_case(folder, outcome)
        stored.append(outcome)
        if len(stored) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(CaseFolder, "write", stop)
    with pytest.raises(SystemExit) as exit_:
        main(["sweep", str(write()), "--out", str(tmp_path / "out")])
    assert exit_.value.code == 130
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "modalshell: stopped: 2 of 6 cases are stored; starting the sweep again does the rest"
    assert len(case_files(tmp_path / "out")) == 2


def test_the_command(swept, tmp_path, capsys):
    file, folder = copied(swept, tmp_path)
    with pytest.raises(SystemExit) as exit_:
        main(["sweep", str(file), "--out", str(folder)])
    assert exit_.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "beams: 12 cases, 12 converged; 0 computed now, 12 from before"
    assert lines[1:] == [str(folder / name) for name in FILES]


@pytest.mark.usefixtures("here")
def test_the_command_says_why_cases_have_no_answer(write, tmp_path, capsys):
    """It counted them, and the reason stood in its table alone."""
    file = write(axes='"model.modes" = [2, 9999]\n"loads.gravity" = [[0, 0, -1], [0, 0, -2]]')
    with pytest.raises(SystemExit) as exit_:
        main(["sweep", str(file), "--out", str(tmp_path / "out")])
    assert exit_.value.code == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("beams: 4 cases, 2 converged, 2 refused")
    assert re.match(r"case 3 and 1 more, refused: .*model\.modes: must be at most \d+", lines[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"workers": 0}, "workers"),
        ({"time_limit": -1.0}, "time_limit"),
        ({"cluster": "tcp://127.0.0.1:1", "workers": 2}, "leave them out with a cluster"),
    ],
)
def test_bad_options(write, tmp_path, options, message):
    with pytest.raises(ms.OptionError, match=message):
        ms.run_sweep(write(), out=tmp_path / "out", **options)


def test_parquet_holds_the_same_rows(swept, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow (extra 'parquet')")
    file, folder = copied(swept, tmp_path)
    (tmp_path / "base.toml").write_text(LOADED_BEAM)
    typed = tmp_path / "beams.toml"
    typed.write_text(file.read_text() + '[output]\nformats = ["parquet"]\n')
    result = ms.run_sweep(typed, out=folder)
    assert result.computed == 0
    assert parquet.read_table(folder / "beams_sweep.parquet").to_pylist() == result.rows


def test_parquet_without_pyarrow_is_refused_before_any_work(write, tmp_path, monkeypatch):
    monkeypatch.setattr("modalshell.sweep.summary.importlib.util.find_spec", lambda _name: None)
    with pytest.raises(ms.OptionError, match=r"pip install 'modalshell\[parquet\]'"):
        ms.run_sweep(write(more="[output]\nformats = ['parquet']"), out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("motion", ["", "[motion]\nduration = 0.4\ndt = 0.02\n"], ids=["still", "moving"])
@pytest.mark.usefixtures("here")
def test_cases_have_the_error_bars_of_a_run(tmp_path, motion):
    (tmp_path / "base.toml").write_text("bar = true\n" + LOADED_BEAM + motion)
    file = tmp_path / "beams.toml"
    file.write_text('scene = "base.toml"\n[axes]\n"material.flexure" = [0.05, 0.1]\n')
    first = ms.run_sweep(file, out=tmp_path / "out").rows[0]
    bars = ms.run_scene(tmp_path / "base.toml", out=tmp_path / "run").trajectory.bars
    assert first["message"].endswith(str(bars))
    assert "from DS" in first["message"]
    assert first["error_bar"] == pytest.approx(bars.displacement.max(), rel=1e-9)
    assert first["margin"] == pytest.approx(bars.margin.min(), rel=1e-9)


def test_units_of_axes_within_lists():
    """Of loads by their kinds, and of a component of a vector."""
    columns = ["loads.pressure.0.p", "loads.point.1.force", "loads.gravity.2", "contacts.0.offset", "material.shear"]
    rows = unit_rows([dict.fromkeys([*columns, "contacts.0.friction"])], [{"material": {"young": [1e9, 1e8]}}])
    assert [row["unit"] for row in rows] == ["Pa", "N", "m/s^2", "m", "Pa", "1"]
    further = ["material.plies.0.thickness", "mesh.wing", "mesh.curl", "contacts.0.path.times", "contacts.0.origin"]
    rows = unit_rows([dict.fromkeys(further)], [{"material": {"plies": []}}])
    assert [row["unit"] for row in rows] == ["m", "m", "deg", "s", "m"]
    springs = {"material": {"stretch": 1.0, "flexure": 1.0}, "units": {"length": "mm", "mass": "t", "time": "s"}}
    rows = unit_rows([dict.fromkeys([*columns, "material.density", "material.flexure"])], [springs])
    assert [row["unit"] for row in rows] == ["MPa", "N", "mm/s^2", "mm", "N", "t/mm^2", "N mm"]


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_units_that_differ_from_case_to_case(tmp_path):
    """An axis of units, and one of whole materials in a scene that has none: each column names all of its units."""
    before, rest = LOADED_BEAM.split("[material]")
    (tmp_path / "base.toml").write_text(before + rest[rest.index("[") :])
    file = tmp_path / "kinds.toml"
    file.write_text(
        'scene = "base.toml"\n[axes]\n"units.length" = ["m", "ft"]\n"material" = ['
        "{stretch = 20.0, shear = 20.0, flexure = 0.05, density = 0.2}, "
        "{young = 1e6, poisson = 0.3, thickness = 0.002, density = 100.0}]\n"
    )
    result = ms.run_sweep(file, out=tmp_path / "out")
    units = {row["column"]: row["unit"] for row in rows_of(result.files[-1])}
    assert (units["displacement"], units["units.length"]) == ("m or ft", "1")
    rows = unit_rows([{"material.density": 1.0}], [raw for _, raw in load_sweep(file).points()])
    assert rows[0]["unit"] == "kg/m^2 or kg/m^3 or kg/ft^2 or kg/ft^3"
