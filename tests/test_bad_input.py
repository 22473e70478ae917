"""Bad input that fuzzing found, each shrunk to one line: it used to crash, hang, or answer NaN."""

import contextlib
import json
import zipfile
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest
import trimesh
from scenes import PLAIN, TINY_BEAM, cantilever

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.checks import checked_count, checked_number, checked_vectors, shown
from modalshell.crowd import Flight
from modalshell.files import atomic_io
from modalshell.files.provenance import run_record
from modalshell.files.study_result import StudyResult
from modalshell.mesh.selection import select_vertices, selected
from modalshell.run import RunFollower
from modalshell.run.frame_file import FrameFile
from modalshell.scene.parts import checked_keyframes
from modalshell.springs import GridVerlet, ImplicitSprings, SheetGrid, Springs, mesh_springs
from modalshell.statics.trust_region import minimise
from modalshell.sweep.cluster import connect

GRID = {"spacing": 0.1, "particle_mass": 0.01, "structural": 20.0, "shear": 10.0, "flexion": 5.0}


@cache
def shell():
    return cantilever((4, 2))


def points():
    return np.array(shell().rest_positions)


@pytest.fixture(scope="module")
def basis():
    return ms.solve_modes(shell(), 3)


def test_what_was_got_is_shown_whatever_it_is():
    assert shown("x" * 5000).endswith("...")
    assert (shown(np.float64(2.0)), shown(np.array([1, 2])), shown(np.array([]))) == ("2.0", "[1, 2]", "[]")
    assert "array" in shown(np.array(2.0))  # which is no number
    assert "True" in shown(np.True_) != "True"  # nor this a bool
    assert shown(10**5000) == "int with too many digits"
    assert shown(object()) == "an object of type object"
    assert shown([object()]) == "a list of objects"
    assert max(len(shown(value)) for value in ("x" * 5000, np.eye(200), [1.0] * 9999)) == 80


@pytest.mark.parametrize(
    "value", [10**400, -(10**5000), np.timedelta64(1, "s"), 1e300, 1e-320, "1", True, 1j, None], ids=shown
)
def test_numbers(value):
    with pytest.raises(ms.OptionError, match="dt must be"):
        checked_number("dt", value, above=0.0)


@pytest.mark.parametrize("value", [np.timedelta64(1, "s"), 10**5000, 2**64, 1.5, True, "1"], ids=shown)
def test_counts(value):
    with pytest.raises(ms.OptionError, match="count must be"):
        checked_count("count", value)


