"""Numbers of theory 8: plain and mixed Newton on a plane chain of stiff links, and a column's buckling load."""

from __future__ import annotations

import numpy as np

import modalshell as ms

LINKS, GAMMA, MOST = 20, 4.0, 200
STIFFNESSES = (1e2, 1e4, 1e6, 1e8)
"""Of a link, L^2 times membrane over bending stiffness."""


def chain(stiffness: float, mixed: bool) -> int | None:
    """Full Newton steps from rest to a residual of 1e-5 of the load, none if it fails; L = D = 1.

    Links resist ``(l^2 - l0^2) / (2 l0^2)``, second differences bend, the first two of the points are held.
    """
    size = 1.0 / LINKS
    rest = np.column_stack([np.linspace(0.0, 1.0, LINKS + 1), np.zeros(LINKS + 1)]).ravel()
    first = (np.eye(LINKS + 1)[1:] - np.eye(LINKS + 1)[:-1]) / size
    second = np.diff(first, axis=0) / size
    bending = size * np.kron(second.T @ second, np.eye(2))
    sides = np.stack([np.kron(row, np.eye(2)) for row in first])
    load = np.zeros((LINKS + 1, 2))
    load[:, 1] = -GAMMA * size
    load[-1, 1] /= 2.0
    free = np.arange(4, 2 * LINKS + 2)
    x, stress = rest.copy(), np.zeros(LINKS)
    for step in range(MOST):
        directions = sides @ x
        strain = 0.5 * (np.sum(directions**2, axis=1) - 1.0)
        slopes = np.einsum("ki,kij->kj", directions, sides)
        residual = bending @ (x - rest) + size * stiffness * strain @ slopes - load.ravel()
        if not np.isfinite(residual).all():
            return None
        if np.linalg.norm(residual[free]) < 1e-5 * np.linalg.norm(load):
            return step
        forces = stress if mixed else stiffness * strain
        hessian = (
            bending + size * stiffness * slopes.T @ slopes + size * np.einsum("k,kij,kil->jl", forces, sides, sides)
        )
        move = np.zeros_like(x)
        move[free] = np.linalg.solve(hessian[np.ix_(free, free)], -residual[free])
        stress = stiffness * (strain + slopes @ move)
        x = x + move
    return None


def column() -> float:
    """Euler load of a clamped column, over pi^2 E I / (4 L^2)."""
    mesh = ms.flat_beam(length=1.0, width=0.05, cells=(40, 2))
    shell = ms.Shell(mesh, ms.Isotropic(young=1e9, poisson=0.0, thickness=1e-2, density=1.0), clamped="x < 1e-9")
    force = np.zeros((len(mesh.vertices), 3))
    end = mesh.vertices[:, 0] > 1.0 - 1e-9
    force[end, 0] = -1.0 / np.count_nonzero(end)
    (factor,) = ms.buckling_factors(shell, 1, force=force).factors
    return float(factor / (np.pi**2 * 1e9 * 0.05 * 1e-6 / 12.0 / 4.0))


def statements() -> list[str]:
    """What the chapter states."""

    def shown(steps: int | None) -> str:
        return "fails" if steps is None else str(steps)

    rows = [f"| 1e{np.log10(k):.0f} | {shown(chain(k, False))} | {shown(chain(k, True))} |" for k in STIFFNESSES]
    return [*rows, f"is {column():.3f} times Euler's load"]


if __name__ == "__main__":
    print(*statements(), sep="\n")
