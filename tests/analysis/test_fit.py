"""Constants recovered from measured positions."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import PLAIN

import modalshell as ms
from modalshell.analysis.fit import _is_least
from modalshell.analysis.fit_measurements import KnownEquilibrium
from modalshell.core import cost as work

SHEET = ms.Isotropic(young=1e6, poisson=0.3, thickness=4e-3, density=60.0)
GRAVITY = (0.0, 0.0, -2.0)


@pytest.fixture(scope="module")
def strip():
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(24, 2))
    return ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < 0.01)


@pytest.fixture(scope="module")
def measured(strip):
    answer = ms.DiscreteShell(strip).equilibrium(gravity=GRAVITY)
    assert answer.converged
    return answer.positions


@pytest.mark.slow
def test_young_is_found_from_exact_positions(strip, measured):
    found = ms.fit(strip.with_material(replace(SHEET, young=4e6)), "young", measured, gravity=GRAVITY)
    assert found.converged
    assert found.values["young"] == pytest.approx(1e6, rel=1e-5)
    assert found.residual < 1e-8
    assert found.material.young == found.values["young"]
    low, high = found.intervals["young"]
    assert low <= found.values["young"] <= high
    assert found.evaluations < 15


@pytest.mark.slow
def test_young_is_found_from_a_small_move_too(strip):
    """Of a tip that has moved by a thousandth of a millimetre: no tolerance has a unit."""
    gravity, tip = 1e-7 * np.array(GRAVITY), strip.rest_positions[:, 0] > 0.999
    seen = ms.DiscreteShell(strip).equilibrium(gravity=gravity).positions[tip].mean(axis=0)
    guess = strip.with_material(replace(SHEET, young=4e6))
    found = ms.fit(guess, "young", seen, where=tip, average=True, gravity=gravity)
    assert found.converged
    assert found.values["young"] == pytest.approx(1e6, rel=1e-5)


@pytest.mark.slow
def test_a_noisy_tip_curve_gives_young_within_its_interval(strip, measured):
    drop = np.abs(measured[:, 2]).max()
    guess = strip.with_material(replace(SHEET, young=3e6))
    hits = 0
    for seed in range(12):
        edge = np.abs(strip.rest_positions[:, 1]) < 1e-9
        seen = np.full((edge.sum(), 3), np.nan)
        noise = 0.01 * drop * np.random.default_rng(seed).standard_normal(len(seen))
        seen[:, 2] = measured[edge, 2] + noise
        found = ms.fit(guess, "young", seen, where=edge, gravity=GRAVITY)
        low, high = found.intervals["young"]
        assert found.converged
        hits += low < 1e6 < high
    assert hits >= 9  # of 12 intervals of 95 %


@pytest.mark.slow
def test_held_vertices_make_no_interval_narrower(strip, measured):
    """Their places were known before they were measured."""
    free = strip.rest_positions[:, 0] > 0.5
    noise = 1e-4 * np.random.default_rng(0).standard_normal((free.sum(), 3))
    guess, seen = strip.with_material(replace(SHEET, young=2e6)), measured.copy()
    seen[free] += noise
    without = ms.fit(guess, "young", seen[free], where=free, gravity=GRAVITY)
    both = free | strip.clamped
    found = ms.fit(guess, "young", seen[both], where=both, gravity=GRAVITY)
    assert found.intervals["young"] == pytest.approx(without.intervals["young"], rel=1e-6)


@pytest.mark.slow
def test_two_constants_are_told_apart():
    """Weight and stiffness by where the shell is, Poisson's ratio by how it bends across."""
    mesh = ms.sheet(length=1.0, width=0.8, cells=(8, 8))
    shell = ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < 0.01)
    load = [ms.PointForce([len(mesh.vertices) - 1], (0.0, 0.0, 0.02))]
    measured = ms.DiscreteShell(shell).equilibrium(loads=load).positions
    guess = shell.with_material(replace(SHEET, young=2e6, poisson=0.1))
    found = ms.fit(guess, ["young", "poisson"], measured, loads=load)
    assert found.values["young"] == pytest.approx(1e6, rel=1e-4)
    assert found.values["poisson"] == pytest.approx(0.3, abs=1e-4)


