"""Commands on meshes as they come: what is chosen, what is repaired, and what is said."""

import os
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.choices import BUCKLES, SAG, UNSEEN, Timing, hold_one_end, motion_as_text, softening
from modalshell.commands.cli import main
from modalshell.core.outcome import Outcome
from modalshell.mesh.selection import select_vertices

GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.fixture(autouse=True)
def _without_opengl(monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")


def run(capsys, *arguments):
    status = 0
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as stop:
        status = stop.code
    captured = capsys.readouterr()
    return status or 0, captured.out, captured.err


@pytest.fixture
def torn(tmp_path):
    """A strip with a fin on an inner edge, a copied face, and a small loose part."""
    mesh = ms.sheet(length=1.0, width=0.3, cells=(8, 3))
    first, second = mesh.edges[mesh.hinge_edges[4]]
    count = len(mesh.vertices)
    fin = 0.5 * (mesh.vertices[first] + mesh.vertices[second]) + [0.0, 0.0, 0.1]
    vertices = np.vstack((mesh.vertices, fin, mesh.vertices[[0, 1, 2, 4]] + np.array([0.0, 1.0, 0.0])))
    faces = [*mesh.faces.tolist(), mesh.faces[0].tolist(), [first, second, count], [count + 1, count + 4, count + 2]]
    path = tmp_path / "torn.obj"
    points = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
    path.write_text(points + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces))
    return path


@pytest.mark.slow
def test_a_mesh_that_is_refused_makes_a_film_with_repair(capsys, torn, tmp_path):
    status, out, err = run(capsys, "simulate", torn, "--out", tmp_path)
    assert status == 2
    assert out == ""
    assert "--repair" in err
    status, out, err = run(capsys, "simulate", torn, "--repair", "--duration", "0.1", "--out", tmp_path)
    assert status == 0, err
    assert "now 2 parts" in out  # the fin stays on its sheet
    status, out, err = run(capsys, "simulate", torn, "--split", "--duration", "0.1", "--out", tmp_path)
    assert status == 0, err
    assert "dropped 1 faces that were there already" in out
    assert "split 1 edges of three or more faces" in out
    assert "now 3 parts" in out
    assert "end of lowest y of each of 3 parts" in out
    assert (tmp_path / "torn_mwts.mp4").exists()
    status, _, err = run(capsys, "modes", torn, "--split", "--clamp", "x > 0.8", "--out", tmp_path)
    assert status == 2
    assert "--component" in err or "component 'largest'" in err
    options = ("--split", "--component", "largest", "--count", "2", "--clamp", "x > 0.8", "--out", tmp_path)
    assert run(capsys, "modes", torn, *options)[0] == 0


def test_repair_writes_a_mesh_that_is_taken_and_leaves_the_original(capsys, torn, tmp_path):
    before = torn.read_bytes()
    mended = tmp_path / "new folder" / "mended.ply"
    status, out, err = run(capsys, "repair", torn, "--split", "--out", mended, "--component", "largest")
    assert status == 0, err
    assert "left out 2 parts" in out
    assert "open edges" in out
    assert str(mended) in out
    assert ms.load_mesh(mended).area == pytest.approx(0.3)
    status, _, err = run(capsys, "repair", torn, "--out", torn)
    assert status == 2
    assert "never overwritten" in err
    (tmp_path / "link.obj").symlink_to(torn)
    assert run(capsys, "repair", torn, "--out", tmp_path / "link.obj")[0] == 2
    assert torn.read_bytes() == before
    status, _, err = run(capsys, "repair", tmp_path / "none.obj", "--out", tmp_path / "b.obj")
    assert status == 2
    assert "no such file" in err


def test_scenes_repair(torn, scene_file):
    def scene(more):
        table = f'file = "{torn.as_posix()}"\ncomponent = "largest"{more}'
        return ms.load_scene(scene_file(('shape = "v_beam"\ncells = [12, 4]', table)))

    with pytest.raises(ms.SceneError, match="--repair"):
        scene("").build_mesh()
    with pytest.warns(ms.ModalShellWarning, match="split 1 edges"):
        assert scene("\nsplit = true").build_mesh().area == pytest.approx(0.3)


