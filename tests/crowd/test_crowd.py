"""Crowds: a batch against single runs, levels of detail and what they show, threads, wing beats, the paper bird."""

import os
import platform
import re
import subprocess
import sys

import llvmlite.binding
import numpy as np
import pytest
from numba import njit
from scenes import PLAIN
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.crowd import Flap
from modalshell.crowd.kernels import instances as kernels
from modalshell.integrators.modal import Exponential
from modalshell.kernels.packed import BYTES
from modalshell.shell.damping import Damping

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


@pytest.mark.by_default("1-LinearModal-1", "2-ModalWarping-None")
@pytest.mark.parametrize("hardly", [None, 1])
@pytest.mark.parametrize(("level", "model"), [(1, ms.LinearModal), (2, ms.ModalWarping)])
def test_a_batch_is_its_single_runs(basis, level, model, hardly):
    """Also where a mode is hardly followed, and some of the loads ask for a second force."""
    crowd, felt = loaded(basis, 5)
    crowd.levels[:] = level
    dt = 1.0 / 120.0
    if hardly is not None:
        dt = 1.0 / (3.5 * basis.frequencies[hardly])
        felt *= [[1e-3], [1e-2], [0.1], [0.3], [1.0]]
    for _ in range(20):
        crowd.step(dt, felt=felt)
    positions = crowd.positions()
    reach = np.abs(positions - basis.shell.rest_positions).max()
    assert reach > 0.01
    for b in range(5):
        single = ms.simulate(
            model(basis, integrator=Exponential(turning=True)),
            duration=20 * dt,
            dt=dt,
            gravity=felt[b],
            damping=(1.0, 1e-3),
        ).positions[-1]
        assert np.abs(positions[b] - single).max() <= 1e-12 * reach


@pytest.mark.slow
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
    """Beyond the polynomials' interval, and beside an instance that is not."""
    crowd = ms.Crowd(basis, 3)
    model = ms.ModalWarping(basis)
    crowd.coordinates[0, 0] = 9.0 / np.linalg.norm(basis.rotations[:, 0].reshape(-1, 3), axis=1).max()
    crowd.coordinates[1] = 0.1 * crowd.coordinates[0]
    crowd.coordinates[2] = -crowd.coordinates[0]
    turn, move = Rotation.from_rotvec((0.3, -0.2, 0.9)).as_matrix(), np.array([1.0, 2.0, 3.0])
    for b, q in enumerate(crowd.coordinates):
        exact = basis.shell.rest_positions + model.displacement(q)
        assert np.abs(crowd.positions()[b] - exact).max() < 1e-12 * np.abs(exact).max()
        assert np.abs(crowd.positions(turn, move)[b] - exact @ turn.T - move).max() < 1e-12 * np.abs(exact).max()
    start = crowd.coordinates.copy()
    crowd.step(0.01, felt=(1.0, 2.0, 3.0))
    for b, q in enumerate(start):
        state = model.start_motion()
        state.coordinates = q
        rates = model.step(state, 0.01, basis.shell.gravity_force((1.0, 2.0, 3.0)), Damping())[0].rates
        np.testing.assert_allclose(crowd.rates[b], rates, rtol=1e-9, atol=1e-12 * np.abs(rates).max())


def test_what_is_not_finite_shows(basis):
    crowd = ms.Crowd(basis, 3)
    crowd.coordinates[1, 0] = np.nan
    crowd.choose_levels(np.full(3, 1e9), 1.0)
    np.testing.assert_array_equal(np.isnan(crowd.positions()).any(axis=(1, 2)), [False, True, False])
    crowd.levels[:] = 2
    crowd.step(0.01, felt=GRAVITY)
    np.testing.assert_array_equal(np.isfinite(crowd.coordinates).all(axis=1), [True, False, True])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coordinates", np.zeros((2, 10))),
        ("coordinates", np.zeros((3, 9))),
        ("rates", np.zeros((3, 1))),
        ("levels", np.zeros(2, np.int8)),
        ("levels", np.array([0, 1, 3])),
        ("levels", np.array([0, -1, 2])),
    ],
)
def test_a_state_of_another_shape_is_refused(basis, name, value):
    crowd = ms.Crowd(basis, 3)
    setattr(crowd, name, value)
    for call in (crowd.positions, lambda: crowd.step(0.01), crowd.level_errors):
        with pytest.raises(ms.OptionError, match=f"{name} must"):
            call()


