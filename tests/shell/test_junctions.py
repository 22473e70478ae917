"""Edges with three and more triangles: joints of split folds against plane frames, beams and one another."""

import numpy as np
import pytest
from junctions import cellular_box, frame, joined, moebius, strip

import modalshell as ms
from modalshell.shell.kernels.split_folds import fold_angles

SHEET = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
FRAMES = {  # ends of the wings, the last of which is loaded and free; deflection over P L^3 / EI
    "T": ([(-1, 0), (1, 0), (0, 1)], 1 / 3 + 1 / 8),
    "cross": ([(-1, 0), (1, 0), (0, -1), (0, 1)], 1 / 3 + 1 / 12),
}
SKEW = [(-1, 0), (1, 0.3), (0, 1), (0.2, -1)]


def at(mesh, place):
    """Vertices (n,) at a place (x, z)."""
    return np.hypot(mesh.vertices[:, 0] - place[0], mesh.vertices[:, 2] - place[1]) < 1e-9


def along_line(mesh, line):
    """Share (n,) of a uniform line load along y at each of the vertices ``line`` (n,)."""
    share = np.zeros(len(mesh.vertices))
    order = np.flatnonzero(line)[np.argsort(mesh.vertices[line, 1])]
    lengths = np.diff(mesh.vertices[order, 1])
    np.add.at(share, order[:-1], 0.5 * lengths)
    np.add.at(share, order[1:], 0.5 * lengths)
    return share / share.sum()


def frame_error(name, family, cells):
    """Relative error of the tip's deflection of a plane frame."""
    ends, exact = FRAMES[name]
    mesh = frame(ends, cells=cells, family=family)
    held = np.any([at(mesh, end) for end in ends[:-1]], axis=0)
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.0, 1e-3, 1000.0), clamped=held)
    share, load = along_line(mesh, at(mesh, ends[-1])), 1e-3
    rigidity = 1e9 * 1e-9 / 12.0 * 0.2
    state = ms.DiscreteShell(shell).equilibrium(force=np.outer(share, [load * rigidity, 0.0, 0.0]))
    assert state.converged
    return float(share @ (state.positions - mesh.vertices)[:, 0]) / (load * exact) - 1.0


@pytest.mark.by_default("T-alternating", "T-one-way", "cross-jittered")
@pytest.mark.parametrize("family", ["alternating", "one-way", "jittered"])
@pytest.mark.parametrize("name", FRAMES)
def test_frames_bend_as_plane_frames_do(name, family):
    coarse, fine = (abs(frame_error(name, family, cells)) for cells in ((8, 2), (16, 4)))
    assert fine < 0.005
    assert fine < coarse / 2.5  # the second order


def shuffled(mesh, seed):
    """The same surface with faces in another order and wound at random: other first wings."""
    random = np.random.default_rng(seed)
    faces = random.permutation(mesh.faces)
    faces = np.where(random.uniform(size=(len(faces), 1)) < 0.5, faces[:, [0, 2, 1]], faces)
    return ms.TriangleMesh(mesh.vertices, np.roll(faces, seed, axis=1))


SUPPORTS = {
    "free": {},
    "a wing's end clamped": {"clamped": "x < -0.999"},
    "a wing held": {"clamped": "x < 0.001"},
    "joint clamped": {"clamped": "nearest(0, -0.1, 0) or nearest(0, 0, 0) or nearest(0, 0.1, 0)"},
    "symmetry across": {"supports": [ms.Symmetry("y > 0.0999", normal=(0, 1, 0))]},
}


@pytest.mark.by_default("a wing's end clamped", "a wing held")
@pytest.mark.filterwarnings("ignore::modalshell.core.errors.ModalShellWarning")
@pytest.mark.parametrize("supports", SUPPORTS)
def test_energy_does_not_depend_on_winding_or_the_first_wing(supports):
    mesh = frame(SKEW, cells=(4, 2), family="jittered")
    random = np.random.default_rng(0)
    moves = 0.02 * random.normal(size=mesh.vertices.shape) * (mesh.vertices[:, 1:2] < 0.0999)
    step = random.normal(size=moves.shape)
    energies = []
    for seed in range(4):
        shell = ms.Shell(shuffled(mesh, seed), SHEET, **SUPPORTS[supports])
        x = shell.rest_positions + moves * ~shell.clamped[:, None]
        energies.append(shell.energy(x))
        gradient = -shell.force(x)
        ahead, back = (shell.energy(x + sign * 1e-6 * step * ~shell.clamped[:, None]) for sign in (1, -1))
        assert (ahead - back) / 2e-6 == pytest.approx(np.sum(gradient * step * ~shell.clamped[:, None]), rel=1e-6)
    assert shell.energy(shell.rest_positions) == 0.0
    assert np.ptp(energies) < 1e-12 * energies[0]


