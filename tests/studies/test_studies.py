import json
import subprocess
import sys

import numpy as np
import pytest

from modalshell.core.errors import FileFormatError, OptionError
from modalshell.files.atomic_io import write_atomically
from modalshell.files.provenance import repository_module, run_record
from modalshell.files.study_result import StudyResult
from modalshell.render.curves import Curve, Panel, draw_curves
from studies.benchmarks import contact, hybrid, modes, run
from studies.reproduce import chosen_studies, studies


@pytest.fixture(scope="module")
def results(quick_study):
    """The folder with the results of the studies that are looked at here."""
    quick_study("flat_vs_v_beam")
    return quick_study("v_beam_accuracy")


@pytest.mark.by_default("cantilever_master_curve", "v_beam_accuracy")
@pytest.mark.parametrize("name", studies())
def test_every_study_leaves_its_files(name, quick_study):
    folder = quick_study(name)
    for suffix in (".json", ".npz", ".md"):
        assert (folder / f"{name}{suffix}").stat().st_size > 100
    for figure in studies()[name].FIGURES:
        assert (folder / "figures" / f"{figure}.png").read_bytes()[:4] == b"\x89PNG"
    assert not list(folder.glob("*.part"))
    found = studies()[name].finding(StudyResult.load(folder, name))
    assert any(letter.isdigit() for letter in found)


def test_record_says_how_to_make_it_again(results):
    record = json.loads((results / "v_beam_accuracy.json").read_text())["record"]
    assert set(record) == {"made", "versions", "seed", "parameters", "machine"}
    assert {"modalshell", "numpy", "scipy", "numba", "python"} <= set(record["versions"])
    assert record["parameters"]["modes"] == 8  # a constant of its module
    assert record["parameters"]["cells"] == [20, 4]  # chosen by a quick run


def test_fold_stiffens(results):
    rows = StudyResult.load(results, "flat_vs_v_beam").findings["rows"]
    drops = {(row["beam"], row["flexure_factor"]): row["ds_tip_drop"] for row in rows}
    assert all(row["ds_status"] == "converged" for row in rows)
    gain = [drops["flat", factor] / drops["v", factor] for factor in (1.0, 10.0, 100.0)]
    assert gain[0] > 3.0
    # The stiffer the flexure, the less the fold adds.
    assert gain[0] > gain[1] > gain[2]


def test_warping_stays_below_linear_and_both_errors_grow(results):
    rows = StudyResult.load(results, "v_beam_accuracy").findings["soft"]["rows"]
    linear, warping = (np.array([row[f"{model}_error"] for row in rows]) for model in ("lma", "mwts"))
    assert (warping < linear).all()
    assert (np.diff(warping) > 0).all()
    assert (np.diff(linear) > 0).all()


def test_snap_is_found_and_marked(results):
    findings = StudyResult.load(results, "v_beam_accuracy").findings
    assert findings["soft"]["snap"] is None
    snap = findings["stiff"]["snap"]
    assert snap["stable_again"] < snap["limit"] == snap["gamma"]
    marked = [row["gamma"] for row in findings["stiff"]["rows"] if row["after_snap"]]
    assert marked
    assert min(marked) >= snap["gamma"]
    assert all(row["mwts_error"] > 0.5 for row in findings["stiff"]["rows"] if row["after_snap"])


def test_paths_meet_their_references(quick_study):
    results = quick_study("snap")
    checks = StudyResult.load(results, "snap").findings["checks"]
    limits = {"Lee's frame": 0.02, "tape spring, opposite sense": 0.05, "tape spring, equal sense": 0.05}
    assert limits.keys() <= {one["case"] for one in checks}
    assert all(one["off"] <= limits.get(one["case"], 0.025) for one in checks), checks
    curves = StudyResult.load(results, "snap").findings["curves"]
    assert all(one["converged"] for one in curves if one["case"].startswith(("V", "roof", "Lee")))


def test_the_hybrid_follows_the_shell_that_trained_it_through_held_out_snaps(quick_study):
    found = StudyResult.load(quick_study("held_out_snaps"), "held_out_snaps").findings
    drawn, named = ([row for row in found["rows"] if row["drawn"] is kind] for kind in (True, False))
    assert np.quantile([row["coarse"] for row in drawn], 0.9) < 0.06
    # By rules of second order motions are lively after a snap: 1.5 to 6.2 %, where implicit Euler damped all below 3 %.
    assert all(row["coarse"] < 0.07 and all(row["snaps"].values()) for row in named)
    assert all(row["coarse"] < 0.02 for row in found["equilibria"])
    assert found["snaps"]["hybrid"] == pytest.approx(found["snaps"]["coarse DS"], rel=0.03)


def test_missing_and_damaged_results_are_named(results, tmp_path):
    with pytest.raises(FileFormatError, match="flat_vs_v_beam"):
        StudyResult.load(tmp_path, "flat_vs_v_beam")
    (tmp_path / "flat_vs_v_beam.json").write_bytes((results / "flat_vs_v_beam.json").read_bytes())
    (tmp_path / "flat_vs_v_beam.npz").write_bytes((results / "flat_vs_v_beam.npz").read_bytes()[:500])
    with pytest.raises(FileFormatError, match="flat_vs_v_beam"):
        StudyResult.load(tmp_path, "flat_vs_v_beam")


