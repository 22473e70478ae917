"""The chart of an equilibrium path: exact on the path, stable where the shell is, both sides of a snap."""

import numpy as np
import pytest

import modalshell as ms
from studies.path_chart import end_forces, tilted, trained_loads
from studies.path_coordinates import Atlas, make_chart
from studies.snap import v_beam

UNTIL, BACK = 80.0, -15.0


@pytest.fixture(scope="module")
def shell():
    return v_beam(150.0, (16, 4))


@pytest.fixture(scope="module")
def chart(shell):
    down, *others = trained_loads(shell)
    return make_chart(shell, down, UNTIL, BACK, others)


@pytest.fixture(scope="module")
def path(shell):
    return ms.equilibrium_path(shell, gravity=(0, 0, -1), until=UNTIL, steps=40)


def test_a_point_of_the_path_is_what_its_own_load_gives_back_where_it_is_stable(shell, chart, path):
    """And where it is not, by a limit point or by twisting, the chart has no state there."""
    size = np.abs(path.positions - shell.rest_positions).max()
    events = [event.index for event in path.events]
    both = 0
    for k in range(3, len(path.factors) - 1):
        if k in events:
            continue  # neither stable nor not
        states = [chart.positions(state) for state in chart.states(shell.gravity_force((0, 0, -path.factors[k])))]
        nearest = min((np.abs(x - path.positions[k]).max() for x in states), default=np.inf)
        if path.stable[k]:
            assert nearest < 1e-6 * size
        else:
            assert nearest > 1e-3 * size
        both += len(states) == 2
    assert not path.stable.all()
    assert both > 0


def test_stability_is_that_of_the_tangent(shell, chart, path):
    """The lowest eigenvalue across the path is the constrained tangent's, a little above it on fewer vectors."""
    dofs = (3 * shell.free[:, None] + np.arange(3)).ravel()
    root = np.sqrt(np.repeat(shell.mass[shell.free], 3))
    pull = np.array(shell.gravity_force((0, 0, -1.0))).ravel()[dofs] / root
    pull /= np.linalg.norm(pull)
    off = np.eye(len(dofs)) - np.outer(pull, pull)
    for k in np.flatnonzero(
        np.isin(np.arange(len(path.factors)), np.linspace(2, len(path.factors) - 2, 6).astype(int))
    ):
        tangent = shell.stiffness(path.positions[k]).toarray()[np.ix_(dofs, dofs)] / np.outer(root, root)
        exact = np.sort(np.linalg.eigvalsh(off @ tangent @ off))
        exact = exact[np.abs(exact) > 1e-6][0]  # but for that of the pull itself
        q = (path.positions[k] - shell.rest_positions).ravel()[dofs] @ (pull * root) / np.abs(pull * root).sum()
        own = np.linalg.eigvalsh(chart.stiffness(q))[0]
        assert exact - 1e-6 * abs(exact) <= own <= exact + 0.05 * abs(exact)
        assert (own > 0.0) == (exact > 0.0)


def test_loads_aside_are_answered_on_both_sides_of_the_snap(shell, chart):
    down, *others = trained_loads(shell)
    atlas = Atlas([chart, make_chart(shell, tilted(shell, 1.0, 0.2, np.pi / 2), UNTIL, BACK, [down, *others])])
    corner = end_forces(shell)[1]
    for load in (tilted(shell, 25.0, 0.15, np.pi / 2), tilted(shell, 70.0, 0.15, np.pi / 2), 0.1 * corner):
        exact = ms.DiscreteShell(shell).equilibrium(force=load).positions
        assert ms.measure.displacement_error(atlas.states(load)[0], exact, shell) < 0.03
    assert len(atlas.states(tilted(shell, 40.0, 0.0, 0.0))) == 2


def test_a_path_whose_coordinate_turns_back_is_refused():
    mesh = ms.cylinder_panel(cells=(6, 8), angle=40.0)
    across = np.abs(mesh.vertices[:, 1])
    shell = ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.005, 0.2), across > across.max() - 1e-9)
    middle = np.argmin(np.linalg.norm(mesh.vertices - mesh.vertices.mean(axis=0), axis=1))
    force = np.zeros(mesh.vertices.shape)
    force[middle, 2] = -1.0
    with pytest.raises(ms.SolverError, match="turns back"):
        make_chart(shell, force, 3.0, -0.1, steps=10)
