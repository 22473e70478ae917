"""Frames of modal warping in one pass: against SciPy and closed forms, at every angle, without allocation."""

import math
import platform
import re
import tracemalloc

import mpmath
import numpy as np
import pytest
from bases import bare_basis
from numba import jit, njit
from scipy.integrate import fixed_quad
from scipy.spatial.transform import Rotation

from modalshell import ModalWarping, OptionError
from modalshell.kernels import frame as kernels
from modalshell.kernels import push, rotations
from modalshell.kernels.rotations import coefficients
from modalshell.models.reduction.warp_frame import WarpFrame
from studies.benchmarks import frame as benchmarks
from studies.benchmarks.timing import interleaved

TOLERANCE = {np.float64: 1e-12, np.float32: 1e-6}
PRECISIONS = pytest.mark.parametrize("dtype", [np.float64, np.float32])

polynomials = njit(lambda squared: kernels.polynomials(squared))


def random_case(n=300, m=5, angle=3.0, seed=0):
    """What a frame needs of a basis, and a q at which the largest rotation is ``angle``."""
    random = np.random.default_rng(seed)
    modes, rotations = random.standard_normal((2, 3 * n, m))
    q = random.standard_normal(m)
    q *= angle / np.linalg.norm((rotations @ q).reshape(-1, 3), axis=1).max()
    return bare_basis(random.standard_normal((n, 3)), modes, rotations), q


def exact_positions(basis, q):
    """Rest plus the mean of the rotations from 0 to w, by quadrature, applied to the linear displacement."""
    u, w = ((a @ q).reshape(-1, 3) for a in (basis.modes, basis.rotations))
    mean, _ = fixed_quad(
        lambda parts: np.stack([Rotation.from_rotvec(part * w).as_matrix() for part in parts], axis=-1), 0.0, 1.0, n=24
    )
    return basis.shell.rest_positions + np.einsum("nij,nj->ni", mean, u)


def error(found, basis, q):
    exact = exact_positions(basis, q)
    reach = np.linalg.norm(exact - basis.shell.rest_positions, axis=1).max()
    return np.linalg.norm(found - exact, axis=1).max() / reach


def one_rotation(w, dtype, u=(0.3, -1.1, 0.7)):
    """Position of every vertex of two tiles whose only mode has the rotation vector w and the displacement u."""
    n = 2 * kernels.TILE
    basis = bare_basis(np.zeros((n, 3)), np.tile(u, n)[:, None], np.tile(w, n)[:, None])
    return WarpFrame(basis, dtype=dtype).positions([1.0]), basis


@PRECISIONS
@pytest.mark.parametrize("n", [1, 127, 128, 129, 256, 1000])
@pytest.mark.parametrize("m", [1, 4])
def test_a_frame_is_the_warp(n, m, dtype):
    basis, q = random_case(n, m)
    positions = WarpFrame(basis, dtype=dtype).positions(q)
    assert positions.shape == (n, 3)
    assert positions.dtype == dtype
    assert positions.flags.c_contiguous
    assert error(positions, basis, q) < TOLERANCE[dtype]


@PRECISIONS
def test_no_rotation_leaves_the_linear_displacement(dtype):
    positions, _ = one_rotation((0.0, 0.0, 0.0), dtype)
    assert np.array_equal(positions, np.tile(np.array((0.3, -1.1, 0.7), dtype), (len(positions), 1)))


@PRECISIONS
@pytest.mark.parametrize("angle", [1e-30, 1e-8, 1e-3, 1.0, math.pi - 1e-9, math.pi, 2 * math.pi - 1e-9, 2 * math.pi])
def test_every_angle_up_to_a_turn(angle, dtype):
    positions, basis = one_rotation(angle * np.array((2.0, -1.0, 2.0)) / 3.0, dtype)
    assert error(positions, basis, np.ones(1)) < TOLERANCE[dtype]


@PRECISIONS
@pytest.mark.parametrize("angle", [2 * math.pi + 1e-6, 7.0, 4 * math.pi, 25.0])
def test_beyond_a_turn_the_library_functions_take_over(angle, dtype):
    positions, basis = one_rotation(angle * np.array((2.0, -1.0, 2.0)) / 3.0, dtype)
    # In float32 the rotation vector itself is rounded, by a part of the angle.
    allowed = TOLERANCE[dtype] * max(1.0, angle / (2 * math.pi))
    assert error(positions, basis, np.ones(1)) < allowed


