"""What a frame of modal warping costs, against plain NumPy and against reading its modal data once.

``benchmark`` is the table, ``scaling`` the cost of a vertex against their number, ``hinge_kernel`` the rate of the
generated hinge kernel. Two-thread rows mean something only where two cores are free.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import DTypeLike, NDArray

import modalshell as ms
from modalshell.shell.kernels.generated import flexure
from studies.benchmarks.timing import interleaved

Array = NDArray[Any]


def random_basis(n: int, m: int, seed: int = 0) -> tuple[ms.Basis, Array]:
    """A sheet of exactly n vertices with m random modes, and a q that turns its vertices by up to pi."""
    rows = max(d for d in range(1, int(n**0.5) + 1) if n % d == 0)
    if rows == 1:
        raise ms.OptionError(f"n must not be prime (got {n})")
    mesh = ms.sheet(cells=(n // rows - 1, rows - 1))
    shell = ms.Shell(mesh, ms.Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2))
    random = np.random.default_rng(seed)
    modes, rotations = random.standard_normal((2, 3 * n, m))
    q = random.standard_normal(m)
    q *= np.pi / np.linalg.norm((rotations @ q).reshape(-1, 3), axis=1).max()
    modes /= np.linalg.norm((modes @ q).reshape(-1, 3), axis=1).max()
    return ms.Basis(shell, np.ones(m), modes, rotations, 0, 0.0, "random"), q


def numpy_frame(rest: Array, modes: Array, rotations: Array, q: Array) -> Array:
    """The frame written with NumPy as its formula reads."""
    u = (modes @ q).reshape(-1, 3)
    w = (rotations @ q).reshape(-1, 3)
    squared = np.einsum("ij,ij->i", w, w)
    angle = np.sqrt(squared)
    small = angle < 1e-2  # series to phi^4: 1e-16
    safe = np.where(small, 1.0, angle)
    linear = np.where(small, 0.5 - squared / 24 + squared**2 / 720, (1 - np.cos(safe)) / safe**2)
    quadratic = np.where(small, 1 / 6 - squared / 120 + squared**2 / 5040, (safe - np.sin(safe)) / safe**3)
    turned = np.cross(w, u)
    return rest + u + linear[:, None] * turned + quadratic[:, None] * np.cross(w, turned)


@njit(fastmath=True)
def read_once(data):  # type: ignore[no-untyped-def]
    """Sum of a flat array, with packed additions: the fastest way to touch all of it on one thread."""
    total = data[0]
    for i in range(1, data.size):
        total += data[i]
    return total


def benchmark(
    sizes: Iterable[int] = (1000, 13117, 100000),
    modes: Iterable[int] = (4, 8, 32, 128),
    repeats: int = 15,
    *,
    precisions: Iterable[DTypeLike] = (np.float64, np.float32),
    threads: Iterable[int] = (1, 2),
    memory_limit: float = 1e9,
) -> list[dict[str, Any]]:
    """One row per case, its times interleaved; cases that need more than ``memory_limit`` bytes are left out.

    ``seconds_bound`` reads the frame's own modal data once on one thread, back to back as the frame is, so from the
    cache that they fit in. ``error`` is the largest distance to NumPy's float64 positions over the largest
    displacement.
    """
    precisions, threads = list(precisions), list(threads)
    rows = []
    for n in sizes:
        for m in modes:
            if 96 * n * m > memory_limit:  # Phi and Psi in the basis and again in the frame
                continue
            basis, q = random_basis(n, m)
            rest = basis.shell.rest_positions
            exact = numpy_frame(rest, basis.modes, basis.rotations, q)
            reach = np.linalg.norm(exact - rest, axis=1).max()
            for precision in precisions:
                plain = [np.asarray(a, dtype=precision) for a in (rest, basis.modes, basis.rotations, q)]
                out = np.empty((n, 3), precision)
                for parts in threads:
                    frame = ms.WarpFrame(basis, dtype=precision, threads=parts)
                    stream = np.ravel(frame.modal_data)
                    times = interleaved(
                        {
                            "frame": partial(frame.positions, plain[3], out),
                            "numpy": partial(numpy_frame, *plain),
                            "bound": partial(read_once, stream),
                        },
                        repeats,
                    )
                    rows.append(
                        {
                            "n": n,
                            "m": m,
                            "dtype": np.dtype(precision).name,
                            "threads": parts,
                            **{f"seconds_{name}": seconds for name, seconds in times.items()},
                            "ratio_numpy": times["numpy"] / times["frame"],
                            "ratio_bound": times["frame"] / times["bound"],
                            "error": float(np.linalg.norm(frame.positions(q) - exact, axis=1).max() / reach),
                        }
                    )
    return rows


def scaling(
    sizes: Iterable[int] = (1000, 3136, 13117, 31329, 100000),
    m: int = 4,
    repeats: int = 15,
    precision: DTypeLike = np.float64,
) -> list[dict[str, Any]]:
    """Seconds of a frame against n, every size with its data in the same level of memory.

    Frames of as many shells as reach the largest size take turns, a hundred shells of 1,000 vertices or one of 100,000:
    ``seconds_frame``. ``deviation`` is its relative distance to the line ``seconds_call + seconds_vertex n`` that fits
    all sizes best (least squares of relative distances). ``seconds_back_to_back`` is one shell's frame after its own,
    where a small shell stays in a near cache.
    """
    sizes = list(sizes)
    functions: dict[str, Callable[[], object]] = {}
    shells: dict[int, list[ms.WarpFrame]] = {}
    for n in sizes:
        basis, q = random_basis(n, m)
        q = q.astype(precision)
        shells[n] = [ms.WarpFrame(basis, dtype=precision) for _ in range(-(-max(sizes) // n))]
        outs = [np.empty((n, 3), precision) for _ in shells[n]]
        functions[f"turn {n}"] = partial(in_turn, shells[n], outs, q)
        functions[f"one {n}"] = partial(shells[n][0].positions, q, outs[0])
    times = interleaved(functions, repeats, 10e-3)
    frame_times = np.array([times[f"turn {n}"] / len(shells[n]) for n in sizes])
    line = np.column_stack((np.ones(len(sizes)), sizes))
    (call, vertex), *_ = np.linalg.lstsq(line / frame_times[:, None], np.ones(len(sizes)), rcond=None)
    return [
        {
            "n": n,
            "m": m,
            "dtype": np.dtype(precision).name,
            "seconds_frame": float(seconds),
            "seconds_back_to_back": times[f"one {n}"],
            "seconds_call": float(call),
            "seconds_vertex": float(vertex),
            "deviation": float(seconds / (call + vertex * n) - 1.0),
        }
        for n, seconds in zip(sizes, frame_times, strict=True)
    ]


def in_turn(frames: list[ms.WarpFrame], outs: list[Array], q: Array) -> None:
    """One frame of each shell."""
    for frame, out in zip(frames, outs, strict=True):
        frame.positions(q, out)


@njit(error_model="numpy")
def all_hinges(x, stencils, gradients, hessians):  # type: ignore[no-untyped-def]
    """Gradient (H, 9) and packed Hessian (H, 45) of every hinge's fold angle."""
    for hinge in range(stencils.shape[0]):
        v0, v1, v2, v3 = stencils[hinge]
        flexure.second_derivatives(
            x[v1, 0] - x[v0, 0],
            x[v1, 1] - x[v0, 1],
            x[v1, 2] - x[v0, 2],
            x[v2, 0] - x[v0, 0],
            x[v2, 1] - x[v0, 1],
            x[v2, 2] - x[v0, 2],
            x[v3, 0] - x[v0, 0],
            x[v3, 1] - x[v0, 1],
            x[v3, 2] - x[v0, 2],
            gradients[hinge],
            hessians[hinge],
        )


