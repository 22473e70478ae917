"""Error bars of static answers against the error that DS shows, and where they are void."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.statics.error_bar import ErrorEstimator

SUPPORTS = {
    "clamp": [ms.Clamp("x < 0.001")],
    "pin": [ms.Pin("x < 0.001"), ms.Pin("x > 0.999")],
    "fix": [ms.Clamp("x < 0.001"), ms.Fix("x > 0.999", axes="z")],
    "roller": [ms.Clamp("x < 0.001"), ms.Roller("x > 0.999", direction=(1.0, 0.0, 0.0))],
    "symmetry": [ms.Clamp("x < 0.001"), ms.Symmetry("x > 0.999", normal=(1.0, 0.0, 0.0))],
}


def beam(kind="hinges", fold=150.0, supports=None, cells=(20, 4)):
    mesh = ms.v_beam(length=1.0, width=0.2, fold=fold, cells=cells)
    if kind == "hinges":
        return ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.051")
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=1e-3, density=200.0)
    return ms.Shell(mesh, sheet, supports=supports or SUPPORTS["clamp"])


def aside(gravity):
    return 0.0, 0.26 * gravity, -0.97 * gravity


def true_error(shell, answer, **load):
    exact = ms.DiscreteShell(shell).equilibrium(**load, start=answer.positions)
    assert exact.outcome is ms.Outcome.CONVERGED
    return ms.measure.displacement_error(answer.positions, exact.positions, shell)


@pytest.mark.by_default("LinearModal-hinges-10.0", "ModalWarping-hinges-25.0", "RotationStrain-shell theory-0.3")
@pytest.mark.parametrize(("kind", "gravity"), [("hinges", 10.0), ("hinges", 25.0), ("shell theory", 0.3)])
@pytest.mark.parametrize("model", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_the_bar_is_the_true_error(kind, gravity, model):
    shell = beam(kind)
    answer = model(ms.solve_modes(shell, 6)).equilibrium(gravity=aside(gravity), bar=True)
    assert answer.bar.valid
    assert not answer.bar.beyond
    assert answer.bar.displacement == pytest.approx(true_error(shell, answer, gravity=aside(gravity)), rel=0.06)
    assert f"{answer}".startswith("converged; ")
    assert "% from DS; " in f"{answer}"
    assert "% from DS" in repr(answer.bar)


@pytest.mark.by_default("point-0.1", "patch-0.03")
@pytest.mark.parametrize("height", [0.03, 0.1])
@pytest.mark.parametrize("apart", [False, True], ids=["point", "patch"])
def test_under_constraints_the_bar_is_the_true_error(height, apart):
    """Of a patch that DS holds rigid and modes by its mean, too."""
    shell = ms.Shell(ms.flat_beam(cells=(10, 2)), ms.Isotropic(1e8, 0.3, 5e-3, 300.0), "x < 0.001")
    tip = np.flatnonzero(shell.rest_positions[:, 0] > 0.999)[:: 1 if apart else 3]
    target = shell.rest_positions[tip].mean(axis=0) + np.array([-0.6 * height**2, 0.0, height])
    load = {"gravity": (0, 0, -2.0), "constraints": [ms.PositionConstraint(tip, target)]}
    answer = ms.RotationStrain(ms.solve_modes(shell, 8)).equilibrium(**load, bar=True)
    assert answer.bar.valid
    assert answer.bar.displacement == pytest.approx(true_error(shell, answer, **load), rel=0.1)
    again = ms.error_bar(shell, answer.positions, **load)
    assert again.displacement == ms.error_bar(shell, answer).displacement == answer.bar.displacement
    with pytest.raises(ms.OptionError, match="knows its constraints"):
        ms.error_bar(shell, answer, constraints=load["constraints"])


def test_other_rungs_have_bars_too():
    shell = ms.Shell(ms.flat_beam(cells=(10, 2)), ms.Isotropic(1e8, 0.3, 5e-3, 300.0), "x < 0.001")
    load = {"gravity": (0.0, 0.0, -0.3)}
    coarse = ms.coarse_shell(shell, ms.flat_beam(cells=(6, 2)))
    for model in (ms.RigidShell(shell), ms.ModalDerivatives(shell, 3), ms.CoarseDiscreteShell(shell, coarse)):
        answer = model.equilibrium(**load, bar=True)
        assert answer.bar.valid
        assert answer.bar.displacement == pytest.approx(true_error(shell, answer, **load), rel=0.1)
    exact = ms.DiscreteShell(shell).equilibrium(**load, bar=True)
    assert exact.bar.displacement < 1e-6
    assert "less than 0.1 % from DS" in str(exact)


@pytest.mark.slow
def test_springs_are_compared_with_the_shell_that_they_stand_for():
    shell, load = beam(), {"gravity": aside(20.0)}
    answer = ms.SpringSheet(shell).equilibrium(**load, bar=True)
    assert answer.bar.beyond
    assert true_error(shell, answer, **load) > 0.3


def test_a_snap_is_foretold_and_past_it_the_bar_is_void():
    """DS leaves its branch at 41.5."""
    shell = beam()
    model = ms.RotationStrain(ms.solve_modes(shell, 6))
    before, near, past = (model.equilibrium(gravity=aside(g), bar=True) for g in (20.0, 37.0, 60.0))
    assert 20.0 * before.bar.critical_load == pytest.approx(41.5, rel=0.15)
    assert before.bar.valid
    assert not near.bar.valid
    assert not past.bar.valid
    assert past.converged
    assert true_error(shell, past, gravity=aside(60.0)) > 0.25
    assert 0.0 < near.bar.margin < 0.3
    assert "void: the answer is near the end of its branch" in str(near)
    assert "void: " in str(past)


@pytest.mark.by_default("20.0")
@pytest.mark.parametrize("gravity", [12.0, 20.0, 60.0])
def test_a_walk_along_the_branch_finds_where_it_ends(gravity):
    """From a quarter of the snap's load, from half of it, and from rest where the answer is past it."""
    shell = beam()
    path = ms.equilibrium_path(shell, gravity=aside(1.0), until=60.0)
    ends = path.events[0].factor
    answer = ms.RotationStrain(ms.solve_modes(shell, 6)).equilibrium(gravity=aside(gravity))
    bar = ms.error_bar(shell, answer, walk=True)
    assert bar.walked
    assert bar.valid == (gravity < 50.0)
    assert gravity * bar.critical_load == pytest.approx(ends, rel=0.05)
    assert "ends at about" in str(bar)
    coarse = ms.Shell(ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(14, 2)), shell.material, "x < 0.072")
    other = ms.error_bar(shell, answer, coarse, walk=True)
    assert gravity * other.critical_load == pytest.approx(ends, rel=0.3)


