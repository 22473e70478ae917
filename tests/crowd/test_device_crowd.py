"""Flocks and crowds by Warp: on its processor device everywhere it is installed, and on a GPU where there is one."""

import sys

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.crowd.device import DeviceCrowd, DeviceSearch
from modalshell.kernels.device import devices, warp

pytest.importorskip("warp", reason="Warp is not installed: pip install 'modalshell[gpu]'")

DEVICES = [pytest.param(name, id=name) for name in devices()]
PRECISIONS = [np.float64, np.float32]


@pytest.fixture(scope="module")
def basis():
    mesh = ms.paper_bird(cells=(8, 8))
    material = ms.Material(stretch=500.0, shear=500.0, flexure=2e-3, density=0.08)
    return ms.solve_modes(ms.Shell(mesh, material, clamped=mesh.vertices[:, 2] <= 0.0), 10)


@pytest.mark.by_default("0.4-360.0-float32-cpu", "2.0-360.0-float64-cpu", "100.0-230.0-float32-cpu")
@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", PRECISIONS)
@pytest.mark.parametrize(("radius", "angle"), [(0.4, 360.0), (2.0, 360.0), (2.0, 230.0), (100.0, 230.0)])
def test_sums_are_those_of_the_kernels(device, dtype, radius, angle):
    """Where all are neighbours, some and none; the cells wrap round, and two boids are in one place."""
    options = {"radius": radius, "seed": 1, "field_of_view": angle, "flock_position": (5.0, -7.0, 0.3)}
    flock, other = ms.Flock.random(700, **options), ms.Flock.random(700, **options, search=DeviceSearch(dtype, device))
    for boids in (flock, other):
        boids.positions[1] = boids.positions[0]
        boids.positions[2] = 900.0
    expected, found = flock.neighbourhood(), other.neighbourhood()
    np.testing.assert_array_equal(found.counts, expected.counts)
    assert expected.counts[2] == 0.0
    if radius < 100.0:
        assert expected.counts[0] > 10.0
    bound = 1e-12 if dtype == np.float64 else 1e-4
    for sums, exact in zip(found, expected, strict=True):
        assert np.isfinite(sums).all()
        assert np.abs(sums - exact).max() <= bound * np.abs(exact).max()


@pytest.mark.parametrize("device", DEVICES)
def test_a_flock_flies_as_it_does_by_the_kernels(device):
    options = {"radius": 2.0, "seed": 3, "field_of_view": 200.0, "bounds": [(-2,) * 3, (2,) * 3]}
    flock, other = ms.Flock.random(300, **options), ms.Flock.random(300, **options, search=DeviceSearch(device=device))
    start = flock.positions
    for _ in range(20):
        flock.step(1.0 / 30.0)
        other.step(1.0 / 30.0)
    assert np.abs(flock.positions - start).max() > 0.3
    assert np.abs(other.positions - flock.positions).max() < 1e-10
    assert np.abs(other.accelerations - flock.accelerations).max() < 1e-7


@pytest.mark.parametrize("device", DEVICES)
def test_one_boid_and_what_is_not_finite(device):
    alone = ms.Flock([(0, 0, 2)], [(1, 0, 0)], search=DeviceSearch(device=device))
    assert not any(sums.any() for sums in alone.neighbourhood())
    flock = ms.Flock(np.zeros((2, 3)), np.eye(3)[:2], search=DeviceSearch(device=device))
    assert not flock.neighbourhood().counts.any()
    flock.directions[1] = np.nan
    flock.positions[1, 0] = 0.5
    assert np.isnan(flock.neighbourhood().directions[0]).all()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", PRECISIONS)
