"""Compiled steps of shell theory: the same Hessian, motions and counts as through sparse algebra."""

import importlib
from dataclasses import replace

import numba
import numpy as np
import pytest
from junctions import frame

import modalshell as ms
from modalshell.linalg import ProfileAnalysis
from modalshell.models.coarse import profile_fold_kernels as kernels
from modalshell.models.coarse.profile_newton import make_room
from modalshell.models.coarse.profile_numbering import numbering_of
from modalshell.models.coarse.profile_step import profile_step
from modalshell.shell.elements import ElementSet
from modalshell.shell.kernels.generated import shear
from modalshell.shell.kernels.split_folds import add_fold_curvatures, fold_angles, half_squares
from modalshell.shell.slopes import held_slopes
from modalshell.shell.split_fold_energy import SplitFoldEnergy

profile_steps = importlib.import_module("modalshell.models.coarse.profile_step")

ISOTROPIC = ms.Isotropic(young=2e8, poisson=0.3, thickness=2e-3, density=1000.0)
ORTHOTROPIC = ms.Orthotropic(young=(4e8, 1e8), shear=5e7, poisson=0.2, thickness=2e-3, density=1000.0)
LAMINATE = ms.Laminate([ms.Ply(ORTHOTROPIC, angle, 5e-4) for angle in (0.0, 1.2, 1.2, 0.0)])
FABRIC = ms.Fabric(stretch=(6e5, 4e5, 1e4, 1e5), bending=(2e-2, 1e-2, 5e-3, 2e-3), density=1.0)


def beam(material, cells=(8, 2), fold=150.0):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=cells)
    return ms.Shell(mesh, material, mesh.vertices[:, 0] < 1e-9)


def junction():
    mesh = frame([(-1, 0), (1, 0), (0, 1)], cells=(4, 2))
    return ms.Shell(mesh, ISOTROPIC, np.abs(mesh.vertices[:, 0]) > 1.0 - 1e-9)


def pinned_panel():
    """Prestrained, and free to turn at its edges."""
    mesh = ms.cylinder_panel(cells=(5, 5))
    rim = np.abs(mesh.vertices[:, 1]) > np.abs(mesh.vertices[:, 1]).max() - 1e-9
    return ms.Shell(mesh, ISOTROPIC, supports=[ms.Pin(rim)], prestrain=1e-3)


SHELLS = {
    "isotropic": lambda: beam(ISOTROPIC),
    "flat": lambda: beam(ISOTROPIC, fold=180.0),
    "orthotropic": lambda: beam(replace(ORTHOTROPIC, direction=np.radians(20.0))),
    "laminate": lambda: beam(LAMINATE),
    "fabric": lambda: beam(FABRIC),
    "junction": junction,
    "pinned, prestrained": pinned_panel,
    "free": lambda: ms.Shell(ms.v_beam(cells=(6, 2), fold=150.0), ISOTROPIC),
}