def test_the_hessian_is_the_gradients_derivative_and_six_motions_are_free():
    mesh = frame(SKEW, cells=(3, 1), family="jittered")
    shell = ms.Shell(mesh, SHEET)
    random = np.random.default_rng(0)
    x = mesh.vertices + 0.02 * random.normal(size=mesh.vertices.shape)
    step = random.normal(size=x.shape)
    exact = (shell.stiffness(x) @ step.ravel()).reshape(-1, 3)
    measured = (shell.force(x - 1e-6 * step) - shell.force(x + 1e-6 * step)) / 2e-6
    np.testing.assert_allclose(exact, measured, atol=1e-6 * np.abs(measured).max())
    values = np.linalg.eigvalsh(shell.stiffness().toarray())
    assert (np.abs(values) < 1e-9 * values[-1]).sum() == 6
    assert values[0] > -1e-9 * values[-1]
    assert shell._energy.halved().energy(x) == pytest.approx(shell.energy(x), rel=1e-12)


@pytest.mark.filterwarnings("ignore::modalshell.core.errors.ModalShellWarning")
@pytest.mark.parametrize("seed", range(4))
def test_folds_against_a_held_wing_follow_from_those_of_the_mesh(seed):
    """What rest angles are differentiated by: a hinge against a held wing is no hinge of the mesh."""
    mesh = shuffled(frame(SKEW, cells=(3, 1), family="jittered"), seed)
    shell = ms.Shell(mesh, SHEET, clamped="x < 0.001")
    folds = shell._energy._folds
    x = mesh.vertices + 0.02 * np.random.default_rng(seed).normal(size=mesh.vertices.shape) * ~shell.clamped[:, None]
    rest, angles, slopes = np.zeros(len(mesh.hinges)), np.zeros(len(mesh.hinges)), np.empty((len(mesh.hinges), 9))
    fold_angles(np.array(mesh.vertices), np.array(mesh.hinges), np.zeros_like(rest), rest, slopes)
    fold_angles(x, np.array(mesh.hinges), rest, angles, slopes)
    real = folds.hinges[:, 3] < len(mesh.vertices)
    np.testing.assert_allclose((folds.sources.T @ angles)[real], shell._energy._measured(x).folds[real], atol=1e-12)


@pytest.mark.filterwarnings("ignore:flipped")
@pytest.mark.parametrize(
    ("ends", "ribs"), [([(1, 0), (1, 0.5)], [(0, 1)]), ([(1, 0)], [(0, 1)]), ([(1, 0), (1, 1)], [])]
)
def test_a_joint_in_a_plane_of_symmetry_is_half_of_the_whole(ends, ribs):
    """Strips on either side of a rib in the plane x = 0, if any, which half a mesh has with half of its stiffness."""
    whole = frame([*ends, *((-x, z) for x, z in ends), *ribs], cells=(4, 2))
    half, tips = frame([*ends, *ribs], cells=(4, 2)), []
    for mesh, share in ((whole, 1.0), (half, 0.5)):
        rib = np.abs(mesh.vertices[mesh.faces][:, :, 0]).max(axis=1) < 1e-9
        sheet = ms.Isotropic(1e8, 0.0, 5e-3, 100.0)
        sheet = ms.Isotropic(np.where(rib, share, 1.0) * 1e8, 0.0, 5e-3, np.where(rib, share, 1.0) * 100.0)
        plane = [ms.Symmetry(np.abs(mesh.vertices[:, 0]) < 1e-9, normal=(1, 0, 0))] if share < 1.0 else []
        shell = ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 2] > 1.0 - 1e-9, supports=plane)
        ends = np.isclose(np.abs(mesh.vertices[:, 0]), 1.0)
        state = ms.DiscreteShell(shell).equilibrium(force=np.outer(ends, [0.0, 0.0, -3e-4]))
        tips.append(state.positions[at(mesh, (1, 0)), 2])
    np.testing.assert_allclose(tips[1], tips[0], rtol=1e-6)
    assert np.abs(tips[0]).min() > 1e-3


