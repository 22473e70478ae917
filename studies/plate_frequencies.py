"""Twelve frequencies of square plates, a curved panel and a V-beam: both energies on three meshes.

Poisson's ratio is 0.3. A plate is clamped on one edge, free or simply supported. The simply supported plate has a
closed form. The other two are computed here by Ritz's method with products of Legendre polynomials; four more terms
each way change them by 0.002 % at most. Modes are matched to the reference's by their shapes (modal assurance criterion
with the masses as weights, a double frequency's shapes taken together), since an energy that is wrong may put them in
another order. The panel, clamped at a curved edge, and the V-beam are compared with solid finite elements
(``studies/finite_elements.json``), the likeness of shapes taken at points.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import eigh
from scipy.optimize import linear_sum_assignment

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.pages import at_most, markdown, paragraphs, result_of
from studies.shell_theory import (
    ENERGIES,
    FAMILIES,
    Sheet,
    columns,
    crossed,
    displacements_at,
    finite_elements,
    flat_shell,
    plate,
    rows_of,
)

FIGURES = ("plate_frequencies",)

SHEET: Sheet = {"young": 1e9, "poisson": 0.3, "thickness": 1e-3, "density": 1000.0}
SUPPORTS = ("CFFF", "FFFF", "SSSS")
"""One edge clamped, free, and simply supported."""
SHELLS = {"panel": (44, 44), "V-beam": (180, 12)}
"""Cells along and across of the finite elements' shells; half and less in a quick run."""
MODES, CANDIDATES = 12, 20
"""Modes that are compared, and modes of a shell among which each is looked for."""
TERMS = 24
"""Polynomials of the reference in each direction."""

Shapes = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Deflections (n, k) of modes at coordinates (n,) along and across, in [0, 1] and [-0.5, 0.5]."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All supports, energies and meshes at two resolutions; ``quick`` takes coarser ones."""
    resolutions = (8, 16) if quick else (22, 44)
    references, elements = {supports: reference(supports) for supports in SUPPORTS}, finite_elements("frequencies")
    exact = {name: numbers[:MODES] for name, (numbers, _) in references.items()}
    exact |= {name: np.array(elements[name]["frequencies"])[:MODES] for name in SHELLS}

    def row(name: str, found: np.ndarray, likeness: np.ndarray) -> dict[str, Any]:
        swapped = bool((np.diff(found) < -1e-9 * found[:-1]).any())
        return {"frequencies": found, "errors": found / exact[name] - 1.0, "likeness": likeness, "swapped": swapped}

    def of_plate(supports: str, energy: str, mesh: str, cells: int) -> dict[str, Any]:
        return row(supports, *matched_frequencies(supports, energy, mesh, cells, *references[supports]))

    def of_shell(supports: str, energy: str, mesh: str) -> dict[str, Any]:
        cells = (24, 8 if supports == "panel" else 4) if quick else SHELLS[supports]
        found = shell_frequencies(supports, energy, mesh, cells, elements[supports])
        return {"cells": cells[1], **row(supports, *found)}

    rows = rows_of(of_plate, crossed(supports=SUPPORTS, energy=ENERGIES, mesh=FAMILIES, cells=resolutions), on_step)
    rows += rows_of(of_shell, crossed(supports=SHELLS, energy=ENERGIES, mesh=FAMILIES))
    arrays = {name: numbers for name, (numbers, _) in references.items()}
    return result_of("plate_frequencies", {"reference": exact, "rows": rows}, arrays, resolutions=resolutions)


