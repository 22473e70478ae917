"""Hinges through flat and through half a turn, folded onto each other, and next to collapsed triangles."""

import math

import numpy as np
import pytest
from scenes import cantilever

from modalshell import DiscreteShell, LoadError, Material, ModalShellError, Shell, TriangleMesh
from modalshell.shell.kernels.generated import flexure

ENDS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
FACES = [[0, 1, 2], [1, 0, 3]]
NO_MEMBRANE = Material(stretch=1e-300, shear=1e-300, flexure=0.7, density=0.2)


def opened(angle, apex=0.8, other=0.7):
    """A hinge about the x axis of two right-angled triangles whose fold angle is ``angle``, flat at 0."""
    turned = other * np.array([0.0, -math.cos(angle), -math.sin(angle)]) + (0.4, 0.0, 0.0)
    return np.vstack([ENDS, [0.3, apex, 0.0], turned])


def fold(x):
    out = np.empty(1)
    flexure.measures(np.ascontiguousarray(x), np.array([[0, 1, 2, 3]]), out)
    return out[0]


def hinge_at(rest):
    shell = Shell(TriangleMesh(opened(rest), FACES), NO_MEMBRANE)
    return shell, next(e.weight[0] for e in shell.elements if e.kernel is flexure)


def gradient(x):
    """Gradient (4, 3) of theta in closed form: along the normals, one over the heights."""
    e, a, b = x[1] - x[0], x[2] - x[0], x[3] - x[0]
    n1, n2 = np.cross(e, a), np.cross(b, e)
    length = np.linalg.norm(e)
    ga, gb = -length * n1 / (n1 @ n1), -length * n2 / (n2 @ n2)
    ge = -((a @ e) * ga + (b @ e) * gb) / length**2
    return np.array([-ga - gb - ge, ge, ga, gb])


@pytest.mark.parametrize("rest", [0.0, 0.5, -2.0])
def test_force_and_stiffness_are_continuous_through_flat(rest):
    shell, weight = hinge_at(rest)
    scale = 2.0 * weight * (1.0 + abs(rest))
    steps = np.array([1e-3, 1e-6, 1e-9, 1e-12, 1e-15])
    jumps = []
    for h in steps:
        force, stiffness = (np.abs(f(opened(h)) - f(opened(-h))).max() for f in (shell.force, dense(shell)))
        jumps.append((force / scale, stiffness / scale))
    # No jump is left as the step shrinks: the difference is of the step's order down to rounding.
    assert (np.array(jumps) < 40.0 * steps[:, None] + 2e-14).all()
    at_flat = [np.abs(f(opened(0.0)) - f(opened(1e-15))).max() / scale for f in (shell.force, dense(shell))]
    assert max(at_flat) < 1e-13


def dense(shell):
    return lambda x: shell.stiffness(x).toarray()


@pytest.mark.parametrize("rest", [0.5, -2.0, 3.0])
def test_the_branch_of_the_angle_itself_makes_no_jump(rest):
    """Past half a turn atan2 jumps by 2 pi; theta - theta0 in (-pi, pi] does not."""
    shell, weight = hinge_at(rest)
    for h in (1e-6, 1e-9, 1e-12):
        before, after = opened(math.pi - h), opened(math.pi + h)
        assert fold(before) - fold(after) == pytest.approx(2 * math.pi, abs=1e-5)
        for f in (shell.force, dense(shell)):
            assert np.abs(f(before) - f(after)).max() < 40.0 * weight * (10.0 * h + 1e-14)


