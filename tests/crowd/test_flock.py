"""Flocks: each rule alone against closed forms, the grid against all pairs, the same flock from the same seed."""

import math

import numpy as np
import pytest

from modalshell import Flock, OptionError
from modalshell.crowd.neighbours import gather

X = (1.0, 0.0, 0.0)


def pair(distance, **parameters):
    """Two boids along y, the second heading along z."""
    return Flock([(0, 0, 0), (0, distance, 0)], [X, (0, 0, 1)], **parameters)


def test_separation():
    rules = pair(0.25, neighbour_distance=2.0).rules()
    # offset (1 / d - 1 / D): a unit vector times 1 - d / D
    np.testing.assert_allclose(rules.separation, [(0, -0.875, 0), (0, 0.875, 0)], atol=1e-15)
    assert not pair(2.0, neighbour_distance=2.0).rules().separation.any()
    assert not pair(0.0, neighbour_distance=2.0).rules().separation.any()


def test_alignment_is_the_mean_of_the_neighbours():
    places = [(0, 0, 0), (0.5, 0, 0), (0, 0.5, 0), (9, 9, 9)]
    rules = Flock(places, [(0, 0, 1), X, (0, 3, 0), X]).rules()
    np.testing.assert_allclose(rules.alignment[0], (0.5, 0.5, 0), atol=1e-15)
    assert not rules.alignment[3].any()


def test_cohesion_counts_the_flock_position_in():
    rules = pair(0.5, flock_position=(4, 0.5, 0)).rules()
    np.testing.assert_allclose(rules.cohesion[0], np.array([4, 1, 0]) / math.sqrt(17), atol=1e-15)
    alone = Flock([(0, 0, 2)], [X]).rules().cohesion
    np.testing.assert_allclose(alone, [(0, 0, -1)], atol=1e-15)


def test_target_and_bounds():
    flock = Flock([(0, 0, 0), (3, -2, 0)], [X, X], target=(0, 0, 5), target_weight=0.3)
    np.testing.assert_allclose(flock.rules().target[0], (0, 0, 0.3), atol=1e-15)
    flock = Flock([(0, 0, 0), (3, -2, 0)], [X, X], neighbour_distance=0.5, bounds=[(-1, -1, -1), (1, 1, 1)])
    np.testing.assert_allclose(flock.rules().bounds, [(0, 0, 0), (-4, 2, 0)], atol=1e-15)


def test_weights():
    one = pair(0.25, flock_position=(4, 0, 0)).rules()
    other = pair(0.25, flock_position=(4, 0, 0), weights=(2.0, 0.0, 0.5)).rules()
    for name, weight in (("separation", 2.0), ("alignment", 0.0), ("cohesion", 0.5)):
        assert getattr(one, name).any()
        np.testing.assert_allclose(getattr(other, name), weight * getattr(one, name), atol=1e-15)


def test_field_of_view_hides_what_is_behind():
    places = [(0, 0, 0), (0.5, 0, 0), (-0.5, 0, 0), (0, 0.5, 0)]
    counts = [gather(np.array(places), np.tile(X, (4, 1)), 0.6, math.radians(a), search=s).counts[0]
              for a in (360.0, 358.0, 181.0, 179.0) for s in ("grid", "all_pairs")]  # fmt: skip
    assert counts == [3, 3, 2, 2, 2, 2, 1, 1]


@pytest.mark.parametrize("steps", [1, 8])
def test_turning_is_exponential_smoothing(steps):
    dt, rate = 0.05, 3.0
    flock = Flock([(0, 0, 1e9)], [X], rotation_speed=rate, speed=0.0)
    direction = np.array(X)
    for _ in range(steps):
        flock.step(dt)
        blend = np.array([0, 0, -1]) + math.exp(-rate * dt) * (direction - [0, 0, -1])
        direction = blend / np.linalg.norm(blend)
    np.testing.assert_allclose(flock.directions[0], direction, atol=1e-14)


