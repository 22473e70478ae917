"""Make the creature: an open thin-shell dinosaur that stands on four open feet in the plane z = 0.

Run ``python -m studies.creature --vertices 13000 --out meshes/creature.ply``. The dinosaur is a smooth blend of
signed distances to tapered tubes and ellipsoids, contoured on a grid that begins at z = 0, so that each foot ends there
in a ring of boundary vertices. Centroidal Voronoi cells on the contour give near-equilateral triangles.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from trimesh.triangles import angles, area

from modalshell import TriangleMesh, save_mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

LOW, HIGH = np.array([-1.02, -0.36, -0.06]), np.array([0.98, 0.36, 1.14])  # corners of the sampled box [m]
SPACING, COARSENING = 0.005, 4  # of the grid [m]; far from the surface, distances come from a grid so much coarser
HEAD_PIVOT = np.array([0.60, 0.035, 0.945])
HEAD_TURN = (18.0, 12.0)  # to the left and down [degrees]

# Rows: x, y, z and radius [m].
SPINE = [
    (-0.90, 0.19, 0.470, 0.023), (-0.83, 0.165, 0.395, 0.029), (-0.73, 0.115, 0.350, 0.036),
    (-0.60, 0.055, 0.345, 0.051), (-0.47, 0.015, 0.395, 0.075), (-0.34, 0.0, 0.465, 0.115),
    (-0.19, 0.0, 0.520, 0.160), (-0.02, 0.0, 0.530, 0.182), (0.14, 0.0, 0.535, 0.165),
    (0.27, 0.0, 0.585, 0.122), (0.37, 0.0, 0.675, 0.085), (0.44, 0.005, 0.775, 0.066),
    (0.50, 0.015, 0.865, 0.057), (0.56, 0.03, 0.930, 0.054), (0.60, 0.035, 0.945, 0.055),
]  # fmt: skip
# Hip or shoulder, knee, ankle and sole, for a foot at the origin of x and y, and the body's side in y > 0.
HIND_LEG = [(0, -0.035, 0.47, 0.105), (0.035, -0.005, 0.27, 0.076), (-0.015, 0, 0.12, 0.055), (0, 0, -0.04, 0.066)]
FORE_LEG = [(0, -0.030, 0.48, 0.085), (-0.025, -0.005, 0.27, 0.060), (0.010, 0, 0.12, 0.050), (0, 0, -0.04, 0.060)]
FEET = [(HIND_LEG, -0.27, 0.145), (HIND_LEG, -0.17, -0.145), (FORE_LEG, 0.23, 0.135), (FORE_LEG, 0.12, -0.135)]


def _blend(first: Floats, second: Floats, width: float) -> Floats:
    """Return the union of two signed distances, rounded where they differ by less than `width`."""
    overlap = np.maximum(width - np.abs(first - second), 0.0) / width
    return np.minimum(first, second) - overlap**3 * (width / 6.0)


def _curve(controls: Sequence[tuple[float, ...]], places: Floats) -> tuple[Floats, ...]:
    """Points (x, y, z, radius) of the smooth curve through `controls` at places from 0 to 1, and their derivatives."""
    knots = np.asarray(controls)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots[:, :3], axis=0), axis=1))])
    path, radius = CubicSpline(arc / arc[-1], knots[:, :3]), PchipInterpolator(arc / arc[-1], knots[:, 3])
    return tuple(np.column_stack([path(places, order), radius(places, order)]) for order in (0, 1))


def _tube(points: Floats, controls: Sequence[tuple[float, ...]], samples: int = 24) -> Floats:
    """Signed distance to the spheres (x, y, z, radius) swept along a smooth curve through `controls`."""
    rows, _ = _curve(controls, np.linspace(0.0, 1.0, samples))
    distance = np.full(len(points), np.inf)
    for (*start, radius), (*end, last) in pairwise(rows):
        length = np.linalg.norm(np.subtract(end, start))
        axis = np.subtract(end, start) / length
        taper = np.clip((last - radius) / length, -0.95, 0.95)
        offset = points - start
        along = offset @ axis
        across = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - along**2, 0.0))
        # The sphere whose surface comes nearest lies towards the thick end of the point's foot on the axis.
        nearest = np.clip(along + across * taper / np.sqrt(1.0 - taper**2), 0.0, length)
        np.minimum(distance, np.hypot(along - nearest, across) - radius - taper * nearest, out=distance)
    return distance


def _ellipsoid(points: Floats, center: Sequence[float], radii: Sequence[float]) -> Floats:
    """Near an ellipsoid, its signed distance."""
    offset, axes = points - np.asarray(center), np.asarray(radii)
    size = np.linalg.norm(offset / axes, axis=1)
    return size * (size - 1.0) / np.maximum(np.linalg.norm(offset / axes**2, axis=1), 1e-9)


def _leg(points: Floats, controls: Sequence[tuple[float, ...]], x: float, y: float) -> Floats:
    """One leg whose foot stands at (x, y), with three toes in front."""
    lean = ((-0.22 if controls is HIND_LEG else 0.17) - x) / controls[0][2]
    leg = _tube(points, [(px + x + lean * pz, np.sign(y) * py + y, pz, r) for px, py, pz, r in controls], 14)
    for angle in np.radians([-48.0, 0.0, 48.0]):
        toe = (x + 0.056 * np.cos(angle), y + 0.056 * np.sin(angle), 0.010)
        leg = _blend(leg, _ellipsoid(points, toe, (0.036, 0.027, 0.036)), 0.036)
    return leg


def _head(points: Floats) -> Floats:
    """The head, symmetric in its own frame: skull, cheeks, snout, eyes and the line of the mouth."""
    local = Rotation.from_euler("ZY", HEAD_TURN, degrees=True).inv().apply(points - HEAD_PIVOT)
    local[:, 1] = np.abs(local[:, 1])
    head = _ellipsoid(local, (0.025, 0.0, 0.012), (0.090, 0.068, 0.066))
    head = _blend(head, _ellipsoid(local, (0.135, 0.0, -0.014), (0.085, 0.056, 0.047)), 0.06)
    head = _blend(head, _ellipsoid(local, (0.090, 0.0, -0.040), (0.095, 0.047, 0.032)), 0.03)
    mouth = [(0.075, 0.066, -0.020), (0.12, 0.058, -0.035), (0.17, 0.045, -0.036), (0.205, 0.025, -0.034)]
    groove = _tube(local, [(*point, 0.009) for point in [*mouth, (0.222, 0.0, -0.033)]], 16)
    head = -_blend(-head, groove, 0.012)
    return _blend(head, _ellipsoid(local, (0.060, 0.049, 0.041), (0.028, 0.024, 0.028)), 0.016)


def _crest(points: Floats) -> Floats:
    """A row of rounded plates along the back, largest over the hips."""
    distance = np.full(len(points), np.inf)
    places = np.linspace(0.13, 0.86, 13)
    sizes = 0.72 + 0.33 * np.exp(-(((places - 0.42) / 0.17) ** 2))
    for (*center, radius), (*tangent, growth), size in zip(*_curve(SPINE, places), sizes, strict=True):
        up = np.array([-tangent[2], 0.0, tangent[0]]) / np.hypot(tangent[0], tangent[2])
        axes = np.array([[up[2], 0.0, -up[0]], [0.0, 1.0, 0.0], up])
        local = (points - center - (radius / np.sqrt(1.0 - growth**2 / np.dot(tangent, tangent)) + 0.006) * up) @ axes.T
        np.minimum(distance, _ellipsoid(local, (0.0, 0.0, 0.0), size * np.array([0.040, 0.025, 0.046])), out=distance)
    return distance


def creature_distance(points: Floats) -> Floats:
    """Evaluate the dinosaur's signed distance [m], negative inside, at points (n, 3)."""
    body = _tube(points, SPINE, 56)
    body = _blend(body, _ellipsoid(points, (-0.02, 0.0, 0.475), (0.25, 0.155, 0.165)), 0.10)
    body = _blend(body, _crest(points), 0.036)
    body = _blend(body, _head(points), 0.05)
    return _blend(body, np.min([_leg(points, *foot) for foot in FEET], axis=0), 0.07)