@pytest.mark.by_default("1000.0")
@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_without_flags_a_mesh_of_any_size_sags_alike(capsys, tmp_path, size):
    mesh = ms.sheet(length=size, width=0.6 * size, cells=(6, 6))
    ms.save_mesh(mesh, tmp_path / "panel.ply")
    status, out, err = run(capsys, "simulate", tmp_path / "panel.ply", "--static", "--model", "lma", "--out", tmp_path)
    assert status == 0, err
    assert 'holds the end "x <= ' in out
    assert "Young's modulus" in out
    assert "time step" in out
    assert "moves by up to" in out
    found = ms.load_trajectory(tmp_path / "panel_lma.npz")
    moved = np.linalg.norm(found.positions - found.rest_positions, axis=2).max() / mesh.size
    assert moved == pytest.approx(SAG, rel=0.06)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*softer than jelly")
def test_what_is_named_is_not_chosen(capsys, tmp_path):
    ms.save_mesh(ms.sheet(length=1.0, width=0.4, cells=(8, 3)), tmp_path / "sheet.ply")
    command = ("simulate", tmp_path / "sheet.ply", "--out", tmp_path, "--duration", "0.1")
    _, out, _ = run(capsys, *command, "--young", "1e9")
    assert "holds the end" in out
    assert "Young" not in out
    assert len(ms.load_trajectory(tmp_path / "sheet_mwts.npz").times) == 4
    _, out, _ = run(capsys, *command, "--clamp", "none")
    assert "holds" not in out
    assert "6 rigid" in out
    np.savetxt(tmp_path / "held.txt", [0, 1, 2, 3], fmt="%d")
    assert ", 4 held" in run(capsys, *command, "--clamp", tmp_path / "held.txt")[1]
    _, out, _ = run(capsys, *command, "--clamp", "x < 0.2", "--young", "1e12")
    assert "too stiff to see" in out
    _, out, _ = run(capsys, *command, "--clamp", "x < 0.2", "--young", "10", "--gravity", "0", "0", "-2000")
    assert "too soft" in out


@pytest.mark.slow
@pytest.mark.filterwarnings("default::modalshell.core.errors.ModalShellWarning")
def test_what_is_doubtful_of_an_option_is_told_once(capsys, tmp_path):
    ms.save_mesh(ms.sheet(length=1.0, width=0.4, cells=(8, 3)), tmp_path / "sheet.ply")
    _, _, err = run(capsys, "simulate", tmp_path / "sheet.ply", "--static", "--thickness", "0.5", "--out", tmp_path)
    assert err.count("--thickness") == 1
    assert err.startswith("modalshell: warning: --thickness 0.5 m is over a fifth of the mesh's size, ")


@pytest.mark.slow
@pytest.mark.filterwarnings("default::modalshell.core.errors.ModalShellWarning")
def test_what_is_refused_of_a_mesh_in_mm_is_said_in_metres_and_by_options(capsys, tmp_path):
    ms.save_mesh(ms.sheet(length=100.0, width=100.0, cells=(2, 40)), tmp_path / "sheet.ply")
    status, _, err = run(capsys, "simulate", tmp_path / "sheet.ply", "--unit", "mm", "--clamp", "x > 101")
    assert status == 2
    assert err.endswith("the mesh reaches from [0.0, -0.05, 0.0] to [0.1, 0.05, 0.0] m\n")
    command = "simulate", tmp_path / "sheet.ply", "--unit", "mm", "--clamp", "x < 0.01", "--static", "--out", tmp_path
    status, _, err = run(capsys, *command, "--young", "1e6", "--thickness", "0.001", "--model", "rigid")
    assert status == 0
    assert err.startswith("modalshell: warning: 100 % of the area is in slivers")


def test_one_end_of_each_part_is_held():
    strip = ms.sheet(length=1.0, width=0.3, cells=(20, 6))
    held, words = hold_one_end(strip, GRAVITY)
    assert np.array_equal(held, strip.vertices[:, 0] <= 0.05 + 1e-9)
    assert words == 'holds the end "x <= 0.05" (14 vertices)'
    far = ms.TriangleMesh(strip.vertices + 1e6, strip.faces)
    held, words = hold_one_end(far, GRAVITY)
    assert np.array_equal(select_vertices(re.search('"(.*)"', words)[1], far), held)  # in the words that --clamp takes
    coarse = ms.sheet(length=1.0, width=0.3, cells=(2, 1))
    assert hold_one_end(coarse, GRAVITY)[0][coarse.faces].all(axis=1).any()
    assert hold_one_end(ms.sheet(cells=(1, 1)), GRAVITY)[1] == "holds the triangle of lowest x (3 vertices)"
    upright = ms.TriangleMesh(strip.vertices[:, [2, 1, 0]], strip.faces)
    assert np.ptp(upright.vertices[hold_one_end(upright, GRAVITY)[0], 1]) < 0.1  # along y, for z runs along gravity
    single = ms.TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0], [6, 1, 0]],
                             [[0, 1, 2], [3, 4, 5], [4, 6, 5]])  # fmt: skip
    held = hold_one_end(single, GRAVITY)[0]
    assert held[:3].all()
    assert held[3:].sum() == 3
    x, y = strip.vertices[:, 0] - 0.5, strip.vertices[:, 1]
    bracket = ms.TriangleMesh(np.column_stack([np.maximum(x, 0.0), y, np.maximum(-x, 0.0)]), strip.faces)
    with pytest.raises(ms.SupportError, match=r"of the mesh would be held: 52 % .* \(at most 30 % .*\); name the vert"):
        hold_one_end(bracket, GRAVITY)


