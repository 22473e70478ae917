"""What a reader derives from the theory manual alone, with SymPy or by hand, is what the package computes."""

from fractions import Fraction
from functools import cache

import numpy as np
import pytest
from later import later

from modalshell import Isotropic, Shell, TriangleMesh, sheet
from modalshell.shell.smoothed_membrane import membrane_elements, membrane_matrix, plane_stress, strained_elements
from modalshell.shell.triangle_pairs import fold_moments
from modalshell.shell.vertex_masses import vertex_masses

sp = later("sympy", "SymPy is not installed (extra symbolic)")

POISSON = Fraction(1, 4)


@cache
def corners_and_across():
    """Corners of a triangle, and the one across its first edge."""
    points = [0, 0], [2, 0], [sp.Rational(1, 2), sp.Rational(3, 2)], [sp.Rational(6, 5), -1]
    *corners, across = map(sp.Matrix, points)
    return corners, across


def normals_and_lengths(corners):
    """Unit normals in the plane and lengths of the edges opposite the corners."""
    edges = [corners[(k + 2) % 3] - corners[(k + 1) % 3] for k in range(3)]
    return [sp.Matrix([edge[1], -edge[0]]) / edge.norm() for edge in edges], [edge.norm() for edge in edges]


def area(corners):
    return sp.Matrix.hstack(corners[1] - corners[0], corners[2] - corners[0]).det() / 2


def flat_mesh(corners, faces):
    plane = np.array([[float(value) for value in corner] + [0.0] for corner in corners])
    return TriangleMesh(plane, np.array(faces))


def derived_triangle(rigidity):
    """Second derivatives of theory 4, eq. 4 with the curvature of eq. 3."""
    corners, _ = corners_and_across()
    normals, lengths = normals_and_lengths(corners)
    folds = sp.symbols("g:3")
    parts = [g * n * n.T * length / area(corners) for g, n, length in zip(folds, normals, lengths, strict=True)]
    curvature = sum(parts, sp.zeros(2))
    density = POISSON * curvature.trace() ** 2 + (1 - POISSON) * (curvature * curvature).trace()
    return sp.hessian(area(corners) * rigidity / 2 * density, folds)


def moment_tensor(corners, couples):
    """M of the couples at the edges opposite the corners, by theory 4, eq. 6."""
    normals, lengths = normals_and_lengths(corners)
    xx, yy, xy = sp.symbols("xx yy xy")
    tensor = sp.Matrix([[xx, xy], [xy, yy]])
    equations = [
        length * (n.T * tensor * n)[0] - couple for n, length, couple in zip(normals, lengths, couples, strict=True)
    ]
    return tensor.subs(sp.solve(equations, (xx, yy, xy)))


def compliance(tensor, rigidity):
    """Theory 4, eq. 7."""
    squares = (1 + POISSON) * (tensor * tensor).trace() - POISSON * tensor.trace() ** 2
    return squares / (rigidity * (1 - POISSON**2))


def derived_pair(rigidity):
    """Flexibility of theory 5, eq. 2 by the moments at the pair's five edges."""
    couples = sp.symbols("m:5")
    corners, across = corners_and_across()
    first, second = [corners[2], corners[0], corners[1]], [across, corners[1], corners[0]]
    tensors = [moment_tensor(first, couples[:3]), moment_tensor(second, [couples[0], *couples[3:]])]
    areas = [area(first), area(second)]
    mean = (areas[0] * tensors[0] + areas[1] * tensors[1]) / sum(areas)
    weight = sp.Rational(5, 6)
    own = sum(a * compliance(tensor, rigidity) for a, tensor in zip(areas, tensors, strict=True))
    return sp.hessian((1 - weight) * own / 2 + weight * sum(areas) * compliance(mean, rigidity) / 2, couples)


def numbers(matrix):
    return np.array(matrix.evalf(30), dtype=float)


@pytest.mark.slow
def test_the_stiffness_of_one_triangle():
    mesh = flat_mesh(corners_and_across()[0], [[0, 1, 2]])
    single = np.array([[0, -1]]), np.zeros((1, 2), dtype=np.int64)
    found = fold_moments(mesh, *single, np.array([3.0]), np.array([0.25]), np.zeros((1, 5), dtype=bool))[0, :3, :3]
    np.testing.assert_allclose(found, numbers(derived_triangle(3)), rtol=1e-13)


@pytest.mark.slow
def test_the_stiffness_of_one_pair():
    corners, across = corners_and_across()
    mesh = flat_mesh([*corners, across], [[0, 1, 2], [1, 0, 3]])
    pair = np.array([[0, 1]]), np.array([[2, 2]])
    found = fold_moments(mesh, *pair, np.full(2, 3.0), np.full(2, 0.25), np.zeros((1, 5), dtype=bool))[0]
    np.testing.assert_allclose(found, numbers(derived_pair(3).inv()), rtol=1e-12)