@PRECISIONS
def test_one_vertex_beyond_a_turn_leaves_the_others_right(dtype):
    basis, q = random_case(angle=2.0)
    rotations = basis.rotations.copy()
    rotations[3 * 140 : 3 * 141] *= 9.0 / np.linalg.norm(rotations[420:423] @ q)
    basis = bare_basis(basis.shell.rest_positions, basis.modes, rotations)
    assert error(WarpFrame(basis, dtype=dtype).positions(q), basis, q) < 2 * TOLERANCE[dtype]


@PRECISIONS
def test_what_is_not_finite_stays_so(dtype):
    basis, q = random_case()
    for bad in (math.nan, math.inf):
        assert not np.isfinite(WarpFrame(basis, dtype=dtype).positions(bad * q)).any()


def test_a_frame_is_what_the_model_draws(v_basis):
    q = np.random.default_rng(1).standard_normal(v_basis.count) * 0.02
    model = ModalWarping(v_basis)
    expected = v_basis.shell.rest_positions + model.displacement(q)
    np.testing.assert_allclose(WarpFrame(v_basis).positions(q), expected, rtol=0, atol=1e-13)


@pytest.mark.by_default("float64")
@PRECISIONS
def test_threads_agree(dtype):
    basis, q = random_case(700)
    one = WarpFrame(basis, dtype=dtype).positions(q)
    for threads in (2, 3, 9):  # more parts than tiles too
        assert np.array_equal(WarpFrame(basis, dtype=dtype, threads=threads).positions(q), one)


@pytest.mark.by_default("1-float32", "2-float64")
@PRECISIONS
@pytest.mark.parametrize("threads", [1, 2])
def test_out_is_written_and_nothing_is_allocated(dtype, threads):
    basis, q = random_case(5000)
    frame = WarpFrame(basis, dtype=dtype, threads=threads)
    out = np.full((5000, 3), np.nan, dtype)
    assert frame.positions(q, out) is out
    assert np.array_equal(out, frame.positions(q))
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for _ in range(20):
            frame.positions(q, out)
        peak = tracemalloc.get_traced_memory()[1] - before
    finally:
        tracemalloc.stop()
    assert peak < 4000


def test_the_modal_data_are_read_as_one_stream():
    basis, _ = random_case(300, 5)
    frame = WarpFrame(basis, dtype=np.float32)
    assert frame.modal_data.flags.c_contiguous
    assert frame.bytes_read == frame.modal_data.nbytes == 3 * 128 * 6 * 5 * 4
    rows = frame.modal_data.reshape(3, 5, 6, 128)
    assert rows[1, 3, 2, 7] == np.float32(basis.modes[3 * 135 + 2, 3])
    assert rows[1, 3, 4, 7] == np.float32(basis.rotations[3 * 135 + 1, 3])
    assert not rows[2, :, :, 300 - 256 :].any()


@pytest.mark.parametrize(
    ("half", "third"), [(kernels.HALF_DOUBLE, kernels.THIRD_DOUBLE), (kernels.HALF_SINGLE, kernels.THIRD_SINGLE)]
)
def test_the_polynomials_are_the_fit_they_claim_to_be(half, third):
    with mpmath.workdps(60):
        middle = 2 * mpmath.pi**2

        def half_of(t):
            root = mpmath.sqrt(t + middle)
            return mpmath.sin(root / 2) / root * mpmath.sqrt(2)

        def third_of(t):
            root = mpmath.sqrt(t + middle)
            return (root - mpmath.sin(root)) / root**3

        for function, powers in ((half_of, half), (third_of, third)):
            fit = mpmath.chebyfit(function, [-middle, middle], len(powers))
            precision = 3e-16 if isinstance(powers[0], float) else 6e-8
            assert all(abs(float(a) / float(b) - 1.0) < precision for a, b in zip(powers, fit, strict=True))


@pytest.mark.parametrize(("dtype", "bound"), [(np.float64, 1e-15), (np.float32, 1.5e-7)])
def test_the_polynomials_hold_over_the_interval(dtype, bound):
    for squared in np.linspace(0.0, 4 * math.pi**2, 3001).astype(dtype):
        found = np.array(polynomials(squared))
        assert np.abs(found - coefficients(math.sqrt(squared), 0.0, 0.0)[1:]).max() < bound


@pytest.mark.skipif(platform.machine() != "x86_64", reason="looks for x86-64 instructions")
def test_the_inner_loops_are_packed():
    kernel = jit(**{**kernels.warp_tiles.targetoptions, "cache": False})(kernels.warp_tiles.py_func)
    arrays = [np.zeros(shape) for shape in ((1, 1, 6 * kernels.TILE), (1, 3 * kernels.TILE), 1, kernels.WORK, (1, 3))]
    kernel(0, 0, *arrays)
    packed = re.findall(r"\bv?(?:mul|add|fmadd\d+)pd\b", "".join(kernel.inspect_asm().values()))
    assert len(packed) > 30  # every power of both polynomials is one multiplication and addition


