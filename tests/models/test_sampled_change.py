"""How a modal force changes by a sample of vertices or triangles: near the whole, of loads that all feel alike."""

from functools import cache

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.reduction.load_quadrature import LoadQuadrature
from modalshell.motion import Motion

MATERIALS = {
    "hinges": ms.Material(200.0, 200.0, 0.05, 0.2),
    "plate": ms.Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0),
}
KINDS = [ms.ModalWarping, ms.RotationStrain]
CELLS = (140, 8)


@cache
def basis_of(energy):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=CELLS)
    held = mesh.vertices[:, 0] < (1.5 / CELLS[0] if energy == "hinges" else 1e-9)
    return ms.solve_modes(ms.Shell(mesh, MATERIALS[energy], clamped=held), 6)


def gravity(basis, gamma):
    return np.array([0.0, 0.0, -gamma / ms.measure.gamma_per_gravity(basis.shell)])


def bent(model, random, turn):
    q = random.standard_normal(6) * [1.0, 0.3, 0.1, 0.1, 0.05, 0.03]
    return q * turn / model.largest_turn(q)


@pytest.mark.by_default("hinges-ModalWarping")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("energy", MATERIALS)
def test_a_sample_tells_most_of_the_change_and_what_it_misses_vanishes_with_it(energy, kind):
    model, random = kind(basis_of(energy)), np.random.default_rng(2)
    load = model.shell.gravity_force(gravity(model.basis, 10.0))
    for turn in (0.5, 1.5, 3.0):
        change_of = model.dead_force(load).change
        q, way = bent(model, random, turn), 0.1 * bent(model, random, turn)
        whole, off = model.modal_force(q, load), []
        for share in (1.0, 0.5, 0.25):
            near = q + share * way
            change = change_of(q, near, whole)
            exact = model.modal_force(near, load) - whole
            off.append(np.linalg.norm(change - exact))
            assert off[-1] < 0.4 * np.linalg.norm(exact)
        assert np.log2(off[0] / off[2]) / 2.0 == pytest.approx(1.0, abs=0.3)
        assert not change_of(q, q, whole).any()


@pytest.mark.by_default("RotationStrain")
@pytest.mark.parametrize("kind", KINDS)
def test_a_load_that_few_feel_and_a_small_shell_have_no_sample(kind):
    model = kind(basis_of("plate"))
    load = np.zeros_like(model.shell.rest_positions)
    load[np.argmax(model.shell.rest_positions.sum(axis=1)), 2] = 1.0  # a corner of the tip
    q = bent(model, np.random.default_rng(3), 0.5)
    force = model.dead_force(load)
    assert kind is ms.RotationStrain or force.change(q, 1.1 * q, force.at(q)) is None
    small = ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(8, 2)), MATERIALS["plate"], clamped=[0, 1, 2])
    few = kind(ms.solve_modes(small, 6))
    load = small.gravity_force((0.0, 0.0, -1.0))
    assert few.dead_force(load).change is None


@pytest.mark.by_default("hinges-RotationStrain")
@pytest.mark.parametrize(
    ("energy", "kind"),
    [("hinges", ms.RotationStrain), ("plate", ms.ModalWarping)],
    ids=["hinges-RotationStrain", "plate-ModalWarping"],
)
def test_a_strip_under_a_large_load_moves_as_by_whole_forces(energy, kind):
    """The second mode has 3.3 steps a period: with one force a step its motion would grow."""
    found, asked = [], []
    for sampled in (True, False):
        model = kind(basis_of(energy))
        whole = model.dead_force

        def told(load, whole=whole, sampled=sampled):
            def change(*at):
                asked.append(sampled)
                return force.change(*at) if sampled else None

            force = whole(load)
            return force._replace(change=change, step=None)

        model.dead_force = told
        dt = 1.0 / (3.3 * model.basis.frequencies[1])
        run, energies = Motion(model, model.shell.loading(gravity(model.basis, 20.0)), dt=dt), []
        for _ in range(150):
            run.advance()
            energies.append(run.energies().sum())
        found.append((run.positions(), np.array(energies)))
    assert asked.count(True) > 100
    scale = np.ptp(found[1][1])
    assert np.abs(found[0][1] - found[1][1])[:30].max() < 0.05 * scale
    for _, energies in found:
        assert energies[75:].max() < energies[:75].max() + 0.1 * scale