@pytest.mark.slow
def test_a_walk_under_pressure_that_follows_a_panel():
    mesh = ms.cylinder_panel(radius=1.0, angle=40.0, length=0.5, cells=(6, 8))
    edge = np.abs(mesh.vertices[:, 1]) > np.abs(mesh.vertices[:, 1]).max() - 1e-9
    shell = ms.Shell(mesh, ms.Isotropic(young=1e7, poisson=0.3, thickness=4e-3, density=100.0), supports=[ms.Pin(edge)])
    truth = ms.DiscreteShell(shell)
    answers = {p: truth.equilibrium(loads=[ms.Pressure(-p)]) for p in (1.5, 3.0)}
    ends = [p * ms.error_bar(shell, answer, walk=True).critical_load for p, answer in answers.items()]
    assert ends[0] == pytest.approx(ends[1], rel=0.02)
    before, past = (truth.equilibrium(loads=[ms.Pressure(-f * ends[0])]) for f in (0.9, 1.1))
    moved = [np.abs(one.positions - shell.rest_positions).max() for one in (before, past)]
    assert moved[1] > 10.0 * moved[0]


def test_a_walk_says_where_no_end_is_near():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(16, 2))
    shell = ms.Shell(mesh, ms.Material(2000.0, 2000.0, 0.05, 0.2), "x < 0.07")
    answer = ms.RotationStrain(ms.solve_modes(shell, 6)).equilibrium(gravity=(0.0, 0.0, -0.5))
    bar = ms.error_bar(shell, answer, walk=True)
    assert bar.critical_load == np.inf
    assert "; no end of its branch is near" in str(bar)


