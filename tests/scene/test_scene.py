import json
import re

import numpy as np
import pytest
from scenes import cantilever
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.models.factory import ModelFactory
from modalshell.models.registry import MODELS
from modalshell.scene.parts import SHAPES

TIP = '[[constraints]]\nkind = "position"\nnearest = [1, 0, 0]\n'


@pytest.fixture
def load(scene_file):
    def load(old="", new="", more=""):
        return ms.load_scene(scene_file(*[(old, new)] * bool(old), more=more))

    return load


def test_a_scene_builds_what_the_same_calls_build(load):
    scene = load("duration = 1", "duration = 0.3\ndt = 0.1\ndamping = [0.5, 0.01]")
    options = {"gravity": (0, 0, -9.81), "damping": (0.5, 0.01)}
    expected = ms.simulate(ms.ModalWarping(ms.solve_modes(cantilever(), 8)), duration=0.3, dt=0.1, **options)
    motion = scene.build().start_motion()
    for _ in range(3):
        motion.advance()
    np.testing.assert_array_equal(motion.positions(), expected.positions[-1])


def test_only_what_is_declared_is_built(load, monkeypatch):
    def refuse(*_args, **_options):
        raise AssertionError("modes were not asked for")

    monkeypatch.setattr(ModelFactory, "basis", refuse)
    scene = load('"mwts"', '"ds"')
    built = scene.build()
    assert (built.force, built.path, list(built.constraints)) == (None, None, [])
    assert (scene.name, scene.constraints, scene.output.formats) == ("scene", (), [])
    free = load('[supports]\nclamped = "x < 0.1"\n[loads]\ngravity = [0, 0, -9.81]', "").build_shell()
    assert not free.clamped.any()


@pytest.mark.filterwarnings("ignore:.*one row of vertices")
@pytest.mark.parametrize("name", SHAPES)
def test_shapes_take_the_parameters_of_their_functions(load, name):
    family = 'family = "right"\n' if "family" in SHAPES[name].__struct_fields__ else ""
    scene = load('shape = "v_beam"\ncells = [12, 4]', f'shape = "{name}"\nlength = 2.0\n{family}cells = [8, 4]')
    mesh = scene.build_shell().mesh
    assert np.ptp(mesh.vertices[:, 0]) == pytest.approx(2.0, rel=0.05)
    with pytest.raises(ms.SceneError, match=r"mesh\.heigth: unknown key.*allowed: shape, length"):
        load('shape = "v_beam"', f'shape = "{name}"\nheigth = 2.0')


@pytest.mark.by_default("rigid")
@pytest.mark.parametrize("name", MODELS)
def test_every_model_can_be_named(load, name):
    model = load('"mwts"', f'"{name}"').build().model
    assert model.positions(model.start_motion()).shape == model.shell.rest_positions.shape


def test_model_options_reach_the_model(load):
    model = load('"mwts"', '"mwts"\nmodes = 5\nintegrator = "implicit_midpoint"\nconsistent_force = true').build().model
    assert (model.basis.count, model.integrator.key, model.consistent_force) == (5, "implicit_midpoint", True)


def test_mesh_files_are_looked_for_beside_the_scene_and_in_the_package(load, tmp_path):
    ms.save_mesh(ms.sheet(cells=(12, 4)), tmp_path / "own.ply")
    own = load('shape = "v_beam"\ncells = [12, 4]', 'file = "own.ply"').build_shell()
    assert len(own.mesh.faces) == 96
    bundled = load('shape = "v_beam"\ncells = [12, 4]', 'file = "meshes/v_beam.obj"').build_shell()
    assert len(bundled.mesh.faces) > 96


SHEET = {"young": 1e7, "poisson": 0.3, "thickness": 1e-3, "density": 700.0}
STIFFNESSES = "stretch = 20.0\nshear = 20.0\nflexure = 0.05\ndensity = 0.2"


def sheet_text(**changed):
    return "\n".join(f"{name} = {json.dumps(value)}" for name, value in (SHEET | changed).items())


def test_physical_material_is_shell_theory(load):
    shell = load(STIFFNESSES, sheet_text()).build_shell()
    assert shell.material == ms.Isotropic(**SHEET).on(shell.mesh)


