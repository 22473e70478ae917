"""Path following on systems of a few bars, whose paths are known in closed form."""

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar

import modalshell as ms
from modalshell.shell import EXACT
from modalshell.statics.bordered import Bordered, Plane
from modalshell.statics.newton import mixed_newton
from modalshell.statics.path import Tracer


def bar(point, foot, rest):
    """Energy, gradient and Hessian by ``point`` of a bar of unit stiffness EA from ``foot``, of length ``rest``."""
    line = point - foot
    length = np.linalg.norm(line)
    along, strain = line / length, (length - rest) / rest
    across = np.eye(line.size) - np.outer(along, along)
    return 0.5 * rest * strain**2, strain * along, np.outer(along, along) / rest + strain / length * across


def truss(height, spring=None):
    """Von Mises truss of half span 1: unknowns of its apex (x, y), and of the end of a spring on top where it has one.

    Its load pulls down, at the apex or at the spring's end.
    """
    rest = np.hypot(1.0, height)

    def energy(x):
        parts = [bar(x[:2], np.array([foot, 0.0]), rest) for foot in (-1.0, 1.0)]
        value, gradient, hessian = (sum(part[k] for part in parts) for k in range(3))
        if spring is None:
            return value, gradient, hessian
        stretch = x[2] - x[1]
        out = np.zeros(3), np.zeros((3, 3))
        out[0][:2], out[1][:2, :2] = gradient, hessian
        out[0][1:] += spring * stretch * np.array([-1.0, 1.0])
        out[1][1:, 1:] += spring * np.array([[1.0, -1.0], [-1.0, 1.0]])
        return value + 0.5 * spring * stretch**2, *out

    start = [0.0, height] if spring is None else [0.0, height, height]
    return ms.EnergyFunction(energy, start), np.array([0.0] * (len(start) - 1) + [-1.0])


def load_of(y, height):
    """Load that holds the symmetric truss at the height ``y``."""
    rest = np.hypot(1.0, height)
    return 2.0 * y * (1.0 / np.hypot(1.0, y) - 1.0 / rest)


def peak(height):
    return -minimize_scalar(
        lambda y: -load_of(y, height), bounds=(0, height), method="bounded", options={"xatol": 1e-13}
    ).fun