@pytest.mark.parametrize(
    "values",
    [
        10**400,
        np.ones(3, dtype=complex),
        np.array(["1", "2", "3"]),
        np.zeros(3, dtype="M8[s]"),
        np.ma.masked_less(np.arange(3.0), 1.0),
        [1.0, [2.0], 3.0],
        [1.0, 1e60, 0.0],
        [1.0, np.nan, 0.0],
    ],
    ids=shown,
)
def test_vectors_are_not_converted_with_loss(values):
    with pytest.raises(ms.LoadError, match="gravity must"):
        checked_vectors("gravity", values, (3,))


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda: ms.Shell(shell().mesh, shell()), ms.OptionError),
        (lambda: ms.Shell(points(), PLAIN), ms.OptionError),
        (lambda: ms.LinearModal(shell()), ms.OptionError),
        (lambda: ms.RotationStrain(shell()), ms.OptionError),
        (lambda: ms.DiscreteShell(shell().mesh), ms.OptionError),
        (lambda: ms.RigidShell(shell().mesh), ms.OptionError),
        (lambda: ms.ModalDerivatives(shell().mesh), ms.OptionError),
        (lambda: ms.CoarseDiscreteShell(shell(), shell().mesh), ms.OptionError),
        (lambda: ms.coarse_shell(shell(), shell().mesh, np.eye(2)), ms.OptionError),
        (lambda: ms.solve_modes(shell().mesh), ms.OptionError),
        (lambda: ms.Crowd(shell(), 2), ms.OptionError),
        (lambda: ms.simulate(shell(), duration=1.0), ms.OptionError),
        (lambda: ms.simulate(ms.DiscreteShell(shell()), duration=1.0, dtype="x"), ms.OptionError),
        (lambda: ms.simulate(ms.DiscreteShell(shell()), duration=1.0, constraints=3), ms.OptionError),
        (lambda: ms.simulate(ms.DiscreteShell(shell()), duration=1.0, supports=shell().mesh), ms.OptionError),
        (lambda: ms.simulate(ms.DiscreteShell(shell()), duration=1e49, dt=1e-3), ms.OptionError),
        (lambda: ms.measure.area_change(points(), shell()), ms.OptionError),
        (lambda: ms.tradeoff({}), ms.OptionError),
        (lambda: ms.tradeoff(shell(), gravity=(0, 0, -1), modes=np.array([])), ms.OptionError),
        (lambda: ms.tradeoff(shell(), gravity=(0, 0, -1), modes="x"), ms.OptionError),
        (lambda: ms.tradeoff(shell(), gravity=(0, 0, -1), loads=[[0.5, 1.0]]), ms.OptionError),
        (lambda: ms.PositionConstraint([1, [2, 3]], points()[0]), ms.OptionError),
        (lambda: ms.SupportPath([0.0, [1.0]], points()[:2]), ms.OptionError),
        (lambda: ms.SupportPath([0.0, 1.0], points()[:2]).at(np.nan), ms.OptionError),
        (lambda: ms.SupportPath([0.0, 1e-320, 1.0], points()[:3]), ms.OptionError),
        (lambda: checked_keyframes([0.0, 1e-320], [(0.0, 0.0, 0.0)] * 2), ms.OptionError),
        (lambda: ms.SupportPath.from_function(lambda _: points()[:2], 1e40, step=1e-9), ms.OptionError),
        (lambda: ms.SupportPath.from_function(3, 1.0), ms.OptionError),
        (lambda: ms.SupportPath.from_function(lambda _: 3.0, 1.0), ms.OptionError),
        (lambda: ms.SupportPath.from_function(lambda _: (0.0, 0.0, 1.0), 1.0), ms.OptionError),
        (lambda: ms.Flock(points(), points() + 1.0, seed=np.nan), ms.OptionError),
        (lambda: ms.Flock.random(2**64, radius=1.0), ms.OptionError),
        (lambda: ms.flat_beam(cells=(10**6, 10**6)), ms.OptionError),
        (lambda: ms.cylinder_panel(angle=np.array([])), ms.OptionError),
        (lambda: shell().mesh.weld(1j), ms.MeshError),
        (lambda: ms.TriangleMesh(points() * 1e-120, shell().mesh.faces), ms.MeshError),
        (lambda: ms.load_mesh("a\0.obj"), ms.MeshError),
        (lambda: ms.save_mesh(shell().mesh, "a\0.obj"), ms.MeshError),
        (lambda: select_vertices("x < " + "9" * 400, points()), ms.OptionError),
        (lambda: selected("clamped", [2**63], shell().mesh.vertices), ms.OptionError),
        (lambda: ms.PointForce([[0.5]], (0, 0, 1)).force(shell().mesh), ms.OptionError),
        (lambda: ms.LineForce([0], (0, 0, 1)).force(shell().mesh), ms.OptionError),
        (lambda: ms.PointForce([0], (0, 0, np.nan)), ms.LoadError),
        (lambda: ms.SpringSheet(shell().mesh), ms.OptionError),
        (lambda: ms.SpringSheet(shell(), points()), ms.OptionError),
        (lambda: mesh_springs(shell().mesh, print, 1.0), ms.MaterialError),
        (lambda: mesh_springs(shell(), 1.0, 1.0), ms.OptionError),
        (lambda: Springs([[0, 1]], [b"1"], 1.0, 0.0), ms.MaterialError),
        (lambda: Springs([[0, 1]], [1e-320], 1.0, 0.0), ms.MaterialError),
        (lambda: Springs([[0], [1, 2]], [1.0], 1.0, 0.0), ms.MeshError),
        (lambda: SheetGrid(shape=(10**6, 10**6), **GRID), ms.MeshError),
        (lambda: SheetGrid(shape=None, **GRID), ms.MeshError),
        (lambda: SheetGrid(shape=(3, 3), pinned=[[1.0]], **GRID), ms.SupportError),
        (lambda: GridVerlet(SheetGrid(shape=(3, 3), **GRID), dtype="x"), ms.OptionError),
        (lambda: GridVerlet(shell()), ms.OptionError),
        (lambda: ImplicitSprings(shell(), [1.0]), ms.OptionError),
        (lambda: Flight(shell(), shell(), shell()), ms.OptionError),
        (lambda: ms.Flock(points(), points() + 1.0, threads=10**9), ms.OptionError),
        (lambda: ms.Flock.random(2**31 - 1, radius=1.0), ms.OptionError),
        (lambda: ms.run_sweep(points()), ms.OptionError),
        (lambda: ms.run_sweep("sweep.toml", out=np.nan), ms.OptionError),
        (lambda: ms.cylinder_panel(radius=2.0**64, family="lloyd"), ms.OptionError),
        pytest.param(
            lambda: connect("x"),
            ms.WorkerError,
            marks=pytest.mark.skipif(find_spec("distributed") is None, reason="needs dask.distributed"),
        ),
        (
            lambda: ms.ReducedRotationStrain(
                ms.RotationStrain(ms.solve_modes(shell(), 2)), np.full((4, 2), 1e-200), rank=2
            ),
            ms.OptionError,
        ),
    ],
)
def test_arguments(call, error):
    shell()  # what it is made of must not be what refuses
    with pytest.raises(error) as refused:
        call()
    assert 20 <= len(str(refused.value)) <= 1000


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_answers_that_leave_the_finite_numbers_are_refused():
    for answer in (shell().energy, shell().force, shell().stiffness):
        with pytest.raises(ms.LoadError, match="at most 1e"):
            answer(points() * 1e200)
    light = ms.Material(1e49, 1e49, 1e49, 1e-49)
    with pytest.raises(ms.SolverError, match="finite"):
        ms.solve_modes(ms.Shell(ms.TriangleMesh(points() * 1e-99, shell().mesh.faces), light), 2)


