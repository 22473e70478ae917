"""Energies with what damping takes in a step: quadratic forms of the changes of measures."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.shell import EXACT
from modalshell.shell.elements import ENERGIES, ElementSet, Energy
from modalshell.shell.kernels.generated import shear


@dataclass(frozen=True)
class Struts(Energy, key="struts"):
    """Springs along some edges, with dashpots."""

    def elements(self, mesh):
        edges = mesh.edges[::5]
        found = ElementSet.at_rest("struts", shear, mesh, edges, np.full(len(edges), 30.0))
        return replace(found, viscosity=np.full(len(edges), 0.5))


ENERGIES.pop("struts")  # of these tests alone
FACTOR, DT = 0.02, 0.005
KINDS = ["hinges", "dashpots", "sheet", "mirrored", "laminate"]


def shell_of(kind):
    mesh = ms.v_beam(length=1.0, width=0.4, fold=150.0, cells=(5, 4))
    sheet = ms.Isotropic(young=1e6, poisson=0.3, thickness=5e-3, density=300.0)
    if kind == "hinges":
        return ms.Shell(mesh, ms.Material(2e3, 1e3, 0.05, 0.5), "x < 0.01")
    if kind == "dashpots":
        material = ms.Material(2e3, 1e3, 0.05, 0.5)
        shell = ms.Shell(mesh, material, "x < 0.01")
        return shell.with_elements([replace(e, viscosity=0.01 * e.weight) for e in shell.elements])
    if kind == "mirrored":
        plate = ms.sheet(length=1.0, width=0.5, cells=(5, 4))
        return ms.Shell(plate, sheet, supports=[ms.Symmetry("x < 1e-6", (1.0, 0.0, 0.0)), ms.Pin("x > 0.999")])
    if kind == "laminate":
        plies = [ms.Ply(ms.Isotropic(1e6, 0.3, 2e-3, 300.0), 0.0, 2e-3)] * 2
        return ms.Shell(mesh, ms.Laminate(plies), "x < 0.01", energies=[Struts()])
    return ms.Shell(mesh, sheet, "x < 0.01")


@pytest.fixture(params=KINDS)
def shell(request):
    return shell_of(request.param)


@pytest.fixture
def bent(shell):
    x = np.array(shell.rest_positions)
    rng = np.random.default_rng(3)
    return x + [0.0, 0.0, 0.2] * np.sin(3.0 * x[:, :1]) + 0.004 * rng.standard_normal(x.shape)


def resisted(shell, x, begun):
    """Potential [J] of the damping but for a constant, and its gradient [N], in a step that ends at x."""
    damped = shell.damped(begun, FACTOR, DT)
    assert damped.undamped is shell
    (value, gradient), (own, elastic) = damped.energy_gradient(x), shell.energy_gradient(x)
    return value - own, gradient - elastic


def test_from_where_a_step_begins_it_is_the_viscous_matrix_to_second_order(shell, bent):
    way = 0.01 * np.random.default_rng(4).standard_normal(bent.shape)
    off = []
    for size in (1e-2, 5e-3):
        exact = -shell.damping_force(bent, size * way, FACTOR) / DT
        gradient = resisted(shell, bent + size * way, shell.changes(bent))[1]
        off.append(np.abs(gradient - exact).max() / np.abs(exact).max())
    assert off[0] < 0.05
    assert off[0] / off[1] == pytest.approx(2.0, abs=0.3)


@pytest.mark.by_default("hinges", "dashpots")
def test_nothing_resists_a_rigid_motion(shell, bent):
    shell = ms.Shell(shell.mesh, shell.material)
    turned = Rotation.from_rotvec([0.4, -1.9, 0.8]).apply(bent)
    begun = shell.changes(bent)
    (still, force), (value, other) = (resisted(shell, x, begun) for x in (bent, turned))
    scale = np.abs(shell.damping_force(bent, bent, FACTOR)).max() / DT
    assert max(np.abs(force).max(), np.abs(other).max()) < 1e-9 * scale
    assert value == pytest.approx(still, abs=1e-9 * scale)


def test_what_damping_takes_is_least_where_measures_stay(shell, bent):
    begun, rng = shell.changes(bent), np.random.default_rng(5)
    least = resisted(shell, bent, begun)[0]
    for size in (1e-4, 1e-2, 0.1):
        assert resisted(shell, bent + size * rng.standard_normal(bent.shape), begun)[0] > least


def test_its_derivatives_are_those_of_its_energy(shell, bent):
    begun = [0.5 * change for change in shell.changes(bent)]
    damped, way = shell.damped(begun, FACTOR, DT), 0.01 * np.random.default_rng(6).standard_normal(bent.shape)
    (value, gradient, data), sizes = damped.energy_gradient_hessian(bent, EXACT), (1e-2, 5e-3, 2.5e-3)
    slope, curvature = float(np.sum(gradient * way)), float(way.ravel() @ damped.pattern.product(data, way.ravel()))
    left = [
        abs(damped.elastic_energy.energy(bent + s * way) - value - s * slope - 0.5 * s**2 * curvature) for s in sizes
    ]
    assert np.polyfit(np.log(sizes), np.log(left), 1)[0] == pytest.approx(3.0, abs=0.2)


def test_creases_keep_their_folds_in_a_damped_shell():
    mesh = ms.v_beam(length=1.0, width=0.4, fold=150.0, cells=(5, 4))
    sheet = ms.Isotropic(young=1e6, poisson=0.3, thickness=5e-3, density=300.0)
    shell = ms.Shell(mesh, sheet, "x < 0.01", creases=[ms.Crease("abs(y) < 1e-6", 1e-3)])
    x, folds = np.array(shell.rest_positions), np.full(shell.crease_state.angles.size, 0.2)
    begun = shell.changes(x)
    creased = shell.damped(begun, FACTOR, DT).creased(folds)
    np.testing.assert_allclose(
        creased.energy_gradient(x)[1] - shell.creased(folds).energy_gradient(x)[1],
        resisted(shell, x, begun)[1],
        atol=1e-9 * np.abs(creased.energy_gradient(x)[1]).max(),
    )


@pytest.mark.parametrize("folds", [(1.0, 1.2), (3.1, 3.2), (-3.0, -3.3)])
def test_plastic_folds_that_come_to_half_a_turn_are_no_jump_for_damping(folds):
    """Their jump by a whole turn pulled damped creases the wrong way, by twenty times the couple."""
    before, after = folds
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, -0.8, 0.0], [0.6, 0.7, 0.0]]
    mesh = ms.TriangleMesh(np.array(corners), [[0, 1, 3], [1, 0, 2]])
    sheet = ms.Material(stretch=1e5, shear=1e3, flexure=0.05, density=1.0)
    shell = ms.Shell(mesh, sheet, [0, 1, 2], creases=[ms.Crease([[0, 1]], 0.02)])

    def turned(angle):
        return np.vstack([corners[:3], [0.6, 0.7 * np.cos(angle), -0.7 * np.sin(angle)]])

    own = shell.creased(np.array([before]))
    damped = own.damped(own.changes(turned(before + 0.05)), FACTOR, DT).creased(np.array([after]))
    hinges = shell.creases.hinges
    (stiffness,), couple = shell.elastic_energy.fold_stiffness(hinges)[0], before + 0.2 - after
    couple += FACTOR / DT * (0.2 - 0.05)
    found = damped.elastic_energy.fold_couples(turned(before + 0.2), hinges)[0]
    assert found == pytest.approx(stiffness * couple, rel=1e-6)