@pytest.mark.by_default("great load, large sheet")
@pytest.mark.parametrize(
    ("consistent", "cells", "gamma"),  # a great load asks for a second force in every step
    [
        pytest.param(False, CELLS, 20.0, id="great load, large sheet"),
        pytest.param(True, CELLS, 1.0, id="small load, consistent force, large sheet"),
        pytest.param(False, (20, 4), 1.0, id="small load"),
        pytest.param(True, (20, 4), 20.0, id="great load, consistent force"),
    ],
)
def test_a_step_in_one_call_is_the_step_in_parts_bit_for_bit(cells, gamma, consistent):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
    basis = ms.solve_modes(ms.Shell(mesh, MATERIALS["plate"], clamped=mesh.vertices[:, 0] < 1e-9), 6)
    found = []
    for whole in (True, False):
        model = ms.ModalWarping(basis, consistent_force=consistent)
        if not whole:
            parts = model.dead_force
            model.dead_force = lambda load, parts=parts: parts(load)._replace(step=None)
        dt = 1.0 / (3.3 * basis.frequencies[1])
        run = Motion(model, model.shell.loading(gravity(basis, gamma)), dt=dt, damping=(0.5, 0.0))
        for _ in range(40):
            run.advance()
        found.append(run.snapshot())
    assert found[0].keys() == found[1].keys()
    for name, array in found[0].items():
        assert np.array_equal(array, found[1][name]), name


@pytest.mark.parametrize("consistent", [False, True])
def test_a_step_under_a_load_that_swings_is_the_step_in_parts_bit_for_bit(consistent, monkeypatch):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    basis = ms.solve_modes(ms.Shell(mesh, MATERIALS["plate"], clamped=mesh.vertices[:, 0] < 1e-9), 6)
    model, found, dead_force = ms.ModalWarping(basis, consistent_force=consistent), [], LoadQuadrature.dead_force
    weight = ms.Scaled(ms.SelfWeight(gravity(basis, 20.0)), lambda time: np.cos(time / dt))
    dt = 1.0 / (3.3 * basis.frequencies[1])
    for whole in (True, False):
        if not whole:
            monkeypatch.setattr(LoadQuadrature, "dead_force", lambda *args: dead_force(*args)._replace(step=None))
        run = Motion(model, model.shell.loading(loads=[weight]), dt=dt, damping=(0.5, 0.0))
        for _ in range(40):
            run.advance()
        found.append(run.snapshot())
    assert np.abs(found[0]["state_coordinates"]).max() > 0.0
    for name, array in found[0].items():
        assert np.array_equal(array, found[1][name]), name


@pytest.mark.slow
def test_a_force_reads_coordinates_however_they_lie_in_memory():
    model = ms.ModalWarping(basis_of("plate"))
    load = model.shell.gravity_force(gravity(model.basis, 10.0))
    many = np.stack([bent(model, np.random.default_rng(seed), 1.0) for seed in range(3)], axis=1)
    for k in range(3):
        np.testing.assert_array_equal(model.modal_force(many[:, k], load), model.modal_force(many[:, k].copy(), load))
    whole = np.zeros(6, dtype=np.int64)
    np.testing.assert_array_equal(model.modal_force(whole, load), model.modal_force(whole.astype(float), load))
    with pytest.raises(ms.OptionError, match="q must have"):
        model.modal_force(many[:4, 0], load)
    with pytest.raises(ms.OptionError, match="load must be"):
        model.modal_force(many[:, 0], load[:300])


@pytest.mark.parametrize("consistent", [False, True])
def test_loads_and_coordinates_of_other_sizes_are_refused(consistent):
    """Also those that fill the same registers."""
    shell = ms.Shell(ms.flat_beam(cells=(4, 2)), ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.26")
    model = ms.ModalWarping(ms.solve_modes(shell, 3), consistent_force=consistent)
    q, load = np.zeros(3), np.zeros((15, 3))
    assert (model.warped_force([0.0, 0.0, 0.0], load) == model.warped_force(q, load)).all()
    for wrong in ((q, load[:-1]), (q[:2], load), (q[:, None], load)):
        for call in (model.warped_force, model.warped_work):
            with pytest.raises(ms.OptionError, match="must"):
                call(*wrong)