class _Surface:
    """The zero set of the sampled distances, as a smooth spline."""

    def __init__(self) -> None:
        shape = np.rint((HIGH - LOW) / SPACING).astype(int) + 1
        axes = [np.arange(n) * SPACING + low for n, low in zip(shape, LOW, strict=True)]
        coarse = np.meshgrid(*(axis[::COARSENING] for axis in axes), indexing="ij")
        values = creature_distance(np.stack(coarse, axis=-1).reshape(-1, 3)).reshape(coarse[0].shape)
        index = np.meshgrid(*(np.arange(n) / COARSENING for n in shape), indexing="ij", sparse=True)
        samples = ndimage.map_coordinates(values, np.broadcast_arrays(*index), order=1, mode="nearest")
        near = np.argwhere(np.abs(samples) < 1.5 * COARSENING * SPACING)
        samples[tuple(near.T)] = creature_distance(near * SPACING + LOW)
        self.samples = ndimage.gaussian_filter(samples, 0.8)  # rounds the creases between segments
        self._spline = ndimage.spline_filter(self.samples, order=3, output=np.float32)

    def distance(self, points: Floats) -> Floats:
        """Evaluate the spline at points (..., 3)."""
        place = np.moveaxis(points - LOW, -1, 0) / SPACING
        return np.asarray(ndimage.map_coordinates(self._spline, place, output=np.float64, prefilter=False))

    def gradient(self, points: Floats) -> Floats:
        """Evaluate the gradient by central differences, shape (n, 3)."""
        steps, places = 0.2 * SPACING * np.eye(3), points[:, None]
        return (self.distance(places + steps) - self.distance(places - steps)) / (0.4 * SPACING)

    def project(self, points: Floats, flat: Flags, steps: int = 2) -> Floats:
        """Move points to the surface by Newton steps; `flat` ones stay in the plane z = 0."""
        for _ in range(steps):
            slope = self.gradient(points)
            slope[flat, 2] = 0.0
            points = points - (self.distance(points) / np.maximum((slope**2).sum(axis=1), 0.05))[:, None] * slope
        return points

    def contour(self, fewest: int) -> tuple[Floats, Ints]:
        """Return the largest component above z = 0 as triangles with at least `fewest` points, open in that plane."""
        import pyvista

        samples = self.samples[:, :, round(-LOW[2] / SPACING) :]
        grid = pyvista.ImageData(dimensions=samples.shape, spacing=(SPACING,) * 3, origin=(LOW[0], LOW[1], 0.0))
        grid.point_data["distance"] = samples.ravel(order="F")
        found = grid.contour([0.0], scalars="distance").triangulate().clean().connectivity("largest")
        while found.n_points < fewest:
            found = found.subdivide(1, "linear")
        points = np.asarray(found.points, dtype=np.float64)
        return self.project(points, points[:, 2] < 1e-9), np.asarray(found.regular_faces, dtype=np.int64)[:, ::-1]


