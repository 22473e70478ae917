"""Small faults of files, names and types: each is read, or refused in one line."""

import copy
import pickle
import warnings

import pytest
from scenes import cantilever

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.checks import printable
from modalshell.files.provenance import repository_file

ESCAPE = "\x1b[31mred"


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return stop.value.code or 0, captured.out, captured.err


def test_toml_with_a_byte_order_mark_is_read(scene_file):
    plain = scene_file()
    before = ms.load_scene(plain)
    plain.write_bytes(b"\xef\xbb\xbf" + plain.read_bytes())
    assert ms.load_scene(plain).content() == before.content()


def test_names_of_files_do_not_steer_the_terminal(capsys, tmp_path):
    for arguments in (
        ["run", f"{ESCAPE}.toml"],
        ["export", f"{ESCAPE}.npz", "--to", "clip"],
        ["modes", f"{ESCAPE}.obj"],
    ):
        status, out, err = run(capsys, *arguments)
        assert status == 2
        assert "\x1b" not in out + err
        assert r"\x1b[31mred" in err
    ms.save_mesh(ms.sheet(length=1.0, width=0.3, cells=(6, 2)), tmp_path / f"{ESCAPE}.obj")
    status, out, err = run(capsys, "repair", tmp_path / f"{ESCAPE}.obj", "--out", tmp_path / f"{ESCAPE}2.ply")
    assert status == 0
    assert "\x1b" not in out + err
    assert r"\x1b[31mred2.ply" in out
    assert (tmp_path / f"{ESCAPE}2.ply").exists()


def test_only_what_steers_a_terminal_is_escaped():
    assert printable("a\x1b[0m\x9b\u202e\x7f") == r"a\x1b[0m\x9b\u202e\x7f"
    assert printable("é 日本 ☃\n\tx") == "é 日本 ☃\n\tx"


@pytest.mark.parametrize("kind", ["clip", "pc2", "page", "body", "usd"])
def test_export_of_no_path_is_refused(capsys, tmp_path, kind):
    (tmp_path / "self.npz").symlink_to(tmp_path / "self.npz")
    for name in (tmp_path / "self.npz", f"{tmp_path}/a\0b.npz"):
        status, _, err = run(capsys, "export", name, "--to", kind)
        assert status == 2
        assert err.count("\n") == 1


@pytest.mark.parametrize("wrong", [None, 5, 1.5, b"a.npz", ["a.npz"], object()])
def test_paths_of_other_types_are_refused(wrong):
    for read in (ms.load_mesh, ms.load_trajectory, ms.load_scene, ms.Basis.load, ms.load_clip):
        with pytest.raises(ms.OptionError, match="path must be a path"):
            read(wrong)


@pytest.mark.parametrize("title", [None, 5, b"leaf", ["leaf"]])
def test_titles_of_other_types_are_refused(title):
    with pytest.raises(ms.OptionError, match="title must be a str"):
        ms.solve_modes(cantilever((4, 2)), 2).page(title=title)


@pytest.mark.parametrize("text", ["nearest(1e999, 0, 0)", "nearest(0, -1e999, 0)", "nearest(1e200, 0, 0)"])
def test_nearest_takes_finite_points(text):
    with pytest.raises(ms.OptionError, match="nearest must have finite numbers"):
        ms.Clamp(text)


SCENES = sorted(repository_file("studies/scenes/v_beam.toml").parent.glob("*.toml"))


@pytest.mark.by_default("flock")
@pytest.mark.parametrize("file", SCENES, ids=lambda file: file.stem)
def test_scenes_pickle_and_copy(file):
    scene = ms.load_scene(file)
    for again in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene), copy.copy(scene)):
        assert type(again) is type(scene)
        assert (again.name, again.file, again.content()) == (scene.name, scene.file, scene.content())
        assert again.output == scene.output
    mesh = scene.build_mesh()
    assert scene.digests(mesh) == pickle.loads(pickle.dumps(scene)).digests(mesh)


