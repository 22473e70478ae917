"""The atlas: its classes on constructed motions, its theory against steps of the models, and its limits measured."""

from dataclasses import replace
from itertools import product
from typing import get_args, get_type_hints

import numpy as np
import pytest

import modalshell as ms
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.files.study_result import StudyResult
from modalshell.integrators.full import FullIntegrator
from modalshell.integrators.modal import ModalIntegrator
from modalshell.integrators.state import MotionState
from modalshell.models.factory import ModelFactory
from modalshell.models.registry import MODELS
from modalshell.motion import Trajectory
from modalshell.render.maps import Boundary, MapPanel, draw_maps
from modalshell.scene.models import model_tables
from modalshell.shell.damping import Damping
from paper_figures.stability_atlas import draw_shares
from studies import stability_atlas as atlas

models = atlas.models
ROWS = models.ROWS


def constructed(tip, outcome=Outcome.COMPLETED, unconverged=0):
    """A motion of three vertices whose last one, the tip, ends displaced by ``tip``."""
    rest = np.array([[0.0, 0.0, 0.0], [0.5, 0.1, 0.0], [1.0, 0.0, 0.0]])
    end = rest.copy()
    end[2] += tip
    return Trajectory(
        times=np.array([0.0, 1.0]),
        positions=np.array([rest, end]),
        outcome=outcome,
        message="",
        unconverged_steps=unconverged,
        seconds=0.0,
        rest_positions=rest,
    )


DOWN = np.array([0.0, 0.0, -0.1])


@pytest.mark.parametrize(
    ("tip", "outcome", "unconverged", "truth", "name"),
    [
        (DOWN, Outcome.COMPLETED, 0, DOWN, "converged"),
        (1.099 * DOWN, Outcome.COMPLETED, 0, DOWN, "converged"),
        (1.101 * DOWN, Outcome.COMPLETED, 0, DOWN, "inaccurate"),
        (DOWN, Outcome.COMPLETED, 0, None, "inaccurate"),
        (DOWN, Outcome.STEPS_NOT_CONVERGED, 3, DOWN, "converged"),
        (2.0 * DOWN, Outcome.STEPS_NOT_CONVERGED, 3, DOWN, "steps not converged"),
        (DOWN, Outcome.STEPS_NOT_CONVERGED, 6, DOWN, "steps not converged"),
        (DOWN, Outcome.CYCLING, 0, DOWN, "cycling"),
        (DOWN, Outcome.WOUND_UP, 0, DOWN, "wound up"),
        (DOWN, Outcome.RUNS_AWAY, 0, DOWN, "diverged"),
        (DOWN, Outcome.DIVERGED, 0, DOWN, "diverged"),
    ],
)
def test_outcome_of_constructed_motions(tip, outcome, unconverged, truth, name):
    assert atlas.classify(constructed(tip, outcome, unconverged), truth) == name
    assert name in atlas.OUTCOMES
    itself = atlas.classify(constructed(tip, outcome, unconverged), truth, static=False)
    assert itself == (atlas.AGREES if name == "converged" else name)


@pytest.mark.by_default("rigid, free and spinning-change22-steps not converged")
@pytest.mark.parametrize(
    ("row", "change", "name"),
    [
        ("LMA, exponential", {"gamma": 1.0}, "converged"),
        ("MWTS, exponential", {"gamma": 10.0}, "converged"),
        ("RSW, exponential", {"gamma": 1.0}, "converged"),
        ("DS, SDIRK2", {"step": 10.0}, "converged"),
        ("coarse DS, BDF2", {"gamma": 1.0}, "converged"),
        ("LMA, implicit Euler", {"gamma": 1.0}, "converged"),
        ("LMA, implicit Euler", {"gamma": 100.0}, "inaccurate"),
        ("MWTS, implicit Euler", {"gamma": 1e4}, "wound up"),
        ("RSW, implicit Euler", {"aspect": 1e5}, "refused"),
        ("MD-ROM, implicit Euler", {"fold": -179.99}, "converged"),
        ("hybrid, implicit Euler", {"ratio": 1e4}, "converged"),
        ("hybrid, implicit Euler", {"ratio": 1.0}, "refused"),
        ("DS, implicit Euler", {"step": 10.0}, "converged"),
        ("DS, implicit Euler", {"aspect": 1e6}, "steps not converged"),
        ("DS, explicit Euler", {"step": 1e-3}, atlas.AGREES),
        ("DS, explicit Euler", {"step": 2e-3}, "diverged"),
        ("DS, Verlet", {"step": 1e-3}, atlas.AGREES),
        ("DS, Verlet", {"step": 2e-3}, "diverged"),
        ("springs, Verlet", {"step": 1e-4}, atlas.AGREES),
        ("springs, Verlet", {"step": 2e-4}, "diverged"),
        ("springs, linearised implicit Euler", {}, "inaccurate"),
        ("rigid, free and spinning", {"damping": 0.0}, atlas.AGREES),
        ("rigid, free and spinning", {"damping": 0.0, "step": 1.0}, "steps not converged"),
    ],
)
def test_outcome_of_single_cells(row, change, name):
    assert atlas.outcome(ROWS[row], replace(models.BASE, **change)) == name


