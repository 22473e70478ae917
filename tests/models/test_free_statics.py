"""Statics of full models whose parts no support holds: what pushes them, what bends them, what they may keep."""

import numpy as np
import pytest
from spheres import icosphere

import modalshell as ms
from modalshell.modes.rigid import free_translations

ISOTROPIC = ms.Isotropic(young=2e9, poisson=0.35, thickness=1e-3, density=900.0)
HINGED = ms.Material(stretch=2e6, shear=2e4, flexure=0.2, density=0.9)


def strip(cells=(12, 4)):
    return ms.flat_beam(length=0.5, width=0.1, cells=cells)


def along(at):
    """1 at the vertices of the strip with this x [m], 0 elsewhere."""
    return (np.abs(strip().vertices[:, 0] - at) < 1e-6).astype(float)


def pulls(forces):
    """Forces (n, 3) [N] along z, one number per vertex."""
    return np.outer(forces, [0.0, 0.0, 1e-3])


def bending():
    return pulls(2.0 * along(0.25) - along(0.0) - along(0.5))


def couple():
    return pulls(along(0.0) - along(0.5))


def full_models(shell):
    yield ms.DiscreteShell(shell)
    yield ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, strip((6, 2))))
    yield ms.Auto(shell)


@pytest.fixture(scope="module")
def free():
    return ms.Shell(strip(), ISOTROPIC)


def test_a_load_that_pushes_has_no_equilibrium(free):
    for model in (*full_models(free), ms.SpringSheet(ms.Shell(strip(), HINGED))):
        answer = model.equilibrium(gravity=(0.1, 0.0, -9.81))
        assert answer.outcome is ms.Outcome.NO_EQUILIBRIUM
        assert "the supports leave free all translations and turns" in answer.message
        np.testing.assert_allclose(answer.positions, strip().vertices, atol=1e-15)
    rail = ms.Shell(strip(), ISOTROPIC, supports=[ms.Fix("x < 1", axes="yz")])
    assert "a translation along (1, 0, 0)" in ms.DiscreteShell(rail).equilibrium(gravity=(1.0, 0.0, 0.0)).message
    assert ms.DiscreteShell(rail).equilibrium(gravity=(0.0, 0.0, 1.0)).converged  # the supports bear this one


@pytest.mark.slow
def test_a_load_in_balance_bends_as_modes_do(free):
    modes = ms.LinearModal(ms.solve_modes(free, 26)).equilibrium(force=bending())
    for model in full_models(free):
        answer = model.equilibrium(force=bending())
        assert (answer.converged, answer.stable, answer.message) == (True, True, "")
        coarse = isinstance(model, ms.CoarseDiscreteShell)
        most = 0.03 if coarse else 0.01  # cells of 8 cm, and of 4
        assert ms.measure.displacement_error(answer.positions, modes.positions, free) < most
        centre = free.mass @ (answer.positions - strip().vertices) / free.mass.sum()
        assert np.abs(centre).max() < (0.1 if coarse else 1e-9) * 1e-3  # of 1 mm; coarse vertices have other masses
    held = ms.Shell(strip(), ISOTROPIC, supports=[ms.Pin("nearest(0.25, 0, 0)"), ms.Fix([0], axes="y")])
    moved = ms.DiscreteShell(held).equilibrium(force=bending()).positions - strip().vertices
    moved -= free.mass @ moved / free.mass.sum()
    answer = ms.DiscreteShell(free).equilibrium(force=bending())
    np.testing.assert_allclose(answer.positions - strip().vertices, moved, atol=1e-6 * np.abs(moved).max())


@pytest.mark.parametrize("factor", [0.5, 1.0, 10.0])
def test_turns_that_a_load_in_balance_does_not_need_do_not_lead_away(free, factor):
    """At rest nothing resists them: Newton took 50 to 90 iterations, and told of bifurcations that are none."""
    answer = ms.DiscreteShell(free).equilibrium(force=factor * bending())
    assert (answer.converged, answer.stable, answer.message) == (True, True, "")
    assert answer.iterations <= 30


@pytest.mark.slow
def test_a_crease_of_a_free_strip_folds_the_way_that_it_is_pushed():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    x, crease = mesh.vertices[:, 0], ms.Crease("abs(x - 0.5) < 1e-6", 1e-3, 1e-3)
    shell = ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 2e-3, 300.0), creases=[crease])
    middle, ends = np.abs(x - 0.5) < 1e-6, np.abs(x - 0.5) > 0.5 - 1e-6
    answer = ms.DiscreteShell(shell).equilibrium(force=np.outer(middle / 3.0 - ends / 6.0, [0.0, 0.0, 0.01]))
    z = answer.positions[:, 2]
    assert answer.converged
    assert z[middle].mean() - z[ends].mean() == pytest.approx(0.479, rel=0.01)
    normals = np.cross(*(answer.positions[mesh.faces[:, k]] - answer.positions[mesh.faces[:, 0]] for k in (1, 2)))
    assert normals[:, 2].min() > 0.0  # not turned over


@pytest.mark.slow
def test_a_dead_couple_turns_a_free_strip_into_its_line(free):
    for model in (*full_models(free), ms.SpringSheet(ms.Shell(strip(), HINGED))):
        x = model.equilibrium(force=couple()).positions
        assert np.ptp(x[:, 2]) == pytest.approx(0.5, rel=1e-3)
        assert np.ptp(x[:, 0]) < 0.11
        assert np.sum(x * couple()) == pytest.approx(2.5e-3, rel=1e-3)  # 5 vertices of 1 mN, 0.5 m apart


