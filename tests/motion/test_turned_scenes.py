"""A scene that is moved and turned as a whole: every rung gives the same shapes, at rest and in motion."""

import warnings
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.models.reduced_rotation_strain import trained_on_loads
from modalshell.models.reduction.load_points import halved

POSES = [
    (Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix(), np.array([3.0, -2.0, 5.0])),
    (np.eye(3)[[2, 0, 1]], np.array([-7.0, 1.0, 0.3])),
    (Rotation.from_rotvec([0.0, 2.9, 0.2]).as_matrix(), np.array([0.3, 20.0, 0.0])),
]
"""Turns and translations; each rung meets all of them, one in each case."""
STILL = np.eye(3), np.zeros(3)
MATERIALS = {
    "hinges": ms.Material(stretch=20.0, shear=20.0, flexure=0.05, density=0.2),
    "plate": ms.Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0),
}
GRAVITY = {"hinges": np.array([0.6, 1.0, -2.0]), "plate": np.array([0.3, 0.5, -1.0])}


def panel(cells):
    """A sheet bent to an arc: no axis of the world is its own."""
    x, y, _ = ms.sheet(width=0.5, cells=cells).vertices.T
    mesh = ms.TriangleMesh(np.column_stack([np.sin(x), y, 1.0 - np.cos(x)]), ms.sheet(cells=cells).faces)
    return mesh, x < 1.5 / 5


def square(cells):
    """A flat sheet whose edges are held: modes of repeated eigenvalues, and no membrane strain in any."""
    mesh = ms.sheet(cells=cells)
    held = np.zeros(len(mesh.vertices), dtype=bool)
    held[mesh.boundary_vertices] = True
    return mesh, held


SURFACES = {"panel": (panel, (10, 4), (5, 2)), "square": (square, (8, 8), (4, 4))}


@cache
def modes_of(shell):
    return ms.solve_modes(shell, 6 if shell.clamped.any() else 12)


def reduced(shell, _, load):
    return trained_on_loads(modes_of(shell), np.array([share * load for share in (0.25, 0.5, 0.75, 1.0)]))


def hybrid(shell, coarse, load):
    return ms.HybridStress.trained(shell, force=load, coarse=coarse, modes=12, motions=4)


RUNGS = {
    "LMA": lambda shell, *_: ms.LinearModal(modes_of(shell)),
    "MWTS": lambda shell, *_: ms.ModalWarping(modes_of(shell)),
    "RSW": lambda shell, *_: ms.RotationStrain(modes_of(shell)),
    "reduced RSW": reduced,
    "MD-ROM": lambda shell, *_: ms.ModalDerivatives(shell, 3 if shell.clamped.any() else 9),
    "MD-ROM, cubature": lambda shell, *_: ms.ModalDerivatives(shell, 3 if shell.clamped.any() else 9, cubature=True),
    "hybrid": hybrid,
    "coarse DS": lambda shell, coarse, _: ms.CoarseDiscreteShell(shell, coarse),
    "auto": lambda shell, coarse, _: ms.Auto(shell, 6, coarse=coarse),
    "DS": lambda shell, *_: ms.DiscreteShell(shell),
}


@cache
def shells(surface, energy, pose=None):
    """The shell and its coarse one, where the scene is."""
    make, *sizes = SURFACES[surface]
    turn, move = STILL if pose is None else POSES[pose]
    meshes = []
    for cells in sizes:
        mesh, held = make(cells)
        meshes.append((ms.TriangleMesh(mesh.vertices @ turn.T + move, mesh.faces), held))
    (fine, held), (under, _) = meshes
    shell = ms.Shell(fine, MATERIALS[energy], held)
    return shell, ms.coarse_shell(shell, under)


def pose_of(*names):
    """Number of a case's pose: names count up in their tables."""
    return sum(list(table).index(name) for table, name in zip((MATERIALS, RUNGS, SURFACES), names, strict=False)) % 3


def by_turns(*tables):
    """Every other case of the tables' product: each rung with both energies, by turns on the surfaces."""
    return [
        tuple(name for _, name in case)
        for case in product(*map(enumerate, tables))
        if sum(place for place, _ in case) % 2 == 0
    ]


CASES = by_turns(SURFACES, MATERIALS, RUNGS)


@pytest.mark.by_default("panel-hinges-hybrid")
@pytest.mark.parametrize(("surface", "energy", "rung"), CASES)
def test_a_turned_scene_is_the_same(surface, energy, rung):
    answers, pose = [], pose_of(energy, rung, surface)
    for at in (None, pose):
        shell, coarse = shells(surface, energy, at)
        turn, move = STILL if at is None else POSES[at]
        gravity = turn @ GRAVITY[energy]
        with warnings.catch_warnings():  # coarse meshes, short training, and what linear modes do not hold
            warnings.simplefilter("ignore", ms.ModalShellWarning)
            model = RUNGS[rung](shell, coarse, shell.gravity_force(gravity))
            rest = model.equilibrium(gravity=gravity).positions
            run = ms.simulate(model, duration=0.3, dt=1.0 / 30.0, gravity=gravity)
        answers.append((np.array([rest, *run.positions]) - move) @ turn)
    assert np.abs(answers[0] - shells(surface, energy)[0].rest_positions).max() > 1e-3
    np.testing.assert_allclose(*answers, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["composite", "bdf2"])