CHOICES = ("consistent_force", "solver")
"""Options by which a model moves otherwise; ``cubature`` is told by what the model has."""


def moves_by(model):
    """What a row is a row of: the kind of model, and how it moves."""
    rule = getattr(model, "integrator", None)
    options = (getattr(model, option, False) for option in CHOICES)
    return type(model), type(rule), *options, bool(getattr(model, "cubature", False))


def variants(table):
    """A scene's model with every integrator, and every value of one of its other options at a time.

    Of few modes and on few motions, which is not asked here.
    """
    hints = get_type_hints(table)
    values = {option: get_args(hints[option]) or (False, True) for option in CHOICES if option in hints}
    if "integrator" in hints:
        values["integrator"] = (*ModalIntegrator.known, *FullIntegrator.known)
    if "cubature" in hints:
        values["cubature"] = (False, True)
    shell = models.shell_of(1e4, 1.0, 0.0)
    factory = ModelFactory(
        shell, lambda: shell.gravity_force(models.BASE.gravity), lambda *_: models.coarse_mesh(shell)
    )
    few = {option: 4 for option in ("modes", "motions") if option in hints}
    for chosen in product(*values.values()):
        options = dict(zip(values, chosen, strict=True))
        unusual = [name for name, value in options.items() if name != "integrator" and value != values[name][0]]
        if len(unusual) > 1:
            continue
        try:
            yield table(**few, **options).build(factory)
        except OptionError:  # options that exclude each other
            continue


@pytest.fixture(scope="module")
def rows_of():
    return {moves_by(models.model_of(name, 1e2, 1.0, 0.0)): name for name in ROWS}


@pytest.mark.by_default("coarse-ds")
@pytest.mark.filterwarnings("ignore:no basis of up to 4 vectors")  # trained as little as that
@pytest.mark.parametrize("name", [key for key, spec in MODELS.items() if spec.on_ladder])
def test_every_model_of_a_scene_has_a_row_for_every_way_to_move(name, rows_of):
    """A new model or integrator that scenes know fails here until the atlas has it."""
    found = [moves_by(model) for model in variants(model_tables()[name])]
    assert found
    for kind in found:
        assert kind in rows_of, f"{name}: no row of the atlas for {kind}"


def test_every_row_moves_in_its_own_way(rows_of):
    assert len(ROWS) == len(list(models.integrated_models()))
    assert len(rows_of) == len(ROWS)


def test_slices_pass_through_the_base_point():
    for plane in atlas.SLICES.values():
        for axis, values in ((plane.x, plane.x_values), (plane.y, plane.y_values)):
            at = getattr(models.BASE, axis)
            assert min(values) <= at <= max(values)
            assert list(values) == sorted(values)


# ---- theory


