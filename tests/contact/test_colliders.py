"""Colliders: signed distances against their own differences, and refusals."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.contact import COLLIDERS
from modalshell.contact.gap_kernels import forms_of, gap_at, packed
from modalshell.contact.touching import Touching

GRID = np.linspace(0.0, 1.0, 6)
HILL = 0.1 * np.sin(3.0 * GRID)[:, None] * np.cos(2.0 * GRID)
EXAMPLES = {
    "plane": ms.Plane((1.0, 2.0, 2.0), 0.1),
    "sphere": ms.Sphere((0.1, 0.2, 0.3), 0.5),
    "cylinder": ms.Cylinder((0.0, 0.0, -0.3), (0.1, 0.2, 0.3), 0.4),
    "capsule": ms.Capsule((0.0, 0.0, -0.3), (0.1, 0.2, 0.3), 0.2),
    "box": ms.Box((0.1, 0.0, 0.0), (0.5, 0.3, 0.2), rotation=(0.3, 0.1, -0.4), rounding=0.1),
    "height-field": ms.HeightField(HILL, 0.2, (-0.5, -0.5, 0.0)),
}


def points(seed=0):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (200, 3))


def slopes(collider, x, step=1e-5):
    """Central differences of the gap (n, 3) and of the normal (n, 3, 3)."""
    first, second = np.empty_like(x), np.empty((len(x), 3, 3))
    for axis in range(3):
        move = step * np.eye(3)[axis]
        ahead, behind = collider.gap(x + move), collider.gap(x - move)
        first[:, axis] = (ahead[0] - behind[0]) / (2 * step)
        second[:, :, axis] = (ahead[1] - behind[1]) / (2 * step)
    return first, second


def sphere_mesh():
    """A closed mesh of a ball, its normals outward."""
    vertices, faces = ms.Sphere((0.1, 0.2, 0.3), 0.5).surface(np.zeros((1, 3)))
    return ms.TriangleMesh(*welded(vertices, faces))


def welded(vertices, faces):
    """The ball's poles as one vertex each, normals outward."""
    places, numbers = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)
    faces = numbers.ravel()[faces]
    faces = faces[[len(set(face)) == 3 for face in faces.tolist()]]
    middle = places[faces].mean(axis=1) - places.mean(axis=0)
    turned = np.cross(places[faces[:, 1]] - places[faces[:, 0]], places[faces[:, 2]] - places[faces[:, 0]])
    return places, np.where((np.sum(turned * middle, axis=1) < 0.0)[:, None], faces[:, ::-1], faces)


def test_every_collider_has_an_example():
    assert {*EXAMPLES, "mesh"} == set(COLLIDERS)  # that of a mesh is compared with a ball


THIN = [
    ms.Box((0.1, 0.0, 0.2), (0.5, 0.3, 0.001), (0.3, 0.1, -0.4)),
    ms.Cylinder((0.0, 0.0, -0.3), (0.0, 0.0, -0.298), 0.4),
    ms.Cylinder((0.0, 0.0, -0.3), (0.1, 0.2, 0.3), 0.004),
]


@pytest.mark.parametrize(
    "collider", [*EXAMPLES.values(), ms.Box((0.1, 0.0, 0.2), (0.5, 0.3, 0.2), (0.3, 0.1, -0.4)), *THIN]
)
def test_colliders_are_drawn_below_all_their_faces(collider):
    """Thin ones at half their depth, and not turned inside out."""
    corners = np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    drawn, triangles = ms.Contact(collider).surfaces(corners, np.zeros(1), 0.01)
    assert collider.gap(drawn[0])[0].max() < -0.99 * min(0.01, 0.5 * collider.smallest_radius)
    a, b, c = np.moveaxis(drawn[0][triangles], 1, 0)
    before, after, last = np.moveaxis(collider.surface(corners)[0][triangles], 1, 0)
    turned = np.sum(np.cross(b - a, c - a) * np.cross(after - before, last - before), axis=1)
    assert turned.min() > -1e-15


