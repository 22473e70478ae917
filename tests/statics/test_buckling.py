"""Linear buckling: what models of quadratic energy cannot see, and `modalshell run` says."""

import contextlib

import numpy as np
import pytest
from scenes import stiff_beam_text

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.statics.buckling import buckles

SCENE = (
    stiff_beam_text(40)
    + """[loads]
gravity = [0.0, 0.0, %g]
[model]
name = "%s"
modes = 4
"""
)


@pytest.mark.parametrize("cells", [(2, 2), (3, 2), (2, 4)])
@pytest.mark.filterwarnings("ignore::modalshell.core.errors.ModalShellWarning")  # of the coarse mesh's modes
def test_sheets_that_nothing_keeps_from_shearing_end_in_no_error_of_linear_algebra(cells):
    """Their stiffness is singular, but for rounding."""
    mesh = ms.sheet(length=1.0, width=0.2, cells=cells)
    sides = np.isclose(np.abs(mesh.vertices[:, 1]), 0.1)
    shell = ms.Shell(mesh, ms.Material(stretch=1000.0, shear=0.0, flexure=0.025, density=0.2), supports=[ms.Pin(sides)])
    with contextlib.suppress(ms.SolverError):
        ms.buckling_factors(shell, gravity=(0.0, 0.0, -9.81))


@pytest.mark.parametrize("material", ["hinges", "shell theory"])
def test_a_column_buckles_at_eulers_load(material):
    young, thickness, width = 1e9, 1e-3, 0.05
    mesh = ms.flat_beam(length=1.0, width=width, cells=(40, 4))
    held = mesh.vertices[:, 0] < (0.03 if material == "hinges" else 1e-9)
    if material == "hinges":
        made = ms.Material.from_physical(young=young, poisson=0.0, thickness=thickness, density=1.0, mesh=mesh)
    else:
        made = ms.Isotropic(young=young, poisson=0.0, thickness=thickness, density=1.0)
    shell = ms.Shell(mesh, made, held)
    length = 1.0 - mesh.vertices[held, 0].max()
    critical = np.pi**2 * young * width * thickness**3 / 12.0 / (4.0 * length**2)
    force = ms.LineForce("x > 0.999", (-1.0 / width, 0.0, 0.0)).force(mesh)
    assert not buckles(shell, 0.95 * critical * force)
    assert buckles(shell, 1.05 * critical * force)
    assert not buckles(shell, -5.0 * critical * force)  # a pull
    assert not buckles(shell, 0.0 * force)


@pytest.mark.slow
@pytest.mark.parametrize("more", [[], pytest.param([ms.Pressure(-1e-3)], marks=pytest.mark.slow)])
def test_factors_that_crowd_about_the_first_one_are_found(monkeypatch, more):
    """A compressed cylinder has many next to its first, on which Lanczos stopped with none: "never buckles"."""
    radius, height, length, around, along = 25e-3, 1.2e-3, 30e-3, 40, 16
    rings, turns = np.meshgrid(np.arange(along + 1), np.arange(around), indexing="ij")
    angle = 2.0 * np.pi * (turns + 0.5 * (rings % 2)) / around
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), length * rings / along], axis=-1).reshape(-1, 3)
    a, b = (rings * around + (turns + step) % around for step in (0, 1))
    faces = []
    for row in range(along):
        low, after, high, beyond = a[row], b[row], a[row + 1], b[row + 1]
        pairs = (
            ((low, after, high), (after, beyond, high)) if row % 2 == 0 else ((low, after, beyond), (low, beyond, high))
        )
        faces += [np.column_stack(corners) for corners in pairs]
    mesh, top = ms.TriangleMesh(points, np.concatenate(faces)), "z > 0.0299"
    sheet = ms.Isotropic(young=70e9, poisson=0.33, thickness=height, density=2700.0)
    shell = ms.Shell(mesh, sheet, supports=[ms.Fix("z < 1e-9", axes="xyz"), ms.Fix(top, axes="xy")])
    monkeypatch.setattr("modalshell.statics.buckling._RESTARTS", 1)
    found = ms.buckling_factors(shell, 2, loads=[ms.LineForce(top, (0.0, 0.0, -1.0)), *more]).factors
    classic = 70e9 * height**2 / (radius * np.sqrt(3.0 * (1.0 - 0.33**2)))  # of a long cylinder, theory of thin shells
    assert found[0] == pytest.approx(classic, rel=0.08)
    monkeypatch.undo()
    expected = ms.buckling_factors(shell, 2, loads=[ms.LineForce(top, (0.0, 0.0, -1.0)), *more]).factors
    assert found[0] == pytest.approx(expected[0], rel=1e-6)
    assert ms.buckling_factors(shell, loads=[ms.LineForce(top, (0.0, 0.0, 1.0))]).factors.size == 0


