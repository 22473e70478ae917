"""Light strips that wind blows onto a ball: its drag, far above inertia in a step, acts in steps with contacts."""

import numpy as np
import pytest
from scenes import stopped_and_resumed

import modalshell as ms

BALL = ms.Contact(ms.Sphere((0.4, 0.0, -0.3), 0.3))
WIND = ms.Wind((0.0, 0.0, -8.0))


def strip(cells):
    return ms.flat_beam(length=1.0, width=0.2, cells=cells)


MODELS = {
    "LMA": lambda shell: ms.LinearModal(ms.solve_modes(shell, 6)),
    "MWTS": lambda shell: ms.ModalWarping(ms.solve_modes(shell, 6)),
    "MD-ROM": lambda shell: ms.ModalDerivatives(shell, count=4),
    "coarse DS": lambda shell: ms.CoarseDiscreteShell(shell, ms.coarse_shell(shell, strip((4, 1)))),
}


@pytest.mark.by_default("LMA")
@pytest.mark.parametrize("name", MODELS)
def test_a_light_strip_comes_to_lie_as_it_does_in_short_steps(name):
    """Its drag at the beginning of steps threw it about, by a quarter of its whole move and more."""
    sheet = ms.Isotropic(young=2e11, poisson=0.0, thickness=1e-3, density=20.0)
    model = MODELS[name](ms.Shell(strip((8, 2)), sheet, clamped="x < 1e-6"))
    given = {"gravity": (0.0, 0.0, -9.81), "loads": [WIND], "contacts": [BALL], "damping": (0.1, 0.0)}
    run, fine = (ms.simulate(model, duration=0.2, dt=1 / rate, **given) for rate in (120, 480))
    assert run.status == fine.status == "completed"
    assert run.in_contact[-1].any()
    off = np.sqrt(np.mean(np.sum((run.positions - fine.positions[::4]) ** 2, axis=2)))
    assert off < 0.004


@pytest.mark.slow
def test_a_scene_that_was_stopped_resumes_to_the_same_bits(tmp_path):
    """A step with a drag asks for derivatives that other steps of MWTS do without: its state keeps where it did."""
    (tmp_path / "scene.toml").write_text("""
[mesh]
shape = "flat_beam"
length = 1.0
width = 0.2
cells = [8, 2]
[material]
young = 2e11
poisson = 0.0
thickness = 1e-3
density = 20.0
[supports]
clamped = "x < 1e-6"
[model]
name = "mwts"
modes = 6
[[loads.wind]]
velocity = [0.0, 0.0, -8.0]
[[contacts]]
kind = "sphere"
center = [0.4, 0.0, -0.3]
radius = 0.3
[motion]
duration = 0.1
dt = 0.01
""")
    runs = stopped_and_resumed(tmp_path / "scene.toml", tmp_path, 6)
    whole, resumed = (run.trajectory for run in runs)
    assert whole.in_contact[5:].any()
    assert np.array_equal(whole.positions, resumed.positions)