@pytest.mark.slow
def test_a_turn_that_changes_nothing_is_not_made(free):
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    flat = ms.DiscreteShell(free).equilibrium(force=bending()).positions
    start = strip().vertices @ turn.T
    np.testing.assert_allclose(
        ms.DiscreteShell(free).equilibrium(force=bending(), start=start).positions, flat @ turn.T, atol=1e-9
    )


def test_each_part_is_judged_by_itself():
    one = strip()
    count = len(one.vertices)
    vertices = np.vstack([one.vertices, one.vertices + np.array([1.0, 0.0, 0.0])])
    mesh = ms.TriangleMesh(vertices, np.vstack([one.faces, one.faces + count]))
    held = np.concatenate([along(0.0) > 0, np.zeros(count, dtype=bool)])
    model = ms.DiscreteShell(ms.Shell(mesh, ISOTROPIC, clamped=held, loose_parts=True))
    weight = bending() + pulls(np.full(count, 0.01))
    answer = model.equilibrium(force=np.vstack([weight, bending()]))
    assert answer.converged
    alone = ms.DiscreteShell(ms.Shell(one, ISOTROPIC, clamped=along(0.0) > 0)).equilibrium(force=weight)
    np.testing.assert_allclose(answer.positions[:count], alone.positions, atol=1e-8)
    assert model.equilibrium(force=np.vstack([bending(), weight])).outcome is ms.Outcome.NO_EQUILIBRIUM


def test_a_free_shell_without_a_load_rests(free):
    for model in full_models(free):
        answer = model.equilibrium()
        assert (answer.converged, answer.stable) == (True, True)


@pytest.mark.by_default("1.0-support1-False", "1.0001-support3-True")
@pytest.mark.parametrize(
    ("support", "pulled"),
    [
        (ms.Fix("x < 1", axes="y"), False),
        (ms.Fix("x < 1", axes="xy"), False),
        (ms.Fix("x < 1e-9", axes="xy"), False),
        (ms.Fix("x < 1", axes="yz"), True),
    ],
)
@pytest.mark.parametrize("factor", [1.0, 1.0001, 2.0])
def test_parts_on_rails_and_planes_do_not_drift(support, pulled, factor):
    force = np.outer(along(0.5) - along(0.0), [1.0, 0.0, 0.0]) if pulled else bending()
    shell = ms.Shell(strip(), ISOTROPIC, supports=[support])
    answer = ms.DiscreteShell(shell).equilibrium(force=factor * force)
    assert (answer.converged, answer.stable, answer.message) == (True, True, "")
    moved = answer.positions - strip().vertices
    for vertices, directions, _ in free_translations(shell):
        centre = shell.mass[vertices] @ moved[vertices] / shell.mass[vertices].sum()
        assert np.abs(centre @ directions).max() <= 1e-9 * np.abs(moved).max()
    assert np.abs(moved).max() < 0.01


def test_derivatives_of_what_drifts_are_refused(free):
    model = ms.DiscreteShell(free)
    answer = model.equilibrium(force=bending())
    with pytest.raises(ms.OptionError, match="sensitivity needs a shell that its supports hold"):
        model.sensitivity(answer, wrt="thickness")


@pytest.mark.parametrize("pressure", [1e5, -1e4])
def test_a_free_balloon_is_stable_and_keeps_its_place(pressure):
    """Turns that change nothing were taken for unstable ones: they must not turn the balloon, nor its verdict."""
    mesh = icosphere(2)
    shell = ms.Shell(mesh, ms.Isotropic(young=1e9, poisson=0.3, thickness=0.01, density=1000.0))
    answer = ms.DiscreteShell(shell).equilibrium(loads=[ms.Pressure(pressure)])
    assert (answer.converged, answer.stable, answer.message) == (True, True, "")
    grown = np.sum((answer.positions - mesh.vertices) * mesh.vertices, axis=1)
    np.testing.assert_allclose(grown.mean(), pressure * 0.7 / (2.0 * 1e9 * 0.01), rtol=0.03)
    aside = answer.positions - mesh.vertices - grown[:, None] * mesh.vertices
    assert np.abs(aside).max() < 0.05 * abs(grown.mean())


@pytest.mark.slow
def test_a_free_balloon_that_buckles_is_not_called_stable_at_its_saddle():
    """At five times the classical pressure, on a coarse mesh, the round shape is no answer."""
    shell = ms.Shell(icosphere(1), ms.Isotropic(young=1e9, poisson=0.3, thickness=0.01, density=1000.0))
    answer = ms.DiscreteShell(shell).equilibrium(loads=[ms.Pressure(-6e5)])
    radii = np.linalg.norm(answer.positions, axis=1)
    assert not answer.stable or np.ptp(radii) > 0.05


@pytest.mark.by_default("-10000.0")
@pytest.mark.parametrize("pressure", [1e5, -1e4])
def test_a_free_balloon_of_a_coarse_shell_finds_its_fixed_point(pressure):
    """Under dead loads between two looks at the pressure it turned, as these have a lowest side: it never settled."""
    fine = icosphere(2)
    shell = ms.Shell(fine, ms.Isotropic(young=1e9, poisson=0.3, thickness=0.01, density=1000.0))
    model = ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, icosphere(1)))
    answer = model.equilibrium(loads=[ms.Pressure(pressure)])
    assert (answer.converged, answer.stable, answer.message) == (True, True, "")
    grown = np.sum((answer.positions - fine.vertices) * fine.vertices, axis=1)
    np.testing.assert_allclose(grown.mean(), pressure * 0.7 / (2.0 * 1e9 * 0.01), rtol=0.2)
    turn = np.cross(fine.vertices, answer.positions).mean(axis=0)
    assert np.abs(turn).max() < 0.02 * abs(grown.mean())