def test_positions_are_those_of_the_kernels(basis, device, dtype):
    """At every level, at rest, by small turns, by those of some radians and by two turns; twice, since data stay."""
    random = np.random.default_rng(2)
    crowds = ms.Crowd(basis, 40, dtype=dtype), DeviceCrowd(basis, 40, dtype=dtype, device=device)
    largest = np.linalg.norm(basis.rotations.reshape(-1, 3, 10), axis=1).max()
    angles = np.repeat([0.0, 1e-9, 1.0, 12.0], 10)
    coordinates = random.uniform(-1.0, 1.0, (40, 10)) * angles[:, None] / largest
    for crowd in crowds:
        crowd.coordinates = coordinates
        crowd.levels[:] = np.arange(40) % 3
    warped = (basis.rotations @ coordinates[crowds[0].levels == 2].T).reshape(-1, 3, 13)
    assert np.linalg.norm(warped, axis=1).max() > 2.0 * np.pi
    turns, moves = Rotation.random(40, rng=random).as_matrix(), random.standard_normal((40, 3))
    bound = 1e-12 if dtype == np.float64 else 1e-5
    for poses in ((), (turns, moves), (turns[3], moves[4]), (None, moves)):
        expected, found = (crowd.positions(*poses) for crowd in crowds)
        assert found.dtype == dtype
        reach = np.abs(expected).max()
        assert np.abs(found - expected).max() <= bound * reach
        left = crowds[1].device_positions(*poses)
        assert str(left.device) == device
        np.testing.assert_array_equal(left.numpy(), found)
    errors, exact = crowds[1].level_errors(), crowds[0].level_errors()
    assert exact.max() > 0.1
    assert np.abs(errors - exact).max() <= bound * reach


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", PRECISIONS)
def test_a_crowd_steps_as_it_does_by_the_kernels(basis, device, dtype):
    """Coordinates in float64 whatever the precision, at every level, from small turns and from more than one."""
    felt = 20.0 * np.random.default_rng(0).standard_normal((9, 3))
    options = {"damping": (1.0, 1e-3), "dtype": dtype}
    crowds = ms.Crowd(basis, 9, **options), DeviceCrowd(basis, 9, **options, device=device)
    largest = np.linalg.norm(basis.rotations.reshape(-1, 3, 10), axis=1).max(axis=0)
    for crowd in crowds:
        crowd.levels[:] = np.arange(9) % 3
        crowd.coordinates[5, 0] = 9.0 / largest[0]
        for _ in range(10):
            crowd.step(1.0 / 120.0, felt=felt)
    linear = ms.Crowd(basis, 9, **options)
    linear.levels[:] = 1
    linear.coordinates[5, 0] = 9.0 / largest[0]
    for _ in range(10):
        linear.step(1.0 / 120.0, felt=felt)
    reach = np.abs(crowds[0].coordinates).max(axis=1, keepdims=True)
    assert (np.abs(linear.coordinates - crowds[0].coordinates).max(axis=1)[2::3] > 1e-3 * reach[2::3, 0]).all()
    assert (np.abs(crowds[1].coordinates - crowds[0].coordinates) <= 1e-11 * reach).all()
    for crowd in crowds:
        crowd.choose_levels(np.geomspace(0.01, 1e4, 9), 1e-3)
    assert len(set(crowds[0].levels)) > 1
    out = np.empty((9, crowds[0].vertices, 3), dtype)
    assert crowds[1].positions(out=out) is out
    assert np.abs(out - crowds[0].positions()).max() < (1e-11 if dtype == np.float64 else 1e-5)


@pytest.mark.parametrize("device", DEVICES)
def test_what_is_not_finite_shows(basis, device):
    crowd = DeviceCrowd(basis, 3, device=device)
    crowd.coordinates[1, 0] = np.nan
    np.testing.assert_array_equal(np.isnan(crowd.positions()).any(axis=(1, 2)), [False, True, False])


def test_bad_input(basis):
    for make in (
        lambda: DeviceSearch(device="gpu"),
        lambda: DeviceCrowd(basis, 2, device="gpu"),
    ):
        with pytest.raises(ms.OptionError, match=r"there is no such device: device must be one of cpu.*got 'gpu'"):
            make()
    with pytest.raises(ms.OptionError, match="float64 or float32"):
        DeviceSearch(np.int32, "cpu")
    with pytest.raises(ms.OptionError, match="float64 or float32"):
        DeviceCrowd(basis, 2, dtype=np.int32, device="cpu")
    with pytest.raises(ms.OptionError, match="out must be"):
        DeviceCrowd(basis, 2, device="cpu").positions(out=np.empty((2, 3)))


@pytest.mark.slow
def test_the_source_compiles_for_gpus(tmp_path):
    """By the compiler for GPUs that Warp brings, which needs none: all kernels, those of forces in float64."""
    from modalshell.crowd.kernels import device_flock

    architectures = warp().get_cuda_supported_archs()
    if not architectures:
        pytest.skip("this build of Warp has no compiler for GPUs")
    warp().compile_aot_module(device_flock, arch=architectures[0], module_dir=tmp_path, use_ptx=True)
    (assembly,) = tmp_path.glob("*.ptx")
    assert assembly.read_text().count(".visible .entry") == 10


def test_missing_warp_says_what_to_install(basis, monkeypatch):
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(ms.OptionError, match=r"pip install 'modalshell\[gpu\]'"):
        DeviceSearch()
    with pytest.raises(ms.OptionError, match=r"pip install 'modalshell\[gpu\]'"):
        DeviceCrowd(basis, 2)
