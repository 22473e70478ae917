"""Error bars of answers under contacts: against the true error, the margin on motions that keep the gaps, and voids."""

import numpy as np
import pytest
import scipy.linalg

import modalshell as ms
from modalshell.contact import error_bar
from modalshell.shell import GAUSS_NEWTON

GRAVITY = (0.0, 0.0, -9.81)
FLOOR = ms.Contact(ms.Plane((0, 0, 1), -0.15))
ROLLER = ms.Contact(ms.Cylinder((0.6, -1, -0.25), (0.6, 1, -0.25), 0.2))
SHEET = {"young": 1e8, "poisson": 0.3, "thickness": 5e-3, "density": 100.0}


def strip(cells=(20, 4), *, own=True):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
    material = ms.Isotropic(**SHEET) if own else ms.Material.from_physical(mesh=mesh, **SHEET | {"poisson": 0.0})
    return ms.Shell(mesh, material, clamped="x < 1e-6" if own else "x < 0.101")


@pytest.fixture(scope="module", params=[True, False], ids=["theory", "springs and hinges"])
def shell(request):
    return strip(own=request.param)


@pytest.mark.slow
@pytest.mark.parametrize("contacts", [[FLOOR], [ROLLER], [FLOOR, ROLLER]], ids=["floor", "roller", "both"])
def test_bars_are_the_true_errors(shell, contacts):
    truth = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=contacts)
    assert truth.in_contact.any()
    basis, small = ms.solve_modes(shell, 8), strip((10, 2), own=isinstance(shell.material, ms.Isotropic))
    models = [ms.LinearModal(basis), ms.ModalWarping(basis), ms.RotationStrain(ms.solve_modes(shell, 3))]
    for model in [*models, ms.CoarseDiscreteShell(shell, small)]:
        state = model.equilibrium(gravity=GRAVITY, contacts=contacts, bar=True)
        error = ms.measure.displacement_error(state.positions, truth.positions, shell)
        assert state.bar.valid
        assert state.bar.displacement == pytest.approx(error, rel=0.02)
        assert ms.measure.displacement_error(state.bar.corrected, truth.positions, shell) < 0.02 * error
        again = ms.error_bar(model, state.positions, gravity=GRAVITY, contacts=contacts)
        assert again.displacement == state.bar.displacement
    own = ms.error_bar(shell, truth)
    assert own.displacement < 1e-6
    assert own.valid


@pytest.mark.by_default("roller")
@pytest.mark.parametrize("contacts", [[FLOOR], [ROLLER]], ids=["floor", "roller"])
def test_bars_of_numbers_are_those_of_discrete_shells(contacts):
    """They were refused."""
    shell = strip()
    truth = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=contacts)
    forces = shell.support_reactions(truth.positions, gravity=GRAVITY)
    held = np.linalg.norm(forces[0].sum(axis=0))
    tip = np.linalg.norm(truth.positions - shell.rest_positions, axis=1).max()
    wanted = {"tip": tip, "reactions": held, "von_mises": shell.fields(truth.positions).values("von_mises").max()}
    basis = ms.solve_modes(shell, 8)
    for model in (ms.ModalWarping(basis), ms.RotationStrain(basis)):
        answer = model.equilibrium(gravity=GRAVITY, contacts=contacts)
        bars = ms.quantity_bars(model, answer, tuple(wanted))
        middle = ms.quantity_bars(model, answer, {"middle": lambda x: x[:, 2].mean()})["middle"]
        assert middle.corrected == pytest.approx(truth.positions[:, 2].mean(), rel=1e-3)
        for name, right in wanted.items():
            assert bars[name].valid
            assert bars[name].corrected == pytest.approx(right, rel=1e-2)
            assert bars[name].error == pytest.approx(abs(bars[name].value / right - 1.0), abs=1e-2, rel=0.1)


@pytest.mark.parametrize("collider", [ms.Plane((0, 0, 1), -0.15), ms.Sphere((0.7, 0.0, -0.51), 0.5)])
def test_the_margin_is_that_on_motions_that_keep_the_gaps(collider):
    shell = strip((12, 2), own=False)
    contact = ms.Contact(collider)
    state = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=[contact])
    x, touches = state.positions, np.flatnonzero(state.in_contact)
    _, normals, curvatures = contact.gap(x)
    whole = shell.stiffness(x).toarray()
    elastic = shell.pattern.matrix(shell.energy_gradient_hessian(x, GAUSS_NEWTON)[2]).toarray()
    rows = np.zeros((touches.size, whole.shape[0]))
    for row, vertex in zip(rows, touches, strict=True):
        at = slice(3 * vertex, 3 * vertex + 3)
        row[at] = normals[vertex]
        whole[at, at] -= np.linalg.norm(state.contact_forces[vertex]) * curvatures[vertex]
    free = np.flatnonzero(np.repeat(shell.mesh.vertices[:, 0] > 0.101, 3))
    basis = scipy.linalg.null_space(rows[:, free])
    parts = (basis.T @ matrix[np.ix_(free, free)] @ basis for matrix in (whole, elastic))
    lowest = scipy.linalg.eigh(*parts, eigvals_only=True)[0]
    assert ms.error_bar(shell, state).margin == pytest.approx(lowest, rel=0.01, abs=0.05 * abs(1.0 - lowest))


