"""What the mesh does to a plate: five families, jittered and random ones, refined, with both bending energies.

Three problems with known answers, Poisson's ratio 0.3. A simply supported square plate under uniform load, against
Navier's series, and under four loads that are products of sines, of one and two half waves a side. A free plate held at
three corners and loaded at the fourth: pure twist, whose deflection P x y / (2 D (1 - nu)) an energy of shell theory
has exactly on every mesh, as all its moments are constant. Errors are those of the whole deflection, in the mass norm,
over the exact one; of several loads or meshes the root of their mean square.

The order of convergence is the slope of the logarithm of the waves' error. Four loads and, on random meshes, several
seeds are taken together, as one answer alone may cross the exact one as cells get smaller. Sizes are multiples of six,
by which equilateral cells keep one ratio of their sides.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from scipy.spatial import Delaunay
from scipy.stats import linregress, t

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from modalshell.mesh.lloyd import delaunay_faces, relax_in_rectangle
from modalshell.supports import Support
from studies.pages import at_most, markdown, paragraphs, result_of
from studies.shell_theory import ENERGIES, Sheet, crossed, flat_shell, plate, rows_of

FIGURES = ("mesh_bias",)

SHEET: Sheet = {"young": 1e9, "poisson": 0.3, "thickness": 1e-2, "density": 1000.0}
RIGIDITY = SHEET["young"] * SHEET["thickness"] ** 3 / (12.0 * (1.0 - SHEET["poisson"] ** 2))
FAMILIES = ("union-jack", "right", "equilateral", "lloyd", "delaunay")
MESHES = (*FAMILIES, "jittered", "random")
SEEDS = dict.fromkeys(("delaunay", "jittered", "random"), 8)
"""Meshes of each size of the random kinds; the others have one. All are refined, the first is in every other row."""
PROBLEMS = ("supported", "waves", "twisted")
WAVES = tuple((m, n) for m in (1, 2) for n in (1, 2))
"""Half waves of the loads along both sides."""
JITTER = 0.2
"""Share of a cell by which inner vertices of the jittered mesh are moved at most along each axis."""
SMALL = 1e-5
"""Deflection that the loads are for [lengths]: linear theory holds."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """All meshes, sizes, energies and problems; ``quick`` leaves out the finest meshes."""
    sizes = (6, 12) if quick else (12, 18, 24, 30, 36)
    refined: dict[str, list[float]] = {name: [] for name in MESHES}

    def errors(mesh: str, cells: int) -> list[dict[str, Any]]:
        made = square(mesh, cells)
        refined[mesh].append(refinement(mesh, cells, 1 if quick else SEEDS.get(mesh, 1)))
        rows = rows_of(lambda **of: {"error": deviation(mesh=made, **of)}, crossed(energy=ENERGIES, problem=PROBLEMS))
        return [{"vertices": len(made.vertices), **row} for row in rows]

    rows = rows_of(errors, crossed(mesh=MESHES, cells=sizes), on_step)
    orders = {
        name: dict(zip(("order", "interval"), order(sizes, errors), strict=True)) for name, errors in refined.items()
    }
    findings = {"rows": rows, "refined": refined, "orders": orders}
    return result_of("mesh_bias", findings, sizes=sizes)


def square(name: str, cells: int, seed: int = 0) -> ms.TriangleMesh:
    """A unit square of about ``cells`` cells a side."""
    if name in FAMILIES and not seed:
        return plate(name, cells)
    random = np.random.default_rng(cells + 1000 * seed)
    regular = ms.sheet(length=1.0, width=1.0, cells=(cells, cells))
    vertices = np.array(regular.vertices)
    inner = np.ones(len(vertices), dtype=bool)
    inner[regular.boundary_vertices] = False
    if name == "delaunay":  # as the package's family, from other points
        lattice = ms.sheet(length=1.0, width=1.0, cells=(cells, cells), family="equilateral")
        first = random.uniform(size=(len(lattice.vertices) - len(lattice.boundary_vertices), 2))
        rim = vertices[~inner, :2] + (0.0, 0.5)
        relaxed = np.vstack([rim, relax_in_rectangle(first, rim, 1.0, 1.0)])
        faces = delaunay_faces(relaxed, sliver=1e-9 / cells**2)
        return ms.TriangleMesh(np.column_stack([relaxed - (0.0, 0.5), np.zeros(len(relaxed))]), faces)
    if name == "jittered":
        vertices[inner, :2] += random.uniform(-JITTER, JITTER, (np.count_nonzero(inner), 2)) / cells
        return ms.TriangleMesh(vertices, regular.faces)
    # As many points anywhere, but no nearer the edge or each other than a third of a cell.
    points = list(vertices[~inner, :2])
    while len(points) < len(vertices):
        point = random.uniform((0.0, -0.5), (1.0, 0.5))
        if np.linalg.norm(np.array(points) - point, axis=1).min() > 1.0 / (3.0 * cells):
            points.append(point)
    corners = Delaunay(np.array(points)).simplices
    return ms.TriangleMesh(np.column_stack([points, np.zeros(len(points))]), corners)


def deviation(energy: str, mesh: ms.TriangleMesh, problem: str) -> float:
    """Mass norm of the deflection less that of Kirchhoff's plate, over the norm of the latter."""
    shell, load, exact = loaded(energy, mesh, "twisted" if problem == "twisted" else "supported")
    cases = [(load, exact)] if problem != "waves" else [wave(shell, *halves) for halves in WAVES]
    model = ms.DiscreteShell(shell)
    errors = [difference(shell, model.equilibrium(force=force).positions, shape) for force, shape in cases]
    return float(np.sqrt(np.mean(np.square(errors))))


