"""Contacts that scenes declare: read, refused, run, resumed, drawn."""

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import stopped_and_resumed

import modalshell as ms
from modalshell.contact import COLLIDERS
from modalshell.contact.contact import Contact
from modalshell.run.path_files import scene_path
from modalshell.run.results import Look, write_result
from modalshell.scene.parts import input_files

FLOOR = '[[contacts]]\nkind = "plane"\nnormal = [0, 0, 1]\noffset = -0.1\n'
BALL = '[[contacts]]\nkind = "sphere"\ncenter = [0.8, 0, -0.3]\nradius = 0.2\nsel = "x > 0.5"\n'
KINDS = {
    "plane": "normal = [0, 0, 1]\noffset = -1",
    "sphere": "center = [0, 0, -2]\nradius = 0.5",
    "capsule": "a = [0, 0, -2]\nb = [1, 0, -2]\nradius = 0.5",
    "cylinder": "a = [0, 0, -2]\nb = [1, 0, -2]\nradius = 0.5",
    "box": "center = [0, 0, -2]\nhalf = [1, 1, 0.5]\nrounding = 0.1\nrotation = [0, 0, 0.3]",
    "height-field": "z = [[0, 0, 0, 0], [0, 0.1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]\nspacing = 1\norigin = [0, 0, -2]",
    "mesh": 'file = "ball.ply"',
}


def save_ball(file, radius=0.2):
    """Write a closed mesh about the place of BALL."""
    corners = radius * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) + [0.8, 0, -0.3]
    quarters = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4]])
    faces = np.concatenate([quarters, np.where(quarters[:, ::-1] == 4, 5, quarters[:, ::-1])])
    ms.save_mesh(ms.TriangleMesh(corners, faces), file)
    return file


def test_every_kind_is_read(scene_file, tmp_path):
    assert set(KINDS) == set(COLLIDERS)
    save_ball(tmp_path / "ball.ply")
    more = "".join(f'[[contacts]]\nkind = "{kind}"\n{keys}\n' for kind, keys in KINDS.items())
    scene = ms.load_scene(scene_file(more=more))
    contacts = scene.build_contacts()
    assert [contact.collider.key for contact in contacts] == list(KINDS)
    assert pickle.loads(pickle.dumps(scene)).build_contacts()[1].collider.radius == 0.5


def test_self_contact_is_read_and_comes_back_from_a_file(scene_file, tmp_path):
    pytest.importorskip("ipctk", reason="ipctk is not installed (pip install 'modalshell[contact]')")
    more = '[[contacts]]\nkind = "self"\ngap = 1e-3\nfriction = 0.2\n' + FLOOR
    scene = ms.load_scene(scene_file(('"mwts"', '"ds"'), ("duration = 1", "duration = 0.1"), more=more))
    own, floor = scene.build_contacts()
    assert (own.gap, own.friction, own.sel) == (1e-3, 0.2, "all")
    assert floor.has_surface
    found = ms.run_scene(scene, out=tmp_path).trajectory
    assert (found.self_contact == 1e-3).all()  # nothing comes near
    assert ms.load_trajectory(ms.save_trajectory(found, tmp_path / "again.npz")).self_contact.size == len(found.times)
    with pytest.raises(ms.SceneError, match=r"contacts\[0\].*path"):
        ms.load_scene(scene_file(more='[[contacts]]\nkind = "self"\npath = {}\n'))


def test_a_scene_rests_on_what_the_same_calls_rest_on(scene_file):
    scene = ms.load_scene(scene_file(('"mwts"', '"ds"'), ("[motion]\nduration = 1", ""), more=FLOOR + BALL))
    built = scene.build()
    state = built.equilibrium()
    same = ms.DiscreteShell(built.shell).equilibrium(
        gravity=built.gravity,
        contacts=[
            Contact(ms.Plane((0, 0, 1), -0.1)),
            Contact(ms.Sphere((0.8, 0, -0.3), 0.2), sel="x > 0.5"),
        ],
    )
    assert state.converged
    assert state.in_contact.any()
    np.testing.assert_array_equal(state.positions, same.positions)