def test_a_mesh_of_a_ball_is_nearly_the_ball():
    collider, ball, x = ms.MeshCollider(sphere_mesh()), EXAMPLES["sphere"], points()
    gap, normal, _ = collider.gap(x)
    exact, outward, _ = ball.gap(x)
    np.testing.assert_allclose(gap, exact, atol=0.005)
    outside = exact > 0.1
    assert np.sum(normal * outward, axis=1)[outside].min() > 0.99
    first, second = slopes(collider, x)
    smooth = np.abs(first - normal).max(axis=1) < 1e-5
    assert smooth.mean() > 0.9
    agrees = np.abs(second - collider.gap(x)[2]).max(axis=(1, 2)) < 1e-3
    assert agrees[smooth].mean() > 0.9


def box_mesh(half):
    """A closed mesh of a box about the origin."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return ms.TriangleMesh(corners, [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])


def test_a_mesh_of_a_box_is_the_box():
    mesh = box_mesh((0.5, 0.3, 0.2))
    box, x = ms.Box((0, 0, 0), (0.5, 0.3, 0.2)), points(3)
    found, exact = ms.MeshCollider(mesh).gap(x), box.gap(x)
    np.testing.assert_allclose(found[0], exact[0], atol=1e-12)
    np.testing.assert_allclose(found[1], exact[1], atol=1e-9)
    np.testing.assert_allclose(found[2], exact[2], atol=1e-6)
    with pytest.raises(ms.OptionError, match="normals of mesh must point outward"):
        ms.MeshCollider(ms.TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]))
    with pytest.raises(ms.OptionError, match="mesh must be closed: the edge of vertices"):
        ms.MeshCollider(ms.TriangleMesh(mesh.vertices, mesh.faces[:-1]))


def bodies(*parts):
    """One mesh of boxes: half their size, their middle, and whether their normals point inward."""
    vertices, faces = [], []
    for number, (half, middle, inward) in enumerate(parts):
        box = box_mesh((half,) * 3)
        vertices.append(np.array(box.vertices) + np.array([middle, 0.0, 0.0]))
        faces.append(np.array(box.faces)[:, :: -1 if inward else 1] + 8 * number)
    return ms.TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ([(0.5, 0.0, False), (0.2, 2.0, True)], "those of the body of triangle 12 point inward, and it is no hollow"),
        ([(0.5, 0.0, False), (0.3, 0.6, False)], "mesh must not cross itself .got triangles"),
        ([(0.5, 0.0, False), (0.2, 0.1, False)], "of triangle 12, that lies in another"),
    ],
)
def test_bodies_whose_inside_is_not_told_are_refused(parts, said):
    """The gap of a point beside the second body was that of one inside it, and inside both that of one outside."""
    with pytest.raises(ms.OptionError, match=said):
        ms.MeshCollider(bodies(*parts))


def test_bodies_apart_and_hollow_ones_are_taken():
    apart = ms.MeshCollider(bodies((0.5, 0.0, False), (0.2, 2.0, False)))
    np.testing.assert_allclose(apart.gap(np.array([[2.0, 0.0, 0.3], [0.0, 0.0, 0.45]]))[0], [0.1, -0.05])
    hollow = ms.MeshCollider(bodies((0.5, 0.0, False), (0.3, 0.1, True), (0.1, 0.1, False)))
    np.testing.assert_allclose(hollow.gap(np.array([[0.1, 0.0, 0.25], [0.1, 0.0, 0.45]]))[0], [0.05, -0.05])


def test_a_flat_face_is_flat_where_its_triangles_meet_too():
    """Above the diagonal of a face the curvature was that about an edge, one over the gap."""
    collider, box = ms.MeshCollider(box_mesh((0.5, 0.5, 0.5))), ms.Box((0, 0, 0), (0.5, 0.5, 0.5))
    along = np.linspace(-0.4, 0.4, 9)
    above = np.full(9, 0.51)
    x = np.concatenate([np.column_stack([along, along, above]), np.column_stack([along, -along, above])])
    for found, exact in zip(collider.gap(x), box.gap(x), strict=True):
        np.testing.assert_allclose(found, exact, atol=1e-9)


@pytest.mark.slow
def test_a_strip_lies_on_a_mesh_as_on_its_ball():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(12, 2))
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    shell = ms.Shell(mesh, material, clamped="x < 1e-9")
    low = ms.SupportPath([0.0, 1.0], [(0.6, -0.2, -0.82), (0.6, -0.2, -0.82)])  # the ball's top is at z = -0.02
    given = {"gravity": (0, 0, -9.81)}
    on_ball = ms.DiscreteShell(shell).equilibrium(contacts=[ms.Contact(EXAMPLES["sphere"], motion=low)], **given)
    body = ms.Contact(ms.MeshCollider(sphere_mesh()), motion=low)
    on_mesh = ms.DiscreteShell(shell).equilibrium(contacts=[body], **given)
    assert on_ball.converged
    assert on_mesh.converged
    assert on_mesh.deepest <= 1e-9
    assert ms.measure.displacement_error(on_mesh.positions, on_ball.positions, shell) < 0.05


@pytest.mark.slow
def test_normals_on_a_mesh_are_those_of_its_faces_next_to_it_too():
    """Offsets of some 1e-12 m have no direction but by rounding: a strip came to rest elsewhere than on the box."""
    turn, half = Rotation.from_rotvec((0.05, 0.1, 0.0)), np.array((0.05, 0.2, 0.05))
    box = ms.Box((0.3, 0.01, -0.12), half, rotation=turn.as_rotvec())
    mesh = box_mesh(half.tolist())
    collider = ms.MeshCollider(ms.TriangleMesh(turn.apply(np.array(mesh.vertices)) + box.center, mesh.faces))
    inner = np.random.default_rng(0).uniform(-0.9, 0.9, (50, 2)) * half[:2]
    top = turn.apply(np.column_stack([inner, np.full(50, half[2])])) + box.center
    up = turn.apply((0.0, 0.0, 1.0))
    for away in (1e-14, 1e-12, 1e-11, -1e-12):
        np.testing.assert_allclose(collider.gap(top + away * up)[1], np.tile(up, (50, 1)), atol=1e-12)
    mesh = ms.flat_beam(length=0.4, width=0.12, cells=(12, 4))
    shell = ms.Shell(mesh, ms.Isotropic(young=2e6, poisson=0.3, thickness=2e-3, density=300.0), "x < 0.001")
    for model in (ms.DiscreteShell(shell), ms.ModalWarping(ms.solve_modes(shell, 8))):
        answers = [model.equilibrium(gravity=(0.0, 0.0, -2.943), contacts=[ms.Contact(one)]) for one in (box, collider)]
        assert answers[1].converged
        np.testing.assert_allclose(answers[1].positions, answers[0].positions, atol=1e-9)


def test_a_point_that_is_not_finite_has_no_gap():
    """A search that has lost its way asks for it: the kernel left its room unwritten, which crashed."""
    assert np.isnan(ms.MeshCollider(sphere_mesh()).gap(np.full((2, 3), np.nan))[0]).all()


@pytest.mark.parametrize("key", [key for key in EXAMPLES if key != "height-field"])
def test_normals_and_curvatures_are_derivatives_of_the_distance(key):
    collider, x = EXAMPLES[key], points()
    gap, normal, curvature = collider.gap(x)
    np.testing.assert_allclose(collider.distance(x), gap, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    first, second = slopes(collider, x)
    # Differences across the border of two features are not derivatives of either.
    smooth = np.abs(first - normal).max(axis=1) < 1e-4
    assert smooth.mean() > 0.97
    kinked = np.abs(second - curvature).max(axis=(1, 2)) > 1e-4 * (1.0 + np.abs(curvature).max(axis=(1, 2)))
    assert (kinked & smooth).mean() < 0.03
    np.testing.assert_allclose(np.einsum("nij,nj->ni", curvature, normal), 0.0, atol=1e-9)


def test_the_height_field_is_exact_on_its_surface():
    collider, x = EXAMPLES["height-field"], points() * 0.4
    for _ in range(60):
        gap, normal, _ = collider.gap(x)
        x = x - gap[:, None] * normal
    gap, normal, curvature = collider.gap(x)
    assert np.abs(gap).max() < 1e-14
    first, second = slopes(collider, x)
    np.testing.assert_allclose(first, normal, atol=1e-8)
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    np.testing.assert_allclose(across @ second @ across, curvature, atol=1e-6)
    beyond = collider.gap(np.array([[9.0, 9.0, 1.0]]))
    assert beyond[0] == pytest.approx(1.0 - HILL[-1, -1])


@pytest.mark.parametrize("key", ["sphere", "cylinder", "capsule"])
def test_a_point_on_the_feature_is_led_out(key):
    collider = EXAMPLES[key]
    at = collider.center if key == "sphere" else 0.5 * (collider.a + collider.b)
    gap, normal, curvature = collider.gap(at[None])
    assert gap[0] == pytest.approx(-collider.radius) or key == "cylinder"
    assert np.linalg.norm(normal[0]) == pytest.approx(1.0)
    assert np.isfinite(curvature).all()


def test_a_moving_contact_carries_its_collider():
    path = ms.SupportPath([0.0, 1.0], [(0.0, 0.0, 0.0), (0.0, 0.0, 2.0)], [(0.0, 0.0, 0.0), (0.3, 0.2, 0.1)])
    still, moving = ms.Contact(EXAMPLES["box"]), ms.Contact(EXAMPLES["box"], motion=path)
    x, pose = points(), path.at(0.4)
    for here, there in zip(still.gap(pose.to_shell(x)), moving.gap(x, 0.4), strict=True):
        assert here.shape == there.shape
    np.testing.assert_allclose(moving.gap(x, 0.4)[0], still.gap(pose.to_shell(x))[0])
    first, second = slopes(type("At", (), {"gap": lambda _, y: moving.gap(y, 0.4)})(), x[:50])
    assert (np.abs(first - moving.gap(x[:50], 0.4)[1]).max(axis=1) < 1e-4).mean() > 0.9
    assert (np.abs(second - moving.gap(x[:50], 0.4)[2]).max(axis=(1, 2)) < 1e-3).mean() > 0.9
    assert moving.largest_move(x, 0.0, 1.0) > 1.9


@pytest.mark.parametrize("second", [1.0, 1e-9, 1e9])
@pytest.mark.parametrize("seen", [False, True])
def test_the_velocity_of_a_moving_contact_is_that_of_its_path_in_any_unit_of_time(second, seen):
    """It was a difference over a microsecond: in units of a second that is a thousandth of one it was any."""
    times, turns = second * np.array([0.0, 0.3, 1.0]), [(0.0, 0.0, 0.0), (0.6, 0.2, 0.0), (0.3, 0.2, 0.1)]
    path = ms.SupportPath(times, [(0, 0, 0), (0, 1, 0), (0, 0, 2)], turns, pivot=(0.5, 0.0, 0.0))
    frame = ms.SupportPath(times, [(0, 0, 0), (1, 1, 0), (0, 0, 0)], turns[::-1], pivot=(0.0, 0.3, 0.0))
    for contact in (ms.Contact(EXAMPLES["box"], motion=path), *([ms.Contact(EXAMPLES["box"])] if seen else [])):
        moving, x, at, step = contact.seen_from(frame if seen else None), points(), 0.4 * second, 1e-4 * second
        own = moving.motion.at(at).to_shell(x)
        ends = [moving.motion.at(at + sign * step).to_world(own) for sign in (-1.0, 1.0)]
        np.testing.assert_allclose(second * moving.velocity(x, at), (ends[1] - ends[0]) / 2e-4, atol=1e-5)


def test_a_straight_way_through_a_thin_body_is_seen_however_long():
    """Of 64 places along it none lay inside."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(2, 2))
    shell, rest = ms.Shell(mesh, ms.Material(1.0, 1.0, 1.0, 1.0)), mesh.vertices
    for height in np.linspace(0.1, 0.9, 23):
        thin = Touching([ms.Contact(ms.Box((0.0, 0.0, height), (2.0, 2.0, 1e-3)))], shell)
        assert thin.crossed(rest, rest + np.array([0.0, 0.0, 1.0]))
        assert not thin.crossed(rest, rest + np.array([0.0, 0.0, height - 1e-3]))
        assert not thin.crossed(rest, rest + np.array([1.0, 0.0, 0.05]))
    assert not thin.crossed(rest, rest + np.array([0.0, 0.0, np.nan]))
    assert thin.crossed(rest, rest + np.array([0.0, 0.0, 1e6]))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ms.Plane((0, 0, 0)), "normal must not be zero"),
        (lambda: ms.Plane((0, 0, 1), np.nan), "offset must be a finite number"),
        (lambda: ms.Sphere((0, 0, 0), 0.0), "radius must be a finite number above 0"),
        (lambda: ms.Sphere((0, np.inf, 0), 1.0), "center must be finite"),
        (lambda: ms.Cylinder((0, 0, 0), (0, 0, 0), 1.0), "a and b must be two points"),
        (lambda: ms.Capsule((0, 0, 0), (0, 0, 1), -1.0), "radius must be"),
        (lambda: ms.Box((0, 0, 0), (1, 1, 0)), "half must be three positive lengths"),
        (lambda: ms.Box((0, 0, 0), (1, 1, 1), rounding=2.0), "rounding must be"),
        (lambda: ms.HeightField(np.zeros((3, 9)), 1.0), "at least 4 x 4"),
        (lambda: ms.HeightField(np.full((4, 4), np.nan), 1.0), "z must be finite"),
        (lambda: ms.Contact("floor"), "collider must be a Collider"),
        (lambda: ms.Contact(ms.Plane(), friction=-0.1), "friction must be"),
        (lambda: ms.Contact(ms.Plane(), restitution=1.5), "restitution must be"),
        (lambda: ms.Contact(ms.Plane(), sel="x <"), "sel cannot read"),
        (lambda: ms.Contact(ms.Plane(), push_out=-1.0), "push_out must be"),
    ],
)
def test_bad_colliders_are_refused_by_name(make, said):
    with pytest.raises(ms.OptionError, match=said):
        make()