def test_a_turned_fold_under_great_stress_moves_alike(integrator):
    """Its first step has many ends: the way downhill is measured by a length that turns with the shell."""
    mesh = ms.v_beam(length=0.6, width=0.15, fold=120.0, cells=(12, 4))
    rest = mesh.vertices * (1.0 + 0.03 * np.sin(5.0 * mesh.vertices + [1.0, 2.0, 3.0]))
    found = []
    for turn, move in (STILL, *POSES):
        warp = tuple(turn @ [0.2, 1.0, 0.4])
        cloth = ms.Fabric(stretch=(5e6, 1e6, 5e5), bending=(0.3, 0.06, 0.04), density=2.5, direction=warp)
        placed = ms.TriangleMesh(mesh.vertices @ turn.T + move, mesh.faces)
        shell = ms.Shell(placed, cloth, clamped=mesh.vertices[:, 0] < 0.06, rest=rest @ turn.T + move)
        run = ms.simulate(ms.DiscreteShell(shell, integrator=integrator), duration=0.02, dt=4e-3)
        found.append((run.positions - move) @ turn)
    assert np.abs(found[0][-1] - found[0][0]).max() > 0.1
    for turned in found[1:]:
        np.testing.assert_allclose(turned, found[0], rtol=0, atol=1e-9)


@cache
def free_panel(energy, at=None):
    """A panel without supports, one with fewer cells, and a load [N] that bends and turns it, where the scene is."""
    turn, move = STILL if at is None else POSES[at]
    fine, under = (panel(cells)[0] for cells in SURFACES["panel"][1:])
    shell, coarse = (
        ms.Shell(ms.TriangleMesh(mesh.vertices @ turn.T + move, mesh.faces), MATERIALS[energy])
        for mesh in (fine, under)
    )
    x, y, _ = fine.vertices.T
    load = shell.mass[:, None] * np.column_stack([0.5 + 0.0 * x, x * y, -1.0 + 2.0 * x**2]) @ turn.T
    return shell, coarse, load


@pytest.mark.slow
@pytest.mark.parametrize(
    ("energy", "rung"),
    by_turns(
        MATERIALS, ["LMA", "MWTS", "RSW", "reduced RSW", "MD-ROM, cubature", "MD-ROM", "coarse DS", "hybrid", "DS"]
    ),
)
@pytest.mark.filterwarnings("ignore::modalshell.ModalShellWarning")
def test_a_turned_shell_without_supports_flies_the_same(energy, rung):
    found = []
    for at in (None, pose_of(energy, rung)):
        shell, coarse, load = free_panel(energy, at)
        turn, move = STILL if at is None else POSES[at]
        model = RUNGS[rung](shell, coarse, load)
        run = ms.simulate(model, duration=0.3, dt=1.0 / 30.0, force=load)
        found.append((run.positions - move) @ turn)
    assert np.abs(found[0] - found[0][0]).max() > 1e-2
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)


@pytest.mark.by_default("hinges-LMA")
@pytest.mark.parametrize(
    ("energy", "rung"),
    by_turns(MATERIALS, ["LMA", "MWTS", "RSW", "reduced RSW", "hybrid", "MD-ROM", "coarse DS", "DS"]),
)
@pytest.mark.filterwarnings("ignore::modalshell.ModalShellWarning")
def test_a_turned_motion_from_a_start_within_a_tolerance_is_the_same(energy, rung):
    """Its steps are divided alike."""
    found, errors = [], []
    for at in (None, pose_of(energy, rung)):
        shell, coarse = shells("panel", energy, at)
        turn, move = STILL if at is None else POSES[at]
        own = shells("panel", energy)[0].rest_positions
        start = own + 0.05 * np.column_stack([0.0 * own[:, 0], 0.3 * own[:, 0] ** 2, own[:, 0] ** 2])
        gravity = turn @ GRAVITY[energy]
        model = RUNGS[rung](shell, coarse, shell.gravity_force(gravity))
        options = {"gravity": gravity, "start": start @ turn.T + move}
        run = ms.simulate(model, duration=0.2, dt=1.0 / 20.0, tolerance=2e-3, **options)
        found.append((run.positions - move) @ turn)
        errors.append(run.step_error)
    assert np.abs(found[0] - found[0][0]).max() > 1e-3
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)
    assert errors[1] == pytest.approx(errors[0], rel=1e-6, abs=1e-12)