def shell_frequencies(
    name: str, energy: str, family: str, cells: tuple[int, int], elements: dict[str, Any]
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] of the modes that are most like each mode of the finite elements, and how alike."""
    cells = (columns(family, cells[0]), cells[1])
    if name == "panel":
        mesh = ms.cylinder_panel(length=0.3, radius=0.6, angle=np.degrees(0.5), cells=cells, family=family)
    else:
        mesh = ms.v_beam(length=0.3, width=0.02, fold=150.0, cells=cells, family=family)
    basis = ms.solve_modes(flat_shell(energy, mesh, SHEET, mesh.vertices[:, 0] < 1e-9), CANDIDATES)
    points, wanted = np.array(elements["points"]), np.array(elements["modes"])
    rest = basis.shell.rest_positions
    shapes = [displacements_at(basis.shell, rest + mode.reshape(-1, 3), points).ravel() for mode in basis.modes.T]
    ones = np.ones(points.size)
    likeness = assurance(wanted.reshape(len(wanted), -1).T, np.column_stack(shapes), ones)
    wanted_modes, chosen = linear_sum_assignment(likeness, maximize=True)
    return basis.frequencies[chosen][:MODES], likeness[wanted_modes, chosen][:MODES]


def reference(supports: str) -> tuple[np.ndarray, Shapes]:
    """Numbers ``omega a^2 sqrt(rho h / D)`` of more than ``MODES`` modes of the Kirchhoff plate, and their shapes."""
    if supports == "SSSS":
        waves = sorted(((m, n) for m in range(1, 6) for n in range(1, 6)), key=lambda pair: np.hypot(*pair))
        m, n = np.array(waves[:CANDIDATES]).T
        return np.pi**2 * (
            m**2 + n**2
        ), lambda x, y: np.sin(np.pi * np.outer(x, m)) * np.sin(np.pi * np.outer(y + 0.5, n))
    return ritz(clamped=supports == "CFFF", poisson=SHEET["poisson"])


def ritz(clamped: bool, poisson: float) -> tuple[np.ndarray, Shapes]:
    """Frequency numbers and shapes of a square plate, free or with the edge x = 0 clamped, by Ritz's method."""
    points, weights = legendre.leggauss(2 * TERMS)
    u, weights = 0.5 * (points + 1.0), 0.5 * weights
    x = [polynomials(u, order, clamped) for order in range(3)]
    y = [polynomials(u, order, False) for order in range(3)]

    def integral(left: tuple[int, int], right: tuple[int, int]) -> np.ndarray:
        """Products of the derivatives of both orders in x and y, over the square."""
        along = x[left[0]].T @ (weights[:, None] * x[right[0]])
        across = y[left[1]].T @ (weights[:, None] * y[right[1]])
        return np.kron(along, across)

    mixed = integral((2, 0), (0, 2))
    stiffness = integral((2, 0), (2, 0)) + integral((0, 2), (0, 2)) + poisson * (mixed + mixed.T)
    stiffness += 2.0 * (1.0 - poisson) * integral((1, 1), (1, 1))
    values, vectors = eigh(stiffness, integral((0, 0), (0, 0)))
    rigid = 0 if clamped else 3
    chosen = slice(rigid, rigid + CANDIDATES)

    def shapes(along: np.ndarray, across: np.ndarray) -> np.ndarray:
        """Deflections of the modes."""
        terms = polynomials(along, 0, clamped)[:, :, None] * polynomials(across + 0.5, 0, False)[:, None, :]
        return np.asarray(terms.reshape(len(along), -1) @ vectors[:, chosen])

    return np.sqrt(values[chosen]), shapes


def polynomials(u: np.ndarray, order: int, clamped: bool) -> np.ndarray:
    """Derivatives of ``order`` of the first ``TERMS`` Legendre polynomials on [0, 1], times u^2 where clamped at 0."""
    columns = []
    for degree in range(TERMS):
        series = legendre.Legendre.basis(degree, domain=[0.0, 1.0])
        if clamped:
            series = series * legendre.Legendre.fit([0.0, 0.5, 1.0], [0.0, 0.25, 1.0], 2, domain=[0.0, 1.0])
        columns.append(series.deriv(order)(u) if order else series(u))
    return np.column_stack(columns)