def test_matrices_that_are_no_rotations_are_refused(basis):
    crowd = ms.Crowd(basis, 3)
    turns = Rotation.random(3, random_state=0).as_matrix()
    crowd.positions(turns.astype(np.float32), np.zeros((3, 3)))
    for wrong in (2.0 * np.eye(3), np.diag([1.0, 1.0, -1.0]), np.eye(3) + np.eye(3, k=1), np.zeros((3, 3))):
        turns[1] = wrong
        with pytest.raises(ms.OptionError, match=r"rotations must be rotation matrices.*of instance 1"):
            crowd.positions(turns)


def test_coordinates_may_be_of_any_layout_and_type(basis):
    crowd, twin = ms.Crowd(basis, 3), ms.Crowd(basis, 3)
    crowd.coordinates = np.asfortranarray(np.arange(30).reshape(3, 10))
    twin.coordinates = np.arange(30.0).reshape(3, 10)
    for each in (crowd, twin):
        each.step(0.01, felt=GRAVITY)
    np.testing.assert_array_equal(crowd.positions(), twin.positions())


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="looks for x86-64 instructions")
def test_the_kernels_are_packed():
    """All multiplications of a pair of instances are, and no array is counted in the loops."""
    kernel = njit(error_model="numpy")(kernels.crowd_positions.py_func)
    lanes = BYTES // 8
    shapes = ((1, 1, 6, lanes), (1, 3, lanes), (1, 1), 30, (1, 12), (1, 1, 3))
    kernel(0, 1, 2, np.zeros(1, np.int64), *(np.zeros(shape) for shape in shapes))
    text = "".join(kernel.inspect_asm().values())
    register = "zmm" if BYTES == 64 else "ymm"
    packed = re.findall(rf"\bv(?:mul|fmadd\d+|fnmadd\d+|fmsub\d+)pd\b.*{register}", text)
    # Of each of two: six rows and modes, the polynomials up to half a turn and beyond, two cross products, the place.
    assert len(packed) > 2 * (12 + 13 + 17 + 21 + 9)
    loop = text[: text.rindex(packed[-1])]
    assert "NRT_incref" not in loop[loop.index(packed[0]) :]


@pytest.mark.by_default("float64")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_threads_change_nothing(basis, dtype):
    crowds = [loaded(basis, 150, dtype=dtype, threads=threads) for threads in (1, 2, 3)]
    for crowd, felt in crowds:
        crowd.levels[:] = np.random.default_rng(5).integers(0, 3, 150)
        for _ in range(5):
            crowd.step(0.01, felt=felt)
    first = crowds[0][0]
    for crowd, _ in crowds[1:]:
        np.testing.assert_array_equal(crowd.coordinates, first.coordinates)
        np.testing.assert_array_equal(crowd.positions(np.eye(3)), first.positions(np.eye(3)))


@pytest.mark.parametrize("cells", [(1, 1), (3, 1), (10, 11)])
def test_few_vertices_and_a_tile_that_ends_anywhere(cells):
    mesh = ms.sheet(cells=cells)
    shell = ms.Shell(mesh, PLAIN, [0, 1])
    basis = ms.solve_modes(shell, 3)
    crowd = ms.Crowd(basis, 2)
    crowd.coordinates[:] = [[0.02, -0.01, 0.03], [0.01, 0.0, 0.0]]
    out = np.full((3, len(mesh.vertices), 3), np.nan)
    crowd.positions(out=out[:2])
    for q, found in zip(crowd.coordinates, out, strict=False):
        exact = mesh.vertices + ms.ModalWarping(basis).displacement(q)
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-14)
    assert np.isnan(out[2]).all()


def test_no_switch_shows_more_than_is_allowed(basis):
    crowd, _ = loaded(basis, 60)
    crowd.coordinates = 2e-5 * np.random.default_rng(3).standard_normal((60, 10))
    distances, angle = np.geomspace(0.01, 1e3, 60), 1e-3
    crowd.choose_levels(distances, angle)
    np.testing.assert_array_equal(np.unique(crowd.levels), [0, 1, 2])
    errors, shown = crowd.level_errors(), crowd.positions()
    crowd.levels[:] = 2
    seen = np.linalg.norm(crowd.positions() - shown, axis=2).max(axis=1)
    np.testing.assert_allclose(errors, seen, atol=1e-15)
    assert errors.max() > 0.0
    assert (errors <= angle * distances).all()
    assert not crowd.level_errors().any()


