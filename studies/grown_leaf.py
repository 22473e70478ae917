"""A leaf whose margin grows more than its midrib, and buckles into waves: the first buckling against plate theory.

Growth is a Green strain along the midrib, the fourth power of the distance from it. Where every strip across a half is
alike, the growth at which it buckles is that of one function across the strip, which a Ritz series finds by itself: a
clamped midrib, a free margin, and waves of cosine along them. Then a leaf grows by small steps, each from the shape
before it; in one step from flat, the finer mesh finds no equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial import Legendre, Polynomial, legendre
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

import modalshell as ms
from modalshell.core.typing import Array, Progress
from modalshell.files.study_result import StudyResult
from studies.pages import counted, markdown, paragraphs, result_of
from studies.stiffened_panel import solved

FIGURES = ("grown_leaf",)
LENGTH, HALF, THICKNESS = 0.12, 0.02, 3e-4
"""Length, greatest half width, and thickness [m]."""
YOUNG, POISSON, DENSITY = 1e7, 0.3, 1000.0
GROWTH, FACTOR = 0.15, 1.25
"""Growth of the margin at the end, and its factor from step to step."""
STRIPS, LEAVES = (4, 8, 16), (4, 8)
"""Cells across a half."""
SHOWN = (0.005, 0.03, 0.15)
"""Growths that are drawn."""
TERMS = 12
"""Terms of the Ritz series; two fewer change its growth by 1e-10."""


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Buckling on three meshes and growth on two; ``quick`` takes the coarsest."""
    best = minimize_scalar(buckling_growth, bounds=(0.5, 5.0), method="bounded")
    wave, exact = float(best.x), float(best.fun)
    strips, leaves = (STRIPS[:1], LEAVES[:1]) if quick else (STRIPS, LEAVES)
    findings: dict[str, Any] = {"exact": {"wave number": wave, "growth": exact}}
    findings["strips"] = [strip(across, wave, exact) for across in strips]
    arrays: dict[str, Any] = {}
    findings["leaves"] = [leaf(across, exact, arrays) for across in counted(leaves, on_step)]
    return result_of("grown_leaf", findings, arrays, quick=quick)


def buckling_growth(wave: float) -> float:
    """Growth of the margin, in squares of thickness over half width, at which waves of a number begin.

    Lengths are in half widths. The deflection is f(t) cos(wave x) with f = t^2 times Legendre polynomials; the stress
    before is -E g t^4 along the midrib alone.
    """
    nodes, weights = legendre.leggauss(4 * TERMS)
    terms = [Polynomial([0, 0, 1]) * Legendre.basis(k, [0, 1]).convert(kind=Polynomial) for k in range(TERMS)]
    t, w = 0.5 * (nodes + 1.0), 0.5 * weights
    f, slope, bent = (np.array([(term.deriv(order) if order else term)(t) for term in terms]) for order in range(3))

    def over(a: Array, b: Array, weight: Any = 1.0) -> Array:
        return np.asarray((a * w * weight) @ b.T)

    crossed = over(bent, f) + over(f, bent)
    bending = over(bent, bent) + wave**4 * over(f, f) - POISSON * wave**2 * crossed
    bending += 2.0 * (1.0 - POISSON) * wave**2 * over(slope, slope)
    pushed = wave**2 * over(f, f, t**4)
    return float(1.0 / eigh(pushed, bending / (12.0 * (1.0 - POISSON**2)), eigvals_only=True)[-1])


def sheet(cells: tuple[int, int], half: Callable[[Array], Array], length: float, growth: float, sides: int) -> ms.Shell:
    """A leaf of one or two ``sides``, whose half width is ``half`` of the place along the midrib, which is clamped.

    One side is a strip between planes of symmetry.
    """
    along, across = cells
    flat = ms.flat_beam(length=1.0, width=float(sides), cells=(along, sides * across))
    place, part = flat.vertices[:, 0], np.abs(flat.vertices[:, 1] - (0.0 if sides == 2 else -0.5))
    side = np.sign(flat.vertices[:, 1]) if sides == 2 else 1.0
    points = np.stack([length * place, side * part * half(place), 0.0 * place], axis=1)

    def grown(centres: Array) -> Array:
        strain = np.zeros((len(centres), 3, 3))
        strain[:, 0, 0] = growth * (centres[:, 1] / half(centres[:, 0] / length)) ** 4
        return strain

    ends = [] if sides == 2 else [ms.Symmetry(place == end, (1.0, 0.0, 0.0)) for end in (0.0, 1.0)]
    material = ms.Isotropic(young=YOUNG, poisson=POISSON, thickness=THICKNESS, density=DENSITY)
    mesh = ms.TriangleMesh(points, flat.faces)
    return ms.Shell(mesh, material, clamped=part < 1e-9, supports=ends, prestrain=grown)


def strip(across: int, wave: float, exact: float) -> dict[str, Any]:
    """Growth at which a strip of half a wave buckles, by the stiffness of its flat state, over the Ritz series'."""
    length, unit = np.pi * HALF / wave, (THICKNESS / HALF) ** 2
    cells = max(round(across * length / HALF), 3), across

    def made(growth: float) -> ms.Shell:
        return sheet(cells, lambda place: np.full_like(place, HALF), length, growth, 1)

    little = 1e-3 * exact * unit
    plain, pushed = made(0.0), made(little)
    flat = solved(ms.DiscreteShell(pushed).equilibrium())
    lateral = 3 * np.flatnonzero(~plain.clamped) + 2
    stiff = plain.stiffness().tocsr()[lateral][:, lateral].toarray()
    softer = stiff - pushed.stiffness(flat.positions).tocsr()[lateral][:, lateral].toarray()
    found = little / eigh(softer, stiff, eigvals_only=True)[-1]
    return {"cells": across, "vertices": len(plain.mesh.vertices), "found": float(found / (exact * unit))}


