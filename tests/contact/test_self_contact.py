"""Self-contact: the barrier's derivatives, folds that rest, layers in motion, and what is refused."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact.layered import LayeredEnergy, Patterns
from modalshell.contact.layers import Layers
from modalshell.contact.self_contact import SelfContact
from modalshell.motion.stepping import Motion
from modalshell.shell import EXACT

ipctk = pytest.importorskip("ipctk", reason="ipctk is not installed (pip install 'modalshell[contact]')")


def folded(cells=(12, 8), fold=60.0, **sheet):
    """A sheet folded along x, one flange held, the other one drawn towards it by gravity along y."""
    mesh = ms.v_beam(length=0.6, width=0.6, fold=fold, cells=cells)
    material = ms.Isotropic(**{"young": 1e6, "poisson": 0.3, "thickness": 2e-3, "density": 500.0} | sheet)
    return ms.Shell(mesh, material, clamped=mesh.vertices[:, 1] > -1e-9)


PULL = (0.0, 3.0, 0.0)


def crossing_free(shell, x):
    """Whether no edge crosses a triangle, by ipctk's own test on the whole mesh."""
    edges, faces = (np.asfortranarray(part, np.int32) for part in (shell.mesh.edges, shell.mesh.faces))
    mesh = ipctk.CollisionMesh(np.asfortranarray(shell.rest_positions), edges, faces)
    return not ipctk.has_intersections(mesh, np.asfortranarray(x))


def two_sheets(distance, cells=(8, 4), shift=0.0):
    """Two flat sheets of one mesh, one above the other, the lower one held."""
    one = ms.flat_beam(length=0.5, width=0.25, cells=cells)
    upper = one.vertices + np.array([shift, 0.0, distance])
    faces = np.concatenate([one.faces, one.faces + len(one.vertices)])
    mesh = ms.TriangleMesh(np.concatenate([one.vertices, upper]), faces)
    return ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 2e-3, 500.0), clamped=np.arange(2 * len(one.vertices)) < len(upper))


@pytest.fixture(scope="module")
def rest():
    """A fold at rest on itself."""
    shell = folded()
    return shell, ms.DiscreteShell(shell).equilibrium(gravity=PULL, contacts=[ms.SelfContact()])


def test_the_pattern_of_pairs_is_kept_as_long_as_it_holds_them(monkeypatch):
    grown, grow = [], Patterns._grow
    monkeypatch.setattr(Patterns, "_grow", lambda self, *given: grown.append(1) or grow(self, *given))
    assert ms.DiscreteShell(folded()).equilibrium(gravity=PULL, contacts=[ms.SelfContact()]).converged
    assert len(grown) == 1


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_derivatives_by_taylor_slopes(rest, friction):
    shell, answer = rest
    origin = ms.DiscreteShell(shell).centred()[1]
    problem, _ = ms.DiscreteShell(shell).problem(shell.loading(PULL, None, None))
    layers = Layers(SelfContact(friction=friction), problem.shell).stiff(20.0)
    random = np.random.default_rng(3)
    # Meshes of both flanges that lie on each other are where pairs change what is nearest in them.
    x = answer.positions - origin + 5e-4 * random.standard_normal(answer.positions.shape)
    layers = layers.rubbed(x - 1e-5, 0.01, 0.01)
    layered = replace(problem, further=LayeredEnergy(layers, Patterns(None)))
    way = random.standard_normal(problem.push.size)
    full = problem.shell.unknowns.prolong(way).reshape(-1, 3)
    value, gradient = layered.potential(x)
    same, hessian = layered.linearise(x, EXACT)
    assert np.abs(same - gradient).max() <= 1e-12 * np.abs(gradient).max()
    count = gradient.size
    turned = hessian @ np.concatenate([way, np.zeros(hessian.shape[0] - count)])
    plain = problem.linearise(x, EXACT)[1] @ np.concatenate([way, np.zeros(hessian.shape[0] - count)])
    steps = 4e-7 * 0.5 ** np.arange(3)
    first = [layered.potential(x + h * full)[0] - value - h * gradient @ way for h in steps]
    assert np.allclose(np.log2(np.array(first[:-1]) / first[1:]), 2.0, atol=0.2)
    second = [
        np.linalg.norm(
            problem.shell.unknowns.restrict((layers.gradient(x + h * full) - layers.gradient(x)).ravel())
            - h * (turned - plain)[:count]
        )
        for h in steps
    ]
    assert np.allclose(np.log2(np.array(second[:-1]) / second[1:]), 2.0, atol=0.3)