def hinge_kernel(count: int = 39000, repeats: int = 15) -> dict[str, float]:
    """Hinges/s of gradient and Hessian on one thread: compiled, and the same generated code on NumPy arrays.

    Both gather the coordinates and leave (H, 9) and (H, 45) in C order; ``columns`` is NumPy leaving (9, H) and (45, H)
    instead, which suits it, and ``stores`` writes the two arrays only.
    """
    side = int((count / 3.0) ** 0.5) + 2
    mesh = ms.sheet(cells=(side, side))
    elements = ms.Shell(mesh, ms.Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2)).elements
    stencils = next(e.stencils for e in elements if e.kernel is flexure)[:count]
    x = mesh.vertices + 0.1 / side * np.random.default_rng(0).standard_normal(mesh.vertices.shape)
    gradients, hessians = np.empty((count, 9)), np.empty((count, 45))
    columns, packed = np.empty((9, count)), np.empty((45, count))

    def on_arrays(gradient: Array, hessian: Array) -> None:
        edges = x.T[:, stencils[:, 1:].T] - x.T[:, None, stencils[:, 0]]
        second: Any = flexure._second  # mypy cannot count starred arguments
        second(*edges.transpose(1, 0, 2).reshape(9, -1), gradient, hessian)

    def stores() -> None:
        gradients.fill(1.0)
        hessians.fill(1.0)

    times = interleaved(
        {
            "numba": lambda: all_hinges(x, stencils, gradients, hessians),
            "numpy": lambda: on_arrays(gradients.T, hessians.T),
            "numpy_columns": lambda: on_arrays(columns, packed),
            "stores": stores,
        },
        repeats,
    )
    all_hinges(x, stencils, gradients, hessians)
    rates = {f"hinges_per_second_{name}": count / seconds for name, seconds in times.items()}
    return {
        "hinges": count,
        **rates,
        "ratio_numpy": times["numpy"] / times["numba"],
        "ratio_numpy_columns": times["numpy_columns"] / times["numba"],
        "error": float(np.abs(hessians.T - packed).max() / np.abs(packed).max()),
    }


if __name__ == "__main__":
    for row in [*benchmark(), *scaling(), *scaling(precision=np.float32), hinge_kernel()]:
        print({key: float(f"{value:.3g}") if isinstance(value, float) else value for key, value in row.items()})
