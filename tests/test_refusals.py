"""Every public function and method refuses NaN and wrong shapes, whichever of its arguments has them.

The calls are those that the fuzzer knows, with sound arguments, and the methods below; a method of an exported class
that takes numbers and is in neither fails the first test.
"""

import copy
import functools
import inspect

import numpy as np
import pytest
from fuzzing.calls import Target, targets
from fuzzing.world import model, model_names, part, world

import modalshell as ms
from modalshell.core.errors import ModalShellError

EXCEPTIONS = {
    (
        "WarpFrame.positions",
        "q",
    ): "runs each frame; its documentation says that NaN gives NaN, and that it checks shapes",
    ("fit", "observed"): "NaN stands for a coordinate that was not measured",
    ("fit, curves", "observed"): "NaN stands for a coordinate that was not measured",
    ("fit, frequencies", "frequencies"): "NaN stands for a mode that was not measured",
    ("repair", "vertices"): "drops the faces of vertices that are not finite, and says so",
}
"""Arguments that may hold NaN, and why. Text and wrong shapes are refused there, too."""
NOT_FINITE = ("one not a number", "infinite")
BETWEEN_PARTS = {
    "check_step",
    "impulse",
    "decay_rate",
    "dragged",
    "factor",
    "step",
    "march",
    "push",
    "pushed_step",
    "velocities",
    "velocity_at",
    "growth",
    "mean_growth",
    "gap",
    "normal",
    "distance",
    "velocity",
    "fastest",
    "largest_move",
    "way",
    "surfaces",
    "body",
    "local_error",
    "stops",
    "euler_step",
    "slowed",
    "carried",
    "shell_at",
    "damped",
    "under",
    "rates_by_constant",
    "damping_force",
    "damping_matrix",
}
"""Methods that models, shells and integrators call each step with numbers that were checked where they came in."""
ELSEWHERE = {
    "RunFollower.wait": "test_waiting_refuses_what_is_no_time below, for without a run it is refused anyway",
    "Crowd.choose_levels": "the fuzzer's one call of a crowd, 'Crowd'",
    "Crowd.positions": "the fuzzer's one call of a crowd, 'Crowd'",
    "Flock.frames": "the fuzzer's one call of a flock, 'Flock'",
    "ReducedRotationStrain.trained": "the fuzzer: minutes of work where it accepts what it gets",
    "Trajectory.still": "made by the package from its own answers",
}
"""Methods that are tried in other ways, and where."""
BAD = {
    "one not a number": lambda value: _one_nan(value),
    "infinite": lambda value: np.full(np.shape(value), np.inf),
    "one axis more": lambda value: np.stack([np.asarray(value)] * 2, axis=-1)[None],
    "text": lambda value: np.full(np.shape(value), "x"),
    "complex": lambda value: np.asarray(value) * (1.0 + 0.5j),
}


def _one_nan(value):
    changed = np.array(value, dtype=float)
    changed.ravel()[-1:] = np.nan
    return changed


@functools.cache
def creased(shell):
    """The method of a shell with one crease."""
    ends = shell.mesh.edges[shell.mesh.hinge_edges[:1]]
    return ms.Shell(shell.mesh, shell.material, clamped=shell.clamped, creases=[ms.Crease(ends, 1.0)]).creased


def methods():
    """Sound calls of methods that the fuzzer does not know by their own name."""
    rest = part("shell", "rest_positions").then(np.array)
    moved, q = rest.then(lambda positions: positions * 1.01), np.array([0.01, 0.02, -0.01])
    vectors = rest.then(lambda positions: np.full(positions.shape, 0.01))
    gravity = np.array([0.0, 0.0, -2.0])
    path = part("shell").then(lambda shell: ms.equilibrium_path(shell, gravity=gravity))
    made = [
        Target("Shell.fields", part("shell", "fields"), {"positions": moved}),
        Target(
            "Shell.reactions", part("shell", "reactions"), {"positions": moved, "gravity": gravity, "force": vectors}
        ),
        Target("Shell.support_reactions", part("shell", "support_reactions"), {"positions": moved, "force": vectors}),
        Target("Shell.total_load", part("shell", "total_load"), {"gravity": gravity, "force": vectors}),
        Target("Shell.loading", part("shell", "loading"), {"gravity": gravity, "force": vectors}),
        Target("Shell.creased", part("shell").then(creased), {"state": np.array([0.1])}),
        Target("Shell.settled", part("shell", "settled"), {"positions": moved}),
        Target("Shell.checked_positions", part("shell", "checked_positions"), {"positions": moved}),
        Target("DiscreteShell.lowest_eigenvalue", model("ds", "lowest_eigenvalue"), {"positions": rest}),
        Target("EquilibriumPath.crossings", path.then(lambda found: found.crossings), {"factor": 0.5}),
        Target("SupportPath.at", part("path", "at"), {"time": 0.05}),
        Target("PositionConstraint.at", ms.PositionConstraint([8], [1.0, 0.0, 0.0]).at, {"time": 0.05}),
        Target("OrientationConstraint.at", ms.OrientationConstraint([8], [0.1, 0.0, 0.0]).at, {"time": 0.05}),
        Target("WarpFrame.positions", part("basis").then(lambda basis: ms.WarpFrame(basis).positions), {"q": q}),
        Target(
            "TriangleMesh.shared_among_corners",
            part("mesh", "shared_among_corners"),
            {"face_values": part("mesh", "face_areas")},
        ),
        Target(
            "Basis.page",
            part("basis", "page"),
            {"gravity": gravity, "force": vectors, "damping": np.array([0.5, 0.001]), "dt": 0.01},
        ),
        Target("Flock.step", _flown, {"dt": 0.1}),
        Target(
            "CoarseDiscreteShell.prolong",
            model("coarse-ds", "prolong"),
            {"positions": model("coarse-ds", "coarse", "shell", "rest_positions")},
        ),
        Target("CoarseDiscreteShell.restrict", model("coarse-ds", "restrict"), {"load": vectors}),
        Target("DiscreteShell.sensitivity", _sensitivity("ds", "flexure"), {"of": vectors}),
        Target("lma.sensitivity", _sensitivity("lma", "load"), {"of": vectors}),
    ]
    pose = {"rotations": np.eye(3), "translations": np.zeros(3)}
    made.append(Target("Crowd.blend_strains", part("basis").then(_blended), {"shares": np.array([0.0, 1.0])} | pose))
    for name in ("lma", "mwts", "rsw"):
        made.append(Target(f"{name}.displacement", model(name, "displacement"), {"q": q}))
        made.append(Target(f"{name}.coordinates_of", model(name, "coordinates_of"), {"positions": rest}))
    for name in model_names():
        made.append(Target(f"{name}.start_motion", model(name, "start_motion"), {"positions": rest}))
    return made


