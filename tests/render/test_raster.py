"""The rasteriser's kernels: coverage, depth, and what cannot be drawn."""

from dataclasses import replace

import numpy as np
import pytest

import modalshell as ms
from modalshell.mesh.topology import area_vectors
from modalshell.render import backend
from modalshell.render.camera import frame_points
from modalshell.render.content import ShadedSurface
from modalshell.render.raster import shrink
from modalshell.render.rasteriser_painter import Canvas, RasteriserPainter, Triangles
from modalshell.render.surfaces import normals


def flat_triangles(corners, nearness, shade, opacity=1.0):
    corners = np.asarray(corners, dtype=float)
    near = np.broadcast_to(np.asarray(nearness, dtype=float)[:, None], (len(corners), 3))
    return Triangles(corners, near, np.full((len(corners), 3, 3), shade), opacity)


def fan(center, radius, count, turn):
    angles = turn + 2.0 * np.pi * np.arange(count + 1) / count
    ring = center + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.stack([np.broadcast_to(center, (count, 2)), ring[:-1], ring[1:]], axis=1)


@pytest.mark.by_default("0.1", "1.3")
@pytest.mark.parametrize("turn", [0.0, 0.1, 1.3])
def test_triangles_that_share_sides_cover_every_pixel_once(turn):
    """Half opaque ones, each on its own layer: a pixel drawn twice would be darker."""
    count = 7
    canvas = Canvas((40, 30), count, 1)
    for layer, corners in enumerate(fan(np.array([20.3, 14.6]), 12.0, count, turn)):
        canvas.draw(layer, flat_triangles([corners], [0.0], 0.0, 0.5))
    image = canvas.take_image()
    assert set(np.unique(image)) == {128, 255}
    area = 0.5 * count * 12.0**2 * np.sin(2.0 * np.pi / count)
    assert (image[..., 0] == 128).sum() == pytest.approx(area, rel=0.03)


def test_the_nearest_is_seen_and_of_equal_ones_the_last():
    square = np.array([[[1.0, 1.0], [8.0, 1.0], [8.0, 8.0]], [[1.0, 1.0], [8.0, 8.0], [1.0, 8.0]]])
    canvas = Canvas((10, 10), 1, 1)
    for order in (1, -1):
        for nearness, shade in ((1.0, 0.2), (2.0, 0.6))[::order]:
            canvas.draw(0, flat_triangles(square, [nearness] * 2, shade))
        image = canvas.take_image()
        assert (image[1:8, 1:8] == 153).all()
        assert (image[8:] == 255).all()
        assert (image[:, 8:] == 255).all()
    for shade in (0.2, 0.4):
        canvas.draw(0, flat_triangles(square, [1.0] * 2, shade))
    assert (canvas.take_image()[1:8, 1:8] == 102).all()
    assert (canvas.take_image() == 255).all()  # emptied


def test_layers_mix_from_far_to_near():
    square = np.array([[[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]]])
    canvas = Canvas((2, 2), 2, 2)
    canvas.draw(1, flat_triangles(square, [3.0], 0.0, 0.25))
    canvas.draw(0, flat_triangles(square, [1.0], 1.0))
    assert (canvas.take_image() == 191).all()
    canvas.draw(1, flat_triangles(square, [0.0], 0.0, 0.25))
    canvas.draw(0, flat_triangles(square, [1.0], 1.0))
    assert (canvas.take_image() == 255).all()


def test_one_layer_is_averaged_as_the_nearest_of_two():
    random, images = np.random.default_rng(3), []
    corners, shades = random.uniform(0.0, 40.0, (30, 3, 2)), random.uniform(0.0, 1.0, (30, 3, 3))
    triangles = Triangles(corners, random.uniform(0.0, 1.0, (30, 3)), shades, 0.7)
    for layers in (1, 2):
        canvas = Canvas((20, 16), layers, 2)
        canvas.draw(layers - 1, triangles)
        images.append(canvas.take_image())
    np.testing.assert_array_equal(*images)
    assert (images[0] < 255).any()


def random_triangles(seed):
    random = np.random.default_rng(seed)
    corners, colors = random.uniform(0.0, 40.0, (9, 3, 2)), random.uniform(0.0, 1.0, (9, 3, 3))
    return Triangles(corners, random.uniform(0.0, 1.0, (9, 3)), colors, 0.7)