def test_the_shallow_truss_snaps_through_as_its_closed_form_says():
    height = 0.3
    system, load = truss(height)
    path = ms.equilibrium_path(system, force=load, until=0.05)
    assert path.converged
    assert path.factors[-1] == 0.05
    assert [event.kind for event in path.events] == ["limit", "limit"]
    exact = peak(height)
    np.testing.assert_allclose([factor for _, _, factor in path.events], [exact, -exact], rtol=1e-10)
    y = path.positions[:, 1]
    np.testing.assert_allclose(path.positions[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(path.factors, load_of(y, height), rtol=0, atol=1e-10)
    np.testing.assert_allclose(path.displacements, height - y, rtol=1e-12)
    assert (np.diff(y) < 0.0).all()
    low, high = (path.events[k].index for k in range(2))
    assert path.stable[:low].all()
    assert not path.stable[low + 1 : high].any()
    assert path.stable[high + 1 :].all()


@pytest.mark.slow
def test_the_steep_truss_buckles_aside_and_its_branch_is_found():
    """Its lateral stiffness falls to zero first: a bifurcation, whose branch leaves the axis of symmetry."""
    height = 3.5
    system, load = truss(height)

    def lateral(y):
        return system(np.array([0.0, y]))[2][0, 0]

    y = brentq(lateral, 2.5, height, xtol=1e-14)
    path = ms.equilibrium_path(system, force=load, until=1.0, steps=10, branches=1)
    first = path.events[0]
    assert first.kind == "bifurcation"
    assert first.factor == pytest.approx(load_of(y, height), rel=1e-6)
    assert path.positions[first.index][1] == pytest.approx(y, rel=1e-6)
    assert [event.kind for event in path.events].count("bifurcation") == 4
    limits = [event.factor for event in path.events if event.kind == "limit"]
    np.testing.assert_allclose(limits, [peak(height), -peak(height)], rtol=1e-9)
    left, right = path.branches
    assert left.parent == right.parent == first.index
    for branch in (left, right):
        assert np.abs(branch.positions[1:-1, 0]).max() > 0.5
        for x, factor in zip(branch.positions, branch.factors, strict=True):
            np.testing.assert_allclose(system(x)[1], factor * load, atol=1e-8)
    np.testing.assert_allclose(left.positions[:9] * [-1.0, 1.0], right.positions[:9], atol=1e-7)


def test_a_path_goes_through_a_double_bifurcation():
    """Two directions alike lose their stiffness at once, as in symmetric shells: at a factor of 1, where u is 1."""

    def energy(point):
        x, y, u = point
        aside, square = np.array([x, y, 0.0]), x * x + y * y
        value = 0.5 * square * (1.0 - u) + 0.25 * square**2 + 0.5 * u * u
        gradient = (1.0 - u + square) * aside + np.array([0.0, 0.0, u - 0.5 * square])
        hessian = np.diag([1.0 - u + square, 1.0 - u + square, 1.0]) + 2.0 * np.outer(aside, aside)
        hessian[2, :2] = hessian[:2, 2] = -aside[:2]
        return value, gradient, hessian

    system = ms.EnergyFunction(energy, [0.0, 0.0, 0.0])
    path = ms.equilibrium_path(system, force=np.array([0.0, 0.0, 1.0]), until=2.05, branches=1)
    assert path.converged, path.message
    ((kind, index, factor),) = path.events
    assert kind == "bifurcation"
    assert factor == pytest.approx(1.0, abs=1e-6)
    assert path.unstable_directions[0] == 0
    assert path.unstable_directions[-1] == 2
    np.testing.assert_allclose(path.positions[index], [0.0, 0.0, 1.0], atol=1e-6)
    assert len(path.branches) == 2
    for branch in path.branches:  # of radius r: u = 1 + r^2, under a factor of 1 + r^2 / 2
        radius = np.linalg.norm(branch.positions[:, :2], axis=1)
        np.testing.assert_allclose(branch.factors, 1.0 + 0.5 * radius**2, atol=1e-6)


def test_what_controls_a_path_may_not_turn_back():
    """On a soft spring the truss snaps back: its load and the spring's end both turn; the arc length goes on."""
    height = 0.3
    system, load = truss(height, spring=0.02)
    arc = ms.equilibrium_path(system, force=load, until=0.05)
    assert arc.converged
    assert (np.diff(arc.displacements) < 0.0).any()
    np.testing.assert_allclose(load_of(arc.positions[:, 1], height), arc.factors, atol=1e-10)
    np.testing.assert_allclose(arc.events[0].factor, peak(height), rtol=1e-8)
    by_load = ms.equilibrium_path(system, force=load, until=0.05, control="load")
    assert by_load.outcome is ms.Outcome.NOT_CONVERGED
    assert "arc" in by_load.message
    assert by_load.stable.all()
    assert by_load.factors[-1] == pytest.approx(peak(height), rel=1e-4)
    by_end = ms.equilibrium_path(system, force=load, until=0.05, control="displacement")
    assert by_end.outcome is ms.Outcome.NOT_CONVERGED
    turn = arc.displacements[: np.flatnonzero(np.diff(arc.displacements) < 0.0)[0] + 1].max()
    assert by_end.displacements[-1] == pytest.approx(turn, rel=1e-2)
    apex = ms.equilibrium_path(system, force=load, until=0.05, control="displacement", watch=[0.0, -1.0, 0.0])
    assert apex.converged
    np.testing.assert_allclose([e.factor for e in apex.events], [e.factor for e in arc.events], rtol=1e-8)


def test_displacement_control_passes_the_limit_of_the_plain_truss():
    system, load = truss(0.3)
    path = ms.equilibrium_path(system, force=load, until=0.05, control="displacement")
    assert path.converged
    np.testing.assert_allclose([event.factor for event in path.events], [peak(0.3), -peak(0.3)], rtol=1e-9)


def test_loads_that_point_the_other_way_and_paths_from_a_start():
    system, load = truss(0.3)
    up = ms.equilibrium_path(system, force=-load, until=-0.05)
    np.testing.assert_allclose([event.factor for event in up.events], [-peak(0.3), peak(0.3)], rtol=1e-9)
    snapped = ms.equilibrium_path(system, force=load, begin=0.0, start=[0.0, -0.3], until=0.02)
    assert snapped.converged
    assert not snapped.events
    assert snapped.stable.all()
    later = ms.equilibrium_path(system, force=load, begin=0.005, until=0.05)
    assert later.factors[0] == 0.005
    assert later.events[0].factor == pytest.approx(peak(0.3), rel=1e-9)


def test_a_bordered_factor_solves_the_bordered_matrix():
    system, load = truss(0.3, spring=0.5)
    problem = system.problem(load)
    random = np.random.default_rng(0)
    x = system.rest + 0.01 * random.standard_normal(3)
    plane = Plane(random.standard_normal(3), 0.3, system.rest, 0.1, 0.7)
    bordered = Bordered(problem, plane, 2.0)
    point = bordered.joined(x, 0.02)
    gradient, hessian = bordered.linearise(point, EXACT)
    whole = np.empty((4, 4))
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-6
        whole[:, k] = (bordered.linearise(point + step, EXACT)[0] - bordered.linearise(point - step, EXACT)[0]) / 2e-6
    solved = bordered.factor(hessian).solve(gradient)
    np.testing.assert_allclose(whole @ solved, gradient, rtol=1e-6, atol=1e-9)


def test_a_plane_that_the_path_does_not_cut_has_no_point():
    system, load = truss(0.3)
    tracer = Tracer(system.problem(load), 0.001)
    across = Plane(np.array([0.0, 1.0]), 0.0, np.array([0.0, 50.0]), 0.0, 1.0)
    assert tracer.corrected(system.rest, 0.0, across, None) is not None  # far along the path, but on it
    beside = Plane(np.array([1.0, 0.0]), 0.0, np.array([0.5, 0.3]), 0.0, 1.0)
    found = tracer.corrected(system.rest, 0.0, beside, None)
    assert found is None or mixed_newton(system.problem(load).loaded(found[1]), found[0].point, 1.0).converged


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"until": 0.0}, "until must differ"),
        ({"until": np.nan}, "until"),
        ({"control": "time"}, "control must be one of"),
        ({"points": 1}, "points"),
        ({"steps": 0}, "steps"),
        ({"branches": -1}, "branches"),
        ({"force": [0.0, 0.0]}, "no load"),
        ({"force": [1.0]}, "force must have shape"),
        ({"gravity": (0, 0, -1)}, "knows no mass"),
        ({"watch": [1.0]}, "watch"),
        ({"start": [np.nan, 0.0]}, "start"),
    ],
)
def test_wrong_options_are_refused(options, match):
    system, load = truss(0.3)
    with pytest.raises(ms.ModalShellError, match=match):
        ms.equilibrium_path(system, **({"force": load} | options))


def test_energies_of_the_wrong_shape_are_refused():
    good = truss(0.3)[0].function
    with pytest.raises(ms.OptionError, match="must return shapes"):
        ms.EnergyFunction(lambda _: (0.0, np.zeros(3), np.eye(2)), [0.0, 0.3])
    with pytest.raises(ms.OptionError, match="energy, gradient and Hessian"):
        ms.EnergyFunction(lambda _: 0.0, [0.0, 0.3])
    with pytest.raises(ms.OptionError, match="zero diagonal"):
        ms.EnergyFunction(lambda _: (0.0, np.zeros(2), np.zeros((2, 2))), [0.0, 0.3])
    with pytest.raises(ms.OptionError, match="callable"):
        ms.EnergyFunction(None, [0.0])
    with pytest.raises(ms.OptionError, match="size"):
        ms.EnergyFunction(good, [0.0, 0.3], size=0.0)