@pytest.mark.slow
def test_a_target_far_out_of_reach_takes_no_more_than_seconds(basis):
    for target in ([-0.1, 0.0, 1.0], [1e12, 0.0, 0.0]):
        answer = ms.ModalWarping(basis).equilibrium(
            gravity=(0.0, 0.0, -1.0), constraints=[ms.PositionConstraint([8, 9], target)]
        )
        # Three modes may just reach three coordinates, by a sheet that is stretched to several times its area.
        assert answer.outcome in (ms.Outcome.OUT_OF_REACH, ms.Outcome.DISTORTED)
        assert answer.iterations <= 200


def test_a_descent_from_where_nothing_is_finite_ends():
    def nowhere(y):
        return (0.0 if not y.any() else np.nan), np.ones(2)

    found = minimise(nowhere, lambda _: np.eye(2), np.zeros(2), 1e-9, scale=1.0, radius=1.0)
    assert not found.converged


def test_the_mesh_reader_says_nothing_beside_its_one_line(tmp_path, capsys):
    text = trimesh.Trimesh(points(), shell().mesh.faces, process=False).export(file_type="stl_ascii")
    (tmp_path / "bad.stl").write_text(text.replace("facet normal 0", "facet normal x", 1))
    with pytest.raises(SystemExit):
        main(["modes", str(tmp_path / "bad.stl"), "--count", "99999"])
    errors = [line for line in capsys.readouterr().err.splitlines() if "compiling kernels" not in line]
    assert len(errors) == 1
    assert errors[0].startswith("modalshell: count must be at most")