def test_sheets_that_hang_by_a_vertex_are_refused_with_a_repair_that_works():
    mesh = ms.sheet(length=1.0, width=1.0, cells=(3, 3))
    corner = int(mesh.vertices.sum(axis=1).argmax())
    count = len(mesh.vertices)
    number = np.where(np.arange(count) == 0, corner, count - 1 + np.arange(count))
    vertices = np.vstack((mesh.vertices, (mesh.vertices - mesh.vertices[0] + mesh.vertices[corner])[1:]))
    pair = ms.TriangleMesh(vertices, np.vstack((mesh.faces, number[mesh.faces])))
    material = ms.Material(20.0, 20.0, 0.05, 0.2)
    basis = ms.solve_modes(ms.Shell(pair, material, hold_one_end(pair, GRAVITY)[0]), 4)
    with pytest.raises(ms.SupportError, match=r"single vertices; split them by .*--repair"):
        softening(basis, GRAVITY)
    mended, report = ms.repair(pair.vertices, pair.faces)
    assert report.parts == 2
    basis = ms.solve_modes(ms.Shell(mended, material, hold_one_end(mended, GRAVITY)[0]), 4)
    assert basis.rigid_modes == 0
    assert softening(basis, GRAVITY)[0] > 0.0
    assert softening(basis, 0.0 * GRAVITY) == (1.0, SAG)
    nearly = np.r_[1e-10 * basis.eigenvalues[-1], basis.eigenvalues[1:]]
    with pytest.raises(ms.SupportError, match="nothing resists 1 lowest modes"):
        softening(SimpleNamespace(shell=basis.shell, modes=basis.modes, eigenvalues=nearly), GRAVITY)


@pytest.mark.by_default("sheet-False", "v_beam-True")
@pytest.mark.parametrize(("mesh", "buckles"), [(ms.sheet, False), (ms.v_beam, True), (ms.cylinder_panel, True)])
def test_the_weight_sags_by_the_set_share_or_is_far_from_buckling(mesh, buckles):
    mesh = mesh(cells=(16, 4))
    held = hold_one_end(mesh, GRAVITY)[0]

    def basis(factor):
        return ms.solve_modes(ms.Shell(mesh, ms.Material(factor * 1e3, factor * 1e3, factor * 0.1, 0.2), held), 4)

    factor, sag = softening(basis(1.0), GRAVITY)
    assert softening(basis(factor), GRAVITY) == pytest.approx((1.0, sag), rel=0.06)
    assert (sag < SAG) is buckles
    if buckles:  # of the V-beam the weight was three times what buckles it, and the error bar of every run void
        assert ms.buckling_factors(basis(factor).shell, gravity=GRAVITY).factors[0] == pytest.approx(BUCKLES, rel=0.06)
    answer = ms.LinearModal(basis(factor)).equilibrium(gravity=GRAVITY)
    assert np.linalg.norm(answer.positions - mesh.vertices, axis=1).max() == pytest.approx(sag * mesh.size, rel=0.06)
    timing = Timing.of_sag(mesh.size, GRAVITY, sag)
    assert timing.duration / timing.dt == pytest.approx(60.0)