def matched_frequencies(
    supports: str, energy: str, family: str, cells: int, exact: np.ndarray, shapes: Shapes
) -> tuple[np.ndarray, np.ndarray]:
    """Frequency number of the shell's mode that is most like each mode of the reference (7,), and how alike (7,)."""
    mesh = plate(family, cells)
    clamp = mesh.vertices[:, 0] < 1e-9 if supports == "CFFF" else None
    pins = [ms.Pin(mesh.boundary_vertices)] if supports == "SSSS" else []
    shell = flat_shell(energy, mesh, SHEET, clamp, pins)
    rigid = 6 if supports == "FFFF" else 0
    # The last candidate may be one of two with the same frequency: that is far beyond the modes compared.
    with warnings.catch_warnings(action="ignore", category=ms.ModalShellWarning):
        basis = ms.solve_modes(shell, rigid + CANDIDATES)
    unit = np.sqrt(SHEET["young"] * SHEET["thickness"] ** 2 / (12.0 * (1.0 - SHEET["poisson"] ** 2) * SHEET["density"]))
    measured = np.sqrt(basis.eigenvalues[rigid:]) / unit
    count = len(mesh.vertices)  # without the mirror images behind a clamp
    deflections = basis.modes.reshape(len(shell.rest_positions), 3, -1)[:count, 2, rigid:]
    likeness = assurance(shapes(*mesh.vertices[:, :2].T), deflections, shell.mass[:count])
    # The shapes of a double frequency are any two of their plane.
    together = np.abs(exact[:, None] - exact) < 1e-6 * exact
    likeness = together @ likeness
    wanted, chosen = linear_sum_assignment(likeness, maximize=True)
    found, alike = measured[chosen], likeness[wanted, chosen]
    for group in np.unique(together, axis=0):
        found[group] = np.sort(found[group])
    return found[:MODES], alike[:MODES]


def assurance(reference_shapes: np.ndarray, found: np.ndarray, masses: np.ndarray) -> np.ndarray:
    """Modal assurance criterion (k, m) of the columns of both: 1 for the same shape, 0 for orthogonal ones."""
    products = reference_shapes.T @ (masses[:, None] * found)
    sizes = np.outer((masses @ reference_shapes**2), (masses @ found**2))
    return np.asarray(products**2 / sizes)


def table(result: StudyResult) -> str:
    """The reference, and the error of each mode by supports, energy, mesh and resolution, as Markdown tables."""
    modes, rows = " | ".join(f"mode {mode}" for mode in range(1, MODES + 1)), []
    for row in result.findings["rows"]:
        largest, order = np.abs(row["errors"]).max(), "changed" if row["swapped"] else "kept"
        rows.append({**row, "largest": largest, "order": order, "least": min(row["likeness"])})
    exact = [{"supports": name, "numbers": values} for name, values in result.findings["reference"].items()]
    return paragraphs(
        "Frequency numbers ω a² √(ρ h / D) of the Kirchhoff plate, and frequencies [Hz] of finite elements:",
        markdown(f"supports | {modes}", "{supports} | {numbers:.4f}", exact),
        "Errors [%], C clamped, F free, S simply supported; cells are counted across:",
        markdown(
            f"supports | energy | mesh | cells | {modes} | largest | order of modes | least likeness of shapes",
            "{supports} | {energy} | {mesh} | {cells} | {errors:100*+.2f} | {largest:100*.2f} | {order} | {least:.3f}",
            rows,
        ),
    )


def finding(result: StudyResult) -> str:
    """The largest error of each energy on the finer meshes, over all modes and supports."""
    rows = result.findings["rows"]

    def largest(energy: str, name: str) -> str:
        own = [row for row in rows if (row["energy"], row["supports"]) == (energy, name)]
        finest = max(row["cells"] for row in own)
        return at_most(100 * max(np.abs(row["errors"]).max() for row in own if row["cells"] == finest))

    split, hinges = (", ".join(largest(energy, name) for name in SUPPORTS) for energy in ENERGIES)
    panel, beam = (" and ".join(largest(energy, name) for energy in ENERGIES) for name in SHELLS)
    cells = max(row["cells"] for row in rows if row["supports"] == "SSSS")
    return (
        f"With {cells} cells a side the first {MODES} frequencies of a square plate ({', '.join(SUPPORTS)}) "
        f"are off by {split} % at most with Isotropic shells on all {len(FAMILIES)} mesh families, by {hinges} % with "
        f"calibrated hinges; those of a curved panel by {panel} %, of a V-beam by {beam} %."
    )