def test_a_fold_rests_on_itself(rest):
    shell, answer = rest
    assert answer.converged
    assert answer.stable
    free = ms.DiscreteShell(shell).equilibrium(gravity=PULL)
    held = answer.positions[shell.clamped]
    across = np.linalg.svd(held - held.mean(axis=0))[2][2]  # the normal of the held flange

    def side(x):
        far = np.argsort(-np.abs(shell.rest_positions @ across))[:20]  # of the free one, away from the fold
        return np.sign(x[far] @ across)

    assert (side(answer.positions) == side(shell.rest_positions)).all()
    assert (side(free.positions) != side(shell.rest_positions)).all()  # it is contact that keeps them apart
    assert crossing_free(shell, answer.positions)
    assert 1e-4 < answer.self_contact < Layers(SelfContact(), shell).gap
    assert answer.in_contact.sum() > 20
    # What one layer does to the other comes back; on the free one it and the supports bear the weight.
    assert np.abs(answer.contact_forces.sum(axis=0)).max() <= 1e-12 * np.abs(answer.contact_forces).sum()
    assert np.abs(answer.contact_forces[~answer.in_contact]).max() == 0.0
    left = shell.energy_gradient(answer.positions)[1] - shell.mass[:, None] * np.array(PULL) - answer.contact_forces
    assert np.abs(left[~shell.clamped]).max() <= 1e-7 * np.abs(answer.contact_forces).max()


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["composite", pytest.param("bdf2", marks=pytest.mark.slow)])
def test_a_closing_fold_neither_crosses_nor_gains_energy(integrator):
    shell = folded((6, 6))
    model = ms.DiscreteShell(shell, integrator=integrator)
    run = ms.simulate(model, duration=0.6, dt=1 / 60, gravity=PULL, contacts=[ms.SelfContact(friction=0.2)])
    assert run.unconverged_steps == 0
    gap = Layers(SelfContact(), shell).gap
    touching = run.self_contact < gap
    assert touching[-1]
    assert not touching[0]
    assert all(crossing_free(shell, x) for x in run.positions)
    energies = run.energies.sum(axis=1)
    after = np.flatnonzero(touching[:-1])
    assert (np.diff(energies)[after] / np.ptp(run.energies[:, 2])).max() <= 1e-6
    assert run.contact_forces[touching].any(axis=(1, 2)).all()


@pytest.mark.slow
def test_a_free_sheet_rests_on_a_floor_along_which_it_drifts():
    mesh = ms.sheet(length=0.6, width=0.6, cells=(4, 4))
    shell = ms.Shell(mesh, ms.Isotropic(1e6, 0.3, 1.4e-3, 500.0))
    start = mesh.vertices + 1e-6 * np.random.default_rng(0).standard_normal(mesh.vertices.shape) * [1.0, 1.0, 0.0]
    contacts = [ms.SelfContact(), ms.Contact(ms.Plane((0, 0, 1), 0.0))]
    answer = ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -3.0), contacts=contacts, start=start)
    assert answer.converged
    assert answer.stable
    np.testing.assert_allclose(answer.contact_forces.sum(axis=0), [0, 0, 3.0 * shell.mass.sum()], atol=1e-9)


@pytest.mark.slow
def test_friction_holds_a_sheet_on_a_slope():
    shell = two_sheets(5e-3, shift=0.013)
    slope = 0.2
    gravity = (9.81 * np.sin(slope), 0.0, -9.81 * np.cos(slope))
    upper = ~shell.clamped
    ways = []
    for friction in (0.0, 0.5):
        contact = ms.SelfContact(gap=4e-3, friction=friction)
        run = ms.simulate(ms.DiscreteShell(shell), duration=0.2, dt=1e-2, gravity=gravity, contacts=[contact])
        assert run.unconverged_steps == 0
        ways.append((run.positions[:, upper, 0] - run.positions[0, upper, 0]).mean(axis=1)[-1])
    assert ways[0] == pytest.approx(0.5 * 9.81 * np.sin(slope) * 0.2**2, rel=0.1)
    assert ways[1] < 0.1 * ways[0]


def test_a_fall_on_a_table_and_on_itself():
    mesh = ms.cylinder_panel(length=0.1, radius=0.06, angle=330.0, cells=(2, 12))
    shell = ms.Shell(mesh, ms.Isotropic(1e5, 0.3, 5e-4, 400.0))
    contacts = [ms.Contact(ms.Plane((0, 0, 1), -0.065), friction=0.3), ms.SelfContact(gap=2e-3, friction=0.3)]
    run = ms.simulate(ms.DiscreteShell(shell), duration=0.24, dt=1 / 60, gravity=(0, 0, -9.81), contacts=contacts)
    assert run.unconverged_steps == 0
    assert run.positions[..., 2].min() >= -0.065 - 1e-9
    assert all(crossing_free(shell, x) for x in run.positions)
    assert run.self_contact.min() < 2e-3


