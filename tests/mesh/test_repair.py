"""Meshes damaged in every way that is refused: the repair that the refusal names makes a shell that moves."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import modalshell as ms
from modalshell.mesh.parts import loose_parts_fault
from modalshell.mesh.polygons import Polygons

NAN = float("nan")


def sheet(count=4):
    mesh = ms.sheet(length=1.0, width=1.0, cells=(count, count))
    return mesh.vertices.copy(), mesh.faces.copy()


def moebius(count=16):
    """A strip of two rows of triangles with half a turn."""
    turn = np.arange(count) / count
    ring = np.column_stack((np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn), np.zeros(count)))
    across = np.column_stack((np.cos(np.pi * turn)[:, None] * ring[:, :2], np.sin(np.pi * turn)))
    vertices = np.stack([ring + share * across for share in (-0.3, 0.0, 0.3)], axis=1).reshape(-1, 3)
    faces = []
    for i in range(count):
        row, after = 3 * i + np.arange(3), 3 * i + 3 + np.arange(3)
        if i + 1 == count:
            after = np.arange(3)[::-1]
        for k in range(2):
            faces += [(row[k], after[k], row[k + 1]), (row[k + 1], after[k], after[k + 1])]
    return vertices, np.array(faces)


def apart(vertices, faces, _):
    """Every triangle with vertices of its own."""
    return vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3)


def repeated_faces(vertices, faces, random):
    copies = faces[random.integers(len(faces), size=3)]
    copies[0] = copies[0][[1, 0, 2]]
    return vertices, np.vstack((faces, copies))


def corners_twice(vertices, faces, random):
    bad = faces[random.integers(len(faces), size=2)][:, [0, 1, 1]]
    return vertices, np.vstack((faces, bad))


def flat_faces(vertices, faces, random):
    """A triangle split at the middle of one side, and one without area over that side."""
    at = int(random.integers(len(faces)))
    a, b, c = faces[at]
    middle = len(vertices)
    further = [(a, middle, c), (middle, b, c), (a, b, middle)]
    points = np.vstack((vertices, 0.5 * (vertices[a] + vertices[b])))
    return points, np.vstack((np.delete(faces, at, axis=0), further))


def flipped(vertices, faces, random):
    turned = random.uniform(size=len(faces)) < 0.4
    return vertices, np.where(turned[:, None], faces[:, ::-1], faces)


def fins(vertices, faces, random):
    """Triangles that stand on edges between two triangles."""
    sides, counts = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0, return_counts=True)
    inner = sides[counts > 1] if (counts > 1).any() else sides
    chosen = inner[random.integers(len(inner), size=2)]
    tips = vertices[chosen].mean(axis=1) + np.array([0.0, 0.0, 0.3])
    standing = np.column_stack((chosen, len(vertices) + np.arange(2)))
    return np.vstack((vertices, tips)), np.vstack((faces, standing))


def unused(vertices, faces, random):
    return np.vstack((random.uniform(size=(2, 3)), vertices)), faces + 2


def not_finite(vertices, faces, random):
    at = int(random.integers(len(faces)))
    points = np.vstack((vertices, [[NAN, 0.0, 0.0]]))
    return points, np.vstack((faces, [[faces[at][0], faces[at][1], len(vertices)]]))


def missing_vertices(vertices, faces, _):
    return vertices, np.vstack((faces, [[0, 1, len(vertices) + 7], [0, 2, -1]]))


def far_away(vertices, faces, _):
    return vertices + 1e10 * np.nanmax(np.ptp(vertices, axis=0)), faces


def one_sided(vertices, faces, _):
    others, strip = moebius()
    return np.vstack((vertices, others + np.array([0.0, 4.0, 0.0]))), np.vstack((faces, strip + len(vertices)))


def loose_part(vertices, faces, _):
    return np.vstack((vertices, vertices + np.array([0.0, 9.0, 0.0]))), np.vstack((faces, faces + len(vertices)))


def thin(height, corner):
    """Damage: a triangle split at a point close to one side ("cap") or to one corner ("needle")."""

    def damage(vertices, faces, random):
        at = int(random.integers(len(faces)))
        a, b, c = faces[at]
        near, far = (0.5 * (vertices[a] + vertices[b]), vertices[c])
        if corner:
            near, far = vertices[a], 0.5 * (vertices[b] + vertices[c])
        point = len(vertices)
        further = [(a, b, point), (point, b, c), (a, point, c)]
        points = np.vstack((vertices, near + height * (far - near)))
        return points, np.vstack((np.delete(faces, at, axis=0), further))

    return damage


REFUSED = {
    "repeated faces": repeated_faces,
    "corners twice": corners_twice,
    "flat faces": flat_faces,
    "unused": unused,
    "not finite": not_finite,
    "missing vertices": missing_vertices,
    "far away": far_away,
}
"""Damages that TriangleMesh refuses."""
JOINED = {"fins": fins, "one-sided": one_sided}
"""What is no two-sided surface, and a shell all the same."""
DAMAGES = REFUSED | JOINED | {"soup": apart, "flipped": flipped, "loose part": loose_part}
DAMAGES |= {"cap": thin(1e-7, False), "needle": thin(1e-6, True)}


def moves(mesh):
    """A shell on the mesh, one end of each part held, has modes, and a short motion by them stays finite."""
    held = np.zeros(len(mesh.vertices), dtype=bool)
    for part in range(mesh.components.max() + 1):
        of_part = mesh.faces[mesh.components[mesh.faces[:, 0]] == part]
        held[of_part[0]] = True
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ms.ModalShellWarning)  # of obtuse triangles and repeated modes
        material = ms.Material.from_physical(young=1e6, poisson=0.3, thickness=0.01, density=500.0, mesh=mesh)
        basis = ms.solve_modes(ms.Shell(mesh, material, held), min(4, 3 * int((~held).sum())))
    run = ms.simulate(ms.ModalWarping(basis), duration=0.1, dt=0.02, gravity=(0.0, 0.0, -1.0), damping=(1.0, 0.0))
    assert np.isfinite(run.positions).all()
    assert basis.rigid_modes == 0


def all_of(mesh):
    """The invariants of a mesh that TriangleMesh takes without a word but on seams."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ms.ModalShellWarning)
        warnings.filterwarnings("ignore", message=".*boundary vertices coincide")
        again = ms.TriangleMesh(mesh.vertices, mesh.faces)
    assert np.array_equal(again.faces, mesh.faces)


