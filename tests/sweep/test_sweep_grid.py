"""The grid of a sweep: its order, ranges, keys and digests, and what is refused before any work."""

import re

import numpy as np
import pytest
from scenes import GRAVITIES, LOADED_BEAM, SWEEP_AXES

import modalshell as ms
from modalshell.sweep import load_sweep
from modalshell.sweep.plan import Plan


def scenes(file):
    return [raw for _, raw in load_sweep(file).points()]


def test_the_grid_is_every_combination_the_last_axis_first(write):
    file = write(GRAVITIES + '"material.flexure" = { from = 0.01, to = 1, count = 3, spacing = "log" }')
    found = [(raw["loads"]["gravity"][2], raw["material"]["flexure"]) for raw in scenes(file)]
    assert [gravity for gravity, _ in found] == [-1, -1, -1, -2, -2, -2]
    np.testing.assert_allclose([flexure for _, flexure in found], [0.01, 0.1, 1.0] * 2, rtol=1e-14)
    assert load_sweep(file).count == 6


def test_ranges(write):
    def values(given):
        return list(load_sweep(write(f'"model.modes" = {given}')).axes[0].values)

    assert values('{ from = 2, to = 32, count = 5, spacing = "log" }') == [2, 4, 8, 16, 32]
    assert all(isinstance(value, int) for value in values("{ from = 2, to = 8, count = 3 }"))
    assert values("{ from = 1, to = 2, count = 3 }") == [1.0, 1.5, 2.0]
    assert values("{ from = 0.5, to = -0.5, count = 2 }") == [0.5, -0.5]


def test_keys_lead_anywhere_and_need_no_quotes(write):
    quoted = scenes(write('"loads.forces.0.total" = [[1, 2, 3]]\n"motion.duration" = [0.5]'))
    plain = scenes(write("loads.forces.0.total = [[1, 2, 3]]\nmotion.duration = [0.5]"))
    assert quoted == plain == scenes(write('"loads.forces[0].total" = [[1, 2, 3]]\n"motion.duration" = [0.5]'))
    assert quoted[0]["loads"]["forces"][0]["total"] == [1, 2, 3]
    assert quoted[0]["motion"] == {"duration": 0.5}


def test_a_named_model_takes_the_options_that_it_knows(write):
    models = [raw["model"] for raw in scenes(write('"model.name" = ["lma", "ds", "rigid"]'))]
    assert models == [{"name": "lma", "modes": 4}, {"name": "ds"}, {"name": "rigid"}]
    plan = Plan(load_sweep(write('"model.name" = ["lma", "ds"]\n"model.modes" = [2, 3, 4]')))
    assert (len(plan.cases), len(plan.tasks)) == (6, 4)  # ds has no modes: one case, three rows


def test_a_refusal_stays_short_whatever_the_axis_is_called(write):
    with pytest.raises(ms.SceneError, match=r"case 1 of 1 \(9{100}.*\.\.\.\): .*unknown key") as refused:
        Plan(load_sweep(write(f"{'9' * 5000} = [1]")))
    assert len(str(refused.value)) < 1500


@pytest.mark.parametrize(
    ("axes", "top", "more", "message"),
    [
        ("", "", "", r"axes: must have at least one key"),
        ("x = 3", "", "", r"axes\.x: must be a list of values"),
        ("model = {}", "", "", r"axes\.model: must be a list"),
        ('"model.modes" = { from = 1, to = 2 }', "", "", r"axes\.model\.modes\.count: missing"),
        ('"model.modes" = { from = 1, to = 2, count = 0 }', "", "", r"axes\.model\.modes\.count: .*at least 1"),
        ('"model.modes" = { from = 1, too = 2, count = 3 }', "", "", r"axes\.model\.modes\.too: .*'to'"),
        ('a = { from = 0, to = 2, count = 3, spacing = "log" }', "", "", r"axes\.a: both ends must be above 0"),
        ('a = { from = 0, to = 2, count = 3, spacing = "odd" }', "", "", r"axes\.a\.spacing: .*linear, log"),
        ("a = { from = 0, to = 1, count = 200000 }", "", "", r"axes\.a\.count: .*at most 100000"),
        (
            "a.a = { from = 0, to = 1, count = 999 }\na.b = { from = 0, to = 1, count = 999 }",
            "",
            "",
            "span 998001 cases",
        ),
        ('"model.modes" = [1, 2, 1]', "", "", r"axes\.model\.modes\[2\]: is there twice"),
        ('"model.modes" = [1]\nmodel = [{ name = "ds" }]', "", "", r"axes\.model: undoes axes\.model\.modes"),
        ('"loads.forces.1.total" = [[0, 0, 0]]', "", "", r"axes\.loads\.forces\.1\.total: '1' must name an entry"),
        ('"model.name.x" = [1]', "", "", r"axes\.model\.name\.x: the scene has no table 'name'"),
        (GRAVITIES, "colour = 3", "", r"colour: unknown key"),
        (GRAVITIES, 'name = "a/b"', "", r"name: must be 1 to 100 letters"),
        (GRAVITIES, "truth = 3", "", r"truth: must be a table"),
        (GRAVITIES, "", "[output]\nformats = ['jpg']", r"output\.formats"),
        (GRAVITIES, "", "[output]\nvalue = 'weight'", r"output\.value: must be one of converged"),
        (GRAVITIES, "", "[output]\nvalue = 'error'", r"'error' needs a \[truth\]"),
        # The scenes of the grid, each checked before the first one is run.
        (
            '"model.modes" = [4, -1]',
            "",
            "",
            r"case 2 of 2 \(model\.modes = -1\): .*base\.toml: model\.modes: .*at least 1",
        ),
        ('"model.modes" = { from = 1, to = 2, count = 3 }', "", "", r"case 1 of 3 .*model\.modes: must be an integer"),
        ('"model.name" = ["mwts", "magic"]', "", "", r"case 2 .*model\.name: must be one of"),
        ('"material.flexure" = [0.1, "soft"]', "", "", r"case 2 .*material\.flexure: must be a number"),
        ('"supports.clamped" = ["x < 0.13", "x < -9"]', "", "", r"case 2 .*supports\.clamped: selects no vertex"),
        ('"mesh.fold" = [150, 500]', "", "", r"case 2 .*mesh\.fold"),
        ('mesh = [{ file = "none.obj" }]', "", "", r"case 1 .*none\.obj"),
        (
            'contacts = [[{ kind = "sphere", center = [0, 0, -9], radius = 0.5 }], '
            '[{ kind = "sphere", center = [0, 0, -9], radius = -1.0 }]]',
            "",
            "",
            r"case 2 .*contacts\[0\]\.radius: must be",
        ),
        ('"loads.rain" = [1]', "", "", r"case 1 .*loads\.rain: unknown key"),
        (GRAVITIES, 'truth = { name = "dss" }', "", r"case 1 .*model\.name: must be one of"),
    ],
)
def test_what_is_not_allowed_is_refused_before_any_work(write, tmp_path, axes, top, more, message):
    with pytest.raises((ms.SceneError, ms.OptionError), match=message) as error:
        ms.run_sweep(write(axes, top, more), out=tmp_path / "out")
    assert "beams.toml: " in str(error.value)
    assert not (tmp_path / "out").exists()