@pytest.mark.by_default("LinearModal-exponential", "ModalWarping-implicit_midpoint", "RotationStrain-implicit_euler")
@pytest.mark.parametrize("integrator", ["exponential", "implicit_euler", "implicit_midpoint"])
@pytest.mark.parametrize("kind", [ms.LinearModal, ms.ModalWarping, ms.RotationStrain])
def test_step_matrix_is_the_derivative_of_a_step(kind, integrator):
    """The remainder of the linearisation at an equilibrium falls with the square of the disturbance."""
    model = kind(ms.solve_modes(models.shell_of(1e2, 1.0, 0.0), 4), integrator=integrator)
    gravity, damping, dt = replace(models.BASE, gamma=20.0).gravity, Damping(2.0, 1e-3), 0.1
    q = model.equilibrium(gravity=gravity).coordinates
    load = model.shell.gravity_force(gravity)
    matrix = atlas.limits.step_matrix(model, q, load, dt, damping)
    direction = np.random.default_rng(0).standard_normal(len(matrix)) * 0.1
    force = model.modal_force(q, load)

    def vector(state):
        kept = [state.memory["force"] - force] if state.memory else []
        return np.concatenate([state.coordinates - q, state.rates, *kept])

    remainders = []
    for size in (0.02, 0.01, 0.005):
        away = np.split(size * direction, len(matrix) // q.size)
        memory = model.start_motion().memory
        if len(away) == 3:
            memory |= {"force": force + away[2], "step": np.array([dt])}
        state, _ = model.step(MotionState(q + away[0], away[1], memory), dt, load, damping)
        remainders.append(np.linalg.norm(vector(state) - matrix @ np.concatenate(away)))
    if kind is ms.LinearModal:
        assert max(remainders) < 1e-7 * np.linalg.norm(direction)
    else:
        slopes = np.log2(np.array(remainders[:-1]) / remainders[1:])
        np.testing.assert_allclose(slopes, 2.0, atol=0.2)


def test_amplification_is_the_decay_rate_of_a_mode_that_oscillates():
    basis = ms.solve_modes(models.shell_of(1e2, 1.0, 0.0), 1)
    model = ms.LinearModal(basis, integrator="implicit_euler")
    stiffness, damping, dt = model.basis.eigenvalues, Damping(0.5, 0.01), 0.05
    factor = (1.0 + dt * (0.5 + 0.01 * stiffness) + dt**2 * stiffness) ** -0.5
    assert float(-2.0 * np.log(factor[0]) / dt) == pytest.approx(model.decay_rate(dt, damping))
    load, rest = np.zeros_like(model.shell.rest_positions), np.zeros(1)
    assert atlas.limits.step_radius(model, rest, load, dt, damping) == pytest.approx(float(factor[0]))


def test_radius_at_long_steps_is_that_of_the_iteration():
    basis = ms.solve_modes(models.shell_of(1e2, 1.0, 0.0), 4)
    model = ms.ModalWarping(basis, integrator="implicit_euler")
    gravity = replace(models.BASE, gamma=20.0).gravity
    q, load = model.equilibrium(gravity=gravity).coordinates, model.shell.gravity_force(gravity)
    radius = atlas.limits.iteration_radius(model, q, load)
    assert atlas.limits.step_radius(model, q, load, 1e6, Damping(1.0, 0.0)) == pytest.approx(radius, rel=1e-4)
    assert radius > 1.0


@pytest.mark.parametrize("name", ["stability_atlas"])  # together with the other tests of that quick study
def test_every_limit_is_met_by_measurement(name, quick_study):
    """The claim of the atlas: within 5 %, for every limit that has a theory."""
    limits = StudyResult.load(quick_study(name), name).findings["limits"]
    grid = [limit for limit in limits if limit["row"].startswith("classical grid")]
    for limit in limits:
        assert limit["theory"] is not None
        assert limit["measured"] is not None, limit["what"]
        if limit not in grid:
            assert limit["ratio"] == pytest.approx(1.0, abs=0.05), (limit["row"], limit["what"])
    without = ("MD-ROM", "hybrid", "coarse DS", "MWTS sum")
    assert {limit["row"] for limit in limits if limit not in grid} == {r for r in ROWS if not r.startswith(without)}
    # Its estimate is that of the endless sheet: never above what a sheet with edges can do.
    assert len(grid) == 4
    for limit in grid:
        assert 0.998 < limit["ratio"] < 1.05, limit["what"]


def test_bisection_says_where_there_is_no_limit():
    assert atlas.limits.bisect(lambda value: value < 2.0, 1.0, 10.0) == pytest.approx(2.0, rel=2e-3)
    assert atlas.limits.bisect(lambda _: True, 1.0, 10.0) is None
    assert atlas.limits.bisect(lambda _: False, 1.0, 10.0) is None


# ---- words and maps


@pytest.mark.parametrize(
    ("classes", "words"),
    [
        ("ccccc", "all"),
        ("hhcdd", "1 to 100; beyond diverged"),
        ("iccdd", "10 to 100; below inaccurate; beyond diverged"),
        ("ddcdd", "100; below diverged; beyond diverged"),
        ("ididi", "nowhere: inaccurate, diverged"),
        ("cdddc", "1; beyond diverged"),
    ],
)
def test_words_of_a_line(classes, words):
    names = [{"c": "converged", "h": atlas.AGREES, "d": "diverged", "i": "inaccurate"}[letter] for letter in classes]
    assert atlas.reach((1.0, 10.0, 100.0, 1e3, 1e4), names, 10.0) == words


def test_maps_refuse_what_they_cannot_draw(tmp_path):
    panel = MapPanel([1.0, 10.0], [0.0, 1.0], [["a", "b"], ["b", "a"]], "t", "x", "y", x_scale="log")
    colors = {"a": "#ffffff", "b": "#000000"}
    with pytest.raises(OptionError, match="without a colour: b"):
        draw_maps([panel], {"a": "#ffffff"}, tmp_path / "a.png", columns=1)
    with pytest.raises(OptionError, match="classes of shape"):
        draw_maps([replace(panel, x=[1.0])], colors, tmp_path / "a.png", columns=1)
    for scale in ("linear", "log", "even"):
        line = Boundary([[2.0, 5.0], []], "limit $_{$")
        path = draw_maps([replace(panel, x_scale=scale, boundaries=[line])], colors, tmp_path / "a.png", columns=1)
        assert path.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_shares_are_drawn_as_long_as_they_are(tmp_path):
    from matplotlib.image import imread

    shares = {"one": [{"good": 0.25, "bad": 0.75}], "two": [{"good": 1.0}]}
    colors = {"good": "#00ff00", "bad": "#ff0000"}
    image = imread(draw_shares(shares, ["case"], colors, tmp_path / "shares.png"))
    rows = [(np.abs(image[..., :3] - colour).max(axis=2) < 0.02).sum(axis=1) for colour in ((0, 1, 0), (1, 0, 0))]
    split, whole = rows[1].argmax(), rows[0].argmax()
    assert rows[0][split] / rows[1][split] == pytest.approx(1.0 / 3.0, rel=0.05)
    assert rows[1][whole] == 0
