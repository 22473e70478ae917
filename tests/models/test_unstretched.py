"""Modal models that do not stretch say so where supports hold opposite ends and the answer's arcs grow longer."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.base.unstretched import HeldEnds

MODELS = [ms.ModalWarping, ms.RotationStrain]
SAID = "does not stretch, and supports hold opposite ends"


def strip(supports, fold=None):
    sizes = {"length": 1.0, "width": 0.1}
    mesh = ms.flat_beam(**sizes, cells=(20, 2)) if fold is None else ms.v_beam(**sizes, fold=fold, cells=(20, 4))
    return ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 1e-3, 1000.0), supports=supports)


BOTH = [ms.Clamp("x < 0.06"), ms.Clamp("x > 0.94")]


@pytest.mark.by_default("RotationStrain")
@pytest.mark.parametrize("model", MODELS)
def test_it_is_said_where_ds_is_a_tenth_stiffer_and_not_before(model):
    shell = strip(BOTH)
    modal, truth = model(ms.solve_modes(shell, 6)), ms.DiscreteShell(shell)
    said = []
    for gravity in (0.001, 0.005, 0.01, 0.05, 0.2, 1.0):
        answer, exact = (one.equilibrium(gravity=(0, 0, -gravity)) for one in (modal, truth))
        moved = [np.abs(one.positions - shell.rest_positions).max() for one in (answer, exact)]
        said.append(SAID in answer.message)
        assert said[-1] if moved[0] > 1.25 * moved[1] else moved[0] > 1.08 * moved[1] or not said[-1]
    assert said[0] is False
    assert said[-1] is True


@pytest.mark.parametrize("model", MODELS)
def test_motions_say_from_when_on(model):
    """A strip held at both ends whose amplitude is 0.87 thicknesses: the model's frequency is that of small motion."""
    shell = strip(BOTH)
    basis = ms.solve_modes(shell, 1)
    shape = basis.modes[:, 0].reshape(-1, 3)
    start = shell.rest_positions + 0.87e-3 * shape / np.abs(shape).max()
    assert SAID in ms.simulate(model(basis), duration=0.1, dt=0.01, start=start).message
    small = shell.rest_positions + 0.1e-3 * shape / np.abs(shape).max()
    assert SAID not in ms.simulate(model(basis), duration=0.1, dt=0.01, start=small).message
    pushed = ms.simulate(model(basis), duration=0.5, dt=0.01, gravity=(0, 0, -0.05)).message
    assert "s on" in pushed
    assert SAID in pushed


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "supports",
    [
        BOTH[:1],
        [BOTH[0], ms.Fix("x > 0.94", axes="yz")],  # its end slides
        [ms.Symmetry("x < 0.001", normal=(1, 0, 0)), ms.Fix("x > 0.94", axes="z"), ms.Fix("y < -0.04", axes="y")],
    ],
)
def test_nothing_is_said_where_an_end_is_free_to_come(model, supports):
    shell = strip(supports)
    answer = model(ms.solve_modes(shell, 6)).equilibrium(gravity=(0, 0, -2.0))
    assert SAID not in answer.message


@pytest.mark.by_default("ModalWarping")
@pytest.mark.parametrize("model", MODELS)
def test_quarters_by_symmetry_and_plates_held_all_round_are_seen(model):
    half = strip([ms.Symmetry("x > 0.999", normal=(1, 0, 0)), ms.Clamp("x < 0.06")])
    mesh = ms.flat_beam(length=1.0, width=1.0, cells=(8, 8))
    plate = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 1e-3, 1000.0), clamped=mesh.boundary_vertices)
    for shell in (half, plate, strip(BOTH, fold=150.0)):
        basis = ms.solve_modes(shell, 4)
        q = np.zeros(4)
        q[0] = 5e-3 / np.abs(basis.modes[:, 0]).max()
        modal = model(basis)
        run = ms.simulate(modal, duration=0.02, dt=0.01, start=shell.rest_positions + modal.raw_displacement(q))
        assert SAID in run.message


def test_a_linear_strain_of_the_modes_is_not_counted():
    """The modes' own stretch is in their energy."""
    shell = strip(BOTH)
    basis = ms.solve_modes(shell, 60)
    along = int(np.argmax([np.sum(mode.reshape(-1, 3)[:, 0] ** 2) for mode in basis.modes.T]))
    mode = basis.modes[:, along].reshape(-1, 3)
    assert np.abs(mode[:, 0]).max() > 10.0 * np.abs(mode[:, 2]).max()
    start = shell.rest_positions + 1e-4 * mode / np.abs(mode).max()
    assert SAID not in ms.simulate(ms.ModalWarping(basis), duration=0.02, dt=0.01, start=start).message


def test_a_motion_that_diverges_is_no_overflow():
    """The energy of a stretch goes as the fourth power of coordinates, beyond all numbers where these diverge."""
    shell = strip(BOTH)
    ends = HeldEnds.of(ms.solve_modes(shell, 4))
    assert ends is not None
    with np.errstate(over="ignore"):
        assert ends.missed(np.full(4, 1e100))
