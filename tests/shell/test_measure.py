import numpy as np
import pytest

import modalshell as ms


def test_error_of_a_scaled_displacement_is_the_scale():
    mesh = ms.flat_beam(cells=(6, 2))
    rng = np.random.default_rng(0)
    reference = mesh.vertices + 0.1 * rng.standard_normal(mesh.vertices.shape)
    answer = mesh.vertices + 1.25 * (reference - mesh.vertices)
    shell = ms.Shell(mesh, ms.Material(1.0, 1.0, 1.0, 1.0))
    for shape in (mesh, shell):
        assert ms.measure.displacement_error(answer, reference, shape) == pytest.approx(0.25, rel=1e-12)
        assert ms.measure.displacement_error(answer, reference, shape, weighted=False) == pytest.approx(0.25, rel=1e-12)


def test_weights_are_the_masses():
    mesh = ms.flat_beam(cells=(6, 2))
    density = np.linspace(1.0, 5.0, len(mesh.faces))
    shell = ms.Shell(mesh, ms.Material(1.0, 1.0, 1.0, density))
    reference = mesh.vertices + np.array([0.0, 0.0, 1.0])
    answer = reference.copy()
    answer[4, 2] += 0.5
    expected = 0.5 * np.sqrt(shell.mass[4] / shell.mass.sum())
    assert ms.measure.displacement_error(answer, reference, shell) == pytest.approx(expected, rel=1e-12)


def test_area_change():
    mesh = ms.v_beam(cells=(6, 2))
    assert ms.measure.area_change(mesh.vertices, mesh) == pytest.approx(0.0, abs=1e-14)
    assert ms.measure.area_change(1.1 * mesh.vertices, mesh) == pytest.approx(0.21, rel=1e-12)


def test_refusals():
    mesh = ms.flat_beam(cells=(6, 2))
    with pytest.raises(ms.OptionError, match="does not move"):
        ms.measure.displacement_error(mesh.vertices + 1.0, mesh.vertices, mesh)
    with pytest.raises(ms.LoadError, match="shape"):
        ms.measure.displacement_error(mesh.vertices[:-1], mesh.vertices, mesh)
    bad = mesh.vertices.copy()
    bad[3, 1] = np.nan
    with pytest.raises(ms.LoadError, match="entry 3"):
        ms.measure.area_change(bad, mesh)


def test_gamma_is_eight_times_the_linear_drop(v_shell):
    gravity = 1e-4
    answer = ms.DiscreteShell(v_shell).equilibrium(gravity=(0, 0, -gravity))
    x, drop = v_shell.rest_positions[:, 0], v_shell.rest_positions[:, 2] - answer.positions[:, 2]
    expected = 8.0 * drop[x == x.max()].mean() / (1.0 - x[v_shell.clamped].max())
    assert ms.measure.gamma_per_gravity(v_shell) * gravity == pytest.approx(expected, rel=1e-4)


def test_gamma_is_the_drop_of_the_last_row_at_any_size():
    """Of graphene all vertices within a nanometre were the end."""
    size = 1e-8
    mesh = ms.flat_beam(length=size, width=0.2 * size, cells=(20, 4))
    strip = ms.Shell(mesh, ms.Isotropic(1e9, 0.0, 1e-3 * size, 1000.0), mesh.vertices[:, 0] < 1e-3 * size)
    assert ms.measure.gamma_per_gravity(strip) == pytest.approx(12.0 * 1000.0 * size / (1e9 * 1e-6), rel=0.01)


@pytest.mark.parametrize("clamped_from", [0.9, 2.0])
def test_gamma_needs_a_clamped_and_a_free_end(v_shell, clamped_from):
    clamped = v_shell.rest_positions[:, 0] > clamped_from
    with pytest.raises(ms.OptionError, match="free at its largest x"):
        ms.measure.gamma_per_gravity(ms.Shell(v_shell.mesh, v_shell.material, clamped))
