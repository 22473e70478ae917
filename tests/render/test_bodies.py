"""Colliders in pictures of answers and motions, and cameras that large ones do not drive away."""

import dataclasses
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread

import modalshell as ms
from modalshell.render.bodies import bodies_at, moving_bodies

BROWN = np.array([0xC9, 0xB7, 0x9C]) / 255.0
LIFT = ms.SupportPath([0.0, 0.1], [[0, 0, 0], [0, 0, 0.05]])


@pytest.fixture(autouse=True)
def _without_opengl(monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")


def resting(radius):
    """A strip held at an end, at rest on a ball, and in motion as the ball lifts it."""
    mesh = ms.flat_beam(length=0.5, width=0.2, cells=(10, 4))
    shell = ms.Shell(mesh, ms.Isotropic(young=5e7, poisson=0.3, thickness=2e-3, density=1e3), clamped="x < 0.001")
    contacts = [ms.Contact(ms.Sphere((0.3, 0.0, -radius - 0.03), radius), motion=LIFT)]
    model = ms.LinearModal(ms.solve_modes(shell, 4))
    answer = model.equilibrium(gravity=(0, 0, -9.81), contacts=contacts)
    return answer, ms.simulate(model, duration=0.1, dt=0.02, gravity=(0, 0, -9.81), contacts=contacts)


def share(picture, color):
    """Share of a picture that has a hue, whatever its shade."""
    image = imread(BytesIO(picture.data))[..., :3].astype(float)
    tones = image / np.maximum(image.sum(axis=2, keepdims=True), 1e-9)
    return float((np.abs(tones - color / color.sum()).max(axis=2) < 6e-3).mean())


@pytest.mark.slow
def test_pictures_show_the_colliders_where_they_are(tmp_path):
    for one in resting(0.1):
        assert share(one.plot(), BROWN) > 0.02
        assert share(dataclasses.replace(one, contacts=()).plot(), BROWN) < 1e-3
        assert "<img" in one._repr_html_()
    low, high = (
        bodies_at(one.positions, one.faces, one.times, one.contacts, time)[0].vertices[:, 2].max()
        for time in (0.0, 0.1)
    )
    assert high - low == pytest.approx(0.05)
    assert not ms.load_trajectory(one.save(tmp_path / "run.npz")).contacts


@pytest.mark.slow
def test_large_colliders_leave_the_camera_at_the_shell():
    answer, run = resting(20.0)
    shell = run.positions.reshape(-1, 3)
    low, high = shell.min(axis=0), shell.max(axis=0)
    for body, moved in moving_bodies(run.positions, run.faces, run.times, run.contacts, run.times):
        assert np.abs(moved).max() > 20.0
        seen = body.framed(moved)
        assert (seen >= low - np.ptp(shell, axis=0).max() - 1e-12).all()
        assert (seen <= high + np.ptp(shell, axis=0).max() + 1e-12).all()
    image = imread(BytesIO(answer.plot().data))[..., :3]
    alone = dataclasses.replace(answer, contacts=()).plot()
    bar = (np.ptp(imread(BytesIO(alone.data))[:, 870:, :3], axis=2) > 0.35).mean() * 90 / 960
    assert (np.ptp(image, axis=2) > 0.35).mean() > bar + 0.01


def test_what_dips_into_a_collider_between_its_vertices_hides_it():
    """A ball showed in spots through a coarse cloth whose vertices lie on it."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(12, 12))
    ball = ms.Sphere((0.5, 0.0, -0.3), 0.3)
    away = mesh.vertices - ball.center
    x = ball.center + away * np.maximum(1.0, 0.3 / np.linalg.norm(away, axis=1))[:, None]
    x[:, 2] = np.sqrt(np.maximum(0.09 - (away[:, :2] ** 2).sum(axis=1), 0.0)) - 0.3
    middles = x[mesh.faces].mean(axis=1)
    lowest = np.linalg.norm(middles - ball.center, axis=1).min()
    assert lowest < 0.3 - 5e-3
    (body,) = bodies_at(x[None], mesh.faces, np.zeros(1), [ms.Contact(ball)], 0.0)
    drawn = np.linalg.norm(body.vertices - ball.center, axis=1).max()
    assert lowest - 0.02 < drawn < lowest
