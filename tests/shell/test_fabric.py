"""Fabrics: membrane and bending apart, against an orthotropic sheet, cylinders and derivatives."""

import numpy as np
import pytest
from scenes import jittered

import modalshell as ms

DENIM = {"stretch": (2000.0, 1500.0, 300.0), "bending": (64e-6, 97e-6, 33e-6), "density": 0.324}


def test_a_fabric_with_the_matrices_of_an_orthotropic_sheet_is_that_sheet():
    mesh = jittered((10, 8), 0.5, 0.4)
    thickness, first, second, poisson, shear = 2e-3, 1e8, 2e7, 0.3, 1.5e7
    wood = ms.Orthotropic(
        young=(first, second), shear=shear, poisson=poisson, thickness=thickness, density=500.0, direction=20.0
    )
    ratio = 1.0 - poisson**2 * second / first
    plane = np.array([first / ratio, second / ratio, shear, poisson * second / ratio])
    cloth = ms.Fabric(
        stretch=tuple(thickness * plane),
        bending=tuple(thickness**3 / 12.0 * plane),
        density=500.0 * thickness,
        direction=20.0,
    )
    x = mesh.vertices + 1e-3 * np.random.default_rng(1).normal(size=mesh.vertices.shape)
    one, other = (ms.Shell(mesh, sheet, clamped="x < 1e-6") for sheet in (wood, cloth))
    assert other.energy(x) == pytest.approx(one.energy(x), rel=1e-12)
    np.testing.assert_allclose(other.force(x), one.force(x), atol=1e-12 * np.abs(one.force(x)).max())
    np.testing.assert_allclose(other.mass, one.mass, rtol=1e-14)
    np.testing.assert_allclose(other.fields(x).moment, one.fields(x).moment, atol=1e-12)
    assert other.fields(x).von_mises is None
    with pytest.raises(ms.OptionError, match="von_mises needs a sheet with a thickness"):
        other.fields(x).values("von_mises")


@pytest.mark.by_default("0.0", "20.0")
@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0, 90.0])
def test_a_cylinder_has_the_stiffness_of_its_direction(angle):
    """Bent about the y axis, the warp at an angle to x: the energy per area is B(angle) / (2 R^2)."""
    mesh, radius = jittered((16, 12), 0.5, 0.4), 4.0
    shell = ms.Shell(mesh, ms.Fabric(**DENIM, direction=angle))
    turned = mesh.vertices[:, 0] / radius
    x = np.column_stack([radius * np.sin(turned), mesh.vertices[:, 1], radius * (np.cos(turned) - 1.0)])
    first, second, twist = DENIM["bending"]
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    stiffness = first * c**4 + second * s**4 + 4.0 * twist * (c * s) ** 2
    fields = shell.fields(x)
    # Inside: at free edges the sheet curls.
    inside = np.abs(mesh.vertices[mesh.faces].mean(axis=1) - [0.25, 0.0, 0.0]).max(axis=1) < 0.12
    along = fields.principal("curvature")[0][inside]
    np.testing.assert_allclose(along[:, 0], 1.0 / radius, rtol=0.03)
    density = shell.with_material(ms.Fabric(**DENIM | {"stretch": (1e-9,) * 3}, direction=angle)).fields(x)
    assert density.energy_density[inside].mean() == pytest.approx(0.5 * stiffness / radius**2, rel=0.01)


@pytest.mark.by_default("bending_3", "direction")
@pytest.mark.parametrize("name", ["stretch_1", "bending_1", "bending_3", "direction"])
def test_sensitivities_are_the_derivatives_of_equilibria(name):
    mesh = jittered((5, 2), 0.2, 0.06)
    sheet = ms.Fabric(stretch=(200.0, 150.0, 30.0), bending=(6e-4, 9e-4, 3e-4), density=0.3, direction=25.0)
    gravity = (0.0, 0.0, -3.0)
    model = ms.DiscreteShell(ms.Shell(mesh, sheet, clamped="x < 1e-6"))
    state = model.equilibrium(gravity=gravity)
    slope, value, remainders = model.sensitivity(state, wrt=name)[:, :, 0], sheet.constants[name], []
    for step in (0.02 * value, 0.01 * value):
        other = ms.DiscreteShell(ms.Shell(mesh, sheet.with_constants({name: value + step}), clamped="x < 1e-6"))
        moved = other.equilibrium(gravity=gravity, start=state.positions).positions
        remainders.append(np.linalg.norm(moved - state.positions - step * slope))
    assert np.log2(remainders[0] / remainders[1]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.slow
def test_a_fabric_falls_over_an_edge_and_comes_to_rest():
    """In motion, damped, it ends where its statics ends."""
    mesh = ms.flat_beam(length=0.06, width=0.02, cells=(8, 2))
    sheet = ms.Fabric(**DENIM | {"stretch": (200.0, 150.0, 30.0)})
    shell = ms.Shell(mesh, sheet, clamped="x < 1e-6")
    model, gravity = ms.DiscreteShell(shell), (0.0, 0.0, -9.81)
    rest = model.equilibrium(gravity=gravity)
    run = ms.simulate(model, duration=2.0, dt=0.02, gravity=gravity, damping=(10.0, 2e-3))
    assert run.outcome == ms.Outcome.COMPLETED, run.message
    assert rest.converged
    np.testing.assert_allclose(run.positions[-1], rest.positions, atol=1e-5)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"stretch": (1.0, 2.0)}, "stretch must be three numbers"),
        ({"bending": (1.0, -2.0, 3.0)}, r"bending\[1\] must be positive"),
        ({"bending": (1.0, 2.0, 3.0, 1.5)}, "coupling"),
        ({"density": -1.0}, "density must be positive"),
        ({"direction": "warp"}, "direction must be"),
    ],
)
def test_what_is_no_fabric_is_refused(changes, match):
    with pytest.raises(ms.MaterialError, match=match):
        ms.Fabric(**DENIM | changes)
