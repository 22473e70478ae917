"""Models are shared by threads, pickled and copied with the same answers; nobody can write into them from outside."""

import copy
import inspect
import pickle
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from fuzzing.world import model_names, part, resolved, world

import modalshell as ms
from modalshell import springs
from modalshell.core.thread_safety import PerThread, read_only_copy
from modalshell.models.base.model import Model
from modalshell.models.reduction.warp_frame import WarpFrame

GRAVITIES = [(0.0, 0.0, -2.0), (0.0, 1.5, -0.5), (0.3, 0.0, 1.0)]


def models():
    """Every rung on a small shell, by name."""
    return dict(world()["models"])


def answers(model, gravity):
    """Bits of an answer at rest and of one in motion."""
    still = model.equilibrium(gravity=gravity)
    moved = ms.simulate(model, duration=0.1, gravity=gravity)
    return still.positions.tobytes(), str(still.status), moved.positions.tobytes(), moved.status


def test_every_model_is_tried():
    kinds = {type(model) for model in models().values()}
    public = {value for value in vars(ms).values() if isinstance(value, type) and issubclass(value, Model)}
    assert kinds == {value for value in public if not inspect.isabstract(value)}


@pytest.fixture
def restless():
    """Threads that take turns as often as Python lets them."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


@pytest.mark.by_default("rigid")
@pytest.mark.parametrize("name", model_names())
@pytest.mark.usefixtures("restless")
def test_threads_share_a_model(name):
    model = models()[name]
    alone = [answers(model, gravity) for gravity in GRAVITIES]
    with ThreadPoolExecutor(len(GRAVITIES)) as pool:
        together = list(pool.map(lambda gravity: [answers(model, gravity) for _ in range(4)], GRAVITIES))
    for expected, found in zip(alone, together, strict=True):
        assert all(answer == expected for answer in found)


@pytest.mark.usefixtures("restless")
def test_threads_share_frames_patches_and_loads():
    basis, model = world()["basis"], world()["models"]["rsw"]
    frame, loads = WarpFrame(basis), [world()["shell"].gravity_force(gravity) for gravity in GRAVITIES]
    coordinates = np.random.default_rng(0).standard_normal((3, basis.count)) * 0.1

    def work(q):
        at = [model.patch_position(q, np.array([vertex]))[0].tobytes() for vertex in range(8, 14)]
        forces = [model.modal_force(q, load).tobytes() for load in loads]
        return frame.positions(q).tobytes(), at, model.displacement(q).tobytes(), forces

    alone = [work(q) for q in coordinates]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda q: [work(q) for _ in range(200)], coordinates))
    for expected, found in zip(alone, together, strict=True):
        assert all(answer == expected for answer in found)


@pytest.mark.by_default("rigid, free-deepcopy", "reduced-rsw-<lambda>", "md-rom-<lambda>", "coarse-ds-<lambda>")
@pytest.mark.parametrize("again", [lambda model: pickle.loads(pickle.dumps(model)), copy.deepcopy])
@pytest.mark.parametrize("name", model_names())
def test_copies_answer_alike(name, again):
    model = models()[name]
    model.equilibrium(gravity=GRAVITIES[0])  # with whatever is made at first use
    assert answers(again(model), GRAVITIES[1]) == answers(model, GRAVITIES[1])


@pytest.mark.parametrize("again", [lambda one: one, lambda one: pickle.loads(pickle.dumps(one)), copy.deepcopy])
@pytest.mark.parametrize("name", ["mesh", "material", "shell", "basis"])
def test_public_arrays_are_read_only_and_stay_so_in_copies(name, again):
    """Of what the user builds models from."""
    made = again(world()[name])
    arrays = {name: value for name in dir(made) if isinstance(value := getattr(made, name), np.ndarray)}
    for name in ("frequencies", "participation_factors", "effective_masses"):  # made anew for each caller
        arrays.pop(name, None)
    assert not [name for name, value in arrays.items() if value.flags.writeable]


ONCE_MADE = {
    "material": lambda: ms.Material(np.full(4, 20.0), 20.0, 0.05, 0.2),
    "isotropic": lambda: ms.Isotropic(np.full(4, 1e6), 0.3, 0.01, 1000.0),
    "support": lambda: ms.Pin(np.array([0, 1])),
    "direction": lambda: ms.Roller("x < 0.1", (0.0, 0.0, 1.0)),
    "position": lambda: ms.PositionConstraint([8, 9], np.ones(3)),
    "orientation": lambda: ms.OrientationConstraint(8, np.ones(3)),
    "wind": lambda: ms.Wind((1.0, 2.0, 3.0)),
    "follower": lambda: ms.FollowerForce("x > 0.1", (1.0, 2.0, 3.0)),
    "point": lambda: ms.PointForce(np.array([0, 1]), (1.0, 2.0, 3.0)),
    "moment": lambda: ms.EdgeMoment(np.array([0, 1]), 1.0),
    "pressure": lambda: ms.Pressure(1.0, sel=np.array([0, 1, 2])),
    "line": lambda: ms.LineForce("x > 0.1", (1.0, 2.0, 3.0)),
    "weight": lambda: ms.SelfWeight(),
    "frame": lambda: ms.FrameInertia((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)),
}


@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
@pytest.mark.parametrize("name", ONCE_MADE)
def test_copies_of_what_is_made_once_are_read_only(name, again):
    made = ONCE_MADE[name]()
    for one in (made, again(made)):
        assert not [
            name for name, value in vars(one).items() if isinstance(value, np.ndarray) and value.flags.writeable
        ]


def test_a_stiffness_matrix_is_the_callers_own():
    shell = world()["shell"]
    before = shell.stiffness()
    taken = shell.stiffness()
    taken.indices[:] = 0
    taken.data[:] = 0.0
    assert (shell.stiffness() != before).nnz == 0


def _implicit(mass, positions):
    stepper = springs.ImplicitSprings(springs.shell_springs(world()["shell"]), mass, None, threads=1)
    stepper.place(positions, np.zeros_like(positions))
    return stepper


def _loads(sel):
    force = (1.0, 2.0, 3.0)
    on_faces = [ms.EdgeMoment(sel, 1.0), ms.Pressure(1.0, sel=sel), ms.Wind(force, sel=sel)]
    return [ms.PointForce(sel, force), ms.LineForce(sel, force), ms.FollowerForce(sel, force), *on_faces]


BUILDERS = {
    "mesh": (ms.TriangleMesh, {"vertices": part("mesh", "vertices"), "faces": part("mesh", "faces")}),
    "material": (
        lambda stretch: ms.Material(stretch, 20.0, 0.05, 0.2),
        {"stretch": part("mesh", "faces").then(lambda faces: np.full(len(faces), 20.0))},
    ),
    "shell": (
        lambda clamped: ms.Shell(world()["mesh"], world()["material"], clamped),
        {"clamped": part("shell", "clamped")},
    ),
    "position": (ms.PositionConstraint, {"vertices": np.array([8, 9]), "target": np.array([1.0, 0.0, -0.1])}),
    "orientation": (ms.OrientationConstraint, {"vertices": np.array([8, 9]), "target": np.array([0.1, 0.0, 0.0])}),
    "path": (
        lambda **keys: ms.SupportPath(**keys),
        {"times": np.array([0.0, 1.0]), "translations": np.zeros((2, 3)), "pivot": np.zeros(3)},
    ),
    "flock": (
        lambda **keys: ms.Flock(directions=np.eye(3), **keys),
        {
            "positions": np.eye(3),
            "target": np.ones(3),
            "flock_position": np.zeros(3),
            "bounds": np.array([[-9.0] * 3, [9.0] * 3]),
        },
    ),
    "loads": (_loads, {"sel": np.array([0, 1, 2])}),
    "rest shape": (
        lambda **keys: ms.Shell(world()["mesh"], ms.Isotropic(1e6, 0.3, 0.01, 1000.0), **keys),
        {
            "prestrain": part("mesh", "faces").then(lambda faces: np.full(len(faces), 1e-4)),
            "rest_curvature": np.eye(3),
            "rest": part("mesh", "vertices"),
        },
    ),
    "energy": (lambda rest: ms.EnergyFunction(lambda x: (0.5 * x @ x, x, np.eye(2)), rest), {"rest": np.zeros(2)}),
    "springs": (
        _implicit,
        {
            "mass": part("mesh", "vertices").then(lambda vertices: np.full(len(vertices), 0.01)),
            "positions": part("mesh", "vertices"),
        },
    ),
}


def sharing(value, array, seen, place):
    """Places inside ``value`` whose memory ``array`` shares."""
    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray):
        if np.shares_memory(value, array):
            yield place
    elif isinstance(value, list | tuple):
        for index, inner in enumerate(value):
            yield from sharing(inner, array, seen, f"{place}[{index}]")
    elif isinstance(value, dict):
        for key, inner in value.items():
            yield from sharing(inner, array, seen, f"{place}[{key!r}]")
    elif type(value).__module__.startswith("modalshell") and hasattr(value, "__dict__"):
        for name, inner in vars(value).items():
            yield from sharing(inner, array, seen, f"{place}.{name}")


@pytest.mark.parametrize("name", BUILDERS)
def test_nothing_keeps_the_callers_arrays(name):
    build, arguments = BUILDERS[name]
    given = {key: np.array(resolved(value)) for key, value in arguments.items()}
    made = build(**given)
    assert not [place for key, array in given.items() for place in sharing(made, array, set(), key)]


def test_a_callables_own_buffer_is_copied():
    buffer = np.zeros(3)
    found = ms.PositionConstraint(0, lambda _: buffer).at(0.5)
    buffer[:] = 1.0
    assert not found.any()


def test_values_per_thread():
    made = PerThread(object)
    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(made).result()
    assert made() is made()
    assert other is not made()
    assert copy.deepcopy(made)() is not made()


def test_read_only_copies():
    mine = np.zeros(3)
    kept = read_only_copy(mine)
    assert kept is not mine
    assert mine.flags.writeable
    assert read_only_copy(kept) is kept