def _means(owner: Ints, weights: Floats | Ints, points: Floats, count: int) -> Floats:
    """Return the weighted mean of the points of each of `count` owners, every one of which has some."""
    sums = [np.bincount(owner, weights * points[:, k], count) for k in range(3)]
    return np.column_stack(sums) / np.bincount(owner, weights, count)[:, None]


def _rings(rim: Floats, spacing: float) -> Floats:
    """Points at even distances around each foot, along its boundary points among `rim`."""
    rings = []
    for _, x, y in FEET:
        loop = rim[np.linalg.norm(rim - (x, y, 0.0), axis=1) < 0.12]
        loop = loop[np.argsort(np.arctan2(loop[:, 1] - y, loop[:, 0] - x))]
        path = np.concatenate([loop, loop[:1]])
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        places = np.linspace(0.0, arc[-1], round(arc[-1] / spacing), endpoint=False)
        rings.append(np.column_stack([np.interp(places, arc, path[:, k]) for k in range(3)]))
    return np.concatenate(rings)


def _nearest(seeds: Floats, points: Floats) -> Ints:
    """Return for each point the index of the nearest seed."""
    return np.asarray(cKDTree(seeds).query(points)[1], dtype=np.int64)


def _scatter(surface: _Surface, vertices: int, rounds: int = 60) -> tuple[Floats, Ints, Flags]:
    """Spread points into a centroidal Voronoi tessellation; return them, their triangles and which are on rings."""
    points, faces = surface.contour(16 * vertices)
    areas = area(points[faces])
    weights = np.bincount(faces.ravel(), np.repeat(areas, 3), len(points))
    rim = points[:, 2] < 1e-9
    rings = _rings(points[rim], np.sqrt(2.0 / np.sqrt(3.0) * areas.sum() / vertices))
    chances = np.where(rim, 0.0, weights) / weights[~rim].sum()
    picked = np.random.default_rng(13).choice(len(points), vertices - len(rings), replace=False, p=chances)
    seeds = np.concatenate([rings, points[picked]])
    fixed = np.arange(len(seeds)) < len(rings)
    for _ in range(rounds):
        step = _means(_nearest(seeds, points), weights, points, len(seeds)) - seeds
        seeds = surface.project(seeds + 1.5 * step * ~fixed[:, None], fixed, 1)
    owner = _nearest(seeds, points)
    owner[rim] = _nearest(rings, points[rim])  # nothing but the rings' cells reaches the boundary
    corners = owner[faces[(owner[faces] != np.roll(owner[faces], 1, axis=1)).all(axis=1)]]
    # Where a cell has an island, a triangle is met once more in either sense; the two cancel.
    found, place = np.unique(np.sort(corners, axis=1), axis=0, return_inverse=True)
    senses = np.sign(np.prod(corners - np.roll(corners, -1, axis=1), axis=1))  # 1 where the order is even
    balance = np.bincount(place.ravel(), senses)
    return seeds, np.where(balance[:, None] > 0, found, found[:, ::-1])[balance != 0], fixed