@pytest.mark.by_default("rigid")
@pytest.mark.parametrize("name", [name for name in MODELS if name not in ("springs", "hybrid")])
def test_models_take_shell_theory(load, name):
    scene = ms.load_scene(load(STIFFNESSES, sheet_text()).file)
    text = scene.file.read_text().replace('"mwts"', f'"{name}"')
    scene.file.write_text(text)
    motion = ms.load_scene(scene.file).build().start_motion()
    motion.advance()
    assert np.isfinite(motion.positions()).all()


def test_springs_refuse_shell_theory(load):
    scene = load(STIFFNESSES, sheet_text())
    scene.file.write_text(scene.file.read_text().replace('"mwts"', '"springs"'))
    with pytest.raises(ms.SceneError, match=r"in \[material\] calibrated = true, for simulate --calibrated"):
        ms.load_scene(scene.file).build()


def test_calibrated_material_is_that_of_discrete_shells(load):
    shell = load(STIFFNESSES, sheet_text(calibrated=True)).build_shell()
    np.testing.assert_array_equal(
        shell.material.shear, ms.Material.from_physical(**SHEET, mesh=ms.v_beam(cells=(12, 4))).shear
    )


@pytest.mark.parametrize("kind", ["list", "npy", "txt"])
def test_material_may_differ_between_triangles(load, tmp_path, kind):
    thickness = np.linspace(1e-3, 2e-3, 96)
    given = thickness.tolist() if kind == "list" else f"thickness.{kind}"
    if kind == "npy":
        np.save(tmp_path / given, thickness)
    elif kind == "txt":
        np.savetxt(tmp_path / given, thickness)
    scene = load(STIFFNESSES, sheet_text(thickness=given))
    shell = scene.build_shell()
    np.testing.assert_array_equal(shell.material.thicknesses(shell.mesh), thickness)
    # The digest is of the numbers, wherever they stand.
    same = load(STIFFNESSES, sheet_text(thickness=thickness.tolist()))
    other = load(STIFFNESSES, sheet_text(thickness=(2.0 * thickness).tolist()))
    digests = [one.digests(shell.mesh)["scene"] for one in (scene, same, other)]
    assert digests[0] == digests[1] != digests[2]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"thickness": [1e-3, 2e-3]}, "material.thickness: has 2 values, but the mesh has 96 triangles"),
        ({"thickness": "none.npy"}, "material.thickness: must be a number, one per triangle, or a readable file"),
        ({"young": "words.txt"}, "material.young: must be a number, .* could not convert string to float"),
        ({"young": "words.npy"}, "material.young: must be a number"),
        ({"young": "waves.npy"}, "material.young: must be .*got dtype complex128"),
        ({"young": [1e6] * 96, "calibrated": True}, "material.young: must be one number where the material is calib"),
        ({"thickness": [1e-3, -1e-3]}, r"material.thickness\[1\]: must be a number above 0.0"),
        ({"thickness": []}, "material.thickness: must be a list of length at least 1"),
    ],
)
def test_bad_materials_by_triangle_are_refused(load, tmp_path, changed, message):
    for suffix in ("txt", "npy"):
        (tmp_path / f"words.{suffix}").write_text("thin thick")
    np.save(tmp_path / "waves.npy", np.full(96, 1e6 + 1e6j))
    with pytest.raises(ms.SceneError, match=message):
        load(STIFFNESSES, sheet_text(**changed)).build_shell()


def test_forces_are_spread_over_the_selected_area(load):
    forces = (
        '[[loads.forces]]\nwhere = "x > 0.7"\ntotal = [0, 1, 2]\n[[loads.forces]]\nwhere = [5]\ntotal = [3, 0, 0]\n'
    )
    built = load("[model]", f"{forces}[model]").build()
    np.testing.assert_allclose(built.force.sum(axis=0), [3, 1, 2])
    chosen = built.shell.rest_positions[:, 0] > 0.7
    assert not built.force[~chosen, 1:].any()
    share = built.shell.mass[chosen] / built.shell.mass[chosen].sum()
    np.testing.assert_allclose(built.force[chosen, 2], 2 * share)