@pytest.mark.slow
def test_the_stiffness_of_a_sheet_of_one_pair():
    """Along the normal, by the fold of theory 4, eq. 1; its rim is free, and the inner moment is the only one."""
    corners, across = corners_and_across()
    mesh = flat_mesh([*corners, across], [[0, 1, 2], [1, 0, 3]])
    young, thickness = 2e6, 0.01
    rigidity = young * thickness**3 / (12 * (1 - 0.25**2))
    heights = sp.symbols("w:4", real=True)
    points = [sp.Matrix([*corner, w]) for corner, w in zip([*corners, across], heights, strict=True)]
    along = points[1] - points[0]
    left, right = along.cross(points[2] - points[0]), (points[3] - points[0]).cross(along)
    fold = sp.atan2(left.cross(right).dot(along) / along.norm(), left.dot(right))
    slopes = numbers(sp.Matrix([sp.diff(fold, w).subs(dict.fromkeys(heights, 0)) for w in heights])).ravel()
    expected = np.outer(slopes, slopes) * rigidity / float(derived_pair(1)[0, 0])
    found = Shell(mesh, Isotropic(young, 0.25, thickness, 1000.0)).stiffness().toarray()[2::3, 2::3]
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def powers_of(place, wave, count):
    """Terms of ``exp(i k . x)`` by powers of k."""
    phase = sp.I * wave.dot(place)
    return [sp.expand(phase**m / sp.factorial(m)) for m in range(count)]


def adjoint(matrix):
    return matrix.applyfunc(sp.conjugate).T


@pytest.mark.slow
@pytest.mark.parametrize(
    ("nu", "weight"), [(0, 0), (Fraction(1, 4), Fraction(5, 6)), (Fraction(-1, 2), Fraction(1, 3))]
)
def test_a_plane_wave_on_pairs_of_equilateral_triangles(nu, weight):
    """Theory 5, eq. 4 and 5: of the flexibility of eq. 2, expanded by the wave number, the mean over directions."""
    nu, weight = sp.Rational(nu), sp.Rational(weight)
    angle = sp.symbols("theta", real=True)
    across, down = sp.symbols("c s", real=True)
    wave, high = sp.Matrix([across, down]), sp.sqrt(3) / 2
    own, turned, other = steps = [
        sp.Matrix([1, 0]), sp.Matrix([sp.Rational(1, 2), high]), sp.Matrix([-sp.Rational(1, 2), high])
    ]  # fmt: skip
    tensors = sp.Matrix([[step[1] ** 2, step[0] ** 2, -2 * step[0] * step[1]] for step in steps]).inv()
    first, second = sp.zeros(3, 5), sp.zeros(3, 5)
    for column, (one, two) in enumerate(((0, 0), (1, 3), (2, 4))):
        first[:, one] = second[:, two] = tensors[:, column]
    elastic = sp.Matrix([[1, -nu, 0], [-nu, 1, 0], [0, 0, 2 * (1 + nu)]]) / (1 - nu**2)
    mean, area = (first + second) / 2, high / 2
    flexibility = (1 - weight) * area * (first.T * elastic * first + second.T * elastic * second)
    flexibility += 2 * weight * area * mean.T * elastic * mean
    moments = [sp.zeros(5, 3) for _ in range(3)]
    moments[0][0, 0] = moments[0][1, 1] = moments[0][2, 2] = 1
    for m in range(3):  # edges 3 and 4 are edges 1 and 2, a lattice step away
        moments[m][3, 1] += powers_of(own - turned, wave, 3)[m]
        moments[m][4, 2] += powers_of(-turned, wave, 3)[m]
    of_order = [sp.zeros(3, 3) for _ in range(3)]
    for one in range(3):
        for two in range(3 - one):
            of_order[one + two] += adjoint(moments[one]) * flexibility * moments[two]
    here = sp.zeros(2, 1)
    ends = ((here, own), (here, turned), (own, turned))
    apexes = ((turned, own - turned), (own, other), (here, own + turned))

    def fold(m):
        places = zip(ends, apexes, strict=True)
        sums = [sum(powers_of(e, wave, 5)[m] for e in end) - sum(powers_of(a, wave, 5)[m] for a in apex)
                for end, apex in places]  # fmt: skip
        return sp.Matrix(sums) / high

    two, three, four = (fold(m) for m in (2, 3, 4))
    inverse = of_order[0].applyfunc(sp.expand).inv().applyfunc(sp.simplify)
    slope = -inverse * of_order[1] * inverse
    bent = inverse * of_order[1] * inverse * of_order[1] * inverse - inverse * of_order[2] * inverse
    direction = {across: sp.cos(angle), down: sp.sin(angle)}

    def along(value):
        return sp.expand(sp.expand(value[0] / high).subs(direction))

    assert sp.simplify(along(adjoint(two) * inverse * two)) == 1
    next_order = adjoint(two) * inverse * four + adjoint(four) * inverse * two + adjoint(three) * inverse * three
    next_order += adjoint(two) * slope * three + adjoint(three) * slope * two + adjoint(two) * bent * two
    found = sp.integrate(along(next_order), (angle, 0, 2 * sp.pi)) / (2 * sp.pi)
    assert sp.simplify(found + (1 - weight) * (3 + nu) ** 3 / (192 * (1 - nu**2))) == 0