@pytest.mark.parametrize(
    ("moved", "outcome", "told"),
    [
        (0.0, Outcome.COMPLETED, "does not move, as without a load"),
        (1e-4, Outcome.COMPLETED, "too stiff"),
        (0.2, Outcome.COMPLETED, "moves by up to 20 % of its size"),
        (3.0, Outcome.COMPLETED, "too soft"),
        (0.5, Outcome.DISTORTED, "too soft"),
        (0.5, Outcome.WOUND_UP, "too soft"),
        (9.0, Outcome.DIVERGED, "flies apart"),
        (9.0, Outcome.RUNS_AWAY, "flies apart"),
    ],
)
def test_too_stiff_too_soft_and_flying_apart_are_told_apart(moved, outcome, told):
    rest = np.array(ms.sheet(cells=(2, 2)).vertices)
    frames = np.stack((rest, rest + np.array([0.0, 0.0, moved])))
    found = ms.Trajectory(times=np.arange(2.0), positions=frames, outcome=outcome, message="", unconverged_steps=0,
                          seconds=0.0, rest_positions=rest)  # fmt: skip
    line = motion_as_text(found, 1.0)
    assert line.startswith(told)
    assert "\n" not in line


def test_a_film_takes_a_rate_a_camera_a_colour_and_a_still(capsys, tmp_path):
    import imageio_ffmpeg
    from matplotlib.image import imread

    mesh = tmp_path / "strip.obj"
    ms.save_mesh(ms.flat_beam(cells=(8, 2)), mesh)
    plain = ("simulate", mesh, "--clamp", "x < 0.2", "--young", "1e8", "--duration", "0.5", "--dt", "0.05")
    looks = ("--color", "displacement", "--fps", "5", "--camera", "0", "-1", "0.2", "--turntable", "--still", "0.2")
    for folder, options in (("plain", ()), ("looks", looks)):
        status, out, err = run(capsys, *plain, *options, "--out", tmp_path / folder)
        assert (status, err.count("error")) == (0, 0)
    assert "strip_mwts.png" in out
    still = imread(tmp_path / "looks" / "strip_mwts.png")[..., :3]
    assert (np.ptp(still, axis=2) > 0.2).mean() > 0.005  # colours of displacement and their bar
    seen = {}
    for folder in ("plain", "looks"):
        film = imageio_ffmpeg.read_frames(str(tmp_path / folder / "strip_mwts.mp4"))
        about = next(film)
        frames = [np.frombuffer(frame, np.uint8).reshape(*about["size"][::-1], 3) for frame in film]
        seen[folder] = about["fps"], frames
    assert (seen["plain"][0], seen["looks"][0]) == (20.0, 5.0)
    dark = [(frame.min(axis=2) < 200)[:, : 3 * frame.shape[1] // 4].sum() for frame in seen["looks"][1]]
    assert max(dark) > 1.5 * min(dark)  # it is seen from its side and along itself
    for wrong, message in (
        (("--fps", "0"), "--fps"),
        (("--camera", "0", "0", "0"), "camera"),
        (("--color", "x"), "von"),
    ):
        status, _, err = run(capsys, *plain, *wrong, "--out", tmp_path)
        assert (status, message in err) == (2, True)


SLOW = ("--clamp", "x < 0.2", "--model", "ds", "--duration", "1")


def started(mesh, out):
    command = [sys.executable, "-m", "modalshell", "simulate", str(mesh), *SLOW, "--out", str(out)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "MODALSHELL_RENDERER": "built-in"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


@pytest.mark.slow
def test_a_killed_command_goes_on_where_it_was(capsys, tmp_path):
    mesh, frames = tmp_path / "strip 1.obj", tmp_path / "killed" / "strip 1_ds.frames"
    ms.save_mesh(ms.flat_beam(cells=(12, 3)), mesh)
    status, out, err = run(capsys, "simulate", mesh, *SLOW, "--out", tmp_path / "whole")
    assert status == 0, err
    assert "earlier run" not in out
    # Positions, and what a step begins with: coordinates, rates, and three vectors that the rule keeps.
    record = 6 * ms.load_trajectory(tmp_path / "whole" / "strip 1_ds.npz").positions[0].nbytes
    process = started(mesh, tmp_path / "killed")
    while not frames.exists() or frames.stat().st_size < 14 * record:
        assert process.poll() is None, process.communicate()
        time.sleep(1e-3)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not (tmp_path / "killed" / "strip 1_ds.npz").exists()
    status, out, err = run(capsys, "simulate", mesh, *SLOW, "--out", tmp_path / "killed")
    assert status == 0, err
    assert int(re.search(r"31 frames in .* s, (\d+) of them from an earlier run", out)[1]) >= 5
    found, expected = (ms.load_trajectory(tmp_path / name / "strip 1_ds.npz") for name in ("killed", "whole"))
    for name in ("times", "positions", "energies"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    names = {path.name for path in (tmp_path / "killed").iterdir()}
    assert names == {f"strip 1_ds.{kind}" for kind in ("npz", "json", "mp4")}


@pytest.mark.slow
def test_results_are_computed_again_where_something_changed(capsys, tmp_path):
    mesh, out = tmp_path / "strip.obj", tmp_path / "out"
    ms.save_mesh(ms.flat_beam(cells=(8, 2)), mesh)
    command = ("simulate", mesh, "--clamp", "x < 0.2", "--duration", "0.1", "--out", out)
    assert "modes" in run(capsys, *command)[1]
    times = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}

    def changed(*options):
        status, told, err = run(capsys, *command, *options)
        assert status == 0, err
        before = dict(times)
        times.update({path.name: path.stat().st_mtime_ns for path in out.iterdir()})
        return told, {name.rpartition(".")[2] for name in times if times[name] != before.get(name)}

    told, new = changed()
    assert "4 frames in" in told
    assert "4 of them from an earlier run" in told
    assert new == set()
    assert changed("--fps", "5")[1] == {"mp4", "json"}
    assert changed("--fps", "5", "--still", "0.1")[1] == {"mp4", "png", "json"}
    told, new = changed("--color", "curvature")
    assert "from an earlier run" in told
    assert {"npz", "mp4"} <= new
    told, new = changed("--gravity", "0", "0", "-2")
    assert "earlier run" not in told
    assert {"npz", "mp4"} <= new
    told, new = changed("--static")
    assert "iterations, residual" in told
    assert {"npz", "png"} <= new
    assert "1 of them from an earlier run" in changed("--static")[0]
    assert "iterations" in changed("--static", "--restart")[0]
    ms.save_mesh(ms.flat_beam(cells=(8, 4)), mesh)
    assert "earlier run" not in changed("--static")[0]


@pytest.mark.slow
def test_frames_of_a_run_with_other_options_are_kept(capsys, tmp_path, monkeypatch):
    mesh = tmp_path / "strip.obj"
    ms.save_mesh(ms.flat_beam(cells=(8, 2)), mesh)
    command = ("simulate", mesh, "--clamp", "x < 0.2", "--duration", "0.2", "--out", tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("modalshell.run.run_shell.write_result", lambda *_: sys.exit(9))
        assert run(capsys, *command)[0] == 9
    frames = (tmp_path / "strip_mwts.frames").read_bytes()
    status, _, err = run(capsys, *command, "--young", "1e8")
    assert (status, "--restart" in err) == (2, True)
    assert (tmp_path / "strip_mwts.frames").read_bytes() == frames
    status, out, err = run(capsys, *command, "--young", "1e8", "--restart")
    assert (status, "earlier run" in out) == (0, False), err
    assert not (tmp_path / "strip_mwts.frames").exists()


@pytest.mark.slow
def test_auto_is_not_told_to_take_what_it_took(capsys, tmp_path, monkeypatch):
    ms.save_mesh(ms.cylinder_panel(length=0.4, radius=0.08, angle=300.0, cells=(8, 12)), tmp_path / "tube.obj")
    arguments = ["simulate", tmp_path / "tube.obj", "--clamp", "x < 0.01", "--duration", "0.2", "--out", tmp_path]
    monkeypatch.setattr("modalshell.commands.unasked_bars._GOOD", -1.0)
    status, out, err = run(capsys, *arguments, "--model", "auto")
    assert status == 0, err
    assert "steps by DS 100 %" in out
    assert "take --model ds" not in out
    assert "take --model ds" in run(capsys, *arguments, "--dt", "0.0005", "--model", "mwts")[1]


def test_a_motion_that_is_hardly_seen_is_not_asked_to_grow_once(v_basis):
    """It said "about 1 times or more"."""
    run = ms.simulate(ms.LinearModal(v_basis), duration=0.1, gravity=(0.0, 0.0, -1e-3))
    moved = np.linalg.norm(run.positions - run.rest_positions, axis=2).max()
    assert "about 2 times" in motion_as_text(run, 1.2 * float(moved) / UNSEEN)


def test_modes_that_are_all_rigid_are_said_to_be(capsys, tmp_path):
    """Four zeros of a free sheet told nothing of its vibrations, nor how to have them."""
    file = tmp_path / "sheet.obj"
    ms.save_mesh(ms.sheet(cells=(3, 3)), file)
    with pytest.raises(SystemExit) as ended:
        main(["modes", str(file), "--count", "4", "--out", str(tmp_path)])
    assert ended.value.code == 0
    assert "rigid motions alone: clamp it (--clamp), or ask for more (--count 12)" in capsys.readouterr().out