@pytest.mark.by_default("modes")
@pytest.mark.parametrize("command", ["simulate", "modes"])
def test_a_folder_that_cannot_be_is_refused_before_the_work(command, tmp_path, capsys):
    path = tmp_path / "panel.obj"
    ms.save_mesh(shell().mesh, path)
    with pytest.raises(SystemExit) as stopped:
        main([command, str(path), "--clamp", "x < 0.3", "--out", str(path)])
    assert stopped.value.code == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "no folder for results" in captured.err
    assert "Hz" not in captured.out


# Saved results.


@pytest.fixture
def study(tmp_path):
    result = StudyResult("study", {"error": 0.25}, {"a": np.arange(6.0)}, run_record({}))
    result.save(tmp_path)
    return tmp_path


def test_a_changed_number_in_the_findings_is_seen(study):
    path = study / "study.json"
    path.write_text(path.read_text().replace("0.25", "0.35"))
    with pytest.raises(ms.FileFormatError, match="digest differs"):
        StudyResult.load(study, "study")


def test_findings_and_arrays_of_two_runs_are_seen(study):
    StudyResult("other", {"error": 0.25}, {"a": np.arange(7.0)}, run_record({})).save(study)
    (study / "other.npz").replace(study / "study.npz")
    with pytest.raises(ms.FileFormatError, match="digest differs"):
        StudyResult.load(study, "study")


def test_findings_without_a_digest_are_refused(study):
    document = json.loads((study / "study.json").read_text())
    del document["sha256"]
    (study / "study.json").write_text(json.dumps(document))
    with pytest.raises(ms.FileFormatError, match="digest differs"):
        StudyResult.load(study, "study")


def test_arrays_of_two_files_are_seen(tmp_path):
    for name, count in (("one", 3), ("two", 4)):
        atomic_io.write_npz(tmp_path / f"{name}.npz", a=np.arange(count), b=np.ones(count))
    with zipfile.ZipFile(tmp_path / "mixed.npz", "w") as mixed:
        for name, source in (("a.npy", "one"), ("b.npy", "two"), ("sha256.npy", "one")):
            with zipfile.ZipFile(tmp_path / f"{source}.npz") as archive:
                mixed.writestr(name, archive.read(name))
    with pytest.raises(ValueError, match="digest differs"):
        atomic_io.read_npz(tmp_path / "mixed.npz")


@pytest.mark.parametrize(
    ("shape", "descr", "message"),
    [("(999999999999,)", "<f8", "not as long"), ("(3,)", "|O", "Python objects"), ("(1,)", "<f8", "not as long")],
)
def test_headers_that_promise_otherwise_are_refused_before_memory_is_taken(tmp_path, shape, descr, message):
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(24)
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w") as archive:
        archive.writestr("a.npy", data)
    with pytest.raises(ValueError, match=message):
        atomic_io.read_npz(tmp_path / "bomb.npz")
    with pytest.raises(ms.FileFormatError):
        ms.Basis.load(tmp_path / "bomb.npz")


@pytest.mark.parametrize("name", ["times", "energies", "positions", "rest", "seconds"])
def test_a_trajectory_with_nan_is_refused(tmp_path, basis, name):
    run = ms.simulate(ms.LinearModal(basis), duration=0.1, gravity=(0.0, 0.0, -1.0))
    with np.load(ms.save_trajectory(run, tmp_path / "run.npz")) as stored:
        arrays = dict(stored)
    arrays[name] = np.full_like(arrays[name], np.nan)
    np.savez(tmp_path / "run.npz", **arrays)
    with pytest.raises(ms.FileFormatError, match="finite"):
        ms.load_trajectory(tmp_path / "run.npz")


@pytest.mark.parametrize("junk", [b"5\n", b"[" * 100_000 + b"\n", b"\xff\n"])
def test_a_frame_file_that_is_none_is_refused(tmp_path, junk):
    (tmp_path / "run.frames").write_bytes(b"modalshell frames 1\n" + junk)
    with FrameFile(tmp_path / "run.frames") as file, pytest.raises(ms.OptionError, match="no file of frames"):
        file.refuse_others({"scene": "x"})


