"""``Material.from_physical`` says where its calibration does not hold, and is silent where it does."""

import re
import warnings

import numpy as np
import pytest

from modalshell import (
    Isotropic,
    Material,
    Shell,
    TriangleMesh,
    cylinder_panel,
    flat_beam,
    leaf,
    sheet,
    solve_modes,
    v_beam,
)
from modalshell.core.errors import ModalShellWarning


def calibrate(mesh, poisson=0.3, thickness=1e-3, **options):
    return Material.from_physical(young=1e9, poisson=poisson, thickness=thickness, density=1e3, mesh=mesh, **options)


def stretched(factor):
    lattice = sheet(cells=(23, 20), family="equilateral")
    return TriangleMesh(lattice.vertices * (factor, 1.0, 1.0), lattice.faces)


def thin():
    return flat_beam(length=1.0, width=0.25, cells=(18, 4), family="union-jack")


@pytest.mark.parametrize(
    ("make", "poisson", "thickness", "words"),
    [
        (
            lambda: v_beam(cells=(40, 8), family="union-jack"),
            0.0,
            1e-3,
            r"in the plane .*18 % off at Poisson's ratio 0 ",
        ),
        (lambda: v_beam(cells=(20, 4), family="right"), 0.1, 1e-3, r"in the plane .*ratio 0\.1 "),
        (thin, 0.3, 1e-4, r"over thickness 10000\).*at least 1000 triangles \(got 144\)"),
        (lambda: stretched(2.0), 0.3, 1e-3, r"cells are longer one way.*0\.\d+ times"),
        (
            lambda: flat_beam(length=1.0, width=0.25, cells=(18, 4), family="delaunay"),
            0.3,
            1e-2,
            r"rows at the ends are not straight.*\d+ % too soft or too stiff",
        ),
        (
            lambda: flat_beam(length=1.0, width=0.2, cells=(20, 2), family="equilateral"),
            0.0,
            1e-3,
            r"'equilateral' lattice .*17 %",
        ),
        (lambda: flat_beam(length=1.0, width=0.2, cells=(40, 4), family="equilateral"), 0.3, 5e-3, r"quality 0\.87"),
        (
            lambda: flat_beam(length=1.0, width=0.2, cells=(20, 2), family="lloyd"),
            0.3,
            1e-2,
            r"unequal triangles .* up to 12 %",
        ),
    ],
    ids=[
        "in its plane",
        "in its plane, low ratio",
        "thin",
        "stretched cells",
        "crooked end row",
        "not equilateral",
        "thick",
        "few of Lloyd's triangles across",
    ],
)
def test_what_the_calibration_misses_is_said(make, poisson, thickness, words):
    mesh = make()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ModalShellWarning)
        material = calibrate(mesh, poisson, thickness)
    assert material.flexure > 0.0
    said = [str(warning.message) for warning in caught if "calibration" in str(warning.message)]
    assert len(said) == 1
    assert re.search(words, said[0])
    assert "ms.Isotropic(" in said[0]
    assert caught[-1].filename == __file__


@pytest.mark.by_default("few of Lloyd's triangles", "ratio 0", "leaf")
@pytest.mark.parametrize(
    ("make", "poisson", "thickness"),
    [
        (lambda: v_beam(cells=(40, 8), family="union-jack"), 0.3, 1e-3),
        (thin, 0.3, 1e-3),
        (lambda: flat_beam(length=1.0, width=0.25, cells=(18, 4), family="equilateral"), 0.3, 1e-4),
        (lambda: flat_beam(length=1.0, width=0.25, cells=(32, 8), family="lloyd"), 0.3, 1e-3),
        (lambda: stretched(1.0), 0.0, 1e-3),
        (lambda: sheet(cells=(20, 20), family="union-jack"), 0.0, 1e-3),
        (lambda: cylinder_panel(cells=(20, 20)), 0.3, 1e-3),
        (lambda: leaf(cells=(40, 16)), 0.3, 3e-3),
    ],
    ids=["V", "thin", "thinner", "few of Lloyd's triangles", "lattice", "ratio 0", "cylinder", "leaf"],
)
def test_no_word_where_it_holds(make, poisson, thickness):
    """Warnings are errors in this suite."""
    assert np.isfinite(calibrate(make(), poisson, thickness).flexure)