def test_supports_move_through_their_keyframes(load):
    path = "times = [0, 1]\ntranslations = [[0, 0, 0], [1, 2, 3]]\nrotations = [[0, 0, 0], [0, 0, 0.5]]"
    pose = load('clamped = "x < 0.1"', f"clamped = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]\n{path}").build().path.at(1.0)
    np.testing.assert_allclose(pose.translation, [1, 2, 3])
    np.testing.assert_allclose(Rotation.from_matrix(pose.rotation).as_rotvec(), [0, 0, 0.5], atol=1e-12)
    turning = load('clamped = "x < 0.1"', "clamped = [0]\ntimes = [0, 1]\nrotations = [[0, 0, 0], [0, 0, 0.5]]")
    assert not turning.build().path.at(0.7).translation.any()


def test_the_largest_load_of_a_short_path_is_that_between_its_ends(load):
    """It was looked for 120 times a second: of a path of some milliseconds at its ends alone, at one by half."""
    path = (
        "times = [0, 1e-3, 2e-3, 3e-3, 4e-3]\ntranslations = [[0, 0, 0], [0, 0, 0], [0, 0, 1e-4], [0, 0, 0], [0, 0, 0]]"
    )
    scene = load('clamped = "x < 0.1"', f'clamped = "x < 0.1"\n{path}')
    built = scene.build()
    felt = scene.largest_load(built.shell)[0] / built.shell.mass[:, None]
    largest = max(abs(9.81 + built.path.at(time).acceleration[2]) for time in (1e-3, 2e-3, 3e-3))
    np.testing.assert_allclose(np.abs(felt[:, 2]), largest, rtol=1e-12)


def test_targets_pass_through_their_keyframes(load):
    frames = "times = [0, 1, 3]\ntargets = [[0, 0, 0], [1, 1, 1], [3, 0, 0]]\n"
    turn = '[[constraints]]\nkind = "orientation"\nvertices = 64\npath = "linear"\n'
    built = load(more=f"{TIP}relative = true\n{frames}{turn}{frames}").build()
    position, orientation = built.constraints
    tip = np.argmin(np.linalg.norm(built.shell.rest_positions - [1, 0, 0], axis=1))
    assert position.vertices.tolist() == [tip]
    for time, target in ((0, [0, 0, 0]), (1, [1, 1, 1]), (3, [3, 0, 0]), (9, [3, 0, 0])):
        np.testing.assert_allclose(position.at(time), built.shell.rest_positions[tip] + target, atol=1e-12)
        np.testing.assert_allclose(orientation.at(time), target, atol=1e-12)
    np.testing.assert_allclose(orientation.at(2.0), [2.0, 0.5, 0.5])
    slope = (position.at(1e-6) - position.at(0.0)) / 1e-6  # starts at rest
    assert np.abs(slope).max() < 1e-4


def test_a_wrong_name_is_answered_with_the_nearest_one(load):
    with pytest.raises(ms.SceneError, match=r"model\.name: must be one of .* \(got 'MWST'\); did you mean 'mwts'\?"):
        load('"mwts"', '"MWST"')