def outline(place: Array) -> Array:
    """Half width [m] of the leaf at a place along its midrib, 0 to 1."""
    return np.asarray(HALF * np.sin(np.pi * (0.08 + 0.84 * place)) ** 0.8)


def leaf(across: int, exact: float, shapes: dict[str, Any]) -> dict[str, Any]:
    """A leaf that grows: at each growth the margin's waves, its height, and how much of its growth it follows.

    ``shapes`` takes its triangles, and its vertices (n, 3) [m] at the growths that are drawn.
    """
    cells = round(across * LENGTH / HALF), across

    def made(growth: float) -> ms.Shell:
        return sheet(cells, outline, LENGTH, growth, 2)

    flat = made(0.0)
    margins = [edge[np.argsort(flat.rest_positions[edge, 0])] for edge in _margins(flat)]
    uneven = np.zeros_like(flat.rest_positions)
    uneven[~flat.clamped, 2] = 1e-3 * THICKNESS * np.random.default_rng(0).standard_normal(len(uneven))[~flat.clamped]
    start = flat.rest_positions
    shapes[f"faces_{across}"] = flat.mesh.faces
    rows, growth = [], 0.9 * exact * (THICKNESS / HALF) ** 2
    while True:
        state = solved(ms.DiscreteShell(made(growth)).equilibrium(start=start + uneven))
        start = state.positions
        rows.append(
            {"growth": growth, "iterations": state.iterations, **_margin(flat, state.positions, margins, growth)}
        )
        if growth in SHOWN:
            shapes[f"shape_{across}_{SHOWN.index(growth)}"] = start
        if growth == GROWTH:
            break
        growth = min([growth * FACTOR] + [shown for shown in SHOWN if shown > growth])
    outright = ms.DiscreteShell(made(GROWTH)).equilibrium(start=flat.rest_positions + uneven)
    return {
        "cells": across,
        "vertices": len(flat.mesh.vertices),
        "rows": rows,
        "in one step": outright.status,
    }


def _margins(shell: ms.Shell) -> list[Any]:
    """Vertices of the two margins."""
    x, y = shell.rest_positions[:, 0], shell.rest_positions[:, 1]
    return [np.flatnonzero(np.abs(y - side * outline(x / LENGTH)) < 1e-9) for side in (-1.0, 1.0)]


def _margin(shell: ms.Shell, x: Array, margins: list[Any], growth: float) -> dict[str, Any]:
    """Waves of a margin by the changes of its height's sign, its height [m], and the share of growth in its length."""
    crossings, rest, now, grown = [], 0.0, 0.0, 0.0
    for edge in margins:
        height = x[edge, 2]
        high = np.sign(height[np.abs(height) > 0.02 * np.abs(height).max()])
        crossings.append(int(np.count_nonzero(np.diff(high))))
        own, moved = np.diff(shell.rest_positions[edge], axis=0), np.diff(x[edge], axis=0)
        rest += float(np.linalg.norm(own, axis=1).sum())
        now += float(np.linalg.norm(moved, axis=1).sum())
        grown += float(np.sqrt(np.sum(own**2, axis=1) + 2.0 * growth * own[:, 0] ** 2).sum())
    return {
        "waves": 0.25 * sum(crossings),
        "height": float(np.abs(x[:, 2]).max()),
        "followed": (now - rest) / (grown - rest),
    }


def table(result: StudyResult) -> str:
    """Buckling of strips, and the leaves as they grow, as Markdown tables."""
    exact = result.findings["exact"]
    grown = [
        row | {"cells": leaf["cells"], "thick": row["height"] / THICKNESS}
        for leaf in result.findings["leaves"]
        for row in leaf["rows"]
        if row["growth"] in SHOWN
    ]
    return paragraphs(
        f"By the Ritz series the strip buckles at a growth of {exact['growth']:.4f} (h/b)^2, in waves of the length "
        f"{2.0 * np.pi / exact['wave number']:.3f} b; h is the thickness, b the half width.",
        markdown(
            "cells across | vertices | growth over the exact one, less 1 [%]",
            "{cells} | {vertices} | {off:100*+.2f}",
            [row | {"off": row["found"] - 1.0} for row in result.findings["strips"]],
        ),
        "The leaf, step by step:",
        markdown(
            "cells across a half | growth | waves of a margin | height in thicknesses | growth that the margin follows "
            "[%] | iterations",
            "{cells} | {growth:.3f} | {waves:.1f} | {thick:.1f} | {followed:100*.1f} | {iterations}",
            grown,
        ),
        markdown(
            "cells across a half | vertices | all growth in one step from flat",
            "{cells} | {vertices} | {in one step}",
            result.findings["leaves"],
        ),
    )


def finding(result: StudyResult) -> str:
    """How near the buckling is, and what the grown leaf looks like."""
    strips = result.findings["strips"]
    *coarser, last = (leaf["rows"][-1] for leaf in result.findings["leaves"])
    on_fewer = "".join(f"{one['waves']:.1f} and {100.0 * one['followed']:.0f} %" for one in coarser[-1:])
    off = ", ".join(f"{100.0 * (row['found'] - 1.0):.1f}" for row in strips)
    cells = ", ".join(str(row["cells"]) for row in strips)
    return (
        f"A strip's growth at buckling is {off} % above plate theory's with {cells} cells across. At a growth of "
        f"{100.0 * last['growth']:.0f} % the leaf's margins make {last['waves']:.1f} waves each and follow "
        f"{100.0 * last['followed']:.0f} % of it{f', with half as many cells across {on_fewer}' if on_fewer else ''}."
    )