def test_round_trip(tmp_path):
    saved = StudyResult("x", {"a": np.float64(1.5), "b": [np.int64(2)]}, {"p": np.eye(3)}, run_record({"k": 1}))
    saved.save(tmp_path)
    loaded = StudyResult.load(tmp_path, "x")
    assert loaded.findings == {"a": 1.5, "b": [2]}
    np.testing.assert_array_equal(loaded.arrays["p"], np.eye(3))
    assert loaded.record == saved.record


def test_a_finding_that_is_not_a_number_is_refused(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        StudyResult("x", {"a": float("nan")}, {}, {}).save(tmp_path)


def test_unknown_studies_are_refused():
    assert chosen_studies(None, everything=True) == list(studies())
    paper = {name for name, study in studies().items() if study.FIGURES and study.FIGURES[0].startswith("figure_")}
    assert set(chosen_studies(None)) == paper
    with pytest.raises(OptionError, match="no study 'nothing'"):
        chosen_studies(["nothing"])
    with pytest.raises(FileFormatError, match="reinstall"):
        repository_module("studies.nothing")


def test_another_package_of_the_same_name_is_named(tmp_path, monkeypatch):
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "studies"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(FileFormatError, match=f"{tmp_path}.*not that of modalshell"):
        repository_module("studies.tradeoff")


def test_a_failed_write_leaves_nothing(tmp_path):
    def fail(file):
        file.write(b"half")
        raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        write_atomically(tmp_path / "a.bin", fail)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("values", [[1.0, float("nan")], [1.0, 0.0]])
def test_curves_that_cannot_be_drawn_are_refused(tmp_path, values):
    with pytest.raises(OptionError):
        draw_curves([Panel([Curve([1, 2], values, "a", "k")], "t", "x", "y", log=True)], tmp_path / "a.png")


@pytest.mark.slow
def test_studies_and_figures_are_imported_without_any_extra():
    program = """
import importlib, sys
sys.modules.update(dict.fromkeys(sys.argv[1:]))  # None: an import of it fails
from studies.reproduce import studies
for study in studies().values():
    for figure in study.FIGURES:
        importlib.import_module(f"paper_figures.{figure}")
import studies.benchmarks.run
"""
    extras = ["pyvista", "vtkmodules", "warp", "sympy", "petsc4py", "distributed", "pyarrow"]
    extras += ["sksparse", "pypardiso", "trame", "pytest", "hypothesis"]
    subprocess.run([sys.executable, "-c", program, *extras], check=True, timeout=120)


def test_benchmarks_that_are_stopped_keep_the_tables_that_are_done(tmp_path, monkeypatch):
    def stop():
        raise RuntimeError("stopped")

    monkeypatch.setattr(run.frame, "benchmark", lambda *_: [{"n": 1000, "seconds": 0.5}])
    monkeypatch.setattr(run.frame, "scaling", stop)
    with pytest.raises(RuntimeError, match="stopped"):
        run.main(tmp_path)
    assert json.loads((tmp_path / "benchmarks.json").read_text())["rows"] == {"frame": [{"n": 1000, "seconds": 0.5}]}
    assert "| 1000 | 0.5 |" in (tmp_path / "benchmarks.md").read_text()


@pytest.mark.slow
def test_frames_on_colliders_are_timed_beside_free_ones():
    rows = contact.frames(((20, 4),), count=1, repeats=2)
    assert len(rows) == len(contact.RUNGS) * len(contact.BODIES)
    for row in rows:
        assert (row["pushed"] > 0) == (row["on"] != "none")
        assert 0.0 < row["microseconds_least"] <= row["microseconds_median"]
        assert row["on"] != "floor below" or row["pushed"] > 30


@pytest.mark.slow
def test_frames_of_the_hybrid_are_timed_beside_those_of_its_coarse_shell():
    rows = hybrid.frames((44,), motions=24, loads=4, repeats=2)
    assert [row["shell"] for row in rows] == list(hybrid.SHELLS)
    for row in rows:
        assert row["vectors"] == 44
        assert row["vertices"] >= 49
        assert 0.0 < row["held_out_error [%]"] < 10.0
        times = [row[kind] for kind in ("without [ms]", "with [ms]", "coarse [ms]", "training [s]") if kind in row]
        assert len(times) >= 3
        assert min(times) > 0.0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the memory of a process is read from Linux")
def test_modes_that_take_too_long_are_stopped_and_count_as_lower_bounds(monkeypatch):
    monkeypatch.setattr(modes, "ENERGIES", ("hinges",))
    monkeypatch.setattr(modes, "BACKENDS", ("cholesky",))  # a process each
    rows = modes.benchmark((400,), repeats=1)
    assert all(row["ended"] for row in rows)
    assert max(row["difference"] for row in rows) < 1e-8
    stopped = modes.solved_alone((400, "hinges"), 4, modes.PLAIN, most_seconds=0.0)
    assert np.isfinite(stopped.megabytes)
    monkeypatch.setattr(modes, "solved_alone", lambda *_: stopped._replace(megabytes=1.0))
    assert not any(row["ended"] or row["difference"] is not None for row in modes.benchmark((400,), repeats=1))