def test_vertices_by_number_on_meshes_of_several_sizes_are_warned_of(write):
    """The force was at another place in every case, without a word."""
    placed = LOADED_BEAM.replace('"x > 0.9"', "[40]")
    with pytest.warns(ms.ModalShellWarning, match="where selects vertices by their numbers.* 45 to 55 vertices"):
        Plan(load_sweep(write('"mesh.cells" = [[8, 4], [10, 4]]', scene=placed)))
    axes = '"mesh.cells" = [[8, 4], [10, 4]]\n"loads.forces.0.where" = [[40], [41]]'
    with pytest.warns(ms.ModalShellWarning, match="where selects vertices by their numbers"):
        Plan(load_sweep(write(axes)))
    Plan(load_sweep(write('"mesh.fold" = [150, 160]', scene=placed)))


def test_bad_scene_references_are_refused(tmp_path):
    for text, message in [
        ("[axes]\na = [1]", "scene: missing"),
        ('scene = "x.toml"', "axes: missing"),
        ('scene = "none.toml"\n[axes]\na = [1]', r"none\.toml: no such file"),
        ("scene = 3\n[axes]\na = [1]", "scene: must be a scene file's path or a table"),
        ("scene = {}\naxes = 3", "axes: must be a table"),
        ("scene = {}\n[axes]\na = [nan]", r"axes\.a\[0\]: must be a finite number"),
    ]:
        (tmp_path / "s.toml").write_text(text)
        with pytest.raises(ms.SceneError, match=message):
            load_sweep(tmp_path / "s.toml")


@pytest.mark.slow
def test_digests_follow_what_decides_the_result_alone(write, tmp_path):
    def digests(axes=SWEEP_AXES, scene=LOADED_BEAM):
        return [case.digest for case in Plan(load_sweep(write(axes, scene=scene))).cases]

    first = digests()
    assert len(set(first)) == 6
    shuffled = LOADED_BEAM.replace("stretch = 20.0\nshear = 20.0\n", "").replace(
        "[material]", "[material]\nshear=20\nstretch=2e1"
    )
    tables = ["[" + part for part in re.split(r"^\[(?!\[)", shuffled, flags=re.MULTILINE)[1:]]
    assert digests(scene="\n".join(reversed(tables))) == first
    assert digests(SWEEP_AXES.replace("-1]", "-1.0]")) == first
    assert digests("\n".join(reversed(SWEEP_AXES.splitlines()))) == [first[k] for k in (0, 3, 1, 4, 2, 5)]
    assert not set(digests(scene=LOADED_BEAM.replace("0.05", "0.06"))) & set(first)
    # A mesh file counts by what is in it.
    mesh = ms.v_beam(cells=(8, 4))
    from_file = LOADED_BEAM.replace('shape = "v_beam"\ncells = [8, 4]', 'file = "beam.ply"')
    ms.save_mesh(mesh, tmp_path / "beam.ply")
    before = digests(scene=from_file)
    assert digests(scene=from_file) == before
    ms.save_mesh(ms.TriangleMesh(mesh.vertices * 1.001, mesh.faces), tmp_path / "beam.ply")
    assert not set(digests(scene=from_file)) & set(before)
