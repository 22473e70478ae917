"""Numbers of theory 5: plane waves on equilateral triangles in pairs, and the orders that a study measured."""

from __future__ import annotations

import numpy as np

from modalshell.core.typing import Array
from modalshell.shell import triangle_pairs
from studies.pages import committed

HEIGHT = np.sqrt(0.75)
STEPS = np.array([[1.0, 0.0], [0.5, HEIGHT], [-0.5, HEIGHT]])
"""Unit edges: that inside a pair, and the two others of its first triangle."""
DIRECTIONS = np.linspace(0.0, np.pi, 12, endpoint=False)


def flexibility(poisson: float, weight: float) -> Array:
    """F of theory 5, eq. 2, with D = 1; edges 3 and 4 are parallel to edges 1 and 2."""
    normals = STEPS[:, [1, 0]] * (1.0, -1.0)
    tensors = np.linalg.inv(np.column_stack([normals**2, 2.0 * normals[:, 0] * normals[:, 1]]))
    first, second = np.zeros((3, 5)), np.zeros((3, 5))
    first[:, [0, 1, 2]] = second[:, [0, 3, 4]] = tensors
    compliance = np.diag([1.0, 1.0, 2.0 * (1.0 + poisson)])
    compliance[0, 1] = compliance[1, 0] = -poisson
    compliance /= 1.0 - poisson**2
    mean, area = 0.5 * (first + second), 0.5 * HEIGHT
    own = area * (first.T @ compliance @ first + second.T @ compliance @ second)
    return np.asarray((1.0 - weight) * own + 2.0 * weight * area * mean.T @ compliance @ mean)


def stiffness(poisson: float, weight: float, wave: Array) -> float:
    """Twice the energy per area of a plane wave of unit amplitude, D = 1; parallel edges differ by a phase."""

    def phase(place: Array) -> complex:
        return complex(np.exp(1j * wave @ place))

    own, turned, _ = STEPS
    moments = np.zeros((5, 3), dtype=complex)
    moments[0, 0] = moments[1, 1] = moments[2, 2] = 1.0
    moments[3, 1], moments[4, 2] = phase(own - turned), phase(-turned)
    reduced = moments.conj().T @ flexibility(poisson, weight) @ moments
    ends = ((0.0 * own, own), (0.0 * own, turned), (own, turned))
    apexes = ((turned, own - turned), (own, turned - own), (0.0 * own, own + turned))
    folds = np.array([sum(map(phase, e)) - sum(map(phase, a)) for e, a in zip(ends, apexes, strict=True)]) / HEIGHT
    return float((folds.conj() @ np.linalg.solve(reduced, folds)).real / HEIGHT)


def softening(poisson: float, weight: float = 0.0) -> float:
    """(1 - w) beta of theory 5, eq. 5, the mean over directions, extrapolated to long waves."""
    found = []
    for number in (0.1, 0.05):
        mean = np.mean([stiffness(poisson, weight, number * np.array([np.cos(a), np.sin(a)])) for a in DIRECTIONS])
        found.append((1.0 - mean / number**4) / number**2)
    return float((4.0 * found[1] - found[0]) / 3.0)


def statements() -> list[str]:
    """What the chapter states."""
    rows = []
    for poisson in (0.0, 0.3, 0.5):
        beta = softening(poisson)
        assert np.isclose(beta, (3.0 + poisson) ** 3 / (192.0 * (1.0 - poisson**2)), rtol=1e-4)
        assert np.isclose(
            softening(poisson, triangle_pairs.MEAN_WEIGHT), (1.0 - triangle_pairs.MEAN_WEIGHT) * beta, rtol=1e-3
        )
        rows.append(f"| {poisson} | {beta:.3f} | {1.0 - 1.0 / (16.0 * beta):.2f} |")
    lost = [100.0 * softening(0.3, weight) * (2.0 * np.pi / 12.0) ** 2 for weight in (0.0, triangle_pairs.MEAN_WEIGHT)]
    orders = committed("mesh_bias").findings["orders"]
    order = ", ".join(f"{name} {found['order']:.2f} within {found['interval']:.2f}" for name, found in orders.items())
    return [
        *rows,
        "intervals of 95 %",
        f"too soft by {lost[0]:.1f} % by triangles and by {lost[1]:.2f} % in pairs",
        order,
        f"bending stiffnesses more than {triangle_pairs.ALIKE} times apart",
    ]


if __name__ == "__main__":
    print(*statements(), sep="\n")
