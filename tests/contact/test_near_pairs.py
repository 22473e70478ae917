"""Pairs in self-contact against ipctk: energy, derivatives, friction and free ways are the same functions."""

import itertools

import numpy as np
import pytest

import modalshell as ms
from modalshell.contact import face_tree_kernels, pair_kernels, pair_move_kernels
from modalshell.contact.near_pairs import NearPairs
from modalshell.shell.pattern import build_pattern
from modalshell.supports import VertexUnknowns

ipctk = pytest.importorskip("ipctk", reason="ipctk is not installed (pip install 'modalshell[contact]')")

GAP = 1e-2


def sheets(noise, seed=0):
    """Rest positions, triangles and positions of two sheets over each other, all edges parallel without noise."""
    one = ms.flat_beam(length=0.5, width=0.25, cells=(10, 5))
    rest = np.concatenate([one.vertices, one.vertices + np.array([3e-3, 2e-3, 6e-3])])
    x = rest + noise * np.random.default_rng(seed).standard_normal(rest.shape)
    return rest, np.concatenate([one.faces, one.faces + len(one.vertices)]), x


def theirs(near, rest, faces, x):
    """The same by ipctk: its mesh, its pairs, its barrier."""
    parts = (np.asfortranarray(part, np.int32) for part in (near.edges, faces))
    mesh = ipctk.CollisionMesh(np.asfortranarray(rest), *parts)
    pairs = ipctk.NormalCollisions()
    pairs.use_area_weighting = True
    pairs.build(mesh, np.asfortranarray(x), GAP)
    return mesh, pairs, ipctk.BarrierPotential(GAP, 1.0, True)


@pytest.mark.parametrize("noise", [0.0, 1e-6, 5e-4, 1.2e-3])
def test_the_barrier_is_that_of_ipctk(noise):
    rest, faces, x = sheets(noise)
    near = NearPairs(faces, rest, GAP, 0.2 * GAP)
    found, (mesh, pairs, barrier) = near.barrier(x, GAP), theirs(near, rest, faces, x)
    places = np.asfortranarray(x)
    gradient = barrier.gradient(pairs, mesh, places).reshape(-1, 3)
    assert found.energy == pytest.approx(barrier(pairs, mesh, places), rel=1e-11)
    assert np.abs(found.gradient - gradient).max() <= 1e-11 * np.abs(gradient).max()
    assert found.least == pytest.approx(np.sqrt(pairs.compute_minimum_distance(mesh, places)), rel=1e-12)
    stencils = found.pairs[found.active]
    pattern, (slots,) = build_pattern(len(x), [stencils], VertexUnknowns(np.zeros(len(x), bool)))
    hessians = []
    for exactly in (True, False):
        data = np.zeros(pattern.size)
        pair_kernels.add_hessian(x, *found[4:], GAP, found.active, exactly, slots, pattern.strides, data)
        hessians.append(pattern.matrix(data))
    expected = barrier.hessian(pairs, mesh, places, ipctk.PSDProjectionMethod.NONE)
    assert abs(hessians[0] - expected).max() <= 1e-11 * abs(expected).max()
    lowest = np.linalg.eigvalsh(hessians[1].toarray())[0]
    assert lowest >= -1e-12 * abs(hessians[1]).max()


@pytest.mark.parametrize("slide", [1e-5, 3e-3])
def test_friction_is_that_of_ipctk(slide):
    rest, faces, x = sheets(5e-4)
    near = NearPairs(faces, rest, GAP, 0.2 * GAP)
    mesh, pairs, barrier = theirs(near, rest, faces, x)
    rubbing, begin = ipctk.TangentialCollisions(), np.asfortranarray(x)
    rubbing.build(mesh, begin, pairs, barrier, 0.3)
    friction, limit = ipctk.FrictionPotential(1e-3), 1e-3
    own = near.rubbing(x, GAP, near.barrier(x, GAP), 0.3)
    moved = x + slide * np.random.default_rng(1).standard_normal(x.shape)
    energy, gradient = own.energy_gradient(moved, limit)
    way = np.asfortranarray(moved - begin)
    expected = friction.gradient(rubbing, mesh, way).reshape(-1, 3)
    assert energy == pytest.approx(friction(rubbing, mesh, way), rel=1e-10)
    assert np.abs(gradient - expected).max() <= 1e-10 * np.abs(expected).max()
    pattern, (slots,) = build_pattern(len(x), [own.pairs], VertexUnknowns(np.zeros(len(x), bool)))
    data = np.zeros(pattern.size)
    own.add_hessian(moved, limit, slots, pattern.strides, data)
    matrix = friction.hessian(rubbing, mesh, way, ipctk.PSDProjectionMethod.NONE)
    assert abs(pattern.matrix(data) - matrix).max() <= 1e-10 * abs(matrix).max()


@pytest.mark.parametrize("fall", [2e-3, 5e-3, 2e-2, 0.1])
def test_free_ways_are_those_of_ipctk(fall):
    rest, faces, x = sheets(3e-4)
    near = NearPairs(faces, rest, GAP, 0.2 * GAP)
    mesh = theirs(near, rest, faces, x)[0]
    moved = x + 1e-3 * np.random.default_rng(2).standard_normal(x.shape)
    moved[len(x) // 2 :] -= [0.01, 0.0, fall]
    near.about(x, moved)
    ends = (np.asfortranarray(place) for place in (x, moved))
    expected = ipctk.compute_collision_free_stepsize(mesh, *ends, narrow_phase_ccd=ipctk.AdditiveCCD())
    found = pair_move_kernels.free_part(x, moved, near.pairs, near.faced)
    assert found == pytest.approx(expected, rel=1e-9)


def test_kept_pairs_are_all_that_are_near():
    rest, faces, x = sheets(5e-4)
    kept = NearPairs(faces, rest, GAP, 0.2 * GAP)
    random = np.random.default_rng(4)
    seen = []
    for _ in range(12):
        x = x + 1e-3 * random.uniform(-1.0, 1.0, x.shape) / np.sqrt(3.0)
        found = kept.barrier(x, GAP)
        seen.append(found.pairs)
        new = NearPairs(faces, rest, GAP, 0.0).barrier(x, GAP)
        assert found.active.size == new.active.size
        assert found.energy == pytest.approx(new.energy, rel=1e-12)
    assert any(one is other for one, other in itertools.pairwise(seen))


def test_places_that_may_not_be_written_to_are_met_by_the_same_kernels():
    rest, faces, x = sheets(5e-4)
    for place in (rest.copy(), x.copy()):
        for writeable in (True, False):
            place.flags.writeable = writeable
            near = NearPairs(faces, rest, GAP, 0.0)
            near.about(place, x)
            near.barrier(place, GAP)
    for kernel in (face_tree_kernels.surround, face_tree_kernels.search, pair_kernels.energy_gradient):
        assert len(kernel.signatures) == 1
