import numpy as np
import pytest
from junctions import moebius
from scenes import held

import modalshell as ms


@pytest.fixture(scope="module")
def mesh():
    return ms.flat_beam(length=1.0, width=0.2, cells=(8, 4))


@pytest.fixture(scope="module")
def end(mesh):
    return mesh.vertices[:, 0] > 0.99


@pytest.mark.parametrize(
    "selection",
    [lambda _: "x > 0.99", lambda end: end, np.flatnonzero, lambda end: np.flatnonzero(end).tolist()],
    ids=["text", "mask", "numbers", "list"],
)
def test_a_point_force_acts_at_each_vertex(selection, mesh, end):
    force = ms.PointForce(selection(end), (0.0, 1.0, -2.0)).force(mesh)
    np.testing.assert_array_equal(force, np.where(end[:, None], [0.0, 1.0, -2.0], 0.0))


@pytest.mark.parametrize("order", [[0, 1, 2], [1, 2, 0], [0, 2, 1]])
def test_follower_forces_turn_by_the_rotation_in_a_strain(mesh, order):
    """However triangles wind and wherever they begin: it was that of one edge, by 9e-4 of the force here."""
    shell = held(ms.TriangleMesh(mesh.vertices, mesh.faces[:, order]), 0.1)
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    turn *= np.linalg.det(turn)
    strain = np.array([[0.1, 0.02, 0.0], [0.02, -0.05, 0.0], [0.0, 0.0, 0.0]]) + np.eye(3)
    force = np.array([1.0, -2.0, 3.0])
    loading = shell.loading(loads=[ms.FollowerForce([7, 11], force)])
    found = loading.force(shell.rest_positions @ strain @ turn.T)
    np.testing.assert_allclose(found[[7, 11]], np.tile(turn @ force, (2, 1)), atol=1e-13)


def test_a_line_force_counts_by_length(mesh, end):
    force = ms.LineForce("x > 0.99", (0.0, 0.0, -3.0)).force(mesh)
    np.testing.assert_allclose(force.sum(axis=0), [0.0, 0.0, -3.0 * 0.2], rtol=1e-14)
    assert not force[~end].any()
    along = mesh.vertices[end, 1]
    shares = force[end, 2] / (-3.0 * 0.05)
    np.testing.assert_allclose(shares, np.where(np.abs(np.abs(along) - 0.1) < 1e-9, 0.5, 1.0), rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ms.PointForce("x > 2", (0, 0, 1)), r"sel selects no vertex \(got 'x > 2'\); the mesh reaches from"),
        (lambda: ms.PointForce([], (0, 0, 1)), "sel selects no vertex"),
        (lambda: ms.PointForce([999], (0, 0, 1)), "sel names vertex 999, but the mesh has vertices 0 to 44"),
        (lambda: ms.PointForce(np.arange(44) > 40, (0, 0, 1)), r"sel must be a mask \(45,\)"),
        (lambda: ms.PointForce("x >", (0, 0, 1)), "sel cannot read the selection"),
        (lambda: ms.LineForce([0, 44], (0, 0, 1)), "sel selects 2 vertices, but no edge between two of them"),
    ],
)
def test_selections_that_fit_no_mesh_are_refused(make, message, mesh):
    with pytest.raises(ms.OptionError, match=message):
        make().force(mesh)


@pytest.mark.parametrize("kind", [ms.PointForce, ms.LineForce, ms.FollowerForce, ms.EdgeMoment, ms.Pressure, ms.Wind])
def test_selections_that_are_none_are_refused_where_the_load_is_made(kind):
    given = {ms.EdgeMoment: {"m": 1.0}, ms.Pressure: {"p": 1.0}, ms.Wind: {"velocity": (0, 0, 1)}}
    refused = ("x >", "sel cannot read"), ([0.5], "sel must be bool"), ([[True], [False]], "sel must be a mask")
    for sel, message in refused:
        with pytest.raises(ms.OptionError, match=message):
            kind(sel=sel, **given.get(kind, {"force": (0, 0, 1)}))


def test_a_moment_is_refused_where_an_edge_has_no_two_sides():
    """Each triangle took its part by its own winding, so that the couple depended on that."""
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 1], [0, -1, -1]]
    tee = ms.TriangleMesh(np.array(points, float), [[0, 1, 2], [1, 0, 3], [1, 0, 4]])
    with pytest.raises(ms.OptionError, match=r"edge between the vertices \[0, 1\], where three sheets meet"):
        ms.EdgeMoment([0, 1], 1.0).force(tee)
    assert np.abs(ms.EdgeMoment([0, 2], 1.0).force(tee)).max() > 0.1
    strip = moebius()
    with pytest.raises(ms.OptionError, match="turns over"):
        ms.EdgeMoment(np.unique(strip.edges[strip.seams]), 1.0).force(strip)


def test_loads_act_in_statics_as_their_forces_do(mesh, end):
    shell = held(mesh, 0.13)
    loads = [ms.PointForce(end, (0.0, 0.0, -1e-4)), ms.LineForce(end, (0.0, 1e-3, 0.0))]
    force = sum(load.force(mesh) for load in loads)
    for model in (ms.DiscreteShell(shell), ms.ModalWarping(ms.solve_modes(shell, 4))):
        by_loads, by_force = model.equilibrium(loads=loads), model.equilibrium(force=force)
        np.testing.assert_array_equal(by_loads.positions, by_force.positions)
        both = model.equilibrium(loads=loads[:1], force=loads[1].force(mesh))
        np.testing.assert_allclose(both.positions, by_force.positions, atol=1e-12)
        with pytest.raises(ms.OptionError, match="each of loads must be a Load"):
            model.equilibrium(loads=[force])


def test_loads_act_in_motion_as_their_forces_do(mesh, end):
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.13)
    load = ms.PointForce(end, (0.0, 0.0, -1e-4))
    model = ms.LinearModal(ms.solve_modes(shell, 4))
    by_loads, by_force = (
        ms.simulate(model, duration=0.2, **options) for options in ({"loads": [load]}, {"force": load.force(mesh)})
    )
    assert by_loads.positions[-1, end, 2].max() < -1e-6
    np.testing.assert_array_equal(by_loads.positions, by_force.positions)