def test_strains_blend_in(basis):
    crowd, _ = loaded(basis, 3)
    model = ms.RotationStrain(basis)
    crowd.coordinates = 1e-4 * np.random.default_rng(4).standard_normal((3, 10))
    pose = Rotation.from_rotvec((0.3, -0.2, 0.9)).as_matrix(), np.array([1.0, 2.0, 3.0])
    warped = crowd.positions(*pose)
    out = warped.copy()
    gaps = crowd.blend_strains(model, [0.0, 0.25, 1.0], out, *pose)
    strained = (basis.shell.rest_positions + model.displacement(crowd.coordinates[2])) @ pose[0].T + pose[1]
    np.testing.assert_array_equal(out[0], warped[0])
    np.testing.assert_allclose(out[2], strained, atol=1e-14)
    moved = np.linalg.norm(out - warped, axis=2).max(axis=1)
    np.testing.assert_allclose(moved, [0.0, 0.25 * gaps[1], gaps[2]], rtol=1e-12)
    assert gaps[0] == 0.0
    assert 1e-7 < gaps[2] < 0.05
    with pytest.raises(ms.OptionError, match="own basis"):
        crowd.blend_strains(ms.RotationStrain(ms.solve_modes(basis.shell, 10)), [0.0] * 3, out)


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
    with pytest.raises(ms.OptionError, match="angle"):
        crowd.choose_levels([1.0, 2.0], 0.0)
    with pytest.raises(ms.OptionError, match="distances must be at least 0"):
        crowd.choose_levels([1.0, -2.0], 0.01)
    with pytest.raises(ms.OptionError, match="threads"):
        ms.Crowd(basis, 2, threads=0)
    with pytest.raises(ms.OptionError, match="damping"):
        ms.Crowd(basis, 2, damping=(-1.0, 0.0))
    with pytest.raises(ms.OptionError, match="dtype"):
        ms.Crowd(basis, 2, dtype=np.int64)


NARROW = """
import sys
import numpy as np
import modalshell as ms
from modalshell.kernels import ahead, packed
ahead.begin = lambda *_: None  # no second process, which would compile what is not used here
basis = ms.Basis.load(sys.argv[1])
crowd = ms.Crowd(basis, 5)
crowd.coordinates = np.load(sys.argv[2])
shapes = crowd.positions(np.eye(3), (1.0, 2.0, 3.0))
crowd.step(0.01, felt=(1.0, 2.0, 3.0))
np.savez(sys.argv[3], shapes=shapes, rates=crowd.rates, width=packed.BYTES)
"""


@pytest.mark.slow
@pytest.mark.skipif(BYTES != 64, reason="the processor has no wider registers than those of AVX2")
def test_registers_of_either_width_give_the_same(basis, tmp_path):
    """A child process compiles for AVX2, where this processor has AVX-512."""
    basis.save(tmp_path / "basis.npz")
    q = np.random.default_rng(3).standard_normal((5, basis.count))
    q *= np.array([0.1, 1.0, 3.0, 6.0, 9.0])[:, None] / np.abs(q @ basis.rotations.T).max(axis=1)[:, None]
    np.save(tmp_path / "q.npy", q)
    features = llvmlite.binding.get_host_cpu_features()
    narrow = ",".join(f"{'+' if on and '512' not in name else '-'}{name}" for name, on in features.items())
    limits = {"NUMBA_CPU_NAME": "haswell", "NUMBA_CPU_FEATURES": narrow, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", NARROW, *(str(tmp_path / name) for name in ("basis.npz", "q.npy", "found.npz"))]
    subprocess.run(command, env=os.environ | limits, check=True, timeout=300)
    crowd = ms.Crowd(basis, 5)
    crowd.coordinates = q
    shapes = crowd.positions(np.eye(3), (1.0, 2.0, 3.0))
    crowd.step(0.01, felt=(1.0, 2.0, 3.0))
    with np.load(tmp_path / "found.npz") as found:
        assert found["width"] == 32
        assert np.abs(found["shapes"] - shapes).max() <= 1e-14 * np.abs(shapes).max()
        assert np.abs(found["rates"] - crowd.rates).max() <= 1e-12 * np.abs(crowd.rates).max()