@pytest.mark.slow
def test_a_tip_curve_along_the_load_gives_young_from_loads_of_all_kinds(strip):
    tip, factors = strip.rest_positions[:, 0] > 0.999, (0.5, 1.5)
    push = np.zeros_like(strip.rest_positions)
    push[tip, 2] = -1e-4
    answers = [
        ms.DiscreteShell(strip).equilibrium(
            gravity=(0.0, 0.0, -1.0 * share), force=share * push, loads=[ms.Pressure(0.02 * share)]
        )
        for share in factors
    ]
    seen = [answer.positions[tip].mean(axis=0) for answer in answers]
    found = ms.fit(
        strip.with_material(replace(SHEET, young=2e6)), "young", seen, where=tip, average=True, factors=factors,
        gravity=(0.0, 0.0, -1.0), force=push, loads=[ms.Pressure(0.02)],
    )  # fmt: skip
    assert found.values["young"] == pytest.approx(1e6, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("free", [False, True])
def test_frequencies_give_young_and_thickness_goes_with_it(free):
    """On a strip so wide that twist does not change places with bending as Poisson's ratio moves."""
    mesh = ms.flat_beam(length=1.0, width=0.15, cells=(24, 4))
    shell = ms.Shell(mesh, SHEET, None if free else mesh.vertices[:, 0] < 0.01)
    basis = ms.solve_modes(shell, 10)
    seen = basis.frequencies[basis.rigid_modes :][:4].copy()
    seen[1] = np.nan
    guess = shell.with_material(replace(SHEET, young=2e6, poisson=0.2))
    found = ms.fit(guess, ["young", "poisson"], frequencies=seen)
    assert found.values["young"] == pytest.approx(1e6, rel=1e-4)
    assert found.values["poisson"] == pytest.approx(0.3, rel=1e-3)
    assert found.state is None
    assert found.residual < 1e-6


@pytest.mark.slow
def test_a_load_curve_takes_few_factorisations(strip):
    """Predicted equilibria take two Newton steps or fewer, and share the factor that shows them stable."""
    tip, factors = strip.rest_positions[:, 0] > 0.999, np.arange(1, 7) / 6.0
    body = ms.DiscreteShell(strip)
    seen = [body.equilibrium(gravity=share * np.array(GRAVITY)).positions[tip].mean(axis=0) for share in factors]
    given = {"where": tip, "average": True, "factors": factors, "gravity": GRAVITY}
    with work.counted() as counts:
        found = ms.fit(strip.with_material(replace(SHEET, young=2e6)), "young", seen, **given)
    assert found.values["young"] == pytest.approx(1e6, rel=1e-9)
    assert counts.factorisations <= 3 * found.evaluations * factors.size
    exact = ms.DiscreteShell(strip.with_material(found.material)).equilibrium(gravity=GRAVITY)
    np.testing.assert_allclose(found.state.positions, exact.positions, atol=1e-7)
    assert found.state.residual <= 1e-7
    np.testing.assert_array_equal(found.state.gravity, GRAVITY)


@pytest.mark.slow
def test_where_no_equilibrium_is_near_the_model_finds_it(strip, measured, monkeypatch):
    monkeypatch.setattr(KnownEquilibrium, "near", lambda *_: None)
    observed = np.stack([ms.DiscreteShell(strip).equilibrium(gravity=(0.0, 0.0, -1.0)).positions, measured])
    guess = strip.with_material(replace(SHEET, young=2e6))
    found = ms.fit(guess, "young", observed, factors=[0.5, 1.0], gravity=GRAVITY)
    assert found.values["young"] == pytest.approx(1e6, rel=1e-5)


def test_a_minimum_is_told_from_a_search_that_came_to_a_halt():
    """Squares are least where the misfit is at right angles to the slopes, or nothing; elsewhere a branch has ended."""
    slopes = np.array([[1.0], [1.0], [0.0]])
    assert _is_least(slopes, np.array([1.0, -1.0, 3.0]))
    assert _is_least(slopes, np.full(3, 1e-7))
    assert not _is_least(slopes, np.array([1.0, 1.0, 3.0]))


def test_what_the_load_cannot_tell_is_refused(strip):
    """Without a load nothing moves, whatever the modulus."""
    with pytest.raises(ms.SolverError, match="do not determine 1 constants"):
        ms.fit(strip, "young", strip.rest_positions)


def test_a_selection_of_the_mesh_says_where(strip, measured):
    rim = np.unique(strip.mesh.edges[strip.mesh.edge_faces[:, 1] < 0])
    guess = strip.with_material(replace(SHEET, young=2e6))
    found = ms.fit(guess, "young", measured[rim], where="boundary", gravity=GRAVITY)
    assert found.values["young"] == pytest.approx(1e6, rel=1e-5)


@pytest.mark.slow
def test_constants_that_act_alike_are_refused_at_the_guess(strip):
    """Under its weight a sheet tells the quotient of modulus and density alone, also with another constant wrong."""
    factors = (0.3, 0.6, 1.0)
    seen = [ms.DiscreteShell(strip).equilibrium(gravity=np.multiply(share, GRAVITY)).positions for share in factors]
    for poisson in (SHEET.poisson, 0.2):
        guess = strip.with_material(replace(SHEET, young=2e6, poisson=poisson))
        for names in (["young", "density"], ["density", "poisson", "young"]):
            with pytest.raises(ms.SolverError, match=f"do not determine {len(names)} constants"):
                ms.fit(guess, names, seen, factors=factors, gravity=GRAVITY)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wrt": "stretch"}, "constants above 0 among young"),
        ({"wrt": []}, "each constant once"),
        ({"wrt": np.nan}, "the name of a constant"),
        ({"wrt": [1]}, "the name of a constant"),
        ({"wrt": ["young", "young"]}, "each constant once"),
        ({"observed": np.zeros((2, 3))}, "observed must have shape"),
        ({"observed": np.full((75, 3), np.nan)}, "at least one measured coordinate"),
        ({"observed": np.full((75, 3), np.inf)}, "observed must be finite"),
        ({"observed": "x"}, "observed must be"),
        ({"observed": None}, "one of the two"),
        ({"frequencies": [1.0]}, "one of the two"),
        ({"observed": None, "frequencies": [1.0]}, "leave where, average, factors and loads out"),
        ({"observed": None, "gravity": None, "frequencies": [2.0, 1.0]}, "must ascend"),
        ({"observed": None, "gravity": None, "frequencies": [np.nan]}, "at least one measured value"),
        ({"observed": None, "gravity": None, "frequencies": [0.0]}, "must be positive"),
        ({"factors": [1.0, 2.0]}, "observed must have shape"),
        ({"factors": [np.nan]}, "factors must be finite"),
        ({"average": 1}, "average"),
        ({"confidence": 2.0}, "confidence must be"),
        ({"gravity": (0.0, np.nan, 0.0)}, "gravity must be finite"),
    ],
)
def test_wrong_input_is_refused(strip, measured, options, message):
    given = {"wrt": "young", "observed": measured, "gravity": GRAVITY} | options
    with pytest.raises(ms.ModalShellError, match=message):
        ms.fit(strip, given.pop("wrt"), given.pop("observed"), **given)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sheet", "guess"),
    [
        (ms.Orthotropic(young=(1e7, 1e6), shear=1e6, poisson=0.9, thickness=4e-3, density=60.0), 0.6),
        (ms.Isotropic(young=1e6, poisson=0.48, thickness=4e-3, density=60.0), 0.5),
    ],
)
def test_poissons_ratio_is_found_wherever_the_sheet_is_stable(sheet, guess):
    """That of two moduli may be up to sqrt(E1 / E2), here 3.2."""
    mesh = ms.sheet(length=1.0, width=0.8, cells=(6, 6))
    shell, load = ms.Shell(mesh, sheet, "x < 0.01"), [ms.PointForce([len(mesh.vertices) - 1], (0.0, 0.0, 0.02))]
    seen = ms.DiscreteShell(shell).equilibrium(loads=load).positions
    found = ms.fit(shell.with_material(replace(sheet, poisson=guess)), "poisson", seen, loads=load)
    assert found.converged
    assert found.values["poisson"] == pytest.approx(sheet.poisson, abs=1e-4)