def test_a_box_of_four_cells_twists_by_bredts_formula():
    """By symmetry its webs carry no shear flow, and a square tube does not warp: J = side^3 thickness."""
    side, length, thickness, young = 0.2, 1.0, 1e-3, 1e9
    mesh = cellular_box(side, length, (3, 24))
    assert len(mesh.junctions) == 5 * 24
    shell = ms.Shell(mesh, ms.Isotropic(young, 0.3, thickness, 1000.0), clamped="y < -0.4999")
    x, _, z = mesh.vertices.T
    outer = (np.maximum(np.abs(x), np.abs(z)) > side / 2 - 1e-9)[mesh.edges].all(axis=1)
    rim = outer & (mesh.vertices[mesh.edges][:, :, 1] > length / 2 - 1e-9).all(axis=1)
    flow, force = 1e-2, np.zeros_like(mesh.vertices)
    for first, second in mesh.edges[rim]:
        middle, along = mesh.vertices[[first, second]].mean(axis=0), mesh.vertices[second] - mesh.vertices[first]
        along = along * np.sign(middle[2] * along[0] - middle[0] * along[2])
        force[[first, second]] += 0.5 * flow * along
    torque = 2.0 * flow * side**2
    state = ms.DiscreteShell(shell).equilibrium(force=force)
    corner = np.flatnonzero((np.abs(x - side / 2) < 1e-9) & (np.abs(z - side / 2) < 1e-9) & at_end(mesh, length))
    moved = (state.positions - mesh.vertices)[corner[0]]
    twist = (moved[0] - moved[2]) / side
    assert twist == pytest.approx(torque * length / (young / 2.6 * side**3 * thickness), rel=0.01)


@pytest.mark.parametrize("family", ["alternating", "jittered"])
def test_a_box_with_webs_bends_as_a_beam(family):
    """Tractions c z at its end bend it to the curvature c / (E t), whatever walls and webs it has; nu = 0."""
    side, length, young, thickness, size = 0.2, 1.0, 1e9, 1e-3, 10.0
    mesh = cellular_box(side, length, (2, 20), family)
    shell = ms.Shell(mesh, ms.Isotropic(young, 0.0, thickness, 1000.0), clamped=f"y < {-length / 2 + 1e-9}")
    rim = mesh.edges[at_end(mesh, length)[mesh.edges].all(axis=1)]
    force, heights = np.zeros_like(mesh.vertices), mesh.vertices[rim][:, :, 2]
    lengths = np.linalg.norm(np.diff(mesh.vertices[rim], axis=1)[:, 0], axis=1)
    for end in (0, 1):
        shares = lengths / 6.0 * (2.0 * heights[:, end] + heights[:, 1 - end])
        np.add.at(force[:, 1], rim[:, end], size * shares)
    state = ms.DiscreteShell(shell).equilibrium(force=force)
    assert state.converged
    tip = -(state.positions - mesh.vertices)[at_end(mesh, length) & at(mesh, (0.0, 0.0)), 2].mean()
    assert tip == pytest.approx(size / (young * thickness) * length**2 / 2.0, rel=0.01)


def at_end(mesh, length):
    return np.abs(mesh.vertices[:, 1] - length / 2) < 1e-9


def test_a_rib_stiffens_its_plate_as_a_beam_of_both():
    """A plate with a rib under its middle line, clamped at an end, under its weight: bending and shear of a T."""
    width, height, thickness, length, young, density = 0.2, 0.1, 2e-3, 1.6, 2e11, 7800.0
    place, cells = [(-width / 2, 0.0), (width / 2, 0.0)], (4, 48)
    plates = [strip((0.0, 0.0), end, length, (2, cells[1])) for end in place]
    mesh = joined(*plates, strip((0.0, 0.0), (0.0, -height), length, cells))
    shell = ms.Shell(mesh, ms.Isotropic(young, 0.0, thickness, density), clamped=f"y < {-length / 2 + 1e-9}")
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -9.81))
    area = (width + height) * thickness
    centre = height * thickness * (height / 2) / area
    second = (
        thickness * height**3 / 12 + thickness * height * (height / 2 - centre) ** 2 + width * thickness * centre**2
    )
    load = 9.81 * density * area
    sag = load * length**4 / (8 * young * second) + load * length**2 / (2 * (young / 2) * height * thickness * 5 / 6)
    tip = -(state.positions - mesh.vertices)[at(mesh, (0.0, 0.0)) & at_end(mesh, length), 2].mean()
    assert tip == pytest.approx(sag, rel=0.03)


def test_a_moebius_strip_has_a_seam_anywhere():
    """Its rest is without energy, motions of it as a whole too, and frequencies do not feel where it is wound over."""
    mesh = moebius()
    assert len(mesh.seams) == 3
    assert len(mesh.junctions) == 0
    frequencies = []
    for rolled in (mesh, ms.TriangleMesh(mesh.vertices, np.roll(mesh.faces, 37, axis=0)[:, ::-1])):
        shell = ms.Shell(rolled, SHEET)
        assert shell.energy(shell.rest_positions) == 0.0
        basis = ms.solve_modes(shell, 6)
        assert basis.rigid_modes == 6
        frequencies.append(basis.frequencies[:6])
    np.testing.assert_allclose(frequencies[0], frequencies[1], rtol=1e-6)


