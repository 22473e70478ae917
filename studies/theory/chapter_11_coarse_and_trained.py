"""Numbers of theory 11: the energy of a projected state, with true and with assumed stresses, and prolongation."""

from __future__ import annotations

import numpy as np

import modalshell as ms
from modalshell.core.typing import Array
from modalshell.models.coarse.prolongation import Prolongation
from modalshell.models.hybrid.assumed_stress import measures_of, position_modes, reduce_energy, stress_modes
from modalshell.models.hybrid.energy_kernels import evaluate
from modalshell.modes import lowest_modes

STATES, UNSEEN, VECTORS = 24, 6, 8


def v_beam() -> ms.Shell:
    """A V-beam of hinges with a stiff membrane, clamped at one end."""
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(20, 4))
    return ms.Shell(mesh, ms.Material(2e4, 2e4, flexure=0.05, density=0.2), clamped=mesh.vertices[:, 0] < 0.051)


def answers(shell: ms.Shell) -> Array:
    """Equilibria (s, n, 3) under weights in random directions, some of them beyond a snap."""
    random = np.random.default_rng(0)
    directions = random.standard_normal((STATES + UNSEEN, 3))
    directions *= random.uniform(20.0, 80.0, len(directions))[:, None] / np.linalg.norm(directions, axis=1)[:, None]
    model = ms.DiscreteShell(shell)
    return np.array([model.equilibrium(gravity=each).positions for each in directions])


def energies() -> tuple[float, float, float]:
    """Of the unseen state whose projection has most: distance [%], true and reduced energy there over its own."""
    shell = v_beam()
    states, rest = answers(shell), shell.rest_positions
    moved = (states[:STATES] - rest).reshape(STATES, -1).T
    modes = lowest_modes(shell, 6)[0].modes
    basis = position_modes(shell, modes[:, :4], moved, VECTORS, shell.stiffness())
    measures, still = measures_of(shell), np.zeros_like(rest)
    leading = np.array([measures.state(rest, mode.reshape(-1, 3)) for mode in modes.T]).T
    stresses = np.array([measures.state(x, still) for x in states[:STATES]]).T
    reduced = reduce_energy(measures, basis, stress_modes(measures, leading, stresses, 2 * VECTORS))
    none, found = np.zeros(reduced.membrane.modes), []
    for x in states[STATES:]:
        z = basis.T @ (shell.mass[:, None] * (x - rest)).ravel()
        near = rest + (basis @ z).reshape(-1, 3)
        distance = 100.0 * ms.measure.displacement_error(near, x, shell)
        found.append((distance, shell.energy(near) / shell.energy(x), evaluate(reduced, z, none)[0] / shell.energy(x)))
    distance, true, assumed = max(found, key=lambda each: float(each[1]))
    return distance, true, assumed


def prolonged() -> list[float]:
    """Largest error [%] of a prolonged cylinder of one radian, over its length, of two coarse meshes."""

    def bent(mesh: ms.TriangleMesh) -> Array:
        x, y, _ = mesh.vertices.T
        return np.column_stack([np.sin(x), y, np.cos(x) - 1.0])

    fine, *meshes = (ms.flat_beam(length=1.0, width=0.2, cells=cells) for cells in ((80, 16), (10, 2), (20, 4)))
    errors = (Prolongation(coarse, fine).prolong(bent(coarse)) - bent(fine) for coarse in meshes)
    return [100.0 * float(np.linalg.norm(error, axis=1).max()) for error in errors]


def statements() -> list[str]:
    """What the chapter states."""
    distance, true, assumed = energies()
    coarse, fine = prolonged()
    return [
        f"{distance:.2f} % of the displacement away",
        f"has {true:.1f} times its energy, and the reduced energy there is {assumed:.2f} times it",
        f"by at most {coarse:.3f} % of its length from cells of a tenth and {fine:.4f} % from cells of a twentieth",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