WINDY = {
    **RUNGS,
    "MWTS, consistent": lambda shell, *_: ms.ModalWarping(modes_of(shell), consistent_force=True),
    "rigid": lambda shell, *_: ms.RigidShell(shell),
    "springs": lambda shell, *_: ms.SpringSheet(shell),
}
TURNED_WINDS = {"panel": 0, "square": 1, "free panel": 2}
"""The pose of each surface."""
WINDY_CASES = [
    pytest.param(
        *case, marks=pytest.mark.slow if case[2] == "hybrid" or case[1:] == ("plate", "MD-ROM, cubature") else ()
    )
    for case in by_turns(TURNED_WINDS, MATERIALS, WINDY)
    if case[1:] != ("plate", "springs") and (case[2] != "rigid" or case[0] == "free panel")
    if case[1:] != ("plate", "MD-ROM, cubature") or case[0] == "free panel"
]
"""Springs stand for hinges alone, a rigid shell that is held does not move, and what is trained takes long."""


def in_wind(rung, shell, coarse, load, turn, gravity):
    """Frames under weight, a load, a wind that grows and a pressure."""
    free = not shell.clamped.any()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ms.ModalShellWarning)
        model = WINDY[rung](shell, None if free and rung == "auto" else coarse, load)
        steady, gust = (ms.Wind(tuple(turn @ way)) for way in ([0.5, 0.3, 1.0], [0.2, 0.6, 0.4]))
        loads = [steady, ms.Pressure(0.3), ms.Scaled(gust, lambda time: 1.0 + np.sin(9.0 * time))]
        force = load if free else None
        return ms.simulate(model, duration=0.2, dt=1.0 / 30.0, gravity=gravity, force=force, loads=loads).positions


@pytest.mark.by_default("panel-hinges-MWTS, consistent")
@pytest.mark.parametrize(("surface", "energy", "rung"), WINDY_CASES)
def test_a_turned_scene_in_wind_is_the_same(surface, energy, rung):
    """Patches of its points turn with the mesh, of shapes without axes of their own as well."""
    found = []
    for at in (None, TURNED_WINDS[surface]):
        turn, move = STILL if at is None else POSES[at]
        gravity = turn @ GRAVITY[energy]
        if surface == "free panel":
            shell, coarse, load = free_panel(energy, at)
        else:
            shell, coarse = shells(surface, energy, at)
            load = shell.gravity_force(gravity)
        found.append((in_wind(rung, shell, coarse, load, turn, gravity) - move) @ turn)
    assert np.abs(found[0] - found[0][0]).max() > 1e-3
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9)


def test_what_a_mesh_is_measured_by_turns_with_it():
    meshes = [ms.flat_beam(length=1.0, width=0.2, cells=(6, 2)), panel((5, 2))[0], ms.sheet(cells=(4, 4)), ms.leaf()]
    for (turn, move), mesh in product(POSES, meshes):
        placed = ms.TriangleMesh(mesh.vertices @ turn.T + move, mesh.faces)
        assert placed.moment_length == pytest.approx(mesh.moment_length, rel=1e-12)
        assert placed.extent == pytest.approx(mesh.extent, rel=1e-12)
        np.testing.assert_allclose(placed.principal_axes @ turn, mesh.principal_axes, rtol=0, atol=1e-11)
        np.testing.assert_allclose(mesh.principal_axes @ mesh.principal_axes.T, np.eye(3), rtol=0, atol=1e-12)
    beam = ms.flat_beam(length=3.0, width=0.2, cells=(6, 2))
    assert beam.moment_length == pytest.approx(3.0, rel=1e-12)
    assert beam.extent == pytest.approx(3.0, rel=1e-12)
    np.testing.assert_allclose(np.abs(beam.principal_axes), np.eye(3), rtol=0, atol=1e-12)


@pytest.mark.by_default("flat_beam-alternating", "cylinder_panel-equilateral")
@pytest.mark.parametrize(
    ("shape", "family"),
    [
        *product(["sheet", "flat_beam", "v_beam", "cylinder_panel"], ["alternating", "equilateral", "lloyd"]),
        ("leaf", None),
    ],
)
def test_patches_of_loads_are_those_of_the_mesh_that_is_turned(shape, family):
    """Of squares and rectangles, on which many triangles lie as far out as others but for rounding."""
    options = {} if family is None else {"family": family}
    mesh = getattr(ms, shape)(cells={"sheet": (12, 12), "leaf": (16, 16)}.get(shape, (24, 6)), **options)
    groups, nearest = halved(mesh, mesh.faces, 64)
    assert len(np.unique(groups)) == 64
    for turn, move in POSES:
        placed = ms.TriangleMesh(mesh.vertices @ turn.T + move, mesh.faces)
        for own, found in zip((groups, nearest), halved(placed, placed.faces, 64), strict=True):
            np.testing.assert_array_equal(found, own)