@pytest.mark.parametrize("dtype", [np.int64, np.float16, complex, ">f8", "nonsense", object])
def test_other_precisions_are_refused(dtype):
    with pytest.raises(OptionError, match="float64 or float32"):
        WarpFrame(random_case()[0], dtype=dtype)


@pytest.mark.parametrize("threads", [0, -1, 1.5, True, "two"])
def test_bad_thread_counts_are_refused(threads):
    with pytest.raises(OptionError, match="threads"):
        WarpFrame(random_case()[0], threads=threads)


@pytest.mark.parametrize("q", [[1.0], np.zeros((5, 1)), 3.0, ["a"] * 5, [1j] * 5, [[1.0], [1.0, 2.0]]])
def test_bad_coordinates_are_refused(q):
    with pytest.raises(OptionError, match="q must"):
        WarpFrame(random_case()[0]).positions(q)


@pytest.mark.parametrize(
    "out",
    [
        np.empty((300, 3), np.float32),
        np.empty((299, 3)),
        np.empty((3, 300)).T,
        np.empty(900),
        [[0.0] * 3] * 300,
        np.broadcast_to(0.0, (300, 3)),
    ],
)
def test_bad_outputs_are_refused(out):
    basis, q = random_case()
    with pytest.raises(OptionError, match="out must be a writable"):
        WarpFrame(basis).positions(q, out)


def test_the_benchmark_says_what_it_measured():
    rows = benchmarks.benchmark(sizes=(90,), modes=(2, 10**6), repeats=1, threads=(1,), memory_limit=1e6)
    assert [(row["n"], row["m"], row["dtype"], row["threads"]) for row in rows] == [
        (90, 2, "float64", 1),
        (90, 2, "float32", 1),
    ]
    assert rows[0]["error"] < 1e-12
    assert rows[1]["error"] < 1e-6
    assert all(row["ratio_numpy"] == row["seconds_numpy"] / row["seconds_frame"] for row in rows)
    with pytest.raises(OptionError, match="prime"):
        benchmarks.random_basis(97, 2)


def test_interleaved_times_order_functions():
    times = interleaved({"short": lambda: sum(range(10)), "long": lambda: sum(range(20000))}, 3, 1e-3)
    assert 0 < times["short"] < times["long"]


@pytest.mark.parametrize("angle", [1e-9, 0.5, 3.0, 6.2, 15.0])
@pytest.mark.parametrize("n", [1, 128, 300])
def test_a_pushed_frame_is_the_load_turned_back(angle, n):
    basis, q = random_case(n=n, angle=angle)
    load = np.random.default_rng(1).standard_normal((n, 3))
    turned = Rotation.from_rotvec((basis.rotations @ q).reshape(-1, 3)).inv().apply(load)
    expected = basis.modes.T @ turned.ravel()
    rows, force = push.load_rows(load), np.empty(q.size)
    modal = WarpFrame(basis).modal_data.reshape(-1)
    push.push_frame(modal, rows, push.POWERS, q, np.empty(push.ROWS), force)
    assert np.abs(force - expected).max() <= 20.0 * TOLERANCE[np.float64] * np.linalg.norm(basis.modes, axis=0).max()


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.5, 3.0, 6.2, 15.0])
@pytest.mark.parametrize("n", [1, 128, 300])
def test_the_work_of_a_frame_is_that_of_its_vertices(angle, n):
    basis, q = random_case(n=n, angle=angle)
    load = np.random.default_rng(1).standard_normal((n, 3))
    turns, linear = ((part @ q).reshape(-1, 3) for part in (basis.rotations, basis.modes))
    by_moves, by_turns = np.empty((2, n, 3))
    work = rotations.warped_work(turns, linear, load, by_moves, by_turns)
    gradient = basis.modes.T @ by_moves.ravel() + basis.rotations.T @ by_turns.ravel()
    modal, found = WarpFrame(basis).modal_data.reshape(-1), np.empty(q.size)
    done = push.work_frame(modal, push.load_rows(load), push.POWERS, q, np.empty(2 * push.ROWS), found)
    size = np.abs(load).sum() * (1.0 + np.abs(linear).max())  # of terms that cancel near a whole turn
    assert np.abs(found - gradient).max() <= 100.0 * np.finfo(float).eps * size * max(1.0, np.abs(basis.modes).max())
    assert abs(done - work) <= 100.0 * np.finfo(float).eps * size