HELD = '[supports]\nclamped = "x < 0.1"\n'
LISTED = """[[supports]]
kind = "clamp"
sel = "x < 0.1"
[[supports]]
kind = "path"
times = [0, 1]
translations = [[0, 0, 0], [0, 0, 0.5]]
"""


@pytest.mark.parametrize(
    ("change", "more"),
    [
        ((HELD, LISTED), ""),
        ((HELD, HELD), "[[loads.pressure]]\np = 2.0\nfollower = true\n"),
        ((HELD, HELD), '[path]\nuntil = 2.0\n[units]\nlength = "mm"\nmass = "t"\n'),
        ((HELD, HELD), '[[constraints]]\nkind = "position"\nvertices = 40\ntarget = [1, 0, 0]\nrelative = true\n'),
    ],
)
def test_scenes_with_lists_of_tables_pickle(scene_file, change, more):
    scene = ms.load_scene(scene_file(change, more=more))
    again = pickle.loads(pickle.dumps(scene))
    assert again.content() == scene.content()
    assert (again.path, again.unit_system) == (scene.path, scene.unit_system)
    assert again.build().shell.supports[0].key == scene.build().shell.supports[0].key


def test_tls_without_certificates_is_one_line(capsys, tmp_path):
    pytest.importorskip("distributed", reason="dask.distributed is not installed (pip install 'modalshell[cluster]')")
    sweep = repository_file("studies/sweeps/v_beam_gravity.toml")
    status, _, errors = run(capsys, "sweep", sweep, "--cluster", "tls://127.0.0.1:9", "--out", tmp_path)
    assert status == 2
    *bars, last = errors.splitlines()  # the scenes are checked first, under a bar
    assert not any(line.startswith("modalshell") for line in bars)
    assert "needs certificates" in last


def test_progress_that_is_no_function_is_refused():
    shell = cantilever()
    model = ms.DiscreteShell(shell)
    run = ms.simulate(model, duration=0.1, dt=0.1)
    for call in (
        lambda: ms.simulate(model, duration=0.1, dt=0.1, on_step=3),
        lambda: ms.equilibrium_path(shell, gravity=(0, 0, -1), on_step="x"),
        lambda: ms.tradeoff(shell, gravity=(0, 0, -1), on_step=3),
        lambda: ms.quick_advice(shell, gravity=(0, 0, -1), error=0.1, on_step=3),
        lambda: ms.save_trajectory(run, "never.usda", on_frame=3),
    ):
        with pytest.raises(ms.OptionError, match=r"on_(step|frame) must be a function.* \(got "):
            call()


def test_a_shell_in_the_place_of_a_basis_or_a_model_is_said_how_to_become_one():
    shell = cantilever()
    for model in (ms.ModalWarping, ms.RotationStrain):
        with pytest.raises(
            ms.OptionError, match=r"basis must be a Basis .*: ms\.solve_modes\(shell, count\) makes one"
        ):
            model(shell)
    with pytest.raises(ms.OptionError, match=r"model must be a Model .*: make one of a shell, as ms\.DiscreteShell"):
        ms.simulate(shell, duration=1.0, dt=0.1)


@pytest.mark.slow
def test_help_shows_no_empty_forms_of_lists(capsys):
    for command in ("simulate", "reproduce", "tradeoff"):
        assert "--empty" not in run(capsys, command, "--help")[1]


@pytest.mark.by_default("True")
@pytest.mark.parametrize("most", [True, 12])
def test_cubature_says_where_it_keeps_nearly_all_elements(most):
    """Of a small V it kept 94 %, at the price of a training."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(4, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 5e-3, 1000.0), "x < 1e-6")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ms.ModalShellWarning)
        model = ms.ModalDerivatives(shell, 3, cubature=most)
    said = [str(one.message) for one in caught if "cubature keeps" in str(one.message)]
    assert (model.cubature.share > 0.75) is (most is True)
    assert len(said) == (most is True)
    assert all(f"cubature keeps {100.0 * model.cubature.share:.0f} % of the elements" in text for text in said)