def flat_edges(points, pairs):
    return [points[b] - points[a] for a, b in pairs]


def test_the_membrane_of_a_pair():
    """Theory 6, eq. 2 to 6: Q of the inner edge of two coplanar triangles, and of each by itself at its free edges."""
    corners, across = corners_and_across()
    points = [np.array([float(value) for value in corner]) for corner in [*corners, across]]
    mesh = flat_mesh([*corners, across], [[0, 1, 2], [1, 0, 3]])
    elasticity = plane_stress(np.full(2, 7.0), np.full(2, 0.25))
    nobody, none = np.zeros(4, dtype=bool), np.zeros(0, dtype=np.int64)
    elements = membrane_elements(strained_elements(mesh, nobody, np.ones(1, dtype=bool), none), elasticity)
    found = membrane_matrix(elements, len(mesh.edges)).toarray()
    number = {tuple(edge): k for k, edge in enumerate(mesh.edges.tolist())}
    stress = 7.0 * np.array([[1.0, 0.25, 0.0], [0.25, 1.0, 0.0], [0.0, 0.0, 0.375]])
    expected, mean, inner_area = np.zeros((5, 5)), np.zeros((3, 5)), 0.0
    for apex in (2, 3):
        pairs = [(0, 1), (0, apex), (1, apex)]
        along = flat_edges(points, pairs)  # the inner edge lies along the first axis, in both triangles
        rows = [[d[0] ** 2, d[1] ** 2, d[0] * d[1]] for d in along]  # d . E d of (E11, E22, 2 E12)
        strain = np.zeros((3, 5))
        strain[:, [number[pair] for pair in pairs]] = np.linalg.inv(rows)
        lengths = np.array([np.linalg.norm(d) for d in along])
        powers = np.maximum((lengths / lengths.max()) ** 4, 0.25)
        parts = 0.5 * abs(along[0][0] * along[1][1] - along[0][1] * along[1][0]) * powers / powers.sum()
        expected += (parts[1] + parts[2]) * strain.T @ stress @ strain
        mean += parts[0] * strain
        inner_area += parts[0]
    expected += mean.T @ stress @ mean / inner_area
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12 * expected.max())


@pytest.mark.parametrize("family", ["equilateral", "right", "union-jack"])
def test_the_masses_of_a_flat_sheet(family):
    """Theory 7, eq. 3 to 6, term by term: integrals of the vertices' hat functions, times the mass per area."""
    mesh = sheet(length=1.0, width=1.0, cells=(5, 4), family=family)
    density = np.linspace(1.0, 2.0, len(mesh.faces))
    plane, count = mesh.vertices[:, :2], len(mesh.vertices)
    gradients = np.zeros((count, count, 2))  # at the first vertex, of the function that is 1 at the second
    areas = np.zeros(count)
    for face, size in zip(mesh.faces, mesh.face_areas, strict=True):
        areas[face] += size
        for corner in range(3):
            side = plane[face[corner - 1]] - plane[face[corner - 2]]
            gradients[face, face[corner]] += np.array([-side[1], side[0]]) / 2.0
    gradients /= areas[:, None, None]
    thirds, moves = np.zeros(count), np.zeros((count, count))
    for face, share in zip(mesh.faces, density * mesh.face_areas / 3.0, strict=True):
        thirds[face] += share
        for a, b in zip(face, np.roll(face, -1), strict=True):
            moves[a] += share * gradients[a] @ (plane[b] - plane[a]) / 8.0
            moves[b] -= share * gradients[b] @ (plane[b] - plane[a]) / 8.0
    taken = np.maximum(-moves, 0.0)
    bound = 0.75 * thirds / np.maximum(taken.sum(axis=0), 1e-300)
    factors = np.minimum(1.0, np.where(taken > 1e-12 * thirds.max(), bound, np.inf).min(axis=1))
    assert (factors < 1.0).any() == (family == "equilateral")
    expected = thirds + factors @ moves
    np.testing.assert_allclose(vertex_masses(mesh, density, np.zeros(count, dtype=bool)), expected, rtol=1e-12)
