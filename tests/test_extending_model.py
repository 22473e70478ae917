"""A model of another package takes two files: its own, and a module that registers its record."""

import numpy as np
import pytest
from guide import source

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.cost import counted
from modalshell.models.check import check_model
from modalshell.models.registry import MODELS, register

MODEL = source("toy_model.py")
RECORD = source("toy_record.py")
TOY = ('name = "mwts"', 'name = "bounded"\nlimit = 0.5\nmodes = 4')
STILL = ("[motion]\nduration = 1\n", "")
WEAK = ("-9.81", "-0.5")


@pytest.fixture
def toy(install_modules):
    install_modules("bounded = toy_record", toy_model=MODEL, toy_record=RECORD)
    yield
    MODELS.pop("bounded", None)


def command(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    assert end.value.code == 0


@pytest.mark.slow
@pytest.mark.usefixtures("toy")
def test_a_model_of_another_package_runs_by_scene_and_stands_on_the_ladder(scene_file, tmp_path):
    file = scene_file(TOY, STILL, WEAK)
    command("run", file, "--out", tmp_path / "out")
    shell = ms.load_scene(file).build_shell()
    direct = ms.models()["bounded"].builder(ms.solve_modes(shell, 4), limit=0.5).equilibrium(gravity=(0, 0, -0.5))
    run = ms.load_trajectory(tmp_path / "out" / "scene.npz").positions[-1]
    np.testing.assert_allclose(run, direct.positions, atol=1e-12)
    command("tradeoff", file, "--modes", "4", "--out", tmp_path / "out")
    assert "bounded 4" in (tmp_path / "out" / "scene_tradeoff.md").read_text()
    assert list(ms.models())[1:3] == ["lma", "bounded"]


def strip(young=1e8):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 2))
    return ms.Shell(mesh, ms.Isotropic(young, 0.3, 5e-3, 100.0), clamped=mesh.vertices[:, 0] < 1e-6)


def bounded(shell, **options):
    return ms.models()["bounded"].builder(ms.solve_modes(shell, 6), **options)


@pytest.mark.usefixtures("toy")
def test_it_passes_the_check_of_models_and_keeps_below_its_limit():
    model = bounded(strip(), limit=0.2)
    check_model(model)
    for gravity in (1.0, 10.0, 1000.0):
        answer = model.equilibrium(gravity=(0, 0, -gravity))
        moved = answer.positions - model.shell.rest_positions
        assert np.sqrt(np.sum(moved**2, axis=1).mean()) < 0.2
    small, linear = model.equilibrium(gravity=(0, 0, -0.01)), ms.LinearModal(model.basis)
    np.testing.assert_allclose(small.positions, linear.equilibrium(gravity=(0, 0, -0.01)).positions, atol=1e-7)


@pytest.mark.usefixtures("toy")
def test_its_positions_and_its_other_bases_have_its_shape():
    model = bounded(strip(), limit=0.2)
    q = np.linspace(0.1, 0.2, 6)
    own = model.displacement(q)
    assert np.abs(own).max() < 0.9 * np.abs(model.basis.modes @ q).max()
    np.testing.assert_allclose(model.warped_positions(q) - model.shell.rest_positions, own, atol=1e-15)
    for other in (model.on_basis(model.basis), model.stepped_by("implicit_midpoint")):
        assert other.limit == 0.2
        np.testing.assert_array_equal(other.displacement(q), own)


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize("wrt", ["young", "density", "load"])
def test_its_sensitivity_is_that_of_differences(wrt):
    model, gravity = bounded(strip(), limit=0.2), (0.0, 0.0, -1.0)
    answer = model.equilibrium(gravity=gravity)

    def at(share):
        scaled = {name: 1.0 + (share if name == wrt else 0.0) for name in ("young", "density", "load")}
        material = ms.Isotropic(1e8 * scaled["young"], 0.3, 5e-3, 100.0 * scaled["density"])
        other = bounded(model.shell.with_material(material), limit=0.2)
        return other.equilibrium(gravity=np.multiply(gravity, scaled["load"])).positions

    unit = {"young": 1e8, "density": 100.0, "load": 1.0}[wrt]
    expected = (at(1e-4) - at(-1e-4)) / (2e-4 * unit)
    found = model.sensitivity(answer, wrt)[:, :, 0]
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())
    weights = np.random.default_rng(0).standard_normal(found.shape)
    assert model.sensitivity(answer, wrt, of=weights)[0] == pytest.approx(np.vdot(weights, expected), rel=1e-4)


@pytest.mark.usefixtures("toy")
def test_contacts_hold_it_at_rest_and_in_motion():
    model, floor = bounded(strip(), limit=0.5), [ms.Contact(ms.Plane((0, 0, 1), -0.1))]
    gravity = (0.0, 0.0, -9.81)
    assert model.equilibrium(gravity=gravity).positions[:, 2].min() < -0.2
    answer = model.equilibrium(gravity=gravity, contacts=floor)
    assert answer.converged
    assert answer.positions[:, 2].min() == pytest.approx(-0.1, abs=1e-6)
    run = ms.simulate(model, duration=0.5, dt=1 / 60, gravity=gravity, damping=(1.0, 0.0), contacts=floor)
    assert run.positions[..., 2].min() == pytest.approx(-0.1, abs=1e-5)


@pytest.mark.usefixtures("toy")
def test_its_counted_work_is_what_it_declares():
    model = bounded(strip(), limit=0.5)
    with counted() as work:
        model.displacement(np.ones(6))
    assert work.bytes_read == model.basis.modes.nbytes


@pytest.mark.usefixtures("toy")
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("limit", "limi", "model.limi: unknown key; did you mean 'limit'"),
        ("0.5", '"x"', "model.limit: must be a number"),
        ('"bounded"', '"bounde"', "model.name: must be one of rigid, lma, bounded, mwts"),
    ],
)
def test_its_table_is_checked_as_others_are(scene_file, old, new, message):
    with pytest.raises(ms.SceneError) as refused:
        ms.load_scene(scene_file((TOY[0], TOY[1].replace(old, new, 1)), STILL, WEAK))
    assert message in str(refused.value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"key": "lma"}, "model 'lma' exists already"),
        ({"name": "DS"}, "is named 'DS' already"),
        ({"key": "A b"}, "key must be"),
        ({"needs": "x"}, "needs must be"),
    ],
)
def test_records_that_cannot_be_are_refused(changed, message):
    values = {"key": "toy", "name": "toy", "builder": ms.RigidShell, "needs": "shell", "cost": 1.0} | changed
    with pytest.raises(ms.OptionError, match=message):
        register(ms.ModelSpec(**values))
    assert "toy" not in ms.models()