@pytest.mark.slow
def test_no_load_factor_multiplies_the_stresses_that_a_shell_has_without_load():
    """A warm rod between two clamps bears less of a further push: none of it from the temperature that buckles it."""
    mesh = ms.flat_beam(length=1.0, width=0.05, cells=(40, 4))
    sheet = ms.Isotropic(young=1e9, poisson=0.0, thickness=1e-3, density=1.0)
    ends = [ms.Clamp("x < 1e-9"), ms.Fix("x > 0.999", "xz"), ms.Fix("nearest(1, 0, 0)", "y")]
    push = [ms.LineForce("x > 0.49 and x < 0.51", (-1.0, 0.0, 0.0))]
    warmest = np.pi**2 * sheet.thickness**2 / 3.0  # thermal strain at which a rod between two clamps buckles

    def shell(share):
        warmth = ms.Temperature(share * warmest, 1.0)
        warm = ms.Shell(mesh, sheet, supports=ends, temperature=warmth)
        return warm.settled(ms.DiscreteShell(warm).equilibrium().positions)

    cold = ms.buckling_factors(ms.Shell(mesh, sheet, supports=ends), loads=push).factors[0]
    for share in (0.5, -1.0):
        settled = shell(share)
        factor = ms.buckling_factors(settled, loads=push).factors[0]
        force = push[0].force(mesh)
        for part, stable in ((0.99, True), (1.01, False)):
            state = ms.DiscreteShell(settled).equilibrium(force=part * factor * force, start=settled.rest_positions)
            straight = np.abs(state.positions[:, 2]).max() < 1e-9
            assert bool(straight and state.stable) is stable
        assert bool(factor < 0.9 * cold) is (share > 0.0)


def test_a_warm_rod_between_clamps_comes_to_rest_before_its_buckling():
    mesh = ms.flat_beam(length=1.0, width=0.05, cells=(4, 1))
    sheet = ms.Isotropic(young=1e9, poisson=0.0, thickness=1e-3, density=1.0)
    ends = [ms.Clamp("x < 1e-9"), ms.Fix("x > 0.999", "xz")]
    warm = ms.Shell(mesh, sheet, supports=ends, temperature=ms.Temperature(1e-6, 1.0))
    with pytest.raises(ms.OptionError, match=r"buckling needs .* come to rest first"):
        ms.buckling_factors(warm, loads=[ms.LineForce("x > 0.49 and x < 0.51", (-1.0, 0.0, 0.0))])


@pytest.mark.by_default("False")
@pytest.mark.parametrize("follower", [True, False])
def test_a_plate_that_pressure_bends_is_not_said_to_buckle(follower):
    """Its factors are of what little stress there is beyond bending: kilometres of linear deflection."""
    sheet = ms.Isotropic(young=210e9, poisson=0.3, thickness=1e-3, density=7850.0)
    shell = ms.Shell(ms.sheet(length=0.5, width=0.5, cells=(6, 6)), sheet, supports=[ms.Pin("boundary")])
    load = ms.Pressure(2000.0, follower=follower)
    with pytest.warns(ms.ModalShellWarning, match=r"linear theory does not hold .* times its own extent .* bends"):
        found = ms.buckling_factors(shell, loads=[load])
    small = ms.DiscreteShell(shell).equilibrium(loads=[ms.Pressure(1e-3)]).positions - shell.rest_positions
    linear = np.linalg.norm(small, axis=1).max() * 2000.0 / 1e-3
    assert found.displacements[0] == pytest.approx(found.factors[0] * linear, rel=1e-4)