def _flown(dt):
    rest = np.array(world()["shell"].rest_positions)
    return ms.Flock(rest[:3], rest[3:6] + 1.0).step(dt)


def _sensitivity(name, to):
    gravity = np.array([0.0, 0.0, -2.0])
    return model(name).then(lambda body: functools.partial(body.sensitivity, body.equilibrium(gravity=gravity), to))


def _blended(basis):
    out = np.empty((2, *basis.shell.rest_positions.shape))
    return functools.partial(ms.Crowd(basis, 2).blend_strains, world()["models"]["rsw"], out=out)


def calls():
    """Every call with a number in it, but for those of ELSEWHERE."""
    for target in (*targets(), *methods()):
        if target.name != "run_sweep" and not target.name.startswith("ReducedRotationStrain") and target.numeric():
            yield pytest.param(target, id=target.name)


def numeric_methods():
    """Public methods of exported classes that take numbers from users, as ``Class.method``."""
    for name in ms.__all__:
        kind = getattr(ms, name)
        if not isinstance(kind, type) or issubclass(kind, BaseException | str):
            continue
        for method, function in inspect.getmembers(kind, callable):
            if method.startswith("_") or isinstance(function, type) or method in BETWEEN_PARTS:
                continue
            kinds = [str(parameter.annotation) for parameter in inspect.signature(function).parameters.values()]
            if any("ArrayLike" in annotation or annotation.startswith("float") for annotation in kinds):
                yield name, method


def test_every_method_that_takes_numbers_is_tried():
    tried = {target.name for target in (*targets(), *methods())} | set(ELSEWHERE)
    tried_methods = {name.split(".")[-1] for name in tried}
    # Of models each rung is tried under its own name, and crowds by one call of all methods.
    missing = {
        f"{kind}.{method}"
        for kind, method in numeric_methods()
        if f"{kind}.{method}" not in tried and not (issubclass(getattr(ms, kind), ms.Model) and method in tried_methods)
    }
    assert not missing


@pytest.mark.parametrize("seconds", [np.nan, np.inf, -1.0, "x", [1.0], 1j])
def test_waiting_refuses_what_is_no_time(seconds, tmp_path):
    with pytest.raises(ms.OptionError, match="wait must be"):
        ms.RunFollower(tmp_path / "never").wait(seconds)


def damaged(target, argument, damage):
    """The sound arguments of a call with one of them damaged."""
    given = {name: copy.copy(value) for name, value in (target.values | target.objects).items()}
    if "dtype" in target.words:
        given["dtype"] = "float64"
    bad = damage(given[argument])
    given[argument] = bad.item() if isinstance(bad, np.ndarray) and np.ndim(bad) == 0 else bad
    return given


def fault(call, given):
    """What is wrong with how a call meets bad arguments; empty where it refuses them."""
    try:
        call(**given)
    except ModalShellError:
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "accepted"


@pytest.mark.parametrize("target", list(calls()))
def test_bad_arguments_are_refused(target):
    call = target.call  # what it is made of must not be what refuses
    faults = {
        f"{argument}, {name}": fault(call, damaged(target, argument, damage))
        for argument in target.numeric()
        for name, damage in BAD.items()
        if name not in NOT_FINITE or (target.name, argument) not in EXCEPTIONS
    }
    assert len(faults) >= len(BAD) - len(NOT_FINITE)
    assert not {place: wrong for place, wrong in faults.items() if wrong}


@pytest.mark.parametrize(("answer", "word"), [(None, "accepted"), (ValueError("shape"), "ValueError: shape")])
def test_calls_that_accept_what_is_bad_are_found(answer, word):
    def careless(number):
        if answer is not None:
            raise answer
        return number

    target = Target("careless", careless, {"number": 1.0})
    assert fault(careless, damaged(target, "number", BAD["infinite"])) == word
