"""What a crowd costs: instances a second against the bare matrix products, and steps a second of a flock.

All on one thread, with BLAS held to one too, and timed by the processor's clock, which does not count the turns of
other programs.
"""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

import modalshell as ms
from modalshell.crowd import LEVELS
from modalshell.crowd.device import DeviceCrowd, DeviceSearch
from modalshell.crowd.shell_crowd import ShellCrowd
from modalshell.kernels.compiler import njit
from modalshell.kernels.device import devices, warp
from modalshell.kernels.packed import BYTES, load, store
from studies.benchmarks.timing import interleaved, one_blas_thread

ROTATION = {8: 34, 4: 29}
"""Packed multiplications of a warped vertex in a crowd, by bytes of a number, without its modes: up to half a turn."""


def bird_basis(modes: int = 8, cells: tuple[int, int] = (16, 14)) -> ms.Basis:
    """Modes of a paper bird, of 493 vertices without other ``cells``, held along its body."""
    mesh = ms.paper_bird(cells=cells)
    material = ms.Material(stretch=2000.0, shear=2000.0, flexure=2e-3, density=0.08)
    return ms.solve_modes(ms.Shell(mesh, material, clamped=mesh.vertices[:, 2] <= 0.0), modes)


def reconstruction(
    instances: int = 4096,
    basis: ms.Basis | None = None,
    repeats: int = 15,
    precisions: Iterable[DTypeLike] = (np.float64, np.float32),
) -> list[dict[str, Any]]:
    """Instances a second, the best of ``repeats`` turns, of a crowd at each level, of its steps, and of three bounds.

    They are the two products Phi q and Psi q over the whole batch, by BLAS, writing the positions alone, and the
    arithmetic of MWTS alone, at the processor's pace of packed fused multiplications and additions: six a mode, and
    :data:`ROTATION`; additions alone, which some processors make at the same time, are not counted. ``mwts`` is without
    a place in the world, as the products are; ``placed`` is MWTS with a rotation and a translation each.
    """
    basis = basis or bird_basis()
    random = np.random.default_rng(0)
    q = bent(instances, basis, random)
    turns = np.broadcast_to(np.eye(3), (instances, 3, 3)).copy()
    moves = random.standard_normal((instances, 3))
    rows = []
    for precision in precisions:
        crowd = ms.Crowd(basis, instances, dtype=precision)
        crowd.coordinates = q
        out = np.empty((instances, crowd.vertices, 3), precision)
        small = q.astype(precision)
        transposed = [np.ascontiguousarray(a.T, dtype=precision) for a in (basis.modes, basis.rotations)]
        products = np.empty((2, instances, 3 * crowd.vertices), precision)
        packs = -(-crowd.vertices // (BYTES // out.itemsize))
        operations = instances * packs * (6 * basis.count + ROTATION[out.itemsize])
        numbers = np.full(14 * BYTES // out.itemsize, 0.5, precision)
        functions: dict[str, Callable[[], object]] = {
            name.lower(): partial(at_level, name, crowd, None, None, out) for name in LEVELS
        }
        functions |= {
            "placed": partial(at_level, ms.ModalWarping.name, crowd, turns, moves, out),
            "products": partial(multiply, small, transposed, products),
            "writing": partial(out.fill, 1.0),
            "arithmetic": partial(fused, numbers, BYTES // out.itemsize, -(-operations // 12)),
            "step": partial(still, crowd, q),
        }
        with one_blas_thread():
            times = interleaved(functions, repeats, statistic=min, clock=time.process_time)
        rows.append(
            {
                "instances": instances,
                "vertices": crowd.vertices,
                "modes": basis.count,
                "dtype": np.dtype(precision).name,
                **{f"per_second_{name}": instances / seconds for name, seconds in times.items()},
                "ratio_products": times["products"] / times["mwts"],
                "ratio_products_placed": times["products"] / times["placed"],
                "ratio_products_arithmetic": times["products"] / times["arithmetic"],
            }
        )
    return rows


@njit(error_model="numpy")
def fused(numbers, lanes, turns):  # type: ignore[no-untyped-def]
    """Twelve chains of ``turns`` packed fused multiplications and additions, as fast as the processor makes them."""
    x, y = load(numbers, 0), load(numbers, lanes)
    a, b, c = load(numbers, 2 * lanes), load(numbers, 3 * lanes), load(numbers, 4 * lanes)
    d, e, f = load(numbers, 5 * lanes), load(numbers, 6 * lanes), load(numbers, 7 * lanes)
    g, h, i = load(numbers, 8 * lanes), load(numbers, 9 * lanes), load(numbers, 10 * lanes)
    j, k, m = load(numbers, 11 * lanes), load(numbers, 12 * lanes), load(numbers, 13 * lanes)
    for _ in range(turns):
        a, b, c, d = a * x + y, b * x + y, c * x + y, d * x + y
        e, f, g, h = e * x + y, f * x + y, g * x + y, h * x + y
        i, j, k, m = i * x + y, j * x + y, k * x + y, m * x + y
    for at, chain in enumerate((a, b, c, d, e, f, g, h, i, j, k, m)):
        store(numbers, (2 + at) * lanes, chain)


def at_level(name: str, crowd: ms.Crowd, turns: Any, moves: Any, out: Any) -> None:
    """Positions of all instances at one level of detail."""
    crowd.levels[:] = LEVELS.index(name)
    crowd.positions(turns, moves, out)


def multiply(q: Any, matrices: Iterable[Any], products: Iterable[Any]) -> None:
    """The products of all coordinates by BLAS."""
    for matrix, product in zip(matrices, products, strict=True):
        np.matmul(q, matrix, out=product)


def bent(instances: int, basis: ms.Basis, random: np.random.Generator) -> Any:
    """Coordinates (B, m) by which no vertex turns more than 1.5 rad."""
    q = random.standard_normal((instances, basis.count))
    return q * (1.5 / np.linalg.norm((q @ basis.rotations.T).reshape(-1, 3), axis=1).max())


def still(crowd: ShellCrowd, q: Any) -> None:
    """One step of all instances from the same state, to which they are put back."""
    crowd.rates = np.zeros_like(q)
    crowd.step(1.0 / 60.0, felt=(0.0, 0.0, -9.81))
    crowd.coordinates = q


def ball(count: int, per_volume: float = 20.0) -> float:
    """Radius of a ball with ``per_volume`` of ``count`` boids in a unit of volume."""
    return float((count / per_volume * 3.0 / (4.0 * np.pi)) ** (1.0 / 3.0))


def flock(
    sizes: Iterable[int] = (1000, 10000, 100000), per_volume: float = 20.0, steps: int = 20, search: str = "grid"
) -> list[dict[str, Any]]:
    """Steps a second, the best of ``steps``, from ``per_volume`` boids in a cube of the neighbour distance.

    Of more than 100,000 boids a tenth of the steps; memory is the most that the arrays of a flock and its steps took.
    """
    rows = []
    ms.Flock.random(8, radius=1.0, search=search).step(1e-6)  # what is loaded and compiled once is no memory of a flock
    for count in sizes:
        tracemalloc.start()
        boids = ms.Flock.random(count, radius=ball(count, per_volume), search=search)
        boids.step(1e-6)
        memory = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        seconds = []
        for _ in range(steps if count <= 100_000 else max(3, steps // 10)):
            start = time.process_time()
            boids.step(1e-6)  # so short that the density stays
            seconds.append(time.process_time() - start)
        best = min(seconds)
        rows.append(
            {
                "boids": count,
                "search": search,
                "neighbours": float(boids.neighbourhood().counts.mean()),
                "steps_per_second": 1.0 / best,
                "microseconds_boid": 1e6 * best / count,
                "megabytes": 1e-6 * memory,
            }
        )
    return rows


DEVICES = ((300, 8, (16, 14)), (10000, 512, (16, 14)), (100000, 4096, (16, 14)), (1000000, 1, (86, 75)))
"""Boids, and instances of a mesh, timed on devices; the last crowd is one frame of 13,137 vertices."""


def left_there(crowd: DeviceCrowd, moves: Any) -> None:
    """Positions of all instances, left on the device."""
    crowd.device_positions(np.eye(3), moves)
    warp().synchronize_device(crowd.device)


def on_devices(boids: int, instances: int, cells: tuple[int, int], repeats: int = 15) -> list[dict[str, Any]]:
    """What every device does of a flock's sums, a crowd's placed MWTS and its steps; the best of ``repeats`` turns.

    Against one thread of the kernels: by the processor's clock on the processor, by the wall's on a GPU. Positions are
    timed with the way back to the host's memory, and left on the device. Large flocks take fewer turns, at least three.
    """
    basis, repeats = bird_basis(cells=cells), max(3, repeats * 100_000 // max(boids, 100_000))
    random = np.random.default_rng(0)
    coordinates, moves = bent(instances, basis, random), random.standard_normal((instances, 3))
    kernels = ms.Flock.random(boids, radius=ball(boids))
    rows = []
    for device in devices():
        clock = time.process_time if device == "cpu" else time.perf_counter
        for precision in ("float64", "float32"):
            single = ms.Crowd(basis, instances, dtype=precision)
            crowd = DeviceCrowd(basis, instances, dtype=precision, device=device)
            single.coordinates = crowd.coordinates = coordinates
            near = ms.Flock.random(boids, radius=ball(boids), search=DeviceSearch(precision, device))
            out = np.empty((instances, crowd.vertices, 3), precision)
            calls: dict[str, Callable[[], object]] = {
                "sums_kernels": kernels.neighbourhood,
                "sums": near.neighbourhood,
                "placed_kernels": partial(single.positions, np.eye(3), moves, out),
                "placed": partial(crowd.positions, np.eye(3), moves, out),
                "left": partial(left_there, crowd, moves),
                "step_kernels": partial(still, single, coordinates),
                "step": partial(still, crowd, coordinates),
            }
            times = interleaved(calls, repeats, statistic=min, clock=clock)
            rows.append(
                {
                    "device": device,
                    "dtype": precision,
                    "boids": boids,
                    "instances": instances,
                    "vertices": crowd.vertices,
                    "boids_per_second": boids / times["sums"],
                    "instances_per_second": instances / times["left"],
                    "ratio_sums": times["sums_kernels"] / times["sums"],
                    "ratio_placed": times["placed_kernels"] / times["placed"],
                    "ratio_left": times["placed_kernels"] / times["left"],
                    "ratio_step": times["step_kernels"] / times["step"],
                }
            )
    return rows
