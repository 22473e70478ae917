"""Compiled error bars: those of sparse algebra, to rounding, wherever a shell is served."""

import numpy as np
import pytest
from numba import typeof

import modalshell as ms
from modalshell.models.coarse import profile_step
from modalshell.statics.error_bar import ErrorEstimator

HINGES = ms.Material(200.0, 200.0, 0.05, 0.2)
SHEET = ms.Isotropic(young=1e8, poisson=0.3, thickness=1e-3, density=200.0)


def fold(material, fold=150.0):
    return ms.Shell(ms.v_beam(length=1.0, width=0.2, fold=fold, cells=(8, 2)), material, "x < 0.13")


def panel(material):
    mesh = ms.cylinder_panel(cells=(6, 5))
    y = np.abs(mesh.vertices[:, 1])
    return ms.Shell(mesh, material, supports=[ms.Pin(y > y.max() - 1e-9)])


SHELLS = {
    "fold of hinges": lambda: fold(HINGES),
    "fold": lambda: fold(SHEET),
    "pinned panel of hinges": lambda: panel(HINGES),
    "pinned panel": lambda: panel(SHEET),
    "flat strip": lambda: fold(SHEET, 180.0),
}


@pytest.mark.by_default("pinned panel of hinges", "flat strip")
@pytest.mark.parametrize("kind", SHELLS)
def test_they_are_those_of_sparse_algebra(kind):
    """Eight states of each shell, moved by up to half its size; margins below the least that holds, too."""
    shell, rng, margins = SHELLS[kind](), np.random.default_rng(3), []
    basis = ms.solve_modes(shell, 6)
    sparse, quick = ErrorEstimator(shell), profile_step.quick_estimator(shell)
    model = ms.ModalWarping(basis)
    for share in np.geomspace(1e-3, 0.5, 8):
        q = rng.standard_normal(6) / basis.eigenvalues
        moved = model.raw_displacement(q)
        q *= share * shell.size / np.abs(moved).max()
        x = shell.rest_positions + model.raw_displacement(q)
        force = (shell.mass[:, None] * (basis.modes @ (basis.eigenvalues * q)).reshape(-1, 3)) * rng.uniform(0.7, 1.3)
        expected, found = sparse.bar(x, force), quick.bar(x, force)
        assert found.displacement == pytest.approx(expected.displacement, rel=1e-6)
        assert found.margin == pytest.approx(expected.margin, abs=1e-6 * (1.0 + abs(expected.margin)))
        assert found.corrected == pytest.approx(expected.corrected, abs=1e-8 * shell.size)
        assert quick._compiled(x - quick.origin, force) is not None  # nothing has stood in for it
        margins.append(found.margin)
    assert max(margins) > 0.3
    assert min(margins) < 0.3


@pytest.mark.by_default("pinned panel of hinges", "flat strip")
@pytest.mark.parametrize("kind", SHELLS)
def test_early_margins_are_near_and_small_ones_the_same(kind):
    """Shapes near those of DS, as a check of a good rung sees them, from far below a snap to beyond it."""
    shell, found = SHELLS[kind](), []
    basis, exactly, whole = ms.solve_modes(shell, 6), ms.DiscreteShell(shell), profile_step.quick_check(shell)
    early, origin = profile_step.quick_check(shell, early=True), ErrorEstimator(shell).origin
    for share in np.geomspace(1e-3, 0.3, 8):
        q = np.zeros(6)
        q[0] = share * shell.size / np.abs(basis.modes[:, 0]).max()
        force = shell.mass[:, None] * (basis.modes @ (basis.eigenvalues * q)).reshape(-1, 3)
        x = exactly.equilibrium(force=force).positions
        x += 0.003 * (x - shell.rest_positions)
        (one, exact), (other, near) = whole(x - origin, force), early(x - origin, force)
        assert other == pytest.approx(one, abs=1e-5 * np.abs(one - one[0]).max())  # iterations solve to 1e-3
        assert near == exact or near > 0.5
        assert 1.0 - near == pytest.approx(1.0 - exact, rel=0.1, abs=0.01)
        found.append(near == exact)
    assert not all(found)


def test_bits_do_not_depend_on_bars_before():
    shell = fold(SHEET)
    force = shell.gravity_force((0.0, 0.1, -0.5))
    bent = ms.RotationStrain(ms.solve_modes(shell, 6)).equilibrium(force=force).positions
    first, later = profile_step.quick_estimator(shell), profile_step.quick_estimator(shell)
    later.bar(np.array(shell.rest_positions), -2.0 * force)
    one, other = first.bar(bent, force), later.bar(bent, force)
    assert np.array_equal(one.corrected, other.corrected)
    assert (one.displacement, one.margin) == (other.displacement, other.margin)


def test_where_a_pivot_vanishes_or_supports_hold_single_directions_sparse_algebra_answers():
    shell = fold(HINGES)
    force = shell.gravity_force((0.0, 0.1, -0.5))
    crushed = np.zeros_like(shell.rest_positions)
    quick, sparse = profile_step.quick_estimator(shell), ErrorEstimator(shell)
    assert quick._compiled(crushed, force) is None
    assert quick.bar(crushed, force).message == sparse.bar(crushed, force).message != ""
    held = shell.also_supported([ms.Roller("x > 0.99", (1.0, 0.0, 0.0))])
    quick = profile_step.quick_estimator(held)
    assert quick._compiled is None
    x = np.array(held.rest_positions)
    assert quick.bar(x, force).margin == ErrorEstimator(held).bar(x, force).margin


@pytest.mark.parametrize("kind", ["fold of hinges", "fold"])
def test_compiled_steps_hand_kernels_what_a_shell_does(kind):
    """Of the same kinds, for each of which a kernel is compiled anew."""
    shell = SHELLS[kind]()
    elastic, (_, slots) = (
        profile_step.profile_step(shell)._body.record.elastic,
        shell.elastic_energy.pattern(shell.unknowns),
    )
    if kind == "fold":
        assert typeof(elastic.slots) == typeof(slots[1])
        return
    for own, elements, place in zip(elastic, shell.elements, slots, strict=True):
        assert [typeof(own.stencils), typeof(own.slots)] == [typeof(elements.stencils), typeof(place)]