def refinement(name: str, cells: int, seeds: int) -> float:
    """Error of the waves with shell theory: the root of the mean square over several meshes of one size."""
    errors = [deviation("Isotropic", square(name, cells, seed), "waves") for seed in range(seeds)]
    return float(np.sqrt(np.mean(np.square(errors))))


def order(cells: tuple[int, ...], errors: list[float]) -> tuple[float, float | None]:
    """Order of convergence and half the width of its interval of 95 %; None from two sizes."""
    fit = linregress(np.log(cells), np.log(errors))
    free = len(cells) - 2
    return -float(fit.slope), float(t.ppf(0.975, free) * fit.stderr) if free else None


def difference(shell: ms.Shell, positions: np.ndarray, exact: np.ndarray) -> float:
    """Mass norm of the deflection less the ``exact`` one (n,), over the norm of the latter."""
    return float(np.sqrt((shell.mass @ (positions[:, 2] - exact) ** 2) / (shell.mass @ exact**2)))


def loaded(energy: str, mesh: ms.TriangleMesh, problem: str) -> tuple[ms.Shell, np.ndarray, np.ndarray]:
    """The plate of a problem, its load (n, 3) [N], and Kirchhoff's deflection (n,) [m]."""
    x, y, _ = mesh.vertices.T
    if problem == "supported":
        supports: list[Support] = [ms.Pin(mesh.boundary_vertices)]
        shape = navier(x, y + 0.5)
    else:
        corners = ((0.0, -0.5), (1.0, -0.5), (0.0, 0.5), (1.0, 0.5))
        first, second, third, loaded = (int(np.argmin(np.hypot(x - a, y - b))) for a, b in corners)
        supports = [ms.Pin([first]), ms.Fix([second], axes="yz"), ms.Fix([third], axes="z")]
        shape = x * (y + 0.5) / (2.0 * (1.0 - SHEET["poisson"]))
    shell = flat_shell(energy, mesh, SHEET, supports=supports)
    load = np.zeros((len(x), 3))
    force = SMALL * RIGIDITY / shape.max()
    if problem == "supported":
        load[:, 2] = force * shell.mass / shell.mass.sum()
    else:
        load[loaded, 2] = force
    return shell, load, SMALL / shape.max() * shape


