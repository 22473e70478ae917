"""The model that switches itself under constraints: as DS within the error asked for, and resumed to the same bits."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.base.bars import led_vertices
from modalshell.motion.stepping import Motion

DT = 0.01
SHEET = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=300.0)
TIMES = [0.0, 0.5, 1.0]


@pytest.fixture(scope="module")
def strip():
    return ms.Shell(ms.flat_beam(length=1.0, width=0.2, cells=(8, 2)), SHEET, "x < 0.001")


def lifted(strip, path=None, height=0.03):
    """The middle of the free end, lifted and let down, beside supports that move along a path."""
    tip = int(np.linalg.norm(strip.rest_positions - (1.0, 0.0, 0.0), axis=1).argmin())

    def target(time):
        z = height * np.sin(3.0 * time) ** 2
        point = strip.rest_positions[tip] + (-0.4 * z**2, 0.0, z)
        return point if path is None else path.at(time).to_world(point[None])[0]

    return [ms.PositionConstraint(tip, target)]


@pytest.mark.slow
@pytest.mark.parametrize("moved", [False, True], ids=["resting", "moving"])
def test_it_follows_ds_and_resumes_to_the_same_bits(strip, moved):
    path = ms.SupportPath(TIMES, [(0, 0, 0), (0.02, 0.01, 0.03), (0, 0, 0)]) if moved else None
    setting = {"duration": 1.0, "dt": DT, "gravity": (0, 0, -0.5), "damping": (2.0, 0.0), "supports": path}
    setting["constraints"] = lifted(strip, path)
    exact, run = (ms.simulate(kind(strip), **setting) for kind in (ms.DiscreteShell, ms.Auto))
    assert run.status == "completed"
    assert set(run.levels[1:]) == {"RSW", "DS"}
    poses = [np.eye(1) if path is None else path.at(float(time)) for time in run.times]
    own, true = (
        np.stack([x if path is None else pose.to_shell(x) for pose, x in zip(poses, one.positions, strict=True)])
        for one in (run, exact)
    )
    off, moves = (np.sqrt(np.sum(strip.mass[:, None] * x**2, axis=(1, 2))) for x in (own - true, true - own[0]))
    assert off.max() < 0.05 * moves.max()
    whole, resumed = (
        Motion(ms.Auto(strip), strip.loading((0, 0, -0.5), None, None), dt=DT, damping=ms.Damping(2.0, 0.0),
               supports=path, constraints=setting["constraints"])
        for _ in range(2)
    )  # fmt: skip
    for step in range(80):
        whole.advance()
        if step == 60:
            resumed.restore(whole.snapshot())
    while resumed.count < whole.count:
        resumed.advance()
    found = resumed.snapshot()
    assert all(np.array_equal(found[name], part) for name, part in whole.snapshot().items())


def test_levels_take_over_where_constraints_lead(strip):
    """Places and speeds of led vertices are those of their targets, of a patch as rigid as DS holds it."""
    patch = np.flatnonzero(strip.rest_positions[:, 0] > 0.8)
    centre = strip.rest_positions[patch].mean(axis=0)
    held = [
        ms.PositionConstraint(patch, lambda time: centre + np.array([0.0, 0.0, 0.02 * time])),
        ms.OrientationConstraint(patch, lambda time: (0.0, -0.05 * time, 0.0)),
    ]
    motion = Motion(ms.Auto(strip), strip.loading(None, None, None), dt=DT, constraints=held)
    stepper, led = motion.stepper, led_vertices(strip, held)
    full = stepper._stepper(1)
    x = strip.rest_positions + np.outer(strip.rest_positions[:, 0] ** 2, (0.0, 0.0, 0.01))
    for level, chosen in ((0, [one.vertices[0] for one in led.points()]), (1, led.vertices)):
        own = stepper._stepper(level)
        state = stepper._levels[level].entered(own, x, np.zeros_like(x), 0.5)
        places = np.isin(led.vertices, chosen)
        np.testing.assert_allclose(own.local_positions(state)[led.vertices][places], led.at(0.5)[places], atol=1e-6)
    state = stepper._levels[0].entered(stepper._stepper(0), x, np.zeros_like(x), 0.5)
    speeds = stepper._levels[0].velocities(stepper._stepper(0), state, DT)[[one.vertices[0] for one in led.points()]]
    true = np.stack([(one.at(0.5) - one.at(0.5 - 1e-5)) / 1e-5 for one in led.points()])
    np.testing.assert_allclose(speeds, true, atol=2e-4)
    assert full.setup.constraints == held


def test_statics_are_those_of_ds(strip):
    load = {"gravity": (0, 0, -0.5), "constraints": lifted(strip)}
    answer, exact = (kind(strip).equilibrium(**load) for kind in (ms.Auto, ms.DiscreteShell))
    assert np.array_equal(answer.constraint_reactions, exact.constraint_reactions)


def test_what_it_does_not_take_is_refused(strip):
    floor = [ms.Contact(ms.Plane((0, 0, 1), -0.5))]
    with pytest.raises(ms.OptionError, match="contacts or constraints, not both"):
        ms.simulate(ms.Auto(strip), duration=0.1, constraints=lifted(strip), contacts=floor)
    free = ms.Shell(strip.mesh, SHEET)
    with pytest.raises(ms.OptionError, match="in free flight takes no constraints"):
        ms.simulate(ms.Auto(free), duration=0.1, constraints=lifted(strip))