@pytest.mark.parametrize("rest", [0.0, 0.5, -2.0])
@pytest.mark.parametrize("distance", [1e-6, 1e-9, 1e-12])
def test_half_a_turn_from_rest_jumps_as_the_model_has_it(rest, distance):
    """The energy k (theta - theta0)^2 has a kink at half a turn: its force jumps by 2 k 2 pi dtheta/dx and no more."""
    shell, weight = hinge_at(rest)
    before, after = opened(rest + math.pi - distance), opened(rest + math.pi + distance)
    middle = opened(rest + math.pi)
    jump = shell.force(before) - shell.force(after)
    own = -2.0 * weight * 2.0 * math.pi * gradient(middle)
    scale = np.abs(own).max()
    np.testing.assert_allclose(jump, own, rtol=0, atol=scale * (5.0 * distance + 1e-13))
    assert shell.energy(before) == pytest.approx(shell.energy(after), rel=1e-13)
    assert shell.energy(middle) == pytest.approx(weight * math.pi**2, rel=1e-14)
    # The stiffness jumps by 2 k 2 pi d2theta/dx2, here by central differences of the gradient.
    stiffness = dense(shell)(before) - dense(shell)(after)
    step = 1e-5
    curvature = np.empty((12, 12))
    for k in range(12):
        push = np.zeros(12)
        push[k] = step
        push = push.reshape(4, 3)
        curvature[k] = (gradient(middle + push) - gradient(middle - push)).ravel() / (2 * step)
    own = 2.0 * weight * 2.0 * math.pi * curvature
    np.testing.assert_allclose(stiffness, own, rtol=0, atol=np.abs(own).max() * (10.0 * distance + 1e-8))


@pytest.mark.parametrize("rest", [0.0, 1.0, math.pi - 1e-6])
@pytest.mark.parametrize("other", [0.7, 0.8])
def test_folded_flat_onto_each_other_stays_finite(rest, other):
    """With apexes at unlike heights and coinciding (other = 0.8 and both at the same place)."""
    shell, weight = hinge_at(rest)
    for angle in (math.pi, -math.pi, math.pi - 1e-12, -math.pi + 1e-12, math.pi - 1e-15, math.nextafter(math.pi, 0.0)):
        x = opened(angle, other=other)
        if other == 0.8:
            x[3, 0] = 0.3
        assert abs(fold(x)) == pytest.approx(math.pi, abs=2e-12)
        deviation = abs((abs(fold(x)) * math.copysign(1.0, fold(x)) - rest + math.pi) % (2 * math.pi) - math.pi)
        assert shell.energy(x) == pytest.approx(weight * deviation**2, rel=1e-9)
        assert np.isfinite(shell.force(x)).all()
        assert np.isfinite(dense(shell)(x)).all()
    exactly = opened(0.0, other=0.8)
    exactly[3] = exactly[2]
    assert np.isfinite(shell.force(exactly)).all()
    assert np.isfinite(dense(shell)(exactly)).all()


@pytest.mark.parametrize("height", [1e-2, 1e-6, 1e-12, 1e-30, 1e-100])
def test_a_nearly_collapsed_triangle_gives_the_closed_form(height):
    shell, weight = hinge_at(0.0)
    x = opened(1.0, apex=height)
    own = -2.0 * weight * fold(x) * gradient(x)
    assert fold(x) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(shell.force(x), own, rtol=1e-9, atol=1e-9 * np.abs(own).max())


COLLAPSED = {
    "an apex on the edge": lambda x: x.__setitem__(2, (0.3, 0.0, 0.0)),
    "an apex on an end": lambda x: x.__setitem__(2, x[0]),
    "an edge without length": lambda x: x.__setitem__(1, x[0]),
    "all at one point": lambda x: x.__setitem__(slice(None), 0.0),
    "too flat for its square": lambda x: x.__setitem__(2, (0.3, 1e-170, 0.0)),
}


@pytest.mark.parametrize("fault", COLLAPSED)
def test_a_collapsed_triangle_is_named(fault):
    shell, _ = hinge_at(0.2)
    x = opened(0.2)
    COLLAPSED[fault](x)
    for f in (shell.force, shell.stiffness):
        with pytest.raises(
            LoadError, match=r"flattest triangle is 0, vertices \[0, 1, 2\].*move its corners apart"
        ) as caught:
            f(x)
        assert isinstance(caught.value, ModalShellError)


def test_statics_from_a_collapsed_start_say_so_or_recover():
    """No NaN in silence: positions are finite, or the status is not that of an equilibrium."""
    shell = cantilever((6, 2))
    start = shell.mesh.vertices.copy()
    start[shell.free[-1]] = start[shell.free[-2]]
    state = DiscreteShell(shell).equilibrium(gravity=(0, 0, -1.0), start=start)
    assert np.isfinite(state.positions).all()
    assert not state.converged or state.residual < 1e-6