@pytest.mark.parametrize("kind", REFUSED)
def test_a_refusal_names_the_repair_and_it_works(kind):
    vertices, faces = REFUSED[kind](*sheet(), np.random.default_rng(1))
    with pytest.raises(ms.MeshError, match=r"ms\.repair\(vertices, faces\) or, on the command line, --repair"):
        ms.TriangleMesh(vertices, faces)
    mesh, report = ms.repair(vertices, faces)
    assert report.changed
    all_of(mesh)
    moves(mesh)


@pytest.mark.parametrize("kind", JOINED)
def test_junctions_and_one_sided_surfaces_are_cut_only_where_that_is_asked_for(kind):
    mesh = ms.TriangleMesh(*JOINED[kind](*sheet(), np.random.default_rng(1)))
    kept, report = ms.repair(mesh.vertices, mesh.faces)
    assert not report.changed
    assert len(kept.joints.edges) == len(mesh.joints.edges) > 0
    for split in (False, True):
        mesh, report = ms.repair(mesh.vertices, mesh.faces, split=split)
        assert report.changed == split
        all_of(mesh)
        moves(mesh)
    assert len(mesh.joints.edges) == 0


@pytest.mark.by_default("repeated faces", "missing vertices", "one-sided", "needle")
@pytest.mark.parametrize("kind", DAMAGES)
def test_what_is_kept_has_the_area_of_the_sheet(kind):
    vertices, faces = DAMAGES[kind](*sheet(), np.random.default_rng(2))
    mesh, _ = ms.repair(vertices, faces, split=kind == "fins")
    part, report = ms.repair(vertices, faces, component="largest", split=kind == "fins")
    if kind != "one-sided":  # whose strip is larger than the sheet
        assert part.area == pytest.approx(1.0, rel=1e-4 if kind in ("far away", "needle", "cap") else 1e-12)
    assert report.parts == 1
    assert loose_parts_fault(part, np.zeros(len(part.vertices), dtype=bool)) == ""
    assert report.dropped_parts == mesh.components.max()