@pytest.mark.filterwarnings("ignore::modalshell.ModalShellWarning")
@pytest.mark.parametrize("directed", [False, True])
def test_masses_and_membrane_do_not_feel_where_a_moebius_strip_is_wound_over(directed):
    """With seams as free edges masses next to them were 5 % off, and the energy 0.07 %; pairs that bend stay apart."""
    mesh, rng = moebius(), np.random.default_rng(0)
    along = np.stack([-mesh.vertices[:, 1], mesh.vertices[:, 0], 0.0 * mesh.vertices[:, 0]], axis=1)
    sheets, found = [SHEET], []
    flipped = np.where(rng.random(len(mesh.faces))[:, None] < 0.5, mesh.faces[:, ::-1], mesh.faces)
    for rolled in (mesh, ms.TriangleMesh(mesh.vertices, flipped)):
        if directed:
            direction = along[rolled.faces].mean(axis=1)
            sheets = [
                ms.Orthotropic(
                    young=(1e9, 2e8), shear=1e8, poisson=0.2, thickness=0.01, density=1000.0, direction=direction
                )
            ]
        shell = ms.Shell(rolled, *sheets)
        found.append((shell.mass, shell.energy(mesh.vertices + 1e-3 * np.sin(7.0 * mesh.vertices[:, [1, 2, 0]]))))
    assert len(rolled.seams) > len(mesh.seams)
    np.testing.assert_allclose(found[1][0], found[0][0], rtol=1e-12)
    assert found[1][1] == pytest.approx(found[0][1], rel=5e-5)


@pytest.mark.by_default("mwts")
@pytest.mark.parametrize("key", ["ds", "mwts"])
def test_a_shell_with_a_junction_is_carried_by_its_support(key):
    mesh = frame([(-0.5, 0), (0.5, 0.1), (0, 0.5)], cells=(4, 1))
    shell = ms.Shell(mesh, ms.Isotropic(1e9, 0.3, 0.01, 1000.0), clamped=at(mesh, (-0.5, 0)))
    model = ms.DiscreteShell(shell) if key == "ds" else ms.ModalWarping(ms.solve_modes(shell, 4))
    path = ms.SupportPath([0.0, 0.5], [[0, 0, 0], [0.4, -0.1, 0.3]], [[0, 0, 0], [0.5, 0.4, -0.9]])
    first = 2.0 * np.pi * float(ms.solve_modes(shell, 1).frequencies[0])
    run = ms.simulate(model, duration=0.5 + 20.0 / first, dt=0.02, damping=(2.0 * first, 1e-4), supports=path)
    assert run.outcome in (ms.Outcome.COMPLETED, ms.Outcome.STEPS_NOT_CONVERGED), run.message
    np.testing.assert_allclose(run.positions[-1], path.at(10.0).to_world(shell.rest_positions), atol=1e-4)


def test_reduced_and_coarse_models_answer_a_frame():
    """Small loads, which every rung answers; a coarse shell on a given mesh with the same junction."""
    ends = [(-1, 0), (1, 0), (0, 1)]
    mesh, small = (frame(ends, cells=cells) for cells in ((8, 2), (4, 1)))
    shell = ms.Shell(mesh, SHEET, clamped=at(mesh, ends[0]) | at(mesh, ends[1]))
    gravity = (0.05, 0.0, 0.0)
    truth = ms.DiscreteShell(shell).equilibrium(gravity=gravity)
    basis = ms.solve_modes(shell, 10)
    models = [ms.LinearModal(basis), ms.ModalWarping(basis), ms.RotationStrain(basis), ms.ModalDerivatives(shell, 6)]
    models.append(ms.CoarseDiscreteShell(shell, coarse=ms.coarse_shell(shell, small)))
    for model in models:
        state = model.equilibrium(gravity=gravity)
        assert state.converged
        assert ms.measure.displacement_error(state.positions, truth.positions, shell) < 0.02, type(model).__name__


def test_hinges_of_a_material_join_the_first_wing_to_the_others():
    mesh = frame([(-1, 0), (1, 0), (0, 1)], cells=(4, 1))
    shell = ms.Shell(mesh, ms.Material(2e4, 2e4, 0.5, 0.5), clamped="x < -0.74 or x > 0.74")
    assert len(mesh.hinges) == len(mesh.hinge_faces) == (mesh.edge_faces[:, 1] >= 0).sum() + len(mesh.junctions)
    basis = ms.solve_modes(shell, 4)
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0.1, 0.0, 0.0))
    assert basis.rigid_modes == 0
    assert state.converged
    assert np.isfinite(shell.fields(state.positions).energy_density).all()
    with pytest.raises(ms.SupportError, match="junction in a plane of symmetry"):
        ms.Shell(mesh, shell.material, supports=[ms.Symmetry(at(mesh, (0, 0)), normal=(1, 0, 0))])
