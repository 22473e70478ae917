"""Flutter: complex pairs among the lowest eigenvalues of a stiffness that is not symmetric, over the mass."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sps
from spheres import icosphere

import modalshell as ms
from modalshell.modes import lowest_tangent_eigenvalue
from modalshell.modes.factorisation import Factoriser
from modalshell.modes.flutter import flutters
from modalshell.modes.unsymmetric import symmetric_half

MASS = np.linspace(0.5, 2.0, 250)


def coupled(size, first, apart, odd):
    """A chain's stiffness with modes ``first`` and the next ``apart`` (a share), coupled by ``odd`` times that."""
    mass = MASS[:size]
    root = np.sqrt(mass)
    chain = sps.diags_array([-1.0, 2.01, -1.0], offsets=[-1, 0, 1], shape=(size, size)).toarray()
    values, vectors = np.linalg.eigh(chain / np.outer(root, root))
    values[first + 1] = values[first] * (1.0 + apart)
    half = np.outer(root, root) * ((vectors * values) @ vectors.T)
    one, other = (root * vectors[:, k] for k in (first, first + 1))
    coupling = odd * max(apart, 1e-2) * values[first] * (np.outer(one, other) - np.outer(other, one))
    return sps.csc_array(0.5 * (half + half.T) + coupling), mass


@pytest.mark.by_default("0.0-0.0-False-5-40", "1e-09-0.0-False-0-40", "0.0-1.0-True-0-40", "0.01-0.55-True-0-250")
@pytest.mark.parametrize("size", [40, 250])
@pytest.mark.parametrize("first", [0, 5])
@pytest.mark.parametrize(
    ("apart", "odd", "complex_pair"),
    [
        (0.0, 0.0, False),
        (1e-9, 0.0, False),
        (0.0, 1.0, True),
        (0.0, 0.05, False),
        (0.01, 0.49, False),
        (0.01, 0.55, True),
    ],
)
def test_vibrations_flutter_where_the_odd_half_is_half_their_distance(size, first, apart, odd, complex_pair):
    matrix, mass = coupled(size, first, apart, odd)
    factor = Factoriser().definite(symmetric_half(matrix))
    assert factor.is_definite()
    assert flutters(matrix, factor, mass) is complex_pair


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strength", "seeds"), [(0.003, range(6)), (0.01, range(6)), (0.03, range(6)), (0.1, range(6)), (1.0, (19, 27, 35))]
)
def test_drawn_matrices_agree_with_all_their_eigenvalues(strength, seeds):
    """The odd half couples all to all, beyond what its first order says; a strong one beyond its third."""
    verdicts = []
    for seed in seeds:
        random = np.random.default_rng(seed)
        values = np.sort(random.uniform(1.0, 4.0, 12))
        values = np.concatenate([values, np.linspace(6.0, 500.0, 288)])
        odd = strength * random.standard_normal((300, 300)) * np.sqrt(np.outer(values, values)) / 17.0
        matrix = np.diag(values) + 0.5 * (odd - odd.T)
        lowest = scipy.linalg.eigvals(matrix)
        lowest = lowest[np.argsort(np.abs(lowest))][:8]
        sparse = sps.csc_array(matrix)
        found = flutters(sparse, Factoriser().definite(symmetric_half(sparse)), np.ones(300))
        assert found is bool((np.abs(lowest.imag) > 1e-3 * np.abs(lowest)).any())
        verdicts.append(found)
    assert strength > 0.02 or not all(verdicts)


@pytest.mark.parametrize("coupled", [False, True])
def test_pairs_above_the_lowest_flutter_too(coupled):
    """The tangent of a coarse shell was asked for its lowest pair alone."""
    mesh = ms.flat_beam(length=1.0, width=0.3, cells=(10, 4))
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 5e-3, 1000.0), "x < 1e-6")
    basis = ms.solve_modes(shell, 4)
    one, other = (np.repeat(shell.mass, 3) * mode for mode in basis.modes.T[2:4])
    odd = float(coupled) * (basis.eigenvalues[3] - basis.eigenvalues[2])
    load = sps.csr_array(odd * (np.outer(one, other) - np.outer(other, one)))
    found = lowest_tangent_eigenvalue(shell, mesh.vertices, load, symmetric=False)
    assert found == (0.0 if coupled else pytest.approx(basis.eigenvalues[0], rel=1e-6))


@pytest.mark.parametrize("make", [ms.LinearModal, ms.RotationStrain])
def test_pressure_on_a_closed_shell_never_makes_modes_flutter(make):
    """It has a potential, and its modes repeat."""
    shell = ms.Shell(icosphere(1), ms.Isotropic(1e9, 0.3, 5e-3, 1000.0), "z < -0.6")
    state = make(ms.solve_modes(shell, 8)).equilibrium(loads=[ms.Pressure(200.0)])
    assert state.conservative
    assert state.stable


@pytest.mark.by_default("RotationStrain")
@pytest.mark.parametrize("make", [lambda basis: ms.ModalWarping(basis, consistent_force=True), ms.RotationStrain])
def test_modal_tangents_know_how_loads_follow_far_turns(make):
    """The vertices' velocities were those of rows that leave out how the turns move them: -120 for 110 1/s^2."""
    mesh = ms.flat_beam(length=1.0, width=1.0, cells=(6, 6))
    basis = ms.solve_modes(ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 5e-3, 1000.0), "x < 1e-6"), 6)
    model = make(basis)
    state = model.equilibrium(loads=[ms.Pressure(28.0 * 1e9 * 5e-3**3 / 12.0)])
    assert np.abs(basis.rotations @ state.coordinates).max() > 1.5

    def balance(q):
        return basis.eigenvalues * q - model.modal_force(q, state.loading.force(model.warped_positions(q)))

    exact = scipy.linalg.eigvals(model.by_differences(balance, state.coordinates)).real.min()
    assert exact > 0.0
    found = model.tangent_eigenvalue(state, state.loading.force(state.positions))
    assert found == pytest.approx(exact, rel=1e-5)
    assert state.stable