@pytest.mark.by_default("0.001-0.0")
@pytest.mark.parametrize(("coupling", "guess"), [(-1e-3, 1e-3), (1e-3, 0.0)])
def test_couplings_of_a_fabric_may_have_any_sign(coupling, guess):
    """Of the other sign nothing was found, and from none, the usual guess, none was allowed."""

    def fabric(coupling):
        stiffness = {"stretch": (1e5, 5e4, 1e4, 2e3), "bending": (1e-2, 5e-3, 2e-3, coupling)}
        return ms.Fabric(**stiffness, density=0.3, direction=30.0)

    shell = ms.Shell(ms.flat_beam(length=0.5, width=0.2, cells=(6, 4)), fabric(coupling), "x < 0.01")
    seen = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -2.0)).positions
    found = ms.fit(shell.with_material(fabric(guess)), "bending_4", seen, gravity=(0.0, 0.0, -2.0))
    assert found.converged
    assert found.values["bending_4"] == pytest.approx(coupling, rel=1e-6)


@pytest.mark.slow
def test_six_constants_of_a_fabric_are_found_from_one_shape():
    """With a first step as long as the logarithms the shear was 89 % off, and called converged."""

    def fabric(stretch, bending):
        stretch, bending = stretch * np.array([1.0, 0.5, 0.06]), bending * np.array([1.0, 0.6, 0.3])
        return ms.Fabric(stretch=tuple(stretch), bending=tuple(bending), density=1.5, direction=24.0)

    shell = ms.Shell(ms.v_beam(length=1.0, width=0.25, fold=140.0, cells=(6, 4)), fabric(2e4, 0.02), "x < 1e-6")
    seen = ms.DiscreteShell(shell).equilibrium(gravity=(1.0, 2.0, -0.5)).positions
    names = [f"{kind}_{k}" for kind in ("stretch", "bending") for k in (1, 2, 3)]
    found = ms.fit(shell.with_material(fabric(3.2e4, 0.032)), names, seen, gravity=(1.0, 2.0, -0.5))
    assert found.converged
    assert list(found.values.values()) == pytest.approx([2e4, 1e4, 1.2e3, 0.02, 0.012, 0.006], rel=1e-5)


