"""Supports in scenes: a list of tables by kind, files of indices, and what is refused with its path."""

import numpy as np
import pytest

import modalshell as ms

HELD = '[supports]\nclamped = "x < 0.1"\n'
LIST = """
[[supports]]
kind = "clamp"
sel = "x < 0.1"
[[supports]]
kind = "roller"
sel = "x > 0.99"
direction = [1.0, 0.0, 0.0]
[[supports]]
kind = "tie"
sel = [7, 8]
"""


@pytest.fixture
def load(scene_file):
    return lambda new, old=HELD: ms.load_scene(scene_file((old, new)))


def test_a_list_of_supports_builds_what_the_same_calls_build(load):
    shell = load(LIST).build_shell()
    x = shell.mesh.vertices[:, 0]
    expected = ms.Shell(
        shell.mesh, shell.material, supports=[ms.Clamp(x < 0.1), ms.Roller(x > 0.99, (1, 0, 0)), ms.Tie([7, 8])]
    )
    assert (shell.unknowns.matrix != expected.unknowns.matrix).nnz == 0
    assert [support.key for support in shell.supports] == ["clamp", "roller", "tie"]


def test_clamped_is_short_for_one_clamp(load):
    short, long = load(HELD), load('[[supports]]\nkind = "clamp"\nsel = "x < 0.1"\n')
    assert (short.build_shell().clamped == long.build_shell().clamped).all()
    mesh = short.build_mesh()
    assert short.digests(mesh)["mesh"] == long.digests(mesh)["mesh"]
    assert short.digests(mesh)["scene"] != long.digests(mesh)["scene"]


def test_listed_supports_move_along_their_path(load):
    moved = LIST + '[[supports]]\nkind = "path"\ntimes = [0, 1]\ntranslations = [[0, 0, 0], [0, 0, 0.5]]\n'
    built = load(moved).build()
    assert built.path.at(1.0).translation == pytest.approx([0.0, 0.0, 0.5])


@pytest.mark.slow
def test_the_largest_load_is_found_along_a_path_of_years(load):
    """It was looked for 120 times a second, and the load of each time kept."""
    moved = HELD + "times = [0, 1e9]\ntranslations = [[0, 0, 0], [0, 0, 0.5]]\n"
    scene = load(moved)
    assert "at 0 s" in scene.largest_load(scene.build_shell())[1]


@pytest.mark.parametrize("content", ["txt", "npy", "mask"])
def test_files_of_indices_or_a_mask_select(scene_file, content):
    count = len(ms.load_scene(scene_file()).build_mesh().vertices)
    suffix = "txt" if content == "txt" else "npy"
    scene = scene_file((HELD, f'[[supports]]\nkind = "pin"\nsel = "rim.{suffix}"\n'))
    if content == "txt":
        (scene.parent / "rim.txt").write_text("3\n4 5\n", encoding="utf-8-sig")  # as Windows writes it
    else:
        chosen = np.array([3, 4, 5])
        np.save(scene.parent / "rim.npy", np.isin(np.arange(count), chosen) if content == "mask" else chosen)
    assert np.flatnonzero(ms.load_scene(scene).build_shell().clamped).tolist() == [3, 4, 5]


def test_a_mask_of_another_mesh_is_refused(scene_file):
    scene = scene_file((HELD, '[[supports]]\nkind = "pin"\nsel = "rim.npy"\n'))
    np.save(scene.parent / "rim.npy", np.isin(np.arange(6), [3, 4, 5]))
    with pytest.raises(ms.SceneError, match=r"supports\[0\]\.sel: must be a mask .*got shape \(6,\)"):
        ms.load_scene(scene).build_shell()


@pytest.mark.parametrize("content", ["", "x", "-1", "1.5"])
def test_files_without_indices_are_refused(scene_file, content):
    scene = scene_file((HELD, '[[supports]]\nkind = "pin"\nsel = "rim.txt"\n'))
    (scene.parent / "rim.txt").write_text(content, encoding="utf-8")
    with pytest.raises(ms.SceneError, match=r"supports\[0\]\.sel"):
        ms.load_scene(scene).build_shell()


@pytest.mark.parametrize(
    ("entry", "told"),
    [
        ('sel = "x < 0.1"', r"supports\[0\]\.kind: missing; choose from clamp, pin"),
        ('kind = "glue"\nsel = "x < 0.1"', r"supports\[0\]\.kind: must be one of"),
        ('kind = "pin"', r"supports\[0\]\.sel: missing"),
        ('kind = "pin"\nsel = "x <"', r"supports\[0\]\.sel: "),
        ('kind = "pin"\nsel = "x < -9"', r"supports\[0\]\.sel: selects no vertex"),
        ('kind = "pin"\nsel = "boundary(5)"', r"supports\[0\]\.sel: "),
        ('kind = "pin"\nsel = "no.txt"', r"supports\[0\]\.sel: must be a file"),
        ('kind = "pin"\nsel = [true, 1]', r"supports\[0\]\.sel: must be bool .*not both in one list"),
        ('kind = "pin"\nsel = []', r"supports\[0\]\.sel: selects no vertex \(got \[\]\)"),
        ('kind = "pin"\nsel = [9999]', r"supports\[0\]\.sel: names vertex 9999"),
        ('kind = "pin"\nsel = "x < 9"', r"supports: the supports hold all"),
        ('kind = "fix"\nsel = "x < 0.1"\naxes = "w"', r"supports\[0\]\.axes: "),
        ('kind = "fix"\nsel = "x < 0.1"\naxis = "z"', r"supports\[0\]\.axis: unknown key; did you mean 'axes'"),
        ('kind = "roller"\nsel = "x < 0.1"\ndirection = [0, 0, 0]', r"supports\[0\]\.direction: must not be zero"),
        ('kind = "symmetry"\nsel = "x < 0.9"\nnormal = [1, 0, 0]', r"supports\[0\]\.sel: of a symmetry plane"),
        ('kind = "path"\ntimes = [0, 1]', r"supports\[0\]\.times: need translations"),
        ('kind = "path"\ntimes = [1, 0]\nrotations = [[0, 0, 0], [0, 0, 1]]', r"supports\[0\]\.times: "),
    ],
)
def test_wrong_keys_are_refused_with_their_path(load, entry, told):
    with pytest.raises(ms.SceneError, match=told):
        load(f"[[supports]]\n{entry}\n").build()


def test_one_path_is_enough(load):
    path = '[[supports]]\nkind = "path"\ntimes = [0, 1]\n'
    with pytest.raises(ms.SceneError, match=r"supports\[1\]: supports move along one path"):
        load(path + path)