def wave(shell: ms.Shell, along: int, across: int) -> tuple[np.ndarray, np.ndarray]:
    """Load (n, 3) [N] whose deflection (n,) [m] has these half waves along both sides of the supported plate."""
    x, y, _ = shell.rest_positions.T
    shape = SMALL * np.sin(along * np.pi * x) * np.sin(across * np.pi * (y + 0.5))
    load = np.zeros((len(x), 3))
    load[:, 2] = RIGIDITY * np.pi**4 * (along**2 + across**2) ** 2 * shape * shell.mass / shell.mass.sum()
    return load, shape


def navier(x: np.ndarray, y: np.ndarray, terms: int = 61) -> np.ndarray:
    """Deflection of the supported unit square with D = 1 under a total load of 1, at coordinates in [0, 1]."""
    waves = np.arange(1, terms, 2)
    m, n = waves[:, None], waves[None, :]
    weights = 16.0 / (np.pi**6 * m * n * (m**2 + n**2) ** 2)
    along, across = (np.sin(np.pi * np.outer(coordinates, waves)) for coordinates in (x, y))
    return np.asarray(np.einsum("im,mn,in->i", along, weights, across))


def table(result: StudyResult) -> str:
    """Errors by mesh, size, problem and energy, and orders, as Markdown tables."""
    found, kinds = result.findings, list(product(PROBLEMS, ENERGIES))
    meshes: dict[Any, dict[Any, float]] = {}
    for row in found["rows"]:
        mesh = meshes.setdefault((row["mesh"], str(row["cells"]), str(row["vertices"])), {})
        mesh[row["problem"], row["energy"]] = row["error"]
    sizes = " | ".join(f"{cells} cells" for cells in dict.fromkeys(row["cells"] for row in found["rows"]))
    return paragraphs(
        "Errors of the deflection [%]:",
        markdown(
            "mesh | cells | vertices | " + " | ".join(f"{problem}, {energy}" for problem, energy in kinds),
            "{mesh} | {errors:100*.3g}",
            [{"mesh": " | ".join(mesh), "errors": [own[kind] for kind in kinds]} for mesh, own in meshes.items()],
        ),
        "The waves with Isotropic shells over all seeds, errors [%], and the order of convergence with its\n"
        "interval of 95 %:",
        markdown(
            f"mesh | {sizes} | order | interval",
            "{mesh} | {errors:100*.3g} | {order:.2f} | {sign}{interval:.2f}",
            [
                {"mesh": name, "errors": found["refined"][name], "sign": "+-" if one["interval"] else "", **one}
                for name, one in found["orders"].items()
            ],
        ),
    )


def finding(result: StudyResult) -> str:
    """Largest errors of both energies on the finest meshes, and the orders of convergence."""
    rows = result.findings["rows"]
    finest = max(row["cells"] for row in rows)

    def largest(problem: str, energy: str) -> str:
        chosen = [row for row in rows if (row["cells"], row["problem"], row["energy"]) == (finest, problem, energy)]
        return at_most(100 * max(row["error"] for row in chosen))

    slopes = {name: slope["order"] for name, slope in result.findings["orders"].items()}
    last = slopes.pop("random")
    return (
        f"With {finest} cells a side the deflection of a supported plate is at most "
        f"{largest('supported', 'Isotropic')} % off with Isotropic shells on {len(MESHES)} kinds of mesh, random "
        f"ones among them; waves converge with order {min(slopes.values()):.2f} to {max(slopes.values()):.2f}, on "
        f"random points with {last:.2f}, not yet asymptotic; pure twist is exact to "
        f"{largest('twisted', 'Isotropic')} %. Calibrated hinges are off by up to "
        f"{largest('supported', 'hinges')} and {largest('twisted', 'hinges')} %, refined or not."
    )