def test_constants_of_hinges_are_found_too():
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(12, 2))
    shell = ms.Shell(mesh, PLAIN, mesh.vertices[:, 0] < 0.1)
    seen = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY).positions
    found = ms.fit(shell.with_material(replace(PLAIN, flexure=0.2)), "flexure", seen, gravity=GRAVITY)
    assert found.values["flexure"] == pytest.approx(PLAIN.flexure, rel=1e-4)


def test_a_search_that_leaves_the_stable_sheets_says_where():
    sheet = ms.Orthotropic(young=(1e7, 1e6), shear=1e6, poisson=2.9, thickness=4e-3, density=60.0)
    shell = ms.Shell(ms.sheet(length=1.0, width=0.8, cells=(6, 6)), sheet, "x < 0.01")
    loads = [ms.PointForce([48], (0.0, 0.0, 0.02))]
    seen = ms.DiscreteShell(shell).equilibrium(loads=loads).positions
    guess = shell.with_material(replace(sheet, young=(4e7, 1e6), poisson=5.9))
    with pytest.raises(ms.SolverError, match=r"at young_1 = .*, poisson = .* begin nearer"):
        ms.fit(guess, ["young_1", "poisson"], seen, loads=loads)


@pytest.mark.slow
def test_frequencies_that_cross_on_the_way_are_told_apart():
    """From this guess the third mode is the fourth of the shell that was measured: the fit ended 20 % or more off."""
    mesh = ms.flat_beam(length=1.0, width=0.64, cells=(8, 5))
    constants = np.array([1.0e9, 0.4e9, 0.2e9])

    def plate(first, second, shear):
        sheet = ms.Orthotropic(young=(first, second), shear=shear, poisson=0.2, thickness=2e-3, density=700.0)
        return ms.Shell(mesh, sheet, "x < 0.001")

    seen = ms.solve_modes(plate(*constants), 6).frequencies
    for share in ((0.5, 2.0, 0.6), (2.0, 2.2, 0.5), (0.6, 0.5, 2.0), (1.8, 0.5, 1.9)):
        found = ms.fit(plate(*constants * share), ["young_1", "young_2", "shear"], frequencies=seen)
        assert found.converged
        np.testing.assert_allclose(list(found.values.values()), constants, rtol=1e-4)