def test_one_thin_triangle_that_rules_the_constants_is_said():
    """A point close to a side of one triangle of 32 makes the plate's constant 200 times what it is without."""
    mesh = sheet(length=1.0, width=1.0, cells=(4, 4))
    a, b, c = mesh.faces[5]
    point, count = mesh.vertices[[a, b]].mean(axis=0), len(mesh.vertices)
    point = point + 0.01 * (mesh.vertices[c] - point)
    faces = np.vstack((np.delete(mesh.faces, 5, axis=0), [(a, b, count), (count, b, c), (a, count, c)]))
    with pytest.warns(ModalShellWarning) as caught:
        calibrate(TriangleMesh(np.vstack((mesh.vertices, point)), faces), 0.3, 1e-2)
    assert any("long and low" in str(warning.message) and "--repair" in str(warning.message) for warning in caught)


@pytest.mark.parametrize(("round_it", "across", "off"), [(48, 2, 0.02), (96, 2, 0.07), (96, 4, 0.06)])
def test_a_ring_is_calibrated_on_a_mean_that_is_not_its_own(round_it, across, off):
    """Its lowest frequency by Hoppe is (n^2 (n^2 - 1)^2 / (n^2 + 1) EI / (m R^4))^(1/2) with n = 2."""
    radius, width, thickness, young, density = 0.2, 0.02, 2e-3, 7e10, 2700.0
    x, turn = np.meshgrid(np.linspace(0.0, width, across + 1), np.arange(round_it) * 2.0 * np.pi / round_it)
    vertices = np.stack([x.T, radius * np.cos(turn.T), radius * np.sin(turn.T)], axis=-1).reshape(-1, 3)
    faces = []
    for i, j in np.ndindex(across, round_it):
        a, b = i * round_it + j, i * round_it + (j + 1) % round_it
        c, d = a + round_it, b + round_it
        faces += [(a, c, b), (b, c, d)] if (i + j) % 2 else [(a, c, d), (a, d, b)]
    mesh, sizes = TriangleMesh(vertices, faces), {"young": young, "thickness": thickness, "density": density}
    with pytest.warns(ModalShellWarning, match=r"closed ring .* times as stiffly") as caught:
        hinges = Material.from_physical(poisson=0.0, mesh=mesh, **sizes)
    exact = np.sqrt(36.0 / 5.0 * young * thickness**2 / 12.0 / (density * radius**4)) / (2.0 * np.pi)
    lowest = [
        solve_modes(Shell(mesh, of), 8).frequencies[6] / exact for of in (hinges, Isotropic(poisson=0.0, **sizes))
    ]
    said = float(re.search(r"about ([\d.]+) times", str(caught[0].message))[1])
    assert lowest[0] < 0.9
    assert lowest[0] == pytest.approx(np.sqrt(said), abs=off)
    assert abs(lowest[1] - 1.0) < 0.01


@pytest.mark.by_default("two neighbours")
@pytest.mark.parametrize(
    ("held", "said"),
    [
        (lambda x: (np.abs(x[:, :2]) > 0.499).any(axis=1), True),
        (lambda x: (x[:, 0] < -0.449) | (x[:, 1] < -0.449), True),
        (lambda x: (np.abs(x[:, :2]) > 0.499).all(axis=1), True),
        (lambda x: x[:, 0] < -0.449, False),
        (lambda x: np.abs(x[:, 0]) > 0.449, False),
        (lambda x: np.zeros(len(x), dtype=bool), False),
    ],
    ids=["all around", "two neighbours", "four corners", "one edge", "two opposite edges", "free"],
)
def test_supports_that_bend_a_plate_two_ways_are_said(held, said):
    mesh = sheet(cells=(20, 20), family="union-jack")
    mesh = TriangleMesh(mesh.vertices - mesh.vertices.mean(axis=0), mesh.faces)
    material = calibrate(mesh)
    clamped = held(mesh.vertices)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ModalShellWarning)
        Shell(mesh, material, clamped)
        Shell(mesh, Isotropic(1e9, 0.3, 1e-3, 1e3), clamped)
        Shell(mesh, Material(20.0, 20.0, 0.05, 0.2), clamped)
    assert [("two directions" in str(warning.message), warning.filename) for warning in caught] == said * [
        (True, __file__)
    ]