@pytest.mark.slow
def test_a_step_on_whose_straight_ways_layers_would_meet_is_solved():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(48, 8))
    along = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, ms.Isotropic(5e6, 0.3, 1e-3, 500.0), clamped=along < 0.45)
    pulled = np.where(along[:, None] > 0.99, [-0.05, 0.0, 0.06], 0.0)
    loading = shell.loading((0.0, 0.0, -9.81), None, None)
    motion = Motion(
        ms.DiscreteShell(shell), loading, dt=1 / 30, damping=(2.0, 0.0), contacts=[ms.SelfContact(gap=2e-3)]
    )
    motion.load = loading.dead + pulled
    for _ in range(9):
        motion.advance()
    before = motion.positions()
    motion.advance()
    assert motion.unconverged == 0
    assert np.abs(motion.positions() - before).max() > 0.05
    assert crossing_free(shell, motion.positions())
    assert motion.touched().self_contact == pytest.approx(2e-3)  # it turned past itself without touching


@pytest.mark.slow
def test_a_resumed_motion_has_the_same_bits():
    def motion():
        shell = folded((6, 6))
        model = ms.DiscreteShell(shell, integrator="bdf2")
        loading = shell.loading(PULL, None, None)
        return Motion(model, loading, dt=1 / 60, contacts=[ms.SelfContact(friction=0.2)])

    whole, first, second = motion(), motion(), motion()
    for _ in range(28):
        whole.advance()
    for _ in range(25):
        first.advance()
    second.restore(first.snapshot())
    for _ in range(3):
        second.advance()
    assert whole.touched().forces.any()
    assert whole.positions().tobytes() == second.positions().tobytes()


def test_refusals(rest):
    shell, answer = rest
    model = ms.DiscreteShell(shell)
    across = answer.positions.copy()
    free = ~shell.clamped
    across[free & (answer.positions[:, 0] > 0.3), 1] += 0.3
    with pytest.raises(ms.OptionError, match=r"edge \(\d+, \d+\) crosses triangle \(\d+, \d+, \d+\) of the shell at"):
        model.equilibrium(gravity=PULL, start=across, contacts=[ms.SelfContact()])
    with pytest.raises(ms.OptionError, match=r"crosses triangle"):
        ms.simulate(model, duration=0.1, dt=0.01, gravity=PULL, start=across, contacts=[ms.SelfContact()])
    with pytest.raises(ms.OptionError, match=r"gap must be less than 0\.\d+ m.*got 0\.5 m"):
        model.equilibrium(gravity=PULL, contacts=[ms.SelfContact(gap=0.5)])
    with pytest.raises(ms.OptionError, match="gap must be"):
        ms.SelfContact(gap=-1.0)
    with pytest.raises(ms.OptionError, match="one SelfContact at most"):
        model.equilibrium(gravity=PULL, contacts=[ms.SelfContact(), ms.SelfContact()])
    explicit = ms.DiscreteShell(shell, integrator="verlet", allow_unstable_step=True)
    with pytest.raises(ms.OptionError, match="needs implicit steps"):
        ms.simulate(explicit, duration=0.1, dt=0.01, gravity=PULL, contacts=[ms.SelfContact()])
    with pytest.raises(ms.OptionError, match="for DS with implicit steps alone"):
        ms.ModalWarping(ms.solve_modes(shell, 2)).equilibrium(gravity=PULL, contacts=[ms.SelfContact()])
    with pytest.raises(ms.OptionError, match="has friction"):
        model.equilibrium(gravity=PULL, contacts=[ms.SelfContact(friction=0.2)])


def test_a_missing_library_is_named(rest, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(ms.OptionError, match=r"pip install 'modalshell\[contact\]'"):
        ms.DiscreteShell(rest[0]).equilibrium(gravity=PULL, contacts=[ms.SelfContact()])


@pytest.mark.slow
def test_nothing_else_imports_the_library():
    code = (
        "import sys, modalshell as ms, modalshell.models.base.touching, modalshell.models.base.contact_motion\n"
        "ms.SelfContact()\n"
        "assert 'ipctk' not in sys.modules and 'modalshell.contact.layers' in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
def test_statics_without_a_potential_say_what_serves():
    mesh = ms.flat_beam(length=0.4, width=0.12, cells=(12, 4))
    shell = ms.Shell(mesh, ms.Isotropic(young=2e6, poisson=0.3, thickness=2e-3, density=300.0), "x < 0.001")
    answer = ms.DiscreteShell(shell).equilibrium(loads=[ms.Pressure(-0.6)], contacts=[ms.SelfContact()])
    assert not answer.converged
    assert "simulate the damped motion" in answer.message