def test_a_mesh_that_is_touched_comes_from_a_file(scene_file, tmp_path):
    saved = save_ball(tmp_path / "ball.ply")
    more = '[[contacts]]\nkind = "mesh"\nfile = "ball.ply"\nsel = "x > 0.5"\n' + FLOOR
    scene = ms.load_scene(scene_file(('"mwts"', '"ds"'), ("[motion]\nduration = 1", ""), more=more))
    built = scene.build()
    state = built.equilibrium()
    contacts = [Contact(ms.MeshCollider(ms.load_mesh(saved)), sel="x > 0.5"), Contact(ms.Plane((0, 0, 1), -0.1))]
    same = ms.DiscreteShell(built.shell).equilibrium(gravity=built.gravity, contacts=contacts)
    assert state.converged
    assert state.in_contact.any()
    np.testing.assert_array_equal(state.positions, same.positions)
    assert saved in input_files(scene)
    before = scene.digests(built.shell.mesh)["scene"]
    save_ball(saved, 0.21)
    assert scene.digests(built.shell.mesh)["scene"] != before
    saved.unlink()
    with pytest.raises(ms.ModalShellError, match=r"ball\.ply"):
        scene.build()


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('[[contacts]]\nkind = "torus"\n', "contacts[0].kind: must be one of"),
        ('[[contacts]]\nkind = "sphere"\ncenter = [0, 0, 0]\n', "contacts[0].radius"),
        ('[[contacts]]\nkind = "sphere"\ncenter = [0, 0, -9]\nradius = -1\n', "contacts[0].radius: must be"),
        ('[[contacts]]\nkind = "mesh"\n', "contacts[0].file: missing"),
        ('[[contacts]]\nkind = "mesh"\nfile = "no.ply"\n', "contacts[0].file: "),
        (FLOOR + "friction = -1\n", "contacts[0].friction: must be"),
        (FLOOR + "bounce = 1\n", "contacts[0].bounce"),
        (FLOOR + 'sel = "x > 9"\n', "contacts[0].sel: selects no vertex"),
        (FLOOR + 'sel = "x < 0.026"\n', "contacts[0].sel: must name a vertex that supports do not hold"),
        (FLOOR + "path = { times = [0, 1] }\n", "contacts[0].path"),
        ("[contacts]\nkind = 'plane'\n", "contacts: must be a list of tables"),
    ],
)
def test_bad_tables_are_refused_by_their_keys(scene_file, table, said):
    with pytest.raises(ms.SceneError) as caught:
        ms.load_scene(scene_file(more=table)).build()
    assert said in str(caught.value)


def test_what_a_motion_refuses_names_the_contact(scene_file):
    """It stood under "motion:", and was numbered without self-contact before it."""
    pytest.importorskip("ipctk", reason="ipctk is not installed (pip install 'modalshell[contact]')")
    fast = BALL + "[contacts.path]\ntimes = [0.0, 0.1]\ntranslations = [[0, 0, 0], [5, 0, 0]]\n"
    for more, model, place in (
        (FLOOR + fast, "mwts", 1),
        ('[[contacts]]\nkind = "self"\ngap = 1e-3\n' + fast, "ds", 1),
    ):
        built = ms.load_scene(scene_file(('"mwts"', f'"{model}"'), more=more)).build()
        with pytest.raises(
            ms.SceneError, match=rf": contacts\[{place}\]: the contact \(Sphere\) moves .* m in the step"
        ):
            built.start_motion()
    inside = 'kind = "self"\ngap = 1e-3\n[[contacts]]\nkind = "plane"\noffset = 0.5\n'
    built = ms.load_scene(scene_file(('"mwts"', '"ds"'), more=f"[[contacts]]\n{inside}")).build()
    with pytest.raises(ms.SceneError, match=r": contacts\[1\]: vertex \d+ begins .* inside the contact \(Plane"):
        built.start_motion()