def test_without_motion_a_scene_is_static(load):
    built = load("[motion]\nduration = 1", f"{TIP}relative = true\ntarget = [-0.02, 0, 0.05]").build()
    answer = built.equilibrium()
    assert answer.converged
    assert answer.constraint_residuals.max() < 1e-8
    with pytest.raises(ms.SceneError, match="motion: missing"):
        built.start_motion()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("stretch = 20.0", "strech = 20.0", "material.strech: unknown key; did you mean 'stretch'? allowed: stretch, "),
        ("stretch = 20.0", 'stretch = "a"', "material.stretch: must be a number (got 'a')"),
        ("stretch = 20.0", "poisson = 0.3", "material.shear: unknown key; allowed: young, poisson, thickness"),
        ("[model]", "[model]\nbar = true", "model.bar: unknown key; error bars are asked for by bar = true before"),
        ("stretch = 20.0", "", "material.stretch: missing"),
        ("density = 0.2", "density = -0.2", "material.density: must be a number above 0.0 (got -0.2)"),
        ("density = 0.2", "density = nan", "material.density: must be a finite number"),
        ("density = 0.2", "density = true", "material.density: must be a number (got True)"),
        ("[12, 4]", "[12]", "mesh.cells: must be a list of length 2 (got [12])"),
        ("[12, 4]", '[12, "a"]', "mesh.cells[1]: must be an integer (got 'a')"),
        ('"v_beam"', '"w_beam"', "mesh.shape: must be one of flat_beam, v_beam, sheet, cylinder_panel, leaf"),
        ('shape = "v_beam"', "", "mesh: must have either file or shape"),
        ("[mesh]", "[[mesh]]", "mesh: must be a table, [mesh], and not a list of them (got"),
        ("[loads]\ngravity", "[[loads]]\np", "loads: must be a table, [loads], and not a list of them; its lists"),
        ("[mesh]", 'name = "a/b"\n[mesh]', "name: must be 1 to 100 letters"),
        ("[mesh]", "x = " + "[" * 3000 + "\n[mesh]", "not TOML"),
        ('"mwts"', '"magic"', "model.name: must be one of rigid, lma, mwts"),
        ('name = "mwts"', "", "model.name: missing; choose from rigid, lma, mwts"),
        ('"mwts"', '"mwts"\nmodes = 0', "model.modes: must be an integer at least 1 (got 0)"),
        ('"mwts"', '"mwts"\nmodes = 2.5', "model.modes: must be an integer (got 2.5)"),
        ('"mwts"', '"mwts"\nwarp = "sum"', "model.warp: unknown key; allowed: name, modes, integrator"),
        ('"mwts"', '"ds"\nmodes = 4', "model.modes: unknown key; allowed: name, integrator"),
        ("duration = 1", "duration = 0", "motion.duration: must be a number above 0.0 (got 0)"),
        ("duration = 1", "duration = 1e-9", "motion.duration: must be at least one step"),
        ("duration = 1", "duration = 1e999", "motion.duration: must be a finite number"),
        ("duration = 1", "duration = 1" + "0" * 400, "motion.duration: must be a finite number"),
        ("duration = 1", "duration = 2020-01-01", "motion.duration: must be a number"),
        ("duration = 1", "duration =", "not TOML: Invalid value (at line 17, column 11)"),
        ("duration = 1", "duration = 1\ndamping = [1, -1]", "motion.damping[1]: must be a number at least 0.0"),
        ("[motion]", "[moton]", "moton: unknown key; did you mean 'motion'?"),
        ('"x < 0.1"', "3.5", "supports.clamped: must be a text or a list (got 3.5)"),
        ('"x < 0.1"', "[-1]", "supports.clamped[0]: must be an integer at least 0 (got -1)"),
        ("[0, 0, -9.81]", "3", "loads.gravity: must be a list of length 3 (got 3)"),
        ("[model]", "[loads.pressure]\np = 1.0\n[model]", "loads.pressure: must be a list of tables, [[loads"),
        ("[supports]", '[supports]\nkind = "pin"', "supports.kind: supports of a kind are a list of tables"),
        ("[supports]\nclamped", '[[supports]]\nkind = "clamp"\ntimes = [0, 1]\nsel', "supports[0].times: supports mov"),
        ("duration = 1", "duration = 1\ndamping = 0.1", "motion.damping: must be a list of length 2 (got 0.1)"),
        ("[0, 0, -9.81]", '[0, 0, inf]', "loads.gravity[2]: must be a finite number"),
        ("[model]", "[[loads.forces]]\nwhere = [1]\ntotl = [0, 0, 1]\n[model]", "loads.forces[0].totl: unknown key"),
        ("[model]", "[[loads.forces]]\nwhere = [1]\ntotal = [0, 0]\n[model]", "loads.forces[0].total: must be a list"),
        ("[model]", "[constraints]\n[model]", "constraints: must be a list of tables"),
        ("[model]", '[[constraints]]\nkind = "x"\n[model]', "constraints[0].kind: must be one of position"),
        ("[model]", '[output]\nformats = ["gif"]\n[model]', "output.formats[0]: must be one of npz, vtkhdf"),
    ],
)  # fmt: skip
def test_what_is_not_allowed_is_refused_at_its_path(load, old, new, message):
    with pytest.raises(ms.SceneError) as refused:
        load(old, new)
    file, _, text = str(refused.value).partition(": ")
    assert file.endswith("scene.toml")
    assert text.startswith(message)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[12, 4]", "[12, 3]", "mesh.cells[1]: must be even"),
        ("[12, 4]", "[12, 4]\nlength = -1", "mesh.length: must be a finite number above 0"),
        ("[12, 4]", '[12, 4]\nfamily = "x"', "mesh.family: must be one of 'alternating'"),
        ('shape = "v_beam"\ncells = [12, 4]', 'file = "no.obj"', "mesh.file: "),
        ('shape = "v_beam"\ncells = [12, 4]', 'file = "meshes/leav.obj"', "mesh.file: meshes/leav.obj is "),
        ("stretch = 20.0", "stretch = -900", "material.stretch: -900 N/m makes triangle"),
        ('"x < 0.1"', '"x < "', "supports.clamped: cannot read the selection 'x < ': invalid syntax; allowed"),
        ('"x < 0.1"', '"x < -9"', "supports.clamped: selects no vertex (got 'x < -9'); the mesh reaches from"),
        ('"x < 0.1"', '"x < 9"', "supports.clamped: holds all 65 vertices"),
        ('"x < 0.1"', "[999]", "supports.clamped: names vertex 999, but the mesh has vertices 0 to 64"),
        ('"x < 0.1"', "[1]\nrotations = [[0, 0, 0], [0, 0, 1]]", "supports.rotations: needs keyframe times"),
        ('"x < 0.1"', "[1]\ntimes = [0, 1]", "supports.times: need translations or rotations"),
        ('"x < 0.1"', "[1]\ntimes = [1, 1]\nrotations = [[0, 0, 0], [0, 0, 1]]", "supports.times: must increase"),
        ('"x < 0.1"', "[1]\ntimes = [0, 1, 2]\nrotations = [[0, 0, 0], [0, 0, 1]]", "supports.rotations: must have"),
        ("[motion]\nduration = 1", "", None),
        ('"mwts"', '"mwts"\nmodes = 999', "model.modes: must be at most 165"),
        ("[model]", '[[loads.forces]]\nwhere = "x > 9"\ntotal = [0, 0, 1]\n[model]', "loads.forces[0].where: selects"),
        ("[model]", f"{TIP}[model]", "constraints[0]: a constraint needs either target or targets"),
        ("[model]", f"{TIP}vertices = 3\ntarget = [0, 0, 0]\n[model]", "constraints[0]: a constraint needs"),
        ("[model]", f"{TIP}targets = [[0, 0, 0], [1, 1, 1]]\n[model]", "constraints[0].targets: need keyframe times"),
        ("[model]", f"{TIP}times = [0, 0]\ntargets = [[0, 0, 0], [1, 1, 1]]\n[model]", "constraints[0].times: must"),
        ("[model]", f"{TIP}times = [0, 1, 2]\ntargets = [[0, 0, 0], [1, 1, 1]]\n[model]", "constraints[0].targets: "),
        ("[model]", f"{TIP.replace('1', '0')}target = [0, 0, 0]\n[model]", "constraints[0]: a constraint names vertex"),
        ('"mwts"', '"ds"\nintegrator = "explicit"', "motion.dt: must be at most"),
    ],
)  # fmt: skip
def test_what_the_mesh_or_model_does_not_allow_is_refused_at_its_path(load, old, new, message):
    scene = load(old, new)
    if message is None:
        message = "motion: missing"
    with pytest.raises(ms.SceneError) as refused:
        scene.build().start_motion()
    assert str(refused.value).partition("scene.toml: ")[2].startswith(message)