@pytest.mark.by_default("1e-07-False", "1e-09-True", "1e-11-False")
@pytest.mark.parametrize("corner", [False, True])
@pytest.mark.parametrize("height", [1e-7, 1e-9, 1e-11])
def test_triangles_too_thin_for_modes_are_taken_away(height, corner):
    """Those that TriangleMesh takes: it is modes that rounding spoils, and that refusal names the repair, too."""
    mesh = ms.TriangleMesh(*thin(height, corner)(*sheet(), np.random.default_rng(1)))
    held = mesh.vertices[:, 0] < 0.3
    sheet_of = ms.Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=500.0)
    frequencies, refusal = None, ""
    try:
        frequencies = ms.solve_modes(ms.Shell(mesh, sheet_of, held), 3).frequencies
    except ms.SolverError as error:
        refusal = str(error)
    assert (frequencies is None) == ("ms.repair(vertices, faces) or, on the command line, --repair" in refusal)
    mended, report = ms.repair(mesh.vertices, mesh.faces)
    assert report.thin_faces + report.collapsed_faces == 1 + corner
    moves(mended)
    plain = ms.TriangleMesh(*sheet())
    expected = ms.solve_modes(ms.Shell(plain, sheet_of, plain.vertices[:, 0] < 0.3), 3).frequencies
    found = ms.solve_modes(ms.Shell(mended, sheet_of, mended.vertices[:, 0] < 0.3), 3).frequencies
    assert found == pytest.approx(expected, rel=0.1)
    if frequencies is not None:  # what is answered is right
        assert frequencies == pytest.approx(found, rel=0.1)


def test_loose_parts_are_refused_by_naming_a_part_that_works():
    mesh = ms.TriangleMesh(*loose_part(*sheet(), None))
    assert "component 'largest'" in loose_parts_fault(mesh, mesh.vertices[:, 1] < 0.5)
    moves(ms.repair(mesh.vertices, mesh.faces, component="largest")[0])


LAST = ("not finite", "missing vertices", "far away")
damages = st.lists(st.sampled_from(sorted(DAMAGES)), min_size=1, max_size=4)


def check_damaged(kinds, seed):
    vertices, faces = sheet(3)
    random = np.random.default_rng(seed)
    last = [kind for kind in LAST if kind in kinds]  # after these nothing else can be done with the arrays
    for kind in [kind for kind in kinds if kind not in LAST] + last:
        vertices, faces = DAMAGES[kind](vertices, faces, random)
    mesh, _ = ms.repair(vertices, faces, split=True)
    all_of(mesh)
    moves(mesh)
    again, second = ms.repair(
        mesh.vertices, mesh.faces, split=True
    )  # seams are merged and split anew, by the winding as it is now
    all_of(again)
    assert again.area == pytest.approx(mesh.area)
    assert second.flat_faces == second.repeated_faces == second.collapsed_faces == second.invalid_faces == 0


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(damages, st.integers(0, 1000))
def test_damages_together_are_mended(kinds, seed):
    check_damaged(kinds, seed)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(damages, st.integers(0, 1_000_000))
def test_many_damages_together_are_mended(kinds, seed):
    check_damaged(kinds, seed)


@pytest.mark.parametrize(
    "make",
    [
        lambda: ms.sheet(cells=(5, 4)),
        lambda: ms.v_beam(cells=(12, 4)),
        lambda: ms.cylinder_panel(cells=(6, 6)),
        ms.paper_bird,
    ],
    ids=["sheet", "V", "cylinder", "bird"],
)
def test_a_shell_comes_back_as_it_is(make):
    mesh = make()
    same, report = ms.repair(mesh.vertices, mesh.faces)
    assert np.array_equal(same.vertices, mesh.vertices)
    assert np.array_equal(same.faces, mesh.faces)
    assert not report.changed
    assert report.messages == []
    assert str(report).startswith("nothing to repair\nnow one part, ")
    assert report.open_edges == (mesh.edge_faces[:, 1] < 0).sum()


