"""Modes and modal models about a mesh whose own stresses are in equilibrium."""

import numpy as np
import pytest

import modalshell as ms

SHEET = ms.Isotropic(1e9, 0.3, 1e-3, 1000.0)


def curled(**options):
    """A strip that has let its rest curvature curl it, and the shell before."""
    mesh = ms.flat_beam(length=0.3, width=0.06, cells=(12, 2))
    shell = ms.Shell(mesh, SHEET, "x < 1e-9", **(options or {"rest_curvature": 2.0}))
    return shell, shell.settled(ms.DiscreteShell(shell).equilibrium().positions)


@pytest.mark.parametrize("tension", [0.0, 2e-5, 2e-4])
def test_a_stretched_strip_has_the_frequencies_of_a_beam_under_tension(tension):
    length, h, young, density = 0.5, 1e-3, 1e9, 1000.0
    mesh = ms.flat_beam(length=length, width=0.02, cells=(40, 2))
    ends = np.isin(mesh.vertices[:, 0].round(9), [0.0, length])
    supports = [ms.Pin(ends)]
    shell = ms.Shell(
        mesh, ms.Isotropic(young, 0.0, h, density), supports=supports, prestrain=np.diag([-tension, 0.0, 0.0])
    )
    found = ms.solve_modes(shell.settled(mesh.vertices), 3).frequencies
    waves = np.arange(1, 4) * np.pi / length
    squares = (young * h**2 / 12.0 * waves**4 + young * tension * waves**2) / density
    np.testing.assert_allclose(found, np.sqrt(squares) / (2.0 * np.pi), rtol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("rest", ["curvature", "mesh", "temperature"])
@pytest.mark.parametrize("make", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_modal_models_stand_on_the_settled_shell(make, rest):
    flat = np.array(ms.flat_beam(length=0.3, width=0.06, cells=(12, 2)).vertices)
    flat[:, 0], flat[:, 2] = 0.3 * np.sin(flat[:, 0] / 0.3), 0.3 - 0.3 * np.cos(flat[:, 0] / 0.3)
    options = {
        "curvature": {"rest_curvature": 2.0},
        "mesh": {"rest": flat},
        "temperature": {"temperature": ms.Temperature(5.0, 1e-4, 20.0)},
    }[rest]
    shell, settled = curled(**options)
    basis = ms.solve_modes(settled, 16)
    about = ms.solve_modes(shell, 16, about=ms.DiscreteShell(shell).equilibrium())
    np.testing.assert_allclose(basis.frequencies, about.frequencies, rtol=1e-9)
    assert basis.residual < 1e-6
    model, load = make(basis), {"gravity": (0.0, 0.0, -0.05)}
    truth = ms.DiscreteShell(shell).equilibrium(start=settled.rest_positions, **load)
    answer = model.equilibrium(bar=True, **load)
    moved = np.abs(truth.positions - settled.rest_positions).max()
    assert moved > 3e-4
    assert np.abs(answer.positions - truth.positions).max() < 0.006 * moved
    assert answer.bar.valid
    assert answer.bar.displacement < 0.01
    run, true = (ms.simulate(each, duration=0.3, dt=0.01, **load) for each in (model, ms.DiscreteShell(settled)))
    assert np.abs(run.positions - true.positions).max() < 0.03 * np.abs(true.positions - settled.rest_positions).max()


def test_the_energy_is_that_of_the_shell():
    shell, settled = curled()
    x = shell.rest_positions + 1e-3 * np.random.default_rng(0).standard_normal(shell.rest_positions.shape)
    assert settled.energy(x) == shell.energy(x)
    np.testing.assert_array_equal(settled.force(x), shell.force(x))
    np.testing.assert_array_equal(settled.fields(x).moment, shell.fields(x).moment)
    np.testing.assert_array_equal(settled.mass, shell.mass)


def test_what_is_not_settled_is_refused():
    shell, settled = curled()
    with pytest.raises(ms.OptionError, match=r"first step is 0.0\d+ m\): take DS or coarse DS; or let it come to rest"):
        ms.solve_modes(shell, 3)
    with pytest.raises(ms.OptionError, match="in equilibrium"):
        ms.solve_modes(shell.settled(0.9 * settled.rest_positions + 0.1 * shell.rest_positions), 3)
    with pytest.raises(ms.LoadError, match="positions"):
        shell.settled([[0.0, 0.0, 0.0]])
    with pytest.raises(ms.OptionError, match="attachments are shapes"):
        ms.solve_modes(settled, 3, attachments=[ms.PointForce([5], (0, 0, 1))])


def test_a_mesh_that_its_own_stresses_buckle_is_named_as_such():
    mesh = ms.sheet(length=0.3, width=0.3, cells=(4, 4))
    warm = ms.Shell(mesh, SHEET, "boundary", temperature=ms.Temperature(60.0, 1e-3))
    with pytest.raises(ms.OptionError, match=r"buckled by the stresses of its .*let it come to rest first"):
        ms.solve_modes(warm, 1)


def test_what_a_settled_shell_does_not_give(tmp_path):
    _, settled = curled()
    basis = ms.solve_modes(settled, 3)
    model = ms.LinearModal(basis)
    with pytest.raises(ms.OptionError, match="a file of a basis holds no rest shape"):
        basis.save(tmp_path / "basis.npz")
    with pytest.raises(ms.OptionError, match="derivatives of modes"):
        basis.sensitivity("young")
    with pytest.raises(ms.OptionError, match="no derivatives about a mesh under stress"):
        model.sensitivity(model.equilibrium(gravity=(0, 0, -0.1)), "young")
    for build in (lambda: settled.with_material(SHEET), lambda: ms.coarse_shell(settled, settled.mesh)):
        with pytest.raises(ms.OptionError, match="cannot be built again"):
            build()
    mesh = settled.mesh
    creased = ms.Shell(mesh, SHEET, "x < 1e-9", creases=[ms.Crease(np.abs(mesh.vertices[:, 1]) < 1e-9, 1.0)])
    with pytest.raises(ms.OptionError, match="a settled shell knows no creases"):
        creased.settled(mesh.vertices)


@pytest.mark.slow
def test_a_settled_strip_touches_as_ds_does():
    _, settled = curled()
    floor = [ms.Contact(ms.Plane((0, 0, 1), settled.rest_positions[:, 2].min() - 5e-4))]
    load = {"gravity": (0.0, 0.0, -0.3), "contacts": floor}
    truth = ms.DiscreteShell(settled).equilibrium(**load)
    answer = ms.ModalWarping(ms.solve_modes(settled, 16)).equilibrium(**load)
    pressed, wanted = (each.contact_forces[:, 2].sum() for each in (answer, truth))
    assert pressed == pytest.approx(wanted, rel=0.005)
    moved = np.abs(truth.positions - settled.rest_positions).max()
    assert np.abs(answer.positions - truth.positions).max() < 0.005 * moved


@pytest.mark.by_default("0.6", "-1.0")
@pytest.mark.parametrize("share", [0.3, 0.6, -1.0])
def test_a_thin_plate_is_settled_only_where_its_stresses_are_those_of_its_equilibrium(share):
    """Warm between two walls and free to grow along them, it moves by a millionth of its size and vibrates by half."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(12, 12))
    sheet = ms.Isotropic(young=7e10, poisson=0.3, thickness=3e-4, density=2700.0)
    rim = np.isin(np.arange(len(mesh.vertices)), mesh.boundary_vertices)
    supports = [ms.Fix(rim, "z"), ms.Fix("x < 1e-9 or x > 0.999", "x"), ms.Fix([0], "y")]
    strain = share * 4.0 * np.pi**2 * sheet.thickness**2 / 12.0 / (1.0 - sheet.poisson**2)
    warm = ms.Shell(mesh, sheet, supports=supports, temperature=ms.Temperature(strain, 1.0))
    with pytest.raises(ms.OptionError, match="let it come to rest first"):
        ms.solve_modes(warm, 1)
    settled = warm.settled(ms.DiscreteShell(warm).equilibrium().positions)
    cold = ms.solve_modes(ms.Shell(mesh, sheet, supports=supports), 1).frequencies[0]
    assert ms.solve_modes(settled, 1).frequencies[0] == pytest.approx(cold * np.sqrt(1.0 - share), rel=0.02)


@pytest.mark.slow
def test_motions_of_settled_shells_have_one_energy_whatever_the_model():
    """That of the stresses at rest was missing from modes', so that a switch was said to have doubled the energy."""
    _, settled = curled()
    basis, options = ms.solve_modes(settled, 8), {"duration": 0.1, "dt": 0.01}
    at_rest = settled.energy(settled.rest_positions)
    moved = ms.simulate(ms.LinearModal(basis), gravity=(0.0, 0.0, -0.05), **options).energies[:, 1] - at_rest
    assert moved[0] == 0.0
    true = ms.simulate(ms.DiscreteShell(settled), gravity=(0.0, 0.0, -0.05), **options).energies[:, 1] - at_rest
    assert moved.max() == pytest.approx(true.max(), rel=0.05)
    assert at_rest > 100.0 * moved.max()
    message = ms.simulate(ms.Auto(settled, 8), gravity=(0.0, 0.0, -9.81), **options).message
    assert "to DS at 0 s" in message
    assert "energy" not in message


def test_supports_hold_the_vertices_that_they_held_before_the_shell_settled():
    """Texts were read again on the settled mesh: half of a curled strip was held, or no vertex found."""
    mesh = ms.flat_beam(length=0.3, width=0.06, cells=(12, 2))
    supports = [ms.Clamp("x < 1e-9"), ms.Fix("x > 0.2999", "y")]
    shell = ms.Shell(mesh, SHEET, supports=supports, rest_curvature=np.diag([16.0, 0.0, 0.0]))
    settled = shell.settled(ms.DiscreteShell(shell).equilibrium().positions)
    x, end = settled.rest_positions, mesh.vertices[:, 0] > 0.2999
    assert x[:, 0].min() < -0.01
    assert np.array_equal(settled.also_supported([]).unknowns.supported, shell.unknowns.supported)
    load = np.where(end[:, None], (0.0, 1.0, 0.0), 0.0)
    clamp, fix = settled.support_reactions(x, force=load)
    np.testing.assert_allclose(fix.sum(axis=0), [0.0, -3.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(clamp.sum(axis=0), 0.0, atol=1e-6)