@pytest.mark.parametrize("path", ["x" * 300, "a\0b/c", "file/below"])
def test_what_cannot_be_written_is_refused(tmp_path, path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ms.FileFormatError, match="give another"):
        atomic_io.write_text(tmp_path / path, "text")


SCENE = (
    TINY_BEAM
    + """
motion = {duration = 0.02, dt = 0.002}
loads = {gravity = [0.0, 0.0, -1.0]}
"""
)
FLIGHT = """
model = {name = "mwts", modes = 2}
flock = {count = 2, radius = 2.0, camera = {position = [0.0, -5.0, 0.0]}}
"""


@pytest.mark.by_default('{name = "ds", integrator = "verlet"}')
@pytest.mark.parametrize(
    "model",
    ['{name = "ds", integrator = "verlet"}', '{name = "springs", integrator = "linear_implicit", solver = "cg"}'],
)
def test_motions_that_take_more_along_are_stored_and_taken_up(tmp_path, model):
    def stop(done, _):
        if done == 4:
            raise KeyboardInterrupt

    (tmp_path / "beam.toml").write_text(f"{SCENE}\nmodel = {model}\n")
    whole = ms.run_scene(tmp_path / "beam.toml", out=tmp_path / "whole")
    for on_step in (stop, None):
        with contextlib.suppress(KeyboardInterrupt):
            found = ms.run_scene(tmp_path / "beam.toml", out=tmp_path / "stopped", on_step=on_step)
    assert found.resumed > 1
    np.testing.assert_array_equal(found.trajectory.positions, whole.trajectory.positions)


@pytest.mark.parametrize("file", ["beam.json", "beam.npz"])
def test_a_flight_whose_results_are_damaged_is_flown_again(tmp_path, file):
    (tmp_path / "beam.toml").write_text(SCENE + FLIGHT)
    first = ms.run_scene(tmp_path / "beam.toml", out=tmp_path)
    assert ms.run_scene(tmp_path / "beam.toml", out=tmp_path).resumed == first.frames
    data = (tmp_path / file).read_bytes()
    at = data.index(b'"birds": 2') + 9 if file.endswith("json") else len(data) // 2
    (tmp_path / file).write_bytes(data[:at] + bytes([data[at] ^ 5]) + data[at + 1 :])  # "2" becomes "7"
    again = ms.run_scene(tmp_path / "beam.toml", out=tmp_path)
    assert (again.resumed, again.report.birds) == (0, 2)


@pytest.mark.parametrize("junk", [b"5", b"[" * 100_000, b"", b'{"identity": 5}'])
def test_a_flight_whose_record_is_none_is_flown_again(tmp_path, junk):
    (tmp_path / "beam.toml").write_text(SCENE + FLIGHT)
    ms.run_scene(tmp_path / "beam.toml", out=tmp_path)
    (tmp_path / "beam.json").write_bytes(junk)
    assert ms.run_scene(tmp_path / "beam.toml", out=tmp_path).resumed == 0


HEADER_CHANGES = [(b'"rest_positions"', b'"rest_posiMions"'), (rb"\"positions\"", rb"\"posiMions\"")]


@pytest.mark.parametrize(("old", "new"), HEADER_CHANGES)
def test_frames_with_a_damaged_header_are_not_followed(tmp_path, old, new):
    def stop(*_):
        raise KeyboardInterrupt

    (tmp_path / "beam.toml").write_text(SCENE + '\nmodel = {name = "rigid"}\n')
    with contextlib.suppress(KeyboardInterrupt):
        ms.run_scene(tmp_path / "beam.toml", out=tmp_path, on_step=stop)
    frames = tmp_path / "beam.frames"
    assert old in frames.read_bytes()
    frames.write_bytes(frames.read_bytes().replace(old, new))
    follower = RunFollower(frames)
    assert not follower.poll()
    assert (follower.index, follower.state) == (-1, "waiting")
    follower.close()