def tetrahedra(*places):
    """Solids wound outwards."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return np.vstack([corners + place for place in places]), np.vstack([faces + 4 * k for k in range(len(places))])


@pytest.mark.parametrize("shared", [1, 2])
def test_solids_that_touch_come_apart(shared):
    """By a vertex, or by an edge of four faces: those wound alike stay together, so both solids stay closed."""
    vertices, faces = tetrahedra([0, 0, 0], [0, 0, 0])
    vertices[4:] = -vertices[4:] if shared == 1 else vertices[4:] * [-1, -1, 1]
    if shared == 1:
        faces[4:] = faces[4:, ::-1]
    mesh, report = ms.repair(vertices, faces, split=True)
    assert report.parts == 2
    assert report.open_edges == 0
    assert report.split_vertices == shared
    assert report.split_edges == shared - 1
    assert report.flipped_faces == 0
    assert len(mesh.vertices) == 8


def test_a_surface_that_passes_an_edge_twice_gets_a_vertex_there():
    """A torus pinched along one edge: no vertex can be split, for its faces hang together round both ends."""
    rows = columns = 6
    number = np.arange(rows * columns).reshape(rows, columns)
    faces = []
    for i in range(rows):
        for j in range(columns):
            a, b = number[i, j], number[(i + 1) % rows, j]
            c, d = number[(i + 1) % rows, (j + 1) % columns], number[i, (j + 1) % columns]
            faces += [(a, b, c), (a, c, d)]
    u, v = np.meshgrid(2 * np.pi * np.arange(rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    vertices = np.stack(((2 + np.cos(v)) * np.cos(u), (2 + np.cos(v)) * np.sin(u), np.sin(v)), axis=-1).reshape(-1, 3)
    joined = np.arange(rows * columns)
    joined[number[3, 0]], joined[number[3, 1]] = number[0, 0], number[0, 1]
    mesh, report = ms.repair(vertices, joined[np.array(faces)], split=True)
    assert report.split_edges == 1
    assert report.open_edges == 0
    assert report.parts == 1
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) in (0, -2)
    moves(mesh)


def test_a_one_sided_strip_is_cut_across_where_that_is_asked_for():
    mesh, report = ms.repair(*moebius())
    assert not report.changed
    assert len(mesh.seams) == 2
    mesh, report = ms.repair(*moebius(), split=True)
    assert report.cut_edges == 2
    assert report.split_vertices == 3
    assert mesh.components.max() == 0
    assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 1  # a disc
    assert "cut one-sided surfaces open along 2 edges" in report.messages


def test_polygons_are_split_without_folding_over():
    """An L of six corners: a fan about its first corner would lie over itself."""
    corners = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (1, 2, 0), (1, 1, 0), (0, 1, 0)]
    for turn in range(6):
        polygon = [*range(turn, 6), *range(turn)]
        for order in (polygon, polygon[::-1]):
            mesh, report = ms.repair(corners, [order])
            assert report.triangulated == 1
            assert len(mesh.faces) == 4
            assert mesh.area == pytest.approx(3.0)
            assert (np.abs(mesh.face_normals[:, 2]) == 1.0).all()
            assert np.ptp(mesh.face_normals[:, 2]) == 0.0
    mesh, report = ms.repair([*corners, (3, 0, 0), (3, 2, 0)], [range(6), [1, 6, 7, 2]])
    assert report.triangulated == 2
    assert mesh.area == pytest.approx(5.0)


@pytest.mark.slow
@given(st.integers(3, 12), st.integers(0, 1000), st.permutations([0, 1, 2]))
@settings(max_examples=60, deadline=None)
def test_star_shaped_polygons_keep_their_area(count, seed, axes):
    random = np.random.default_rng(seed)
    angles = np.sort(random.uniform(0.0, 2.0 * np.pi, count))
    if np.diff([*angles, angles[0] + 2.0 * np.pi]).max() > 3.0 or np.diff(angles).min() < 1e-3:
        return  # not star-shaped about the origin
    radii = random.uniform(0.2, 1.0, count)
    points = np.column_stack((radii * np.cos(angles), radii * np.sin(angles), np.zeros(count)))[:, axes]
    triangles = Polygons.of_lists(points, [range(count)]).triangles()
    following = np.roll(radii, -1) * np.sin(np.roll(angles, -1) - angles)
    normals = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx((radii * following).sum())
    assert np.linalg.norm(normals.sum(axis=0)) == pytest.approx((radii * following).sum())


SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("vertices", "faces", "match"),
    [
        ([], [], "no vertices"),
        (SQUARE, [], "no faces"),
        (SQUARE, [[0, 1]], "face 0 .* has 2 corners"),
        (SQUARE, 7, "lists of vertex indices"),
        (SQUARE, [[0, 1, 1.5]], "whole numbers"),
        (SQUARE, [[0, 1, NAN]], "whole numbers"),
        (SQUARE, [[True, False, True]], "whole numbers"),
        (SQUARE, [["a", "b", "c"]], "whole numbers"),
        (SQUARE, [[0, 1, 99]], "none of the 1 faces"),
        ([[NAN] * 3] * 3, [[0, 1, 2]], "none of the 1 faces"),
        ([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], "zero area"),
        ([[0, 0, 0]] * 3, [[0, 1, 2]], "scale the mesh"),
        (np.zeros((3, 2)), [[0, 1, 2]], r"shape \(n, 3\)"),
    ],
)
def test_what_cannot_be_repaired_is_refused(vertices, faces, match):
    with pytest.raises(ms.MeshError, match=match):
        ms.repair(vertices, faces)


@pytest.mark.by_default("12", "14", "23", "30")
@pytest.mark.parametrize("seed", range(40))
def test_triangles_at_random_become_sheets(seed):
    """Few points and many triangles among them: hardly an edge has two faces, and hardly a vertex one fan."""
    random = np.random.default_rng(seed)
    points = random.uniform(size=(int(random.integers(4, 12)), 3)).round(int(random.integers(1, 4)))
    faces = random.integers(len(points), size=(int(random.integers(3, 60)), 3))
    mesh, report = ms.repair(points, faces, split=True)
    all_of(mesh)
    kept = {tuple(sorted(map(tuple, points[face]))) for face in faces}
    areas = [np.linalg.norm(np.cross(np.subtract(b, a), np.subtract(c, a))) / 2 for a, b, c in kept]
    assert mesh.area == pytest.approx(sum(areas))
    assert report.split_vertices > 0 or len(mesh.vertices) <= len(points)


def ribbed(cells=10):
    """A plate and a rib that stands on its middle line: faces of one mesh with edges of three triangles."""
    plate = ms.sheet(length=1.0, width=0.4, cells=(cells, 4))
    low, step = plate.vertices.min(axis=0), 1.0 / cells
    line = np.flatnonzero(np.abs(plate.vertices[:, 1] - low[1] - 0.2) < 1e-9)
    line = line[np.argsort(plate.vertices[line, 0])]
    top = len(plate.vertices) + np.arange(len(line))
    vertices = np.vstack((plate.vertices, plate.vertices[line] + [0.0, 0.0, step]))
    quads = np.column_stack((line[:-1], line[1:], top[1:], top[:-1]))
    return vertices, np.vstack((plate.faces, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))


def test_a_rib_is_cut_off_its_plate_only_where_that_is_asked_for():
    vertices, faces = ribbed()
    mesh, report = ms.repair(vertices, faces)
    assert report.parts == 1
    assert not report.changed
    assert len(mesh.junctions) == 10
    with pytest.raises(ms.OptionError, match="split"):
        ms.repair(vertices, faces, split=1)
    _, report = ms.repair(vertices, faces, split=True)
    assert report.parts == 2
    assert any("hold one another no longer" in line for line in report.messages)


def test_ties_hold_a_rib_on_its_plate():
    """Cut off the rib leaves the plate as soft as without it; its vertices tied to the plate's stiffen it."""
    mesh, _ = ms.repair(*ribbed(), split=True)
    _, place, count = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True, return_counts=True)
    pairs = [np.flatnonzero(place.ravel() == group) for group in np.flatnonzero(count == 2)]
    assert len(pairs) == 11
    sheet = ms.Isotropic(young=2e11, poisson=0.3, thickness=2e-3, density=7800.0)
    held = mesh.vertices[:, 0] < mesh.vertices[:, 0].min() + 1e-6
    sags = []
    for ties in ([], [ms.Tie(pair) for pair in pairs if not held[pair].any()]):
        shell = ms.Shell(mesh, sheet, clamped=held, supports=ties)
        answer = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -9.81))
        assert answer.converged
        plate = mesh.components == 0
        sags.append(-(answer.positions - mesh.vertices)[plate, 2].min())
    assert sags[1] < 0.1 * sags[0]