def test_modes_above_the_measured_ones_may_share_an_eigenvalue():
    """Of a square plate they do: they have no derivatives, and orders are those of the measured modes alone."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(6, 6), family="union-jack")
    plate = ms.Shell(mesh, SHEET)
    seen = ms.solve_modes(plate, 9).frequencies[6:] * (1.0, 1.01, 0.995)
    found = ms.fit(plate.with_material(replace(SHEET, young=2e6, poisson=0.1)), ["young", "poisson"], frequencies=seen)
    assert found.converged
    assert found.values["young"] == pytest.approx(1e6, rel=0.05)


@pytest.mark.slow
def test_a_fit_that_explains_little_says_so(strip, measured):
    other = measured.copy()
    other[:, 1] += 0.4 * measured[:, 2]
    with pytest.warns(ms.ModalShellWarning, match="% off what was measured"):
        assert ms.fit(strip, "young", other, gravity=GRAVITY).converged
    seen = ms.solve_modes(strip, 4).frequencies * (1.0, 1.3, 1.0, 1.3)
    with pytest.warns(ms.ModalShellWarning, match="% off what was measured"):
        assert ms.fit(strip, "young", frequencies=seen).converged


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::modalshell.core.errors.ModalShellWarning")
def test_poissons_ratio_stays_within_its_bounds_where_other_orders_are_tried():
    """Frequencies that no sheet has: starts of further searches may lie beyond 0.495."""
    mesh = ms.sheet(cells=(8, 6))

    def shell(young, poisson):
        return ms.Shell(mesh, ms.Isotropic(young, poisson, 1e-2, 100.0), clamped="x < 1e-6")

    measured = ms.solve_modes(shell(1e6, 0.3), 8).frequencies * np.linspace(0.8, 1.3, 8)
    for names in (["young", "poisson"], ["poisson"]):
        found = ms.fit(shell(1.3e6, 0.1), names, frequencies=measured)
        assert -1.0 < found.values["poisson"] < 0.5


@pytest.mark.slow
def test_frequencies_of_a_half_that_symmetry_leaves_free_are_those_of_its_elastic_modes():
    """Three rigid motions stood in place of as many frequencies: NumPy's IndexError."""
    mesh = ms.sheet(length=1.0, width=0.7, cells=(6, 4))
    side = mesh.vertices[:, 1] < mesh.vertices[:, 1].min() + 1e-9
    half = ms.Shell(mesh, SHEET, supports=[ms.Symmetry(side, (0, 1, 0))])
    basis = ms.solve_modes(half, 6)
    found = ms.fit(half.with_material(replace(SHEET, young=2e6)), "young", frequencies=basis.frequencies[3:])
    assert basis.rigid_modes == 3
    assert found.values["young"] == pytest.approx(1e6, rel=1e-6)


@pytest.mark.slow
def test_a_sheet_whose_pairs_of_triangles_follow_its_constants_is_found():
    """Neighbours pair where their elasticity is alike: the order of elimination of the guess ended in a ValueError."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(8, 2))
    turns = np.random.default_rng(0).uniform(0.0, 90.0, len(mesh.faces))

    def shell(*young):
        constants = {"shear": 4e6, "poisson": 0.1, "thickness": 4e-3, "density": 60.0, "direction": turns}
        return ms.Shell(mesh, ms.Orthotropic(young=young, **constants), "x < 1e-9")

    seen = ms.DiscreteShell(shell(2e7, 2e6)).equilibrium(gravity=GRAVITY).positions
    found = ms.fit(shell(6e6, 6e6), ["young_1", "young_2"], seen, gravity=GRAVITY)
    assert list(found.values.values()) == pytest.approx([2e7, 2e6], rel=1e-6)