def test_a_coarse_surface_with_collapsed_triangles_is_prolong():
    coarse = ms.CoarseDiscreteShell(shell(), ms.coarse_shell(shell(), shell().mesh, PLAIN))
    for scale in ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, -1.0], [1.0, -1.0, 0.0]):
        assert np.isfinite(coarse.prolong(points() * scale)).all()


PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\n{}element face 1\nproperty list uchar int vertex_indices\nend_header\n{}"
)
AXES = "property float x\nproperty float y\nproperty float z\n"


@pytest.mark.parametrize(
    ("axes", "rows", "words"),
    [
        (AXES + "property float x\n", "0 0 0 0\n1 0 0 0\n0 1 0 0\n", "property of vertex 'x' twice"),
        (AXES + "element vertex 3\n" + AXES, "0 0 0\n1 0 0\n0 1 0\n" * 2, "element 'vertex' twice"),
        (AXES.replace("float x", "list uchar float x"), "1 0 0 0\n1 1 0 0\n1 0 1 0\n", "no x, y and z"),
    ],
)
def test_a_ply_declares_each_name_once(axes, rows, words, tmp_path):
    (tmp_path / "mesh.ply").write_text(PLY.format(axes, rows + "3 0 1 2\n"))
    with pytest.raises(ms.MeshError, match=words):
        ms.load_mesh(tmp_path / "mesh.ply")


@pytest.mark.parametrize(("until", "begin"), [(5e-324, 0.0), (1e-310, 0.0), (5e-324, 1e-323)])
def test_ranges_of_load_factors_that_vanish(until, begin):
    with pytest.raises(ms.OptionError, match=r"until must differ from begin by at least 1e-50 .* scale the load"):
        ms.equilibrium_path(shell(), gravity=(0.0, 0.0, -2.0), until=until, begin=begin)


@pytest.mark.parametrize("shape", [(2,), (2, 2), (1, 1, 3), (7, 3)])
def test_winds_of_a_wrong_shape(shape):
    wind = ms.Wind(lambda _points, _time: np.ones(shape))
    with pytest.raises(ms.LoadError, match=r"wind's velocity must have shape \(\d+, 3\), a row for each point"):
        ms.DiscreteShell(shell()).equilibrium(loads=[wind])


@pytest.mark.parametrize("value", [np.zeros(3), "no", None, 1], ids=shown)
def test_switches(value):
    with pytest.raises(ms.OptionError, match="follower must be True or False"):
        ms.Pressure(1.0, follower=value)


def test_one_load_in_place_of_a_list_is_refused():
    """It ended in a TypeError."""
    mesh = ms.flat_beam(cells=(4, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 100.0), mesh.vertices[:, 0] < 1e-6)
    for loads in (ms.Wind((1.0, 0.0, 0.0)), 3):
        with pytest.raises(ms.LoadError, match="loads must be a list of loads"):
            ms.DiscreteShell(shell).equilibrium(loads=loads)
    with pytest.raises(ms.OptionError, match="energies must be a list of energies"):
        ms.Shell(mesh, shell.material, energies=3)
    with pytest.raises(ms.OptionError, match="fields must be a list of names"):
        ms.simulate(ms.DiscreteShell(shell), duration=0.1, fields=3)
    with pytest.raises(ms.OptionError, match="run must be a Trajectory"):
        ms.save_trajectory(shell, "shell.npz")


def test_switches_take_numbers_of_truth_from_numpy():
    mesh = ms.flat_beam(cells=(6, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.0, 7e-3, 1000.0), mesh.vertices[:, 0] < 0.2, loose_parts=np.False_)
    assert ms.LinearModal(ms.solve_modes(shell, 4)).equilibrium(gravity=(0, 0, -0.1), bar=np.True_).bar is not None
    with pytest.raises(ms.OptionError, match="bar must be True or False"):
        ms.LinearModal(ms.solve_modes(shell, 4)).equilibrium(gravity=(0, 0, -0.1), bar=1)