@pytest.mark.parametrize("name", ["rigid", "md-rom"])
def test_models_without_constraints_refuse_them(load, name):
    with pytest.raises(ms.SceneError, match=r"constraints: .* takes none"):
        load('"mwts"', f'"{name}"', more=f"{TIP}target = [1, 0, 0]").build()


def test_moving_parts_need_a_motion(load, scene_file):
    text = "[motion]\nduration = 1"
    with pytest.raises(ms.SceneError, match=r"constraints\[0\]: targets that move need a \[motion\]"):
        load(text, f"{TIP}times = [0, 1]\ntargets = [[0, 0, 0], [1, 1, 1]]").build()
    scene = scene_file((text, ""), ('"x < 0.1"', "[1]\ntimes = [0, 1]\nrotations = [[0, 0, 0], [0, 0, 1]]"))
    with pytest.raises(ms.SceneError, match=r"supports\.times: .* \[motion\]"):
        ms.load_scene(scene).build()


THEORY = (
    "stretch = 20.0\nshear = 20.0\nflexure = 0.05\ndensity = 0.2",
    "young = 1e8\npoisson = 0.3\nthickness = 1e-3\ndensity = 1e3",
)


@pytest.mark.parametrize(
    ("changes", "more", "message"),
    [
        (
            (("duration = 1", "duration = 1\nmodal_damping = [0.1, 0.2]"),),
            "",
            r"motion\.modal_damping: must be one number",
        ),
        ((THEORY,), "[rest]\nrest_curvature = 0.5\n", r"toml: model: vibration modes about the mesh need"),
    ],
)
def test_a_refusal_is_a_whole_sentence_under_the_scenes_own_key(scene_file, changes, more, message):
    scene = ms.load_scene(scene_file(*changes, more=more))
    with pytest.raises(ms.SceneError, match=message):
        scene.build().start_motion()


