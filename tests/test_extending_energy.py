"""An energy of another package takes three files: its SymPy definition, its registration, and a scene that uses it."""

import json
import runpy
import sys
from dataclasses import replace

import numpy as np
import pytest
from guide import source
from later import later

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.core.registry import load_plugins
from modalshell.shell.elements import ENERGIES

sympy = later("sympy", "SymPy generates the toy's kernel: pip install 'modalshell[symbolic]'")

DEFINITION = source("toy_fibres/definition.py")
REGISTRATION = source("toy_fibres/__init__.py")

ENTRY = "[modalshell]\nfibres = toy_fibres\n"
METADATA = "Metadata-Version: 2.1\nName: toy-fibres\nVersion: 0.1\n"
STILL = ("[motion]\nduration = 1\n", "")
FLAT = ('"v_beam"', '"flat_beam"')
WEAK = ("-9.81", "-1.0")


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """A package of three files beside its metadata, found as an installed one is; its kernel is compiled once."""
    site = tmp_path_factory.mktemp("site")
    package = site / "toy_fibres"
    package.mkdir(parents=True)
    (package / "definition.py").write_text(DEFINITION)
    (package / "__init__.py").write_text(REGISTRATION)
    metadata = site / "toy_fibres-0.1.dist-info"
    metadata.mkdir()
    (metadata / "entry_points.txt").write_text(ENTRY)
    (metadata / "METADATA").write_text(METADATA)
    runpy.run_path(str(package / "definition.py"), run_name="__main__")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(site))
        patch.setenv("MODALSHELL_RENDERER", "built-in")
        load_plugins.cache_clear()
        yield
    for name in [name for name in sys.modules if name.split(".")[0] == "toy_fibres"]:
        del sys.modules[name]
    ENERGIES.pop("fibres", None)
    load_plugins.cache_clear()


def command(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    assert end.value.code == 0


def drop(shell, positions):
    return float((positions - shell.rest_positions)[:, 2].min())


def scene(text, stiffness, model):
    table = f"[energies.fibres]\nstiffness = {stiffness}\ndirection = [1, 0, 0]\n[model]"
    return text(FLAT, WEAK, STILL, ("[model]", table), ('"mwts"', f'"{model}"'))


@pytest.mark.usefixtures("toy")
def test_an_energy_of_another_package_runs_by_scene(scene_text, tmp_path):
    (tmp_path / "bare.toml").write_text(scene_text(FLAT, WEAK, STILL, ('"mwts"', '"ds"')))
    (tmp_path / "toy.toml").write_text(scene(scene_text, 40.0, "ds"))
    for name in ("bare", "toy"):
        command("run", tmp_path / f"{name}.toml", "--out", tmp_path / "out")
    bare, stiffer = (ms.load_trajectory(tmp_path / "out" / f"{name}.npz") for name in ("bare", "toy"))
    shell = ms.load_scene(tmp_path / "toy.toml").build_shell()
    assert [elements.name for elements in shell.elements] == ["stretch", "shear", "flexure", "fibres"]
    # Pulled along the fibres the beam is stiffer by them alone: (E A + k c) of the fibres that lie along it.
    pull = np.where(shell.rest_positions[:, :1] > 0.99, [[1e-3, 0.0, 0.0]], 0.0)
    plain = ms.Shell(shell.mesh, shell.material, shell.clamped)
    with_fibres, without = (ms.DiscreteShell(s).equilibrium(force=pull).positions for s in (shell, plain))
    assert (with_fibres - shell.rest_positions)[:, 0].max() < 0.7 * (without - shell.rest_positions)[:, 0].max()
    assert drop(shell, stiffer.positions[-1]) != drop(shell, bare.positions[-1])
    direct = ms.Shell(shell.mesh, shell.material, shell.clamped, energies=[ENERGIES["fibres"](stiffness=40.0)])
    answer = ms.DiscreteShell(direct).equilibrium(gravity=(0, 0, -1))
    np.testing.assert_array_equal(answer.positions, stiffer.positions[-1])


def test_products_of_the_guide_are_its_second_variation():
    """Exactly, along a random step, and the generator takes them."""
    from modalshell.symbolic.generator import generate  # needs SymPy

    space = {}
    exec(compile(source("toy_fibres/angle.py"), "angle.py", "exec"), space)
    energy, step = space["ANGLE"], sympy.Matrix(np.random.default_rng(0).integers(-9, 9, 6).tolist())
    second = (step.T * sympy.hessian(energy.measure, energy.unknowns) * step)[0]
    split = sum(factor * (sympy.Matrix([row]) * step)[0] ** 2 for factor, row in energy.squares)
    split += 2 * sum((sympy.Matrix([m]) * step)[0] * (sympy.Matrix([n]) * step)[0] for m, n in energy.products)
    assert sympy.simplify(second - split) == 0
    assert [sympy.diff(energy.measure, unknown) for unknown in energy.unknowns] == list(energy.gradient)
    assert "def " in generate(energy).source


@pytest.mark.usefixtures("toy")
def test_an_energy_that_fails_is_named(monkeypatch):
    load_plugins()
    kind, mesh = ENERGIES["fibres"], ms.flat_beam(cells=(4, 2))

    def fails(*_):
        raise AttributeError("'TriangleMesh' object has no attribute 'edge_length'")

    monkeypatch.setattr(kind, "elements", fails)
    with pytest.raises(ms.OptionError, match=r"energy 'fibres' \(toy_fibres.Fibres\) failed on this mesh: Attribute"):
        ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 100.0), mesh.vertices[:, 0] < 1e-6, energies=[kind(1.0)])


