"""The drapes of the page ``modalshell page --drape``: a round cloth between two discs, by its bending length alone.

A cloth of 300 mm, held between discs of 180 mm, hangs under its weight as in the drape test of Cusick (BS 5058). Where
it does not stretch, its shape depends on its bending length ``(B / (rho g))^(1/3)`` alone. Discrete shells find the
shape for each of a geometric series of bending lengths, from stiff to soft and back, each from the one before, and the
state of less energy is kept; a small seeded unevenness lets it buckle. Runs in between that start from the interpolated
shape measure the error of interpolation; runs that start from the flat cloth fold otherwise, and measure the scatter.

With ``--length`` a cloth of any bending length [m] is run from the page's own shape, and compared with the page.

Example: python -m studies.drape_family --length 0.021
"""

from __future__ import annotations

import argparse
import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import Delaunay

import modalshell as ms
from modalshell.core.typing import Array
from modalshell.files.atomic_io import write_record
from modalshell.page.drape import CLOTH, DISCS, FAMILY, coefficient_between
from modalshell.shell.cards import GRAVITY

EDGE = 9e-3
"""Length of edges [m]."""
STIFFEST, SOFTEST, COUNT = 0.14, 0.014, 25
"""Bending lengths [m] of the family, and their number."""
_THIN = 40.0
"""Bending length over thickness: at 40 the weight stretches the cloth by less than 1e-4."""
_UNEVEN = 2e-4
"""Unevenness [m] from which the cloth buckles."""
_WEIGHT = 0.2
"""Mass per area [kg/m^2], which changes nothing at a given bending length."""
_PIXELS = 1200


def annulus(edge: float = EDGE, cloth: float = CLOTH, discs: float = DISCS) -> ms.TriangleMesh:
    """A cloth of a radius between the rim of its discs and its own, with a strip inside; no direction is preferred."""

    def ring(radius: float) -> Array:
        angles = 2.0 * np.pi * np.arange(round(2.0 * np.pi * radius / edge)) / round(2.0 * np.pi * radius / edge)
        return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    count = int(np.pi * cloth**2 / (0.87 * edge**2))
    turns = np.arange(count) + 0.5
    radius, angle = cloth * np.sqrt(turns / count), np.pi * (1.0 + 5.0**0.5) * turns
    inside = (radius < cloth - 0.6 * edge) & (radius > discs + 0.55 * edge)
    spiral = (radius * np.stack([np.cos(angle), np.sin(angle)]))[:, inside].T
    inner = discs - 0.9 * edge
    points = np.concatenate([spiral, ring(discs), ring(cloth), ring(inner)])
    faces = Delaunay(points).simplices.astype(np.int64)
    faces = faces[np.hypot(*points[faces].mean(axis=1).T) > 0.99 * inner]
    first, second = (points[faces[:, k]] - points[faces[:, 0]] for k in (1, 2))
    turned = first[:, 0] * second[:, 1] < first[:, 1] * second[:, 0]
    faces[turned] = faces[turned, ::-1]
    return ms.TriangleMesh(np.column_stack([points, np.zeros(len(points))]), faces)


def cloth(mesh: ms.TriangleMesh, length: float, discs: float = DISCS) -> ms.Shell:
    """The cloth of a bending length [m], held between discs of a radius [m]."""
    thickness = length / _THIN
    young = 12.0 * _WEIGHT * GRAVITY * length**3 / thickness**3
    sheet = ms.Isotropic(young=young, poisson=0.0, thickness=thickness, density=_WEIGHT / thickness)
    return ms.Shell(mesh, sheet, np.hypot(*mesh.vertices[:, :2].T) < 1.0001 * discs)


def hung(shell: ms.Shell, start: Array, seed: int = 0) -> ms.Equilibrium:
    """The cloth at rest under its weight, from ``start`` (n, 3) [m] made uneven by a seed."""
    uneven = start.copy()
    uneven[shell.free, 2] += _UNEVEN * np.random.default_rng(seed).standard_normal(len(shell.free))
    return ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -GRAVITY), start=uneven)