def profile_hessian(shell, x):
    """Hessian by free positions (N, N), in the order of the vertices: assembled in a profile, shares condensed."""
    step = profile_step(shell)
    body, profile = step._body.record, numbering_of(shell).profile
    own = make_room(body).elastic
    folds, values = body.elastic, body.elastic.shares.copy()
    own.points[: len(x)] = x
    fold_angles(own.points, folds.hinges, folds.angles, own.angles, own.slopes)
    half_squares(own.points, folds.membrane.edges, folds.membrane.half_squares, own.stretches)
    kernels.couples_of(own.angles, folds.bending, own.right, own.shares, own.couples)
    kernels.tensions_of(own.stretches, folds.membrane, own.tensions)
    kernels.add_bending(own.slopes, folds.bending, body.strides, values)
    kernels.add_membrane(own.points, folds.membrane, own.vectors, values)
    add_fold_curvatures(own.points, folds.hinges, own.couples, folds.slots, body.strides, values)
    kernels.add_tensions(own.tensions, folds.membrane, body.strides, values)
    size = 3 * body.first.size
    rows, columns = np.indices((size, size))
    there = (columns // 3 <= rows // 3) & (columns >= body.first[rows // 3])
    whole = np.zeros((size, size))
    whole[there] = values[profile.places(rows[there], columns[there])]
    lower = np.tril(whole)
    whole = lower + np.tril(lower, -1).T
    positions = (3 * body.rows[np.argsort(body.free)][:, None] + np.arange(3)).ravel()
    others = np.setdiff1d(np.arange(size), positions)
    across = whole[np.ix_(others, positions)]
    return whole[np.ix_(positions, positions)] - across.T @ np.linalg.solve(whole[np.ix_(others, others)], across)


@pytest.mark.parametrize("name", SHELLS)
def test_the_hessian_in_the_profile_is_the_shells(name):
    shell = SHELLS[name]()
    x = shell.rest_positions + 0.02 * np.random.default_rng(0).standard_normal(shell.rest_positions.shape)
    x[shell.clamped] = shell.rest_positions[shell.clamped]
    unknowns = (3 * shell.free[:, None] + np.arange(3)).ravel()
    exact = shell.stiffness(x).toarray()[np.ix_(unknowns, unknowns)]
    np.testing.assert_allclose(profile_hessian(shell, x), exact, atol=1e-11 * np.abs(exact).max())


@pytest.mark.parametrize("name", SHELLS)
def test_its_arrays_are_of_the_types_that_the_shells_own_are(name):
    """Kernels that the shell has compiled are not compiled once more for the step."""
    shell = SHELLS[name]()
    forms, body = shell.elastic_energy.constant_forms(), profile_step(shell)._body.record
    mine, factor = body.elastic, forms.shares.factor
    pairs = [(body.faces, shell.mesh.faces), (mine.membrane.edges, forms.edges)]
    if factor is not None:
        pairs += zip(mine.bending.factor, factor, strict=True)
    for own, known in pairs:
        assert numba.typeof(own) == numba.typeof(known)


def through(shell, integrator, damping):
    """Motions by compiled and by sparse steps from the same states, under a load and after it: largest difference."""
    compiled = ms.CoarseDiscreteShell(shell, shell, step_tolerance=1e-10, integrator=integrator)
    sparse = ms.DiscreteShell(shell, step_tolerance=1e-10, integrator=integrator)
    step, solved_by = compiled._step, []

    def counted(*arguments, **options):
        solved_by.append(step(*arguments, **options))
        return solved_by[-1]

    compiled._step = counted
    state, apart = compiled.start_motion(), 0.0
    for gravity in (40.0, 40.0, 40.0, 40.0, 0.0, 0.0):
        load = shell.gravity_force((0.0, 0.3 * gravity, -gravity))
        other, converged = sparse.step(state, 0.01, load, ms.Damping(*damping))
        state, solved = compiled.step(state, 0.01, load, ms.Damping(*damping))
        assert solved
        assert converged
        apart = max(apart, np.abs(state.coordinates - other.coordinates).max())
    assert all(solved for _, solved in solved_by)  # none was left to sparse algebra
    moved = np.linalg.norm(state.coordinates - shell.rest_positions, axis=1).max()
    assert moved > 0.005 * shell.size
    return apart / moved


@pytest.mark.by_default("damping0-composite", "damping0-implicit", "damping1-bdf2")
@pytest.mark.parametrize("integrator", ["bdf2", "composite", "implicit"])
@pytest.mark.parametrize("damping", [(0.0, 0.0), (2.0, 0.002)])
def test_motions_are_those_of_sparse_steps(integrator, damping):
    assert through(beam(ISOTROPIC), integrator, damping) < 1e-8  # steps are solved to 1e-10 of their push


@pytest.mark.by_default("orthotropic", "free")
@pytest.mark.parametrize("name", ["orthotropic", "laminate", "fabric", "junction", "free"])
def test_motions_of_other_shells_are_too(name):
    assert through(SHELLS[name](), "bdf2", (2.0, 0.002)) < 1e-8  # steps are solved to 1e-10 of their push


@pytest.mark.slow
def test_far_from_the_origin_the_clamps_come_along():
    # Pushed to one side: straight down the beam bends to either, as rounding has it.
    far, runs = np.array([2.0**20, -(2.0**21), 2.0**19]), []
    near = ms.v_beam(cells=(6, 2), fold=150.0)
    for offset in (np.zeros(3), far):
        mesh = ms.TriangleMesh(near.vertices + offset, near.faces)
        shell = ms.Shell(mesh, ISOTROPIC, mesh.vertices[:, 0] < offset[0] + 1e-6)
        run = ms.simulate(ms.CoarseDiscreteShell(shell, shell), duration=0.3, dt=0.05, gravity=(0, 1, -10))
        runs.append(run.positions[-1] - mesh.vertices)
    assert np.abs(runs[0]).max() > 0.01
    np.testing.assert_allclose(runs[1], runs[0], atol=1e-6)


@pytest.mark.slow
def test_moving_supports_live_loads_and_drag_act_as_in_sparse_steps():
    """In the frame of the supports, with pressure that follows and air."""
    shell = beam(ISOTROPIC)
    none = [0.0, 0.0, 0.0]
    given = {
        "duration": 0.4, "dt": 0.04, "gravity": (0.0, 0.0, -5.0), "damping": (1.0, 1e-3),
        "loads": [ms.Pressure(20.0), ms.Wind((0.0, 2.0, 0.0))],
        "supports": ms.SupportPath([0.0, 0.2, 0.4], [none, [0, 0, 0.1], none], [none, [0, 0.5, 0], none]),
    }  # fmt: skip
    compiled, plain = (ms.CoarseDiscreteShell(shell, shell, step_tolerance=1e-10) for _ in range(2))
    assert compiled._step is not None
    plain._step = None
    runs = [ms.simulate(model, **given) for model in (compiled, plain)]
    size = np.abs(runs[1].positions - runs[1].positions[0]).max()
    assert size > 0.02
    np.testing.assert_allclose(runs[0].positions, runs[1].positions, atol=1e-8 * size)


@pytest.mark.slow
def test_a_shell_that_is_too_large_is_seen_by_its_edges_alone(monkeypatch):
    """Shares of folds are numbered for nothing there; what edges leave open is decided by the whole profile."""
    numbered = []

    def counting(shell):
        numbered.append(len(shell.mass))
        return numbering_of(shell)

    monkeypatch.setattr(profile_steps, "numbering_of", counting)
    plates = [ms.Shell(ms.sheet(cells=(cells, cells)), ISOTROPIC, "x < 1e-6") for cells in (12, 30, 48)]
    found = [profile_step(plate) is not None for plate in plates]
    assert found == [True, False, False]
    assert numbered == [len(plate.mass) for plate in plates[:2]]


@pytest.mark.by_default("alternating")
@pytest.mark.parametrize("family", ["alternating", "delaunay"])
def test_shares_by_threes_take_fewer_products_than_one_by_one(family):
    """On meshes without a grid an order found again for the threes took 1.4 times as many, and coarse shells 3."""
    sheet = ms.sheet(cells=(14, 14), family=family)
    plate = ms.Shell(sheet, ISOTROPIC, "x < 1e-6")
    alone = ProfileAnalysis(plate.pattern.free_matrix(np.ones(plate.pattern.size))).profile
    assert alone.block == 1
    found = numbering_of(plate)
    assert found.profile.products < 0.9 * alone.products  # rows of one fill packed registers by less
    rows = np.concatenate([(3 * found.place[plate.free][:, None] + np.arange(3)).ravel(), found.shares])
    assert np.unique(rows).size == rows.size == alone.size


def test_what_it_does_not_serve_goes_through_sparse_algebra():
    mesh = ms.v_beam(cells=(6, 2), fold=150.0)
    end = mesh.vertices[:, 0] < 1e-8  # steps are solved to 1e-10 of their push
    assert profile_step(ms.Shell(mesh, ISOTROPIC, supports=[ms.Roller(end, (1.0, 0.0, 0.0))], loose_parts=True)) is None
    shell = ms.Shell(mesh, ISOTROPIC, end)
    fibres = ElementSet.at_rest("fibres", shear, mesh, mesh.edges, np.ones(len(mesh.edges)))
    further = SplitFoldEnergy(mesh, ISOTROPIC, held_slopes(shell.supports, mesh), [fibres], shell.clamped)
    assert profile_step(shell) is not None
    assert profile_step(shell._with_energy(further)) is None
