"""Modal models say where a state is beyond what they can describe, all by the same criteria."""

import sys

import numpy as np
import pytest
from scenes import Made, jittered

import modalshell as ms
from modalshell.mesh.topology import area_vectors
from modalshell.models.base.distortion import Distortion
from modalshell.models.base.distortion_kernels import surface_changes


@pytest.fixture(scope="module")
def basis():
    mesh = ms.v_beam(cells=(16, 4))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), clamped=mesh.vertices[:, 0] < 0.07)
    return ms.solve_modes(shell, 6)


@pytest.mark.parametrize("model", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_small_motion_has_no_fault(model, basis):
    run = ms.simulate(model(basis), duration=0.5, dt=1 / 30, gravity=(0, 0, -2.0), damping=(1.0, 0.0))
    assert run.outcome is ms.Outcome.COMPLETED


def test_linear_modes_that_inflate_the_surface_are_distorted(basis):
    run = ms.simulate(ms.LinearModal(basis), duration=3.0, dt=1 / 30, gravity=(0, 0, -80.0), damping=(1.0, 0.0))
    assert run.outcome is ms.Outcome.DISTORTED
    assert "stretched or folded over" in run.message
    answer = ms.LinearModal(basis).equilibrium(gravity=(0, 0, -80.0))
    assert answer.outcome is ms.Outcome.DISTORTED
    assert answer.converged  # its equations are solved
    assert not answer.outcome.succeeded
    assert "surface area" in answer.message


@pytest.fixture(scope="module")
def models(basis):
    """Every modal rung."""
    full = ms.RotationStrain(basis)
    trained = ms.ReducedRotationStrain.trained(full, [(0, 0, -1.0), (0, 0, -3.0)], rank=6)
    derivatives = ms.ModalDerivatives(basis.shell, 4)
    return [ms.LinearModal(basis), ms.ModalWarping(basis), full, trained, derivatives]


def fault(model, state):
    """What the model says of a state at its own positions."""
    return model.fault(state, model.positions(state))


def crumpled_state(model):
    """A state at rest whose coordinates are far beyond all loads."""
    state = model.start_motion()
    state.coordinates[:] = 100.0 * model.shell.size * np.sqrt(model.shell.mass.sum())
    return state


def test_every_modal_model_names_crumpled_motion(models):
    for model in models:
        assert fault(model, model.start_motion()) is None
        assert fault(model, crumpled_state(model)) in (ms.Outcome.WOUND_UP, ms.Outcome.DISTORTED), model.name


def test_every_modal_model_judges_its_answers_by_the_same_rule(models, monkeypatch):
    load = {"gravity": (0.0, 0.0, -10.0)}
    assert all(model.equilibrium(**load).outcome is ms.Outcome.CONVERGED for model in models)
    monkeypatch.setattr(sys.modules["modalshell.models.base.distortion"], "_AREA", 1.0 + 1e-9)
    for model in models:
        answer = model.equilibrium(**load)
        assert answer.outcome is ms.Outcome.DISTORTED, model.name
        assert answer.message.startswith("beyond what the model can describe: the surface area is")


@pytest.mark.parametrize("model", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_every_modal_model_names_a_state_outside_its_reach(model, basis):
    chosen = model(basis)
    q = 3.0 * np.ones(basis.count) / np.sqrt(basis.eigenvalues) * np.sqrt(basis.eigenvalues[0])
    state = chosen.start_motion()
    assert fault(chosen, state) is None
    state.coordinates[:] = q * 20.0
    assert fault(chosen, state) in (ms.Outcome.WOUND_UP, ms.Outcome.DISTORTED)


def test_distortion_sees_stretch_collapse_and_folds():
    mesh = ms.flat_beam(cells=(20, 4))
    rest = np.asarray(mesh.vertices)
    distortion = Distortion(mesh).of
    assert distortion(rest) == ""
    bent = rest.copy()
    bent[:, 0], bent[:, 2] = np.sin(2.0 * rest[:, 0]) / 2.0, (1.0 - np.cos(2.0 * rest[:, 0])) / 2.0
    assert distortion(bent) == ""
    assert "area is 2.2" in distortion(rest * [1.5, 1.5, 1.0])
    assert "area is 0.25" in distortion(rest * [0.5, 0.5, 1.0])
    locally = rest.copy()
    locally[:, 0] = np.where(rest[:, 0] > 0.8, rest[:, 0] + 1.5 * (rest[:, 0] - 0.8), rest[:, 0])
    assert "doubled or halved on 20 % of the surface" in distortion(locally)
    crumpled = rest.copy()
    crumpled[:, 0] = np.abs((rest[:, 0] + 0.1) % 0.2 - 0.1)  # a zigzag of leaves 0.1 m long
    assert "fold over" in distortion(crumpled)


def test_surface_changes_are_those_of_every_face_and_pair():
    mesh = ms.v_beam(cells=(12, 4))
    pairs = np.ascontiguousarray(mesh.edge_faces[mesh.hinge_edges])
    rng = np.random.default_rng(4)
    for size in (0.0, 0.01, 0.05, 0.3):
        x = mesh.vertices + size * rng.standard_normal(mesh.vertices.shape)
        normals = area_vectors(x, mesh.faces)
        lengths = np.linalg.norm(normals, axis=1)
        ratio = 0.5 * lengths / mesh.face_areas
        units = (normals / lengths[:, None])[pairs]
        folded = int((np.einsum("hi,hi->h", units[:, 0], units[:, 1]) < -0.5).sum())
        for ignored in (-1, folded - 1, folded, len(pairs)):
            area, changed, counted = surface_changes(
                x, mesh.faces, mesh.face_areas, pairs, 2.0, -0.5, ignored, np.empty((4, len(mesh.faces)))
            )
            assert area == pytest.approx(0.5 * lengths.sum(), rel=1e-13)
            assert changed == pytest.approx(mesh.face_areas[(ratio > 2.0) | (ratio < 0.5)].sum(), rel=1e-13)
            assert counted == folded or (counted == 0 and folded <= ignored)


SURFACES = Made(
    {
        "flat": lambda: ms.flat_beam(cells=(80, 24)),
        "jittered": lambda: jittered((64, 30)),
        "folded": lambda: ms.v_beam(cells=(100, 20)),
    }
)


@pytest.mark.by_default("jittered", "folded")
@pytest.mark.parametrize("surface", SURFACES)
def test_a_sample_of_the_surface_misses_no_distortion(surface, monkeypatch):
    mesh = SURFACES[surface]
    sampled, whole = Distortion(mesh), Distortion(mesh)
    monkeypatch.setattr(whole, "_sample", None)
    assert sampled._sample is not None
    rest, rng = np.asarray(mesh.vertices), np.random.default_rng(5)
    middle, size = rest.mean(axis=0), np.ptp(rest, axis=0).max()
    seen, cleared = set(), 0
    for turn in range(300):
        place = rest[rng.integers(len(rest))]
        near = np.linalg.norm(rest - place, axis=1) < size * rng.uniform(0.0, 0.5)
        kind, amount = turn % 4, rng.uniform(0.0, 2.0)
        moved = rest.copy()
        if kind == 0:  # a patch is pulled apart or pushed together
            moved[near] = place + (rest[near] - place) * amount
        elif kind == 1:  # all of the surface is
            moved = middle + (rest - middle) * amount
        elif kind == 2:  # a patch is crumpled
            moved[near] += 0.03 * size * amount * rng.standard_normal((int(near.sum()), 3))
        else:  # a narrow strip in some direction is folded over
            along = (rest - place) @ (way := rng.standard_normal(3)) / np.linalg.norm(way)
            moved -= 2.0 * np.clip(along, 0.0, 0.05 * size * amount)[:, None] * way / np.linalg.norm(way)
        if turn % 5 == 0:  # a few vertices are thrown away, or lost
            far = 10.0 ** rng.uniform(0.0, 6.0)
            lost = rng.integers(len(rest), size=3)
            moved[lost] = far * rest[lost] if turn % 10 else rng.choice([np.nan, np.inf])
        elif turn % 7 == 0:  # all are far from the origin
            moved += 10.0 * size * rng.standard_normal(3)
        said = sampled.of(moved)
        assert said == whole.of(moved)
        seen.add(said.split()[2] if said else "")
        cleared += sampled._clear(moved)
    assert len(seen) >= 3  # none, and two kinds at least
    assert cleared > 50


def test_a_mesh_of_unlike_triangles_is_looked_at_whole():
    mesh = ms.flat_beam(cells=(80, 24))
    graded = np.array(mesh.vertices)
    graded[:, 0] = np.expm1(10.0 * graded[:, 0]) / np.expm1(10.0)
    assert Distortion(ms.TriangleMesh(graded, mesh.faces))._sample is None


def test_no_vertex_is_farther_than_a_model_tells(models):
    rng = np.random.default_rng(3)
    for model in models[:4]:  # modal derivatives are judged by themselves
        state = model.start_motion()
        for size in (0.01, 0.3, 3.0):
            q = size * rng.standard_normal(model.basis.count) / model.reach
            moved = np.linalg.norm(model.raw_displacement(q), axis=1).max()
            assert moved <= (1.0 + 1e-12) * model.farthest(q)
        assert not model.farthest(np.full_like(q, np.nan)) <= 1.0
        assert model.fault(state, model.positions(state)) is None


def test_extents_are_looked_at_where_vertices_may_be_far():
    mesh = ms.flat_beam(length=1.0, width=1.0, cells=(60, 60))
    far = mesh.vertices.copy()
    far[:7, 2] += 1e6  # the sample's triangles need not see them
    looked = []
    distortion = Distortion(mesh)
    together, distortion._together = distortion._together, lambda x: looked.append(len(x)) or together(x)
    assert distortion.of(mesh.vertices, lambda: 0.4) == ""
    assert looked == []
    assert distortion.of(far, lambda: 1e6) == distortion.of(far) != ""
    assert distortion.of(mesh.vertices, lambda: 0.6) == distortion.of(mesh.vertices, lambda: np.nan) == ""
    assert len(looked) == 4
