import numpy as np
import pytest

import modalshell as ms
from modalshell.shell.strain_range import strained_beyond


@pytest.fixture(scope="module")
def mesh():
    return ms.flat_beam(length=1.0, width=0.2, cells=(10, 2))


@pytest.fixture(scope="module")
def shell(mesh):
    return ms.Shell(mesh, ms.Isotropic(young=1e6, poisson=0.3, thickness=5e-3, density=100.0), clamped="x < 1e-6")


def stretched(mesh, factor, beyond=0.0):
    """Positions of the mesh with what lies further than ``beyond`` drawn out along x."""
    x = mesh.vertices.copy()
    x[:, 0] += (factor - 1.0) * np.maximum(x[:, 0] - beyond, 0.0)
    return x


@pytest.mark.parametrize("factor", [0.95, 1.0, 1.05])
def test_small_strains_are_not_worth_a_word(mesh, shell, factor):
    assert strained_beyond(shell, stretched(mesh, factor)) == ""


@pytest.mark.parametrize(("beyond", "share"), [(0.0, 100), (0.5, 50)])
def test_large_strains_are_named_with_their_share_of_the_area(mesh, shell, beyond, share):
    said = strained_beyond(shell, stretched(mesh, 1.2, beyond))
    assert "strains by up to 22 %" in said  # Green strain (1.2^2 - 1) / 2
    assert f"more than 10 % on {share} % of the area" in said


def test_strains_count_from_the_shape_without_stress(mesh):
    sheet = ms.Isotropic(young=1e6, poisson=0.3, thickness=5e-3, density=100.0)
    drawn = ms.Shell(mesh, sheet, clamped="x < 1e-6", prestrain=np.diag([0.22, 0.0, 0.0]))
    assert strained_beyond(drawn, stretched(mesh, 1.2)) == ""
    assert "up to 22 %" in strained_beyond(drawn, mesh.vertices)


def test_springs_of_hinge_shells_have_no_such_range(mesh):
    shell = ms.Shell(mesh, ms.Material(1000.0, 20.0, 0.01, 0.2), clamped="x < 1e-6")
    assert strained_beyond(shell, stretched(mesh, 1.5)) == ""


def rungs(shell):
    coarse = ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(5, 1)), shell.material, clamped="x < 1e-6")
    return {"DS": ms.DiscreteShell(shell), "coarse DS": ms.CoarseDiscreteShell(shell, coarse), "auto": ms.Auto(shell)}


@pytest.mark.by_default("coarse DS", "auto")
@pytest.mark.parametrize("rung", ["DS", "coarse DS", "auto"])
def test_answers_and_motions_of_what_solves_for_all_vertices_say_so_once(mesh, shell, rung):
    end, model = mesh.vertices[:, 0] > 1.0 - 1e-9, rungs(shell)[rung]
    force = np.zeros_like(mesh.vertices)
    force[end, 0] = 1100.0 / end.sum()
    assert model.equilibrium(force=force).message.count("the membrane strains by") == 1
    run = ms.simulate(model, duration=0.02, dt=0.01, force=force)
    assert run.message.count("at its end the membrane strains by") == 1


def test_answers_and_motions_under_constraints_say_so(mesh, shell):
    end, model = mesh.vertices[:, 0] > 1.0 - 1e-9, ms.DiscreteShell(shell)
    target = ms.PositionConstraint(end, mesh.vertices[end].mean(axis=0) + np.array([0.2, 0.0, 0.0]))
    found = model.equilibrium(constraints=[target])
    assert "; the membrane strains by" in f"; {found.message}"
    run = ms.simulate(model, duration=0.02, dt=0.01, start=found.positions, constraints=[target])
    assert "at its end the membrane strains by" in run.message
