"""Crowds: a batch against single runs, levels of detail, the errors of their switches, wing beats, the paper bird."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.crowd import Flap

GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def basis():
    mesh = ms.paper_bird(cells=(8, 8))
    material = ms.Material(stretch=500.0, shear=500.0, flexure=2e-3, density=0.08)
    return ms.solve_modes(ms.Shell(mesh, material, clamped=mesh.vertices[:, 2] <= 0.0), 10)


def loaded(basis, count, **options):
    """Crowd of birds that feel different accelerations, and those."""
    felt = 20.0 * np.random.default_rng(0).standard_normal((count, 3))
    return ms.Crowd(basis, count, damping=(1.0, 1e-3), **options), felt


@pytest.mark.parametrize(("level", "model"), [(1, ms.LinearModal), (2, ms.ModalWarping)])
def test_a_batch_is_its_single_runs(basis, level, model):
    crowd, felt = loaded(basis, 5)
    crowd.levels[:] = level
    for _ in range(20):
        crowd.step(1.0 / 120.0, felt=felt)
    positions = crowd.positions()
    reach = np.abs(positions - basis.shell.rest_positions).max()
    assert reach > 0.01
    for b in range(5):
        single = ms.simulate(
            model(basis), duration=20 / 120, dt=1.0 / 120.0, gravity=felt[b], damping=(1.0, 1e-3)
        ).positions[-1]
        assert np.abs(positions[b] - single).max() <= 1e-12 * reach


def test_an_instance_does_not_depend_on_its_batch(basis):
    crowd, felt = loaded(basis, 70)
    crowd.levels[:] = np.arange(70) % 3
    singles = [ms.Crowd(basis, 1, damping=(1.0, 1e-3)) for _ in range(70)]
    for _ in range(5):
        crowd.step(0.01, felt=felt)
    together = crowd.positions()
    for b, single in enumerate(singles):
        single.levels[:] = b % 3
        for _ in range(5):
            single.step(0.01, felt=felt[b])
        np.testing.assert_allclose(single.positions()[0], together[b], rtol=0, atol=1e-12)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_levels_and_places(basis, dtype):
    crowd, _ = loaded(basis, 40, dtype=dtype)
    random = np.random.default_rng(2)
    crowd.coordinates = 1e-3 * random.standard_normal((40, 10))
    crowd.levels[:] = np.arange(40) % 3
    turns, moves = Rotation.random(40, rng=random).as_matrix(), random.standard_normal((40, 3))
    out = np.empty((40, crowd.vertices, 3), dtype)
    assert crowd.positions(turns, moves, out) is out
    rest = basis.shell.rest_positions
    for b in range(40):
        model = (None, ms.LinearModal(basis), ms.ModalWarping(basis))[b % 3]
        shape = rest if model is None else rest + model.displacement(crowd.coordinates[b])
        exact = shape @ turns[b].T + moves[b]
        assert np.abs(out[b] - exact).max() < (1e-13 if dtype == np.float64 else 2e-6)


def test_turns_beyond_two_pi(basis):
    crowd = ms.Crowd(basis, 1)
    q = np.zeros(10)
    q[0] = 9.0 / np.linalg.norm(basis.rotations[:, 0].reshape(-1, 3), axis=1).max()
    crowd.coordinates[0] = q
    exact = basis.shell.rest_positions + ms.ModalWarping(basis).displacement(q)
    assert np.abs(crowd.positions()[0] - exact).max() < 1e-12 * np.abs(exact).max()


def test_switch_errors_are_what_a_switch_shows(basis):
    crowd, _ = loaded(basis, 6)
    crowd.coordinates = 2e-4 * np.random.default_rng(3).standard_normal((6, 10))
    shapes = []
    for level in range(3):
        crowd.levels[:] = level
        shapes.append(crowd.positions())
    errors = crowd.switch_errors()
    for jump in range(2):
        seen = np.linalg.norm(shapes[jump + 1] - shapes[jump], axis=2).max(axis=1)
        np.testing.assert_allclose(errors[:, jump], seen, rtol=1e-9)
    w = np.linalg.norm((crowd.coordinates @ basis.rotations.T).reshape(6, -1, 3), axis=2)
    assert (errors[:, 1] <= (0.5 * w * np.linalg.norm(shapes[1] - shapes[0], axis=2)).max(axis=1)).all()
    linear, rigid = crowd.switch_distances(1e-3)
    assert linear == pytest.approx(1e3 * errors[:, 1].max())
    assert rigid >= max(linear, 1e3 * np.linalg.norm(shapes[2] - shapes[0], axis=2).max())
    crowd.set_levels([0.0, linear, rigid, 2 * rigid, 0.99 * linear, 0.99 * rigid], linear, rigid)
    np.testing.assert_array_equal(crowd.levels, [2, 1, 0, 0, 2, 1])


def test_flaps_follow_the_load_factor(basis):
    flap = Flap(basis, amplitude=0.03, frequency=2.0, largest_load_factor=2.5)
    quarter = 0.125
    forcing = flap.forcing(quarter, np.zeros(4), [GRAVITY, 2 * GRAVITY, 9 * GRAVITY, 0 * GRAVITY])
    static = (basis.modes @ (forcing[0] / basis.eigenvalues)).reshape(-1, 3)
    assert np.linalg.norm(static, axis=1).max() == pytest.approx(0.03)
    np.testing.assert_allclose(forcing[1:], forcing[0] * np.array([[2.0], [2.5], [0.0]]), atol=1e-15)
    late = flap.forcing(0.0, [0.5 * np.pi], [GRAVITY])
    np.testing.assert_allclose(late[0], forcing[0])
    # Both wings beat together, and a crowd that is driven so moves.
    crowd = ms.Crowd(basis, 1)
    crowd.step(0.01, forcing=late)
    z = crowd.positions()[0, :, 2] - basis.shell.rest_positions[:, 2]
    rest = basis.shell.rest_positions
    tip = rest[:, 1].argmax()
    tips = [tip, np.linalg.norm(rest - rest[tip] * (1, -1, 1), axis=1).argmin()]
    assert np.ptp(z[tips]) < 1e-6 * np.abs(z[tips]).max()


def test_the_bird_flies_with_its_flock(basis):
    flock = ms.Flock.random(20, radius=2.0, speed=4.0, speed_variation=0.3)
    crowd = ms.Crowd(basis, 20, damping=(2.0, 1e-3))
    flap = Flap(basis, amplitude=0.02, frequency=3.0)
    for _ in range(30):
        flock.step(1.0 / 60.0)
        frames = flock.frames(GRAVITY)
        felt = np.einsum("bij,bi->bj", frames, GRAVITY - flock.accelerations)
        # Banked: nothing is felt to the side.
        np.testing.assert_allclose(felt[:, 1], 0.0, atol=1e-10)
        crowd.step(1.0 / 60.0, felt=felt, forcing=flap.forcing(flock.time, np.arange(20.0), felt))
    placed = crowd.positions(frames, flock.positions)
    assert np.isfinite(placed).all()
    assert np.linalg.norm(placed - flock.positions[:, None], axis=2).max() < 0.5


def test_paper_bird():
    bird = ms.paper_bird()
    assert bird.vertices.shape == (493, 3)
    np.testing.assert_array_equal(np.unique(np.abs(bird.vertices[bird.vertices[:, 1] < 0, 1]))[[-1]],
                                  np.unique(bird.vertices[:, 1])[[-1]])  # fmt: skip
    corners = bird.vertices[bird.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    # Developable: the area is that of the paper, body and wings.
    wing = 0.2 * 0.18 * (0.5 * 0.3 * (1.0 + 0.58) + 0.5 * 0.7 * (0.58 + 0.26))
    area = 0.5 * np.linalg.norm(normals, axis=1).sum()
    assert area == pytest.approx(2 * (0.2 * 0.04 + wing), rel=0.01)
    body = bird.vertices[:, 2] <= 0.0
    assert np.abs(bird.vertices[body, 1]).max() == pytest.approx(0.04 * np.sin(np.radians(20.0)))
    with pytest.raises(ms.OptionError, match="at least 2 cells"):
        ms.paper_bird(cells=(8, 1))


def test_refuses(basis):
    crowd = ms.Crowd(basis, 2)
    with pytest.raises(ms.OptionError, match="felt"):
        crowd.step(0.01, felt=np.zeros((3, 3)))
    with pytest.raises(ms.OptionError, match="forcing"):
        crowd.step(0.01, forcing=np.zeros((2, 3)))
    with pytest.raises(ms.OptionError, match="out must be"):
        crowd.positions(out=np.empty((2, 3, 3)))
    with pytest.raises(ms.OptionError, match="switches"):
        crowd.set_levels([1.0, 2.0], 3.0, 1.0)
    with pytest.raises(ms.OptionError, match="damping"):
        ms.Crowd(basis, 2, damping=(-1.0, 0.0))
    with pytest.raises(ms.OptionError, match="dtype"):
        ms.Crowd(basis, 2, dtype=np.int64)