@pytest.mark.parametrize("name", ["mesh", "material", "model"])
def test_missing_tables_are_named(scene_text, tmp_path, name):
    left = re.sub(rf"\n\[{name}\]\n(\w.*\n)*", "\n", scene_text())
    (tmp_path / "scene.toml").write_text(left)
    with pytest.raises(ms.SceneError, match=rf"scene\.toml: {name}: missing"):
        ms.load_scene(tmp_path / "scene.toml")


@pytest.mark.parametrize("name", ["Blätter", "\u8449_2", "a-b"])
def test_a_scene_is_named_after_its_file_in_any_alphabet(scene_text, tmp_path, name):
    file = tmp_path / f"{name}.toml"
    file.write_text(scene_text(), encoding="utf-8")
    results = ms.run_scene(ms.load_scene(file), out=tmp_path / "results").files
    assert {result.stem for result in results if result.is_file()} == {name}


def test_names_that_no_results_can_have_are_refused(scene_text, scene_file, tmp_path):
    file = tmp_path / "scene.toml"
    file.write_text(f'name = "{90 * chr(0x8449)}"\n{scene_text()}', encoding="utf-8")
    with pytest.raises(ms.SceneError, match="name: must be 1 to 100 letters"):
        ms.load_scene(file)
    with pytest.raises(ms.SceneError, match=r"got 'my scene', the file's own: rename it, or begin it"):
        ms.load_scene(scene_file().rename(tmp_path / "my scene.toml"))


def test_unreadable_files_are_named(tmp_path):
    with pytest.raises(ms.SceneError, match="no such file"):
        ms.load_scene(tmp_path / "no.toml")
    with pytest.raises(ms.SceneError, match="cannot be read"):
        ms.load_scene(tmp_path)
    (tmp_path / "bad.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ms.SceneError, match=r"no such file; take .*bad\.toml$"):
        ms.load_scene(tmp_path / "bad")
    with pytest.raises(ms.SceneError, match="UTF-8"):
        ms.load_scene(tmp_path / "bad.toml")


@pytest.mark.by_default("text1")
@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 5000 + "]" * 5000, "a = " + "{a=" * 300 + "1" + "}" * 300, ".".join(["a"] * 2_000) + " = 1"],
)
def test_deeply_nested_tables_are_refused(tmp_path, text):
    path = tmp_path / "deep.toml"
    path.write_text(text)
    for load in (ms.load_scene, ms.run_sweep):
        with pytest.raises(ms.SceneError, match="deep") as caught:
            load(path)
        assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.obj", b"v 0 0 0\n", "not a scene: `modalshell simulate` takes meshes"),
        ("a.stl", b"\xff\xfe\x00solid", "not a scene: `modalshell simulate` takes meshes"),
        ("a.npz", b"PK\x03\x04\xff", "a result is not a scene: `modalshell open`"),
        ("a.png", b"\x89PNG", r"scenes and sweeps are \.toml files \(got a\.png\)"),
        ("a.toml", b"scene = 'b.toml'\naxes.bar = [true]", "a sweep is not a scene: `modalshell sweep`"),
    ],
)
def test_another_file_in_place_of_a_scene_is_told_where_it_belongs(tmp_path, name, content, told):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ms.SceneError, match=told):
        ms.load_scene(tmp_path / name)