@pytest.mark.usefixtures("toy")
def test_its_derivatives_and_its_saved_basis_are_right(tmp_path, monkeypatch):
    load_plugins()
    mesh = ms.v_beam(cells=(8, 4))
    fibres = ENERGIES["fibres"](stiffness=40.0, direction=(1.0, 0.5, 0.0))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.13, energies=[fibres])
    x = mesh.vertices + 1e-2 * np.random.default_rng(0).standard_normal(mesh.vertices.shape)
    step = np.random.default_rng(1).standard_normal(mesh.vertices.shape)
    force, bent = shell.force(x), shell.stiffness(x) @ step.ravel()
    sizes, left = 10.0 ** -np.arange(2.0, 4.01, 0.5), []
    for size in sizes:
        series = shell.energy(x) - size * np.vdot(force, step) + 0.5 * size**2 * (step.ravel() @ bent)
        pushed = shell.force(x + size * step) - force + size * bent.reshape(-1, 3)
        left.append((abs(shell.energy(x + size * step) - series), np.linalg.norm(pushed)))
    slopes = np.diff(np.log10(left), axis=0) / np.diff(np.log10(sizes))[:, None]
    # The series of the energy is good to second order, that of the force to first.
    np.testing.assert_allclose(slopes[-2:], [[3.0, 2.0]] * 2, atol=0.15)
    basis, bare = ms.solve_modes(shell, 4), ms.Shell(mesh, shell.material, shell.clamped)
    assert basis.eigenvalues[0] > ms.solve_modes(bare, 4).eigenvalues[0]
    own = [ms.SpringSheet(each).shell.energy(x) for each in (shell, bare)]  # springs stand for the material alone
    assert own[0] - own[1] == pytest.approx(shell.energy(x) - bare.energy(x), rel=1e-9)
    assert shell.with_elements(shell.elements).energy(x) == pytest.approx(shell.energy(x), rel=1e-12)
    with pytest.raises(ms.OptionError, match="solver='cg' knows springs alone"):
        ms.SpringSheet(shell, integrator="linear_implicit", solver="cg")
    basis.save(tmp_path / "basis.npz")
    loaded = ms.Basis.load(tmp_path / "basis.npz")
    assert loaded.shell.energy(x) == shell.energy(x)
    monkeypatch.delitem(ENERGIES, "fibres")
    with pytest.raises(ms.FileFormatError, match="fibres"):
        ms.Basis.load(tmp_path / "basis.npz")


@pytest.mark.slow
@pytest.mark.usefixtures("toy")
def test_every_model_of_a_tradeoff_has_it(scene_text, tmp_path):
    (tmp_path / "toy.toml").write_text(scene(scene_text, 4000.0, "mwts"))
    command("tradeoff", tmp_path / "toy.toml", "--modes", "6", "--out", tmp_path / "out")
    rows = json.loads((tmp_path / "out" / "toy_tradeoff.json").read_text())["findings"]["rows"]
    errors = {row["label"]: row["worst_error"] for row in rows}
    assert {"LMA 6", "MWTS 6", "RSW 6"} <= set(errors)
    assert min(error for error in errors.values() if error is not None) < 0.02


@pytest.mark.usefixtures("toy")
def test_its_table_is_checked_as_others_are(scene_text, tmp_path):
    for wrong, message in (
        ("[energies.fibres]\nstifness = 1.0\n", "energies.fibres.stifness: unknown key; did you mean 'stiffness'"),
        ("[energies.fibres]\nstiffness = 'x'\n", "energies.fibres.stiffness: must be a number"),
        ("[energies.fibers]\nstiffness = 1.0\n", "energies.fibers: unknown key; did you mean 'fibres'"),
    ):
        file = tmp_path / "wrong.toml"
        file.write_text(scene_text(("[model]", f"{wrong}[model]")))
        with pytest.raises(ms.SceneError) as refused:
            ms.load_scene(file)
        assert message in str(refused.value)


def test_a_plugin_that_fails_is_named(tmp_path, monkeypatch, scene_file):
    metadata = tmp_path / "broken-0.1.dist-info"
    metadata.mkdir()
    (metadata / "entry_points.txt").write_text("[modalshell]\nbroken = no_such_module\n")
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 0.1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    load_plugins.cache_clear()
    with pytest.raises(ms.OptionError, match=r"entry point 'broken' \(no_such_module\) cannot be imported"):
        ms.load_scene(scene_file())
    load_plugins.cache_clear()


@pytest.mark.slow
def test_cubature_chooses_among_the_elements_of_further_sets():
    mesh = ms.v_beam(cells=(8, 4))
    clamped = mesh.vertices[:, 0] < 0.13
    half, whole = (ms.Shell(mesh, ms.Material(20.0, 20.0, flexure, 0.2), clamped) for flexure in (0.025, 0.05))
    split = half.with_elements([*half.elements, replace(half.elements[2], name="more flexure")])
    model = ms.ModalDerivatives(split, 3, cubature=True)
    assert len(model.cubature.chosen) == 3
    assert model.cubature.held_out_error < 0.05
    answer = model.equilibrium(gravity=(0, 0, -1)).positions
    truth = ms.ModalDerivatives(whole, 3).equilibrium(gravity=(0, 0, -1)).positions
    assert ms.measure.displacement_error(answer, truth, mesh) < 0.02