@pytest.mark.parametrize("kind", EXAMPLES)
def test_drawn_surfaces_lie_on_their_colliders(kind):
    collider, corners = EXAMPLES[kind], np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]])
    vertices, triangles = collider.surface(corners)
    if kind != "height-field":
        on = collider.gap(vertices)[0]
        assert np.abs(on[1:-1]).max() < 1e-9 or kind == "cylinder"
    assert triangles.max() < len(vertices)
    turn = np.cross(*(vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2)))
    middle = vertices[triangles].mean(axis=1)
    outward = np.sum(turn * collider.gap(middle)[1], axis=1)
    big = np.linalg.norm(turn, axis=1) > 1e-4
    assert (outward[big] > 0.0).all() or (outward[big] < 0.0).all()


@pytest.mark.by_default("True-collider0", "True-collider1", "False-collider2", "False-collider3", "False-collider4")
@pytest.mark.parametrize(
    "collider",
    [
        ms.Plane((1, 2, 3), 0.2),
        ms.Sphere((0.1, 0.2, 0.3), 0.7),
        ms.Capsule((0, 0, 0), (0.5, 0.2, 0.1), 0.3),
        ms.Cylinder((0, 0, -0.2), (0.4, 0.1, 0.5), 0.6),
        ms.Box((0.1, 0, 0), (0.5, 0.4, 0.6), rotation=(0.1, 0.5, -0.3), rounding=0.15),
    ],
)
@pytest.mark.parametrize("moving", [False, True])
def test_compiled_gaps_and_normals_are_those_of_the_collider(collider, moving):
    path = ms.SupportPath([0.0, 1.0], [(0, 0, 0), (0.3, 0.1, 0.2)], [(0, 0, 0), (0.2, -0.4, 0.5)])
    contact, origin = ms.Contact(collider, motion=path if moving else None), np.array([0.3, -0.2, 0.1])
    x = np.random.default_rng(3).uniform(-1.2, 1.2, (400, 3))
    kinds, numbers = packed([contact], forms_of([contact]), 0.4, origin)
    gap, normal, _ = contact.gap(x + origin, 0.4)
    found = np.empty(3)
    for point, distance, direction in zip(x, gap, normal, strict=True):
        assert gap_at(kinds[0], numbers[0], *point, found) == pytest.approx(distance, abs=1e-13)
        np.testing.assert_allclose(found, direction, atol=1e-12)
