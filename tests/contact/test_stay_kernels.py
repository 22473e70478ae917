"""A step of a modal shell whose contacts stay is the same in one compiled call as in its parts."""

import importlib

import numpy as np
import pytest

import modalshell as ms
from modalshell.motion.stepping import Motion

STAYING = importlib.import_module("modalshell.models.base.staying")


@pytest.fixture(scope="module")
def basis():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(20, 4))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    return ms.solve_modes(ms.Shell(mesh, sheet, clamped="x < 1e-6"), 8)


@pytest.mark.parametrize("body", [ms.Plane((0.0, 0.0, 1.0), -0.1), ms.Sphere((0.7, 0.0, -0.6), 0.5)], ids=type)
@pytest.mark.parametrize("key", ["lma", "mwts", "mwts-consistent"])
def test_a_step_in_one_call_is_that_of_its_parts(monkeypatch, basis, key, body):
    model, found = ms.models()[key].builder(basis), []
    whole = STAYING.stay_whole
    monkeypatch.setattr(STAYING, "stay_whole", lambda *given: found.append(whole(*given)) or found[-1])
    loading, contacts = model.shell.loading((0.0, 0.0, -9.81), None, None), [ms.Contact(body)]
    one, parts = (Motion(model, loading, dt=1 / 120, damping=(1.0, 0.0), contacts=contacts) for _ in range(2))
    for _ in range(90):
        one.advance()
        before = len(found)
        parts.advance()
        assert len(found) == before or parts.count == 1
        parts.stepper._dead = parts.stepper._dead._replace(push=None)  # which one call needs
        np.testing.assert_allclose(one.positions(), parts.positions(), rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(one.energies(), parts.energies(), rtol=0.0, atol=1e-9)
    stays = [end[0] == STAYING.STAYS for end in found]
    assert np.count_nonzero(stays) > 20
    assert one.unconverged == 0


def test_given_back_is_what_was_gained():
    """Slower rates have as much less kinetic energy; of much too much nothing is given back."""
    given_back = STAYING.given_back
    before = 1.0, 2.0, 0.5
    assert given_back(before, before, 0.0) == 1.0
    slower = given_back((1.004, 2.0, 0.5), before, 0.001)
    assert 1.004 * slower**2 == pytest.approx(1.001, rel=1e-12)
    assert given_back((1.1, 2.0, 0.5), before, 0.0) == 0.0