def coefficient(positions: Array, faces: Any, cloth: float = CLOTH, discs: float = DISCS) -> float:
    """Drape coefficient: the area of the shadow beyond the discs, seen from above, over that of the flat cloth."""
    scale = 0.5 * _PIXELS / (1.02 * cloth)
    corners = positions[faces][:, :, :2] * scale + 0.5 * _PIXELS
    rows, columns = np.mgrid[0:_PIXELS, 0:_PIXELS] + 0.5
    shadow = np.hypot(columns - 0.5 * _PIXELS, rows - 0.5 * _PIXELS) < discs * scale
    for a, b, c in corners:
        low = np.clip(np.floor(np.min([a, b, c], axis=0)).astype(int), 0, _PIXELS)
        high = np.clip(np.ceil(np.max([a, b, c], axis=0)).astype(int) + 1, 0, _PIXELS)
        window = np.s_[low[1] : high[1], low[0] : high[0]]
        x, y = columns[window] - a[0], rows[window] - a[1]
        (p, q), (r, s) = b - a, c - a
        area = p * s - q * r
        if abs(area) > 1e-9:
            u, v = (x * s - y * r) / area, (y * p - x * q) / area
            shadow[window] |= (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    disc = np.pi * discs**2
    return float((shadow.sum() / scale**2 - disc) / (np.pi * cloth**2 - disc))


def potential(shell: ms.Shell, positions: Array) -> float:
    """Elastic energy less the work of the weight [J]: of several ways to fold, the cloth prefers the least."""
    moved = positions - shell.rest_positions
    return shell.energy(positions) - float(np.sum(shell.gravity_force((0.0, 0.0, -GRAVITY)) * moved))


def swept(mesh: ms.TriangleMesh, lengths: Array, start: Array) -> list[Array]:
    """Positions (n, 3) [m] of the cloth at every bending length, each from the one before; SolverError without one."""
    found = []
    for length in lengths:
        answer = hung(cloth(mesh, float(length)), start)
        if not answer.converged:
            raise ms.SolverError(f"the cloth of a bending length of {length:.4g} m: {answer.status}, {answer.message}")
        start = answer.positions
        found.append(start)
        print(f"{1e3 * length:.2f} mm: {100.0 * coefficient(start, mesh.faces):.2f} %", flush=True)
    return found


def shown(length: float, file: Path = FAMILY) -> tuple[Array, float]:
    """Shape (n, 3) [m] and drape coefficient that the page shows at a bending length [m] within its range."""
    family = json.loads(file.read_text(encoding="utf-8"))
    lengths = family["lengths"]
    if not lengths[-1] <= length <= lengths[0]:
        raise ms.OptionError(f"length must be from {lengths[-1]:g} to {lengths[0]:g} m (got {length:g})")
    stored = np.frombuffer(base64.b64decode(family["positions"]), dtype="<i2").astype(np.float64)
    states = family["scale"] * stored.reshape(len(lengths), -1, 3)
    place = float(np.interp(-np.log(length), -np.log(lengths), np.arange(len(lengths))))
    before = min(int(place), len(lengths) - 2)
    share = place - before
    shape = (1.0 - share) * states[before] + share * states[before + 1]
    return shape, coefficient_between(length, lengths, family["coefficients"])


def again(length: float, seed: int = 99) -> tuple[float, float]:
    """Drape coefficient of a run of the cloth of a bending length [m] from the page's shape, and the page's own."""
    mesh = annulus()
    start, told = shown(length)
    answer = hung(cloth(mesh, length), start, seed)
    if not answer.converged:
        raise ms.SolverError(f"the cloth of a bending length of {length:.4g} m: {answer.status}, {answer.message}")
    return coefficient(answer.positions, mesh.faces), told


def main(target: Path = FAMILY) -> Path:
    """Find the family and write it: of the sweeps to soft cloth and back, the state of less energy at each length."""
    mesh = annulus()
    lengths = np.geomspace(STIFFEST, SOFTEST, COUNT)
    flat = np.array(mesh.vertices)
    there = swept(mesh, lengths, flat)
    back = swept(mesh, lengths[::-1], there[-1])[::-1]
    states = []
    for length, pair in zip(lengths, zip(there, back, strict=True), strict=True):
        shell = cloth(mesh, float(length))
        states.append(min(pair, key=lambda positions: potential(shell, positions)))
    shares = [coefficient(state, mesh.faces) for state in states]
    missed: list[list[float]] = []
    scatter: list[list[float]] = []
    for number, length in enumerate(np.sqrt(lengths[1:] * lengths[:-1])):
        expected = coefficient_between(float(length), lengths.tolist(), shares)
        runs = [(missed, 0.5 * (states[number] + states[number + 1]))] + [(scatter, flat)] * (number % 2)
        for kept, start in runs:
            answer = hung(cloth(mesh, float(length)), start, seed=1 + number)
            if answer.converged:
                kept.append([float(length), coefficient(answer.positions, mesh.faces) - expected])
                print(f"{1e3 * length:.2f} mm, {len(runs)}: {100.0 * kept[-1][1]:+.2f} points", flush=True)
    scale = float(np.abs(states).max()) / 32767.0
    stored = np.round(np.array(states) / scale).astype("<i2")
    record = {
        "lengths": lengths.tolist(),
        "coefficients": shares,
        "missed": missed,
        "scatter": scatter,
        "scale": scale,
        "positions": base64.b64encode(stored.tobytes()).decode(),
        "faces": base64.b64encode(np.asarray(mesh.faces, dtype="<u2").tobytes()).decode(),
    }
    return write_record(target, record)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m studies.drape_family", description=__doc__)
    parser.add_argument("--length", type=float, help="bending length [m] of a cloth to run and compare with the page")
    asked = parser.parse_args().length
    if asked is None:
        print(main())
    else:
        run, page = again(asked)
        print(f"run {100.0 * run:.1f} %, page {100.0 * page:.1f} %: {100.0 * (run - page):+.1f} points")