@pytest.mark.slow
def test_a_wrong_branch_that_two_steps_do_not_leave_is_void():
    """Of a panel that sinks in: to Newton's steps an unstable answer in balance looks exact."""
    mesh = ms.cylinder_panel(radius=1.0, angle=40.0, length=0.5, cells=(6, 8))
    sheet = ms.Isotropic(young=1e7, poisson=0.3, thickness=2e-3, density=100.0)
    away = np.abs(mesh.vertices[:, 1])
    edge = away > away.max() - 1e-9
    shell = ms.Shell(mesh, sheet, supports=[ms.Pin(edge)])
    path = ms.equilibrium_path(shell, gravity=(0.0, 0.0, -1.0), until=20.0)
    wrong = np.flatnonzero(~path.stable)
    assert wrong.size
    middle = wrong[wrong.size // 2]
    bar = ms.error_bar(shell, path.positions[middle], gravity=(0.0, 0.0, -path.factors[middle]))
    assert bar.displacement < 1e-4
    assert bar.margin < 0.0
    assert not bar.valid


@pytest.mark.parametrize("held", sorted(SUPPORTS))
def test_supports_of_every_kind(held):
    shell = beam("shell theory", supports=SUPPORTS[held])
    answer = ms.ModalWarping(ms.solve_modes(shell, 6)).equilibrium(gravity=aside(0.2), bar=True)
    assert answer.bar.valid
    assert answer.bar.displacement == pytest.approx(true_error(shell, answer, gravity=aside(0.2)), rel=0.1)


@pytest.mark.by_default("hinges-pressure", "shell theory-follower force")
@pytest.mark.parametrize(
    "live",
    [ms.Pressure(0.05), ms.Wind((0.0, 0.3, -0.6)), ms.FollowerForce("x > 0.99", (0.0, 0.0, -1e-3))],
    ids=["pressure", "wind", "follower force"],
)
@pytest.mark.parametrize("kind", ["hinges", "shell theory"])
def test_loads_that_follow_the_shell(kind, live):
    shell, scale = beam(kind), 20.0 if kind == "hinges" else 0.2
    loads = [ms.Scaled(live, lambda _: scale)]
    answer = ms.ModalWarping(ms.solve_modes(shell, 6)).equilibrium(loads=loads, bar=True)
    assert answer.bar.valid
    assert answer.bar.displacement == pytest.approx(true_error(shell, answer, loads=loads), rel=0.1)


def test_a_bar_on_the_coarse_shell():
    shell, load = beam(), {"gravity": aside(30.0)}
    coarse = ms.coarse_shell(shell, ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(14, 2)))
    answer = ms.LinearModal(ms.solve_modes(shell, 2)).equilibrium(**load)
    fine, other = ms.error_bar(shell, answer), ms.error_bar(shell, answer, on=coarse)
    assert (fine.on, other.on) == ("shell", "coarse")
    assert other.corrected.shape == answer.positions.shape
    assert other.displacement == pytest.approx(fine.displacement, rel=0.5)
    assert other.margin == pytest.approx(fine.margin, abs=0.15)
    model = ms.CoarseDiscreteShell(shell, coarse)
    assert ms.error_bar(model, model.equilibrium(**load), on="coarse").displacement < 5e-3


