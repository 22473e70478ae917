"""Pages of shells without supports: their parts fall, turn and spring as those of ``simulate``."""

import json
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import modalshell as ms
from modalshell.motion.stepping import Motion

GRAVITY, STEP, STEPS = (0.0, 0.0, -9.81), 1.0 / 60.0, 30
PLATE = ms.Isotropic(young=1e8, poisson=0.3, thickness=2e-3, density=1000.0)


def sheets(count):
    """A free sheet, or such ones that nothing joins."""
    one = ms.flat_beam(length=1.0, width=0.5, cells=(8, 4))
    moved = [one.vertices * (1.0, 1.0 - 0.2 * k, 1.0) + (0.1, 0.0, 0.4 * k) for k in range(count)]
    faces = [one.faces + k * len(one.vertices) for k in range(count)]
    return ms.Shell(ms.TriangleMesh(np.vstack(moved), np.vstack(faces)), PLATE, loose_parts=count > 1)


def couple(shell):
    """Forces that turn the first sheet by about 80 degrees, and bend it."""
    force = np.zeros_like(shell.rest_positions)
    first = shell.mesh.components == 0
    arms = shell.rest_positions[first, 0] - 0.6
    force[first, 2] = -11.0 * shell.mass[first] * (arms + arms**3)
    return force


def centre(shell, x, part):
    return shell.mass[part] @ x[part] / shell.mass[part].sum()


def page_frames(page, name, start):
    """Positions (F, n, 3) of the page from given coordinates on."""
    page.evaluate(f"shell.state.paused = true; shell.state.model = '{name}'; shell.release()")
    page.evaluate(f"shell.state.q.set({json.dumps(start.tolist())})")
    frames = []
    for _ in range(STEPS + 1):
        frames.append(np.reshape(page.evaluate("[...shell.positions()]"), (-1, 3)))
        page.evaluate("shell.steps(1)")
    return np.array(frames)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.filterwarnings("ignore:modes are spent on rigid motion")
def test_free_parts_fly_as_the_models_do(count, open_file):
    shell = sheets(count)
    basis, force = ms.solve_modes(shell, 6 * count + 8), couple(shell)
    page, errors = open_file(basis.page(gravity=GRAVITY, force=force, damping=(0.1, 0.0), dt=STEP))
    x, y, _ = shell.rest_positions.T
    bent = shell.rest_positions + np.column_stack([0.0 * x, 0.0 * x, 0.1 * (x - 0.5) ** 2 + 0.1 * x * y])
    for name, model in (("mwts", ms.ModalWarping(basis)), ("lma", ms.LinearModal(basis))):
        motion = Motion(model, shell.loading(GRAVITY, force, None), dt=STEP, damping=ms.Damping(0.1, 0.0), start=bent)
        found = page_frames(page, name, motion.state.coordinates)
        expected = [motion.positions()]
        for _ in range(STEPS):
            motion.advance()
            expected.append(motion.positions())
        for number in range(count):
            part = shell.mesh.components == number
            fallen = centre(shell, expected[-1], part) - centre(shell, expected[0], part)
            assert np.linalg.norm(fallen) > 1.0
            off = [centre(shell, a, part) - centre(shell, b, part) for a, b in zip(found, expected, strict=True)]
            assert np.abs(off).max() < 1e-6 * np.linalg.norm(fallen)
        turn, _ = Rotation.align_vectors(*(x[:45] - x[:45].mean(axis=0) for x in (expected[-1], expected[0])))
        assert np.degrees(turn.magnitude()) > 50.0
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3)
    assert errors == []


@pytest.mark.slow
def test_a_free_sheet_on_a_page_springs_back_without_turning(open_file):
    shell = sheets(1)
    basis = ms.solve_modes(shell, 14)
    page, errors = open_file(basis.page(gravity=(0.0, 0.0, 0.0), damping=(0.0, 0.0), dt=STEP))
    x, y, _ = shell.rest_positions.T
    bent = shell.rest_positions + np.column_stack([0.0 * x, 0.0 * x, 0.3 * (x - 0.5) ** 2 + 0.1 * x * y])
    model = ms.ModalWarping(basis)
    for name in ("mwts", "lma"):
        frames = page_frames(page, name, model.coordinates_of(bent))
        arms = [x - centre(shell, x, slice(None)) for x in frames]
        momenta = [shell.mass @ np.cross(a, b) for a, b in pairwise(arms)]
        sizes = [shell.mass @ (np.linalg.norm(a, axis=1) * np.linalg.norm(b - a, axis=1)) for a, b in pairwise(arms)]
        assert max(sizes) > 1e-4
        assert np.abs(momenta).max() < 1e-6 * max(sizes)
        assert np.ptp([centre(shell, x, slice(None)) for x in frames], axis=0).max() < 1e-7
    page.evaluate("shell.state.gravity = [0, 0, -9.81]")
    assert page.evaluate("shell.settle()")  # to its shape in free fall, where its frame is
    assert np.abs(page.evaluate("[...shell.state.q.slice(6)]")).max() < 1e-9
    assert not any(page.evaluate("[...shell.state.v]"))
    assert errors == []