def _flip(mesh: TriangleMesh) -> Ints:
    """Return the faces after flipping the edges that are not Delaunay, none next to another."""
    opposite = [angles(mesh.vertices[mesh.hinges[:, [apex, 0, 1]]])[:, 0] for apex in (2, 3)]
    excess = opposite[0] + opposite[1] - np.pi
    order = np.argsort(-excess, kind="stable")[: np.count_nonzero(excess > 1e-3)]
    hinges, sides = mesh.hinges[order], mesh.edge_faces[mesh.hinge_edges[order]]
    known = set(map(tuple, mesh.edges.tolist()))
    faces, touched = mesh.faces.copy(), np.zeros(len(mesh.faces), dtype=bool)
    for (start, end, apex, below), pair in zip(hinges.tolist(), sides, strict=True):
        edge = (min(apex, below), max(apex, below))
        if not touched[pair].any() and edge not in known:
            faces[pair] = (apex, start, below), (below, end, apex)
            touched[pair] = True
            known.add(edge)
    return faces


_surface = cache(_Surface)
"""Made once: its samples take most of the time of a coarse creature."""


def make_creature(vertices: int = 13000) -> TriangleMesh:
    """
    Build the dinosaur, about 1.7 m long and 1 m tall, facing +x with z up.

    Parameters
    ----------
    vertices : int
        Number of vertices; fewer than about 4000 cannot follow the crest and are refused.

    Returns
    -------
    TriangleMesh
        One component, wound outward, whose four boundary loops are the feet's rings in the plane z = 0.
    """
    surface = _surface()
    points, faces, fixed = _scatter(surface, vertices)
    for _ in range(30):
        mesh = TriangleMesh(points, faces)
        middles, weights = points[faces].mean(axis=1), np.repeat(mesh.face_areas, 3)
        goal = _means(faces.ravel(), weights, np.repeat(middles, 3, axis=0), len(points))
        points, faces = surface.project(np.where(fixed[:, None], points, goal), fixed), _flip(mesh)
    points[fixed, 2] = 0.0
    return _checked(TriangleMesh(points, _flip(TriangleMesh(points, faces))), surface)


def quality(mesh: TriangleMesh) -> tuple[Floats, Floats]:
    """Return each triangle's quality, 1 where equilateral, and smallest angle [degrees]."""
    corners = mesh.vertices[mesh.faces]
    squares = np.sum((corners - np.roll(corners, 1, axis=1)) ** 2, axis=(1, 2))
    return 4.0 * np.sqrt(3.0) * mesh.face_areas / squares, np.degrees(angles(corners).min(axis=1))


def _checked(mesh: TriangleMesh, surface: _Surface) -> TriangleMesh:
    """Refuse a mesh in pieces, open elsewhere than at the feet, folded over, or with bad triangles."""
    shapes, smallest = quality(mesh)
    normals = surface.gradient(mesh.vertices)[mesh.faces].sum(axis=1)
    facing = np.einsum("ij,ij->i", mesh.face_normals, normals) / np.linalg.norm(normals, axis=1)
    sound = {
        "one sphere with four holes": mesh.components.max() == 0
        and len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 2 - len(FEET),
        "open in the plane z = 0 only": not mesh.vertices[mesh.boundary_vertices, 2].any(),
        f"wound outward everywhere (least cosine {facing.min():.2f})": facing.min() > 0.5,
        f"free of angles below 20 degrees (least {smallest.min():.1f})": smallest.min() > 20.0,
        f"of mean quality above 0.93 (got {shapes.mean():.3f})": shapes.mean() > 0.93,
    }
    if wanted := ", ".join(what for what, holds in sound.items() if not holds):
        raise RuntimeError(f"the creature's mesh is not {wanted}; try another number of vertices")
    return mesh


def main() -> None:
    """Make the creature's file."""
    parser = argparse.ArgumentParser(description="Make an open thin-shell dinosaur.")
    parser.add_argument("--vertices", type=int, default=13000, help="number of vertices")
    parser.add_argument("--out", default="meshes/creature.ply", help="file to write")
    options = parser.parse_args()
    mesh = make_creature(options.vertices)
    save_mesh(mesh, options.out)
    print(f"{options.out}: {mesh}, mean quality {quality(mesh)[0].mean():.4f}")


if __name__ == "__main__":
    main()