def test_answers_at_rest_and_large_ones():
    shell = beam()
    assert ms.error_bar(shell, shell.rest_positions).displacement == 0.0
    rigid = ms.error_bar(shell, shell.rest_positions, gravity=aside(5.0))
    assert rigid.displacement == pytest.approx(1.0)
    assert rigid.beyond
    assert "beyond 30 % from DS" in str(rigid)
    lost = ms.error_bar(shell, 1e45 * np.array(shell.rest_positions), gravity=aside(5.0))
    assert not lost.valid
    assert lost.message
    assert "no error bar" in str(lost)


def test_what_has_no_bar_is_refused():
    mesh = ms.flat_beam(cells=(8, 2))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=1e-3, density=200.0)
    free, held = ms.Shell(mesh, sheet), ms.Shell(mesh, sheet, "x < 0.001")
    answer = ms.DiscreteShell(held).equilibrium(gravity=aside(0.1))
    assert answer.bar is None
    with pytest.raises(ms.OptionError, match="the supports leave free all translations and turns"):
        ms.error_bar(free, mesh.vertices)
    with pytest.raises(ms.OptionError, match="leave out gravity, force and loads"):
        ms.error_bar(held, answer, gravity=aside(0.1))
    with pytest.raises(ms.OptionError, match=r'on must be "shell", "coarse" or a coarse Shell \(got .fine.\)'):
        ms.error_bar(held, answer, on="fine")
    with pytest.raises(ms.OptionError, match="model_or_shell must be"):
        ms.error_bar(mesh, answer)
    with pytest.raises(ms.LoadError, match="positions"):
        ms.error_bar(held, np.zeros((3, 3)))
    with pytest.raises(ms.OptionError, match="bar must be"):
        ms.DiscreteShell(held).equilibrium(bar=1)


@pytest.mark.parametrize("gravity", [4.0, 8.0])
def test_steps_that_take_back_one_another_are_told_as_beyond(gravity):
    """Of a panel blown open: at 4 m/s^2 the bar is right, at 8 both steps are long and their sum short, by chance."""
    panel = ms.cylinder_panel(angle=60.0, cells=(6, 10))
    x = panel.vertices[:, 0]
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=1000.0)
    shell = ms.Shell(panel, sheet, clamped=x < x.min() + 0.12)
    model = ms.RotationStrain(ms.solve_modes(shell, 16))
    load = {"gravity": (0.0, 0.0, gravity)}
    answer, exact = model.equilibrium(**load), ms.DiscreteShell(shell).equilibrium(**load)
    off = ms.measure.displacement_error(answer.positions, exact.positions, shell)
    force = shell.gravity_force(load["gravity"])
    for bar in (ms.error_bar(model, answer), ErrorEstimator(shell).bar(answer.positions, force)):
        assert bar.valid
        if gravity < 5.0:
            assert bar.displacement == pytest.approx(off, rel=0.06)
        else:
            assert off > 0.4
            assert bar.beyond


@pytest.mark.parametrize("size", [1e-9, 1e6])
def test_bars_do_not_depend_on_the_unit_of_length(size):
    """Displacements of shells of micrometres and less counted as none: any answer was 0 % off."""
    bars = []
    for unit in (1.0, size):
        mesh = ms.flat_beam(length=unit, width=0.2 * unit, cells=(10, 2))
        sheet = ms.Isotropic(young=1e9, poisson=0.3, thickness=1e-2 * unit, density=1e3)
        shell = ms.Shell(mesh, sheet, mesh.vertices[:, 0] < 0.05 * unit)
        bars.append(ms.LinearModal(ms.solve_modes(shell, 4)).equilibrium(gravity=(0, 0, -20.0 / unit), bar=True).bar)
    assert bars[0].displacement > 0.02
    assert bars[1].displacement == pytest.approx(bars[0].displacement, rel=1e-6)