def test_a_boid_flies_straight_to_where_it_heads():
    flock = Flock([(5, 0, 0)], [(-1, 0, 0)], speed=2.0, speed_variation=0.0)
    for _ in range(10):
        flock.step(0.1)
    np.testing.assert_allclose(flock.positions, [(3, 0, 0)], atol=1e-13)
    np.testing.assert_allclose(flock.accelerations, 0.0, atol=1e-12)
    np.testing.assert_allclose(flock.velocities, [(-2, 0, 0)], atol=1e-14)


@pytest.mark.slow
def test_speed_noise_is_smooth_and_bounded():
    flock = Flock(np.zeros((400, 3)), np.tile(X, (400, 1)), speed=2.0, speed_variation=0.25, noise_frequency=1.0)
    speeds = []
    for flock.time in np.linspace(0.0, 20.0, 4001):
        speeds.append(flock.speeds())
    speeds = np.array(speeds)
    assert speeds.min() >= 1.5
    assert speeds.max() <= 2.5
    assert np.ptp(speeds) > 0.9
    # Slope of the quintic at most 15 / 8 of the knots' difference; its second derivative 10 / sqrt(3) of it.
    assert np.abs(np.diff(speeds, axis=0)).max() / 0.005 <= 1.875
    assert np.abs(np.diff(speeds, 2, axis=0)).max() / 0.005**2 <= 5.78
    flock.time = 256.0
    np.testing.assert_allclose(flock.speeds(), speeds[0], rtol=1e-10)


@pytest.mark.by_default("6.283185307179586-0.5", "4.0-3.0", "4.0-200.0")
@pytest.mark.parametrize("spread", [0.5, 3.0, 200.0])
@pytest.mark.parametrize("angle", [2.0 * math.pi, 4.0])
def test_grid_agrees_with_all_pairs(spread, angle):
    random = np.random.default_rng(1)
    positions = spread * random.standard_normal((700, 3)) + (50.0, -70.0, 0.3)
    positions[0] = 1e5
    directions = random.standard_normal((700, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    exact = gather(positions, directions, 0.9, angle, search="all_pairs")
    for threads in (1, 3):
        found = gather(positions, directions, 0.9, angle, threads=threads)
        np.testing.assert_array_equal(found.counts, exact.counts)
        for one, other in zip(found, exact, strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * max(1.0, np.abs(other).max()))


def test_the_same_seed_gives_the_same_flock():
    def fly(seed, **parameters):
        flock = Flock.random(300, radius=2.0, seed=seed, bounds=[(-2,) * 3, (2,) * 3], **parameters)
        for _ in range(30):
            flock.step(1.0 / 30.0)
        return flock

    one, other, parallel = fly(3), fly(3), fly(3, threads=2)
    np.testing.assert_array_equal(one.positions, other.positions)
    np.testing.assert_array_equal(one.positions, parallel.positions)
    assert np.abs(fly(4).positions - one.positions).max() > 0.1
    np.testing.assert_allclose(np.linalg.norm(one.directions, axis=1), 1.0, atol=1e-14)
    assert np.abs(fly(3, search="all_pairs").positions - one.positions).max() < 1e-9


def test_frames_bank_with_the_turn():
    flock = Flock(np.zeros((3, 3)), [X, X, (0, 0, 1)])
    flock.accelerations[1] = (0, 9.81, 0)
    frames = flock.frames()
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (3, 1, 1)), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    np.testing.assert_allclose(frames[0], np.eye(3), atol=1e-15)
    np.testing.assert_allclose(frames[1, :, 2], np.array([0, 1, 1]) / math.sqrt(2), atol=1e-14)
    np.testing.assert_allclose(frames[:, :, 0], flock.directions)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"field_of_view": 0.0}, "field_of_view"),
        ({"neighbour_distance": 0.0}, "neighbour_distance"),
        ({"speed_variation": 1.5}, "speed_variation"),
        ({"bounds": [(1, 1, 1), (0, 0, 0)]}, "lower and an upper"),
        ({"search": "tree"}, "search"),
        ({"weights": (1.0, -1.0, 0.0)}, "weights"),
        ({"directions": [(0, 0, 0)]}, "directions must not be zero"),
        ({"positions": [(0, 0)]}, "positions"),
    ],
)
def test_refuses(parameters, message):
    with pytest.raises(OptionError, match=message):
        Flock(**{"positions": [(0, 0, 0)], "directions": [X], **parameters})