@pytest.mark.slow
def test_a_run_with_contacts_is_drawn(scene_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = scene_file(("duration = 1", "duration = 0.5\ndt = 0.05"), more=FLOOR)
    scene = ms.load_scene(file)
    whole = ms.run_scene(scene).trajectory
    assert whole.positions[..., 2].min() >= -0.1 - 1e-8
    assert whole.positions[..., 2].min() <= -0.1 + 1e-8
    contacts = scene.build_contacts()
    bare = write_result(whole, tmp_path / "bare.png", Look()).read_bytes()
    assert write_result(whole, tmp_path / "with.png", Look(), contacts=contacts).read_bytes() != bare


@pytest.mark.slow
def test_a_plain_scene_imports_no_contacts_comparisons_or_sweeps_but_knows_all_kinds(scene_file):
    flock = Path(__file__).parents[2] / "studies/scenes/flock.toml"
    code = (
        "import sys, modalshell as ms\n"
        f"scene = ms.load_scene({str(scene_file())!r})\n"
        "scene.build().start_motion().advance()\n"
        "for given in (None, []):\n"
        "    ms.DiscreteShell(scene.build_shell()).equilibrium(gravity=(0, 0, -0.1), contacts=given)\n"
        "print([part for part in ms._LATER if f'modalshell.{part}' in sys.modules])\n"
        f"assert 'springs' in ms.models() and ms.load_scene({str(flock)!r})\n"
        "assert ms.contact.Plane is ms.Plane and 'Flock' in dir(ms) and ms.crowd.Flock is ms.Flock\n"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "['crowd', 'springs']"  # register a kind of scene and a model


@pytest.mark.by_default("mwts")
@pytest.mark.parametrize("model", ["mwts", "ds"])
def test_what_touches_is_stored_with_the_frames_and_the_same_after_a_stop(scene_file, tmp_path, model):
    file = scene_file(('"mwts"', f'"{model}"'), ("duration = 1", "duration = 0.5"), more=FLOOR)
    whole, parts = (result.trajectory for result in stopped_and_resumed(file, tmp_path, 7))
    frames, count = whole.positions.shape[:2]
    assert whole.contact_forces.shape == (frames, count, 3)
    assert whole.in_contact.shape == (frames, count)
    assert whole.in_contact[-1].any()
    assert not whole.in_contact[0].any()
    assert whole.deepest.max() <= 1e-9
    assert (whole.contact_forces[~whole.in_contact] == 0.0).all()
    assert (whole.contact_forces[whole.in_contact][:, 2] > 0.0).all()
    for name in ("positions", "contact_forces", "in_contact", "deepest", "energies"):
        assert np.asarray(getattr(parts, name)).tobytes() == np.asarray(getattr(whole, name)).tobytes(), name


def test_a_result_without_contacts_has_no_members_of_them(scene_file, tmp_path):
    found = ms.run_scene(scene_file(("duration = 1", "duration = 0.2")), out=tmp_path)
    with np.load(found.files[0]) as stored:
        assert not {"contact_forces", "in_contact", "deepest"} & set(stored.files)
    assert found.trajectory.deepest.size == 0


@pytest.mark.slow
def test_bars_and_paths_of_scenes_know_what_they_touch(scene_file):
    still = ('"mwts"', '"ds"'), ("[motion]\nduration = 1", '[path]\ncontrol = "load"')
    scene = ms.load_scene(scene_file(*still, more=FLOOR))
    state = scene.build().equilibrium()
    path = scene_path(scene)
    assert path.in_contact[-1].any()
    np.testing.assert_allclose(path.positions[-1], state.positions, atol=1e-8)
    with pytest.raises(
        ms.SceneError, match=r'path: with contacts a path is followed by load steps.* give control="load"'
    ):
        scene_path(scene, control="arc")
    file = scene_file(*still, more=FLOOR)
    file.write_text(f"bar = true\n{file.read_text()}")
    barred = ms.load_scene(file).build().equilibrium()
    assert barred.bar.valid
    assert barred.bar.displacement < 1e-6
    own = scene_file(("mwts", "ds"), more='[[contacts]]\nkind = "self"\ngap = 1e-3\n')
    own.write_text(f"bar = true\n{own.read_text()}")
    with pytest.raises(ms.SceneError, match="bar: an error bar under self-contact is not known"):
        ms.load_scene(own).build()


@pytest.mark.slow
def test_what_is_said_of_colliders_is_the_same_after_a_stop(scene_file, tmp_path):
    ceiling = FLOOR.replace("[0, 0, 1]", "[0, 0, -1]").replace("-0.1", "-0.2")
    press = ceiling + "path = { times = [0, 0.5], translations = [[0, 0, 0], [0, 0, -0.5]] }\n"
    file = scene_file(("duration = 1", "duration = 0.5"), more=FLOOR + press)
    whole, parts = (result.trajectory for result in stopped_and_resumed(file, tmp_path, 13))
    assert "contacts 0 and 1 leave vertex" in whole.message
    assert parts.message == whole.message