def arch():
    """A shallow arch, its ends held, and a ball under a quarter of it."""
    flat = ms.flat_beam(length=1.0, width=0.1, cells=(24, 2))
    x, y, _ = flat.vertices.T
    mesh = ms.TriangleMesh(np.stack([x, y, 0.06 * np.sin(np.pi * x)], axis=1), flat.faces)
    shell = ms.Shell(mesh, ms.Isotropic(**SHEET), clamped="x < 1e-6 or x > 1 - 1e-6")
    ball = ms.Contact(ms.Sphere((0.25, 0.0, 0.06 * np.sin(np.pi / 4) - 0.1), 0.1), push_out=1.0)
    return shell, ball


@pytest.mark.slow
def test_a_bar_is_void_next_to_a_snap_over_a_ball():
    shell, ball = arch()
    model, x, states = ms.DiscreteShell(shell), None, []
    for g in np.arange(4.0, 100.0, 4.0):
        state = model.equilibrium(gravity=(0, 0, -g), contacts=[ball], start=x)
        assert state.converged
        if x is not None and np.abs(state.positions - x).max() > 0.06:
            break
        x = state.positions
        states.append(state)
    bars = [ms.error_bar(shell, state) for state in states]
    assert states[0].in_contact.any()
    assert bars[0].valid
    assert bars[0].margin > 0.7
    assert len(states) < 24  # it snapped
    assert bars[-1].margin < 0.4
    past = ms.error_bar(shell, states[-1].positions, gravity=(0, 0, -1.5 * g), contacts=[ball])
    assert not (past.valid and past.displacement < 0.1)


@pytest.mark.by_default("springs and hinges")
def test_bars_that_cannot_be_are_refused_or_void_by_name(shell):
    state = ms.DiscreteShell(shell).equilibrium(gravity=GRAVITY, contacts=[FLOOR])
    rough = ms.Contact(FLOOR.collider, friction=0.2)
    with pytest.raises(ms.OptionError, match="error bars take contacts without friction"):
        ms.error_bar(shell, state.positions, gravity=GRAVITY, contacts=[rough])
    with pytest.raises(ms.OptionError, match="the equilibrium knows its contacts"):
        ms.error_bar(shell, state, contacts=[FLOOR])
    with pytest.raises(ms.OptionError, match='take on="shell"'):
        ms.error_bar(shell, state, on=strip((10, 2)))
    with pytest.raises(ms.OptionError, match='take on="shell"'):
        ms.simulate(ms.DiscreteShell(shell), duration=0.1, bars=(2, strip((10, 2))), contacts=[FLOOR])
    with pytest.raises(ms.OptionError, match="an error bar under self-contact is not known"):
        ms.simulate(ms.DiscreteShell(shell), duration=0.1, bars=2, contacts=[ms.SelfContact(gap=1e-3)])
    with pytest.raises(ms.OptionError, match="under contacts a frequency has no bar"):
        ms.quantity_bars(ms.DiscreteShell(shell), state, ("frequency",))
    wild = shell.rest_positions + np.random.default_rng(0).normal(size=shell.rest_positions.shape)
    found = ms.error_bar(shell, wild, gravity=GRAVITY, contacts=[FLOOR])
    assert not found.valid or found.beyond


def test_a_bar_is_void_where_what_touches_does_not_settle(shell, monkeypatch):
    monkeypatch.setattr(error_bar, "_MOST", 2)
    found = ms.error_bar(shell, shell.rest_positions, gravity=GRAVITY, contacts=[FLOOR])
    assert not found.valid
    assert str(found) == "no error bar: what touches has not settled in 2 Newton steps"


@pytest.mark.slow
def test_bars_under_loads_that_change(shell):
    loads = [ms.Pressure(-6.0)]
    truth = ms.DiscreteShell(shell).equilibrium(loads=loads, contacts=[FLOOR])
    rough = ms.RotationStrain(ms.solve_modes(shell, 4)).equilibrium(loads=loads, contacts=[FLOOR], bar=True)
    error = ms.measure.displacement_error(rough.positions, truth.positions, shell)
    assert rough.bar.displacement == pytest.approx(error, rel=0.02)