def test_shells_that_nothing_holds_or_that_have_no_stiffness_are_not_said_to_buckle():
    mesh = ms.flat_beam(cells=(8, 2))
    for material, held in ((ms.Material(20.0, 20.0, 0.05, 0.2), None), (ms.Material(0.0, 0.0, 0.0, 0.2), [0, 1, 2])):
        shell = ms.Shell(mesh, material, held)
        assert not buckles(shell, shell.gravity_force((-1e3, 0.0, 0.0)))


@pytest.mark.parametrize(("cells", "gravities"), [((40, 8), (40.0, 46.0)), ((80, 16), (40.0, 46.0))])
def test_it_is_where_the_stiff_fold_snaps(cells, gravities):
    """DS snaps between 42 and 44, `studies/v_beam_accuracy.py`."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=cells)
    shell = ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.026)
    below, above = (buckles(shell, shell.gravity_force((0.0, 0.0, -gravity))) for gravity in gravities)
    assert (below, above) == (False, True)


@pytest.mark.parametrize("fold", [150.0, 180.0])
def test_large_bends_without_a_snap_are_not_called_one(fold):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=(20, 4))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.051)
    assert not buckles(shell, shell.gravity_force((0.0, 0.0, -30.0)))


def _pushed(mesh, share):
    """Loads, contacts and constraints that push a V-beam to about ``share`` of where it snaps, or past it."""
    tip = mesh.vertices[:, 0] > 1.0 - 1e-9
    target = mesh.vertices[tip].mean(axis=0) - (0.0, 0.0, 0.3 * share)
    below = ms.Contact(ms.Capsule((0.6, -1.0, -0.35), (0.6, 1.0, -0.35), 0.1))
    return {
        "gravity": {"gravity": (0.0, 0.0, -60.0 * share)},
        "pressure": {"loads": [ms.Pressure(-20.0 * share)]},
        "contacts": {"gravity": (0.0, 0.0, -60.0 * share), "contacts": [below]},
        "constraints": {"constraints": [ms.PositionConstraint(tip, target)]},
    }


@pytest.mark.by_default("lma", "mwts-consistent")
@pytest.mark.parametrize("key", [spec.key for spec in ms.models().values() if spec.quadratic and spec.needs == "basis"])
def test_statics_of_modal_models_past_a_snap_say_so_once(key):
    """They converge: with the capsule `studies/v_beam_accuracy.py`'s beam is 60 to 90 % off DS."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    shell = ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.051)
    model = ms.models()[key].builder(ms.solve_modes(shell, 8))
    for (name, below), above in zip(_pushed(mesh, 0.1).items(), _pushed(mesh, 1.0).values(), strict=True):
        answers = [model.equilibrium(**given) for given in (below, above, above)]
        said = [answer.message.count("linear buckling load") for answer in answers]
        assert said == [int(answer.converged and share) for answer, share in zip(answers, (0, 1, 1), strict=True)], name
        assert name == "constraints" or answers[1].converged


@pytest.mark.by_default("lma--70.0-True-", "mwts--20.0-False-[motion]\\nduration = 0.1\\n")
@pytest.mark.parametrize("motion", ["", "[motion]\nduration = 0.1\n"])
@pytest.mark.parametrize(
    ("model", "gravity", "told"), [("mwts", -70.0, True), ("lma", -70.0, True), ("mwts", -20.0, False)]
)
def test_run_past_a_snap_points_to_advise(model, gravity, told, motion, tmp_path, capsys):
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE % (gravity, model) + motion)
    with pytest.raises(SystemExit) as ended:
        main(["run", str(scene), "--out", str(tmp_path / "out")])
    assert ended.value.code == 0
    assert capsys.readouterr().out.count("linear buckling load") == told
    kept = ms.load_trajectory(tmp_path / "out" / "scene.npz")
    assert ("modalshell advise" in kept.message) == told