def test_what_stands_still_is_seen_as_if_it_were_drawn_each_time():
    kept, fresh = Canvas((20, 16), 1, 2), Canvas((20, 16), 1, 2)
    for still in (1, 2):
        kept.draw(0, random_triangles(still))
        kept.keep()
        for moving in (3, 4):
            kept.draw(0, random_triangles(moving))
            for seed in (still, moving):
                fresh.draw(0, random_triangles(seed))
            np.testing.assert_array_equal(kept.take_image(), fresh.take_image())


def test_surfaces_that_move_late_leave_the_place_where_they_stood():
    mesh = ms.flat_beam(cells=(4, 2))
    surfaces = [ShadedSurface(mesh.vertices + lift * np.array([0.0, 0.0, 1.0]), mesh.faces) for lift in (0.0, 0.3)]
    camera, moved = frame_points(mesh.vertices, (1.0, 1.0, 1.0), 1.0), mesh.vertices + 0.1
    painter, images = RasteriserPainter((60, 60)), []
    painter.start(surfaces, camera, None)
    for index in range(2):
        painter.move(index, moved)
        images.append(painter.image())
    painter.start([replace(surface, vertices=moved) for surface in surfaces], camera, None)
    np.testing.assert_array_equal(images[1], painter.image())
    assert (images[0] != images[1]).any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e14])
def test_corners_that_are_nowhere_draw_nothing_outside_the_picture(value):
    canvas = Canvas((6, 5), 1, 2)
    for corner in range(3):
        for axis in range(2):
            corners = np.array([[[1.0, 1.0], [9.0, 2.0], [4.0, 8.0]]])
            corners[0, corner, axis] = value
            canvas.draw(0, flat_triangles(corners, [1.0], 0.5))
    assert canvas.take_image().shape == (5, 6, 3)


def test_normals_are_those_of_faces_and_their_mean_by_area():
    mesh = ms.v_beam(cells=(6, 4))
    x = mesh.vertices + 0.02 * np.random.default_rng(2).standard_normal(mesh.vertices.shape)
    x[mesh.faces[3]] = x[mesh.faces[3, 0]]  # a face without area
    flat, smooth = normals(x, mesh.faces)
    vectors = area_vectors(x, mesh.faces)
    total = np.zeros_like(x)
    np.add.at(total, mesh.faces, vectors[:, None])
    for found, along in ((flat, vectors), (smooth, total)):
        lengths = np.linalg.norm(along, axis=1, keepdims=True)
        expected = np.divide(along, lengths, out=np.zeros_like(along), where=lengths > 0.0)
        np.testing.assert_allclose(found, expected, atol=1e-15)
    assert not flat[3].any()


def test_blocks_are_averaged_and_rounded():
    pixels = np.random.default_rng(0).integers(0, 256, (12, 18, 4)).astype(np.uint8)
    out = np.empty((4, 6, 3), np.uint8)
    shrink(pixels, 3, out)
    mean = pixels[..., :3].reshape(4, 3, 6, 3, 3).mean(axis=(1, 3))
    np.testing.assert_array_equal(out, np.floor(mean + 0.5 - 1.0 / 18.0 + 1e-9))


def test_the_named_renderer_draws_films(monkeypatch):
    monkeypatch.setattr(backend.sys, "platform", "linux")
    monkeypatch.setattr(backend, "_GRAPHICS_DEVICES", ("no such device",))
    monkeypatch.delenv(backend.RENDERER_VARIABLE, raising=False)
    assert backend.draws_faster()
    monkeypatch.setattr(backend, "_GRAPHICS_DEVICES", ("nul*",))
    assert not backend.draws_faster()
    monkeypatch.setattr(backend, "_GRAPHICS_DEVICES", ("no such device",))
    monkeypatch.setenv(backend.RENDERER_VARIABLE, "pyvista")
    assert not backend.draws_faster()


@pytest.mark.parametrize("size", [1e-15, 1e15])
def test_cameras_know_no_size(size):
    points = np.asarray(ms.v_beam(cells=(4, 2)).vertices)
    seen, other = (frame_points(each, (1.0, 1.0, 1.0), 1.5).project(each) for each in (points, size * points))
    np.testing.assert_allclose(other[:, :2], seen[:, :2], atol=1e-9)
