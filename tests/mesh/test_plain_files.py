"""Whole-array readers give what the readers line by line give, or leave it to these."""

import numpy as np
import pytest

from modalshell.core.errors import MeshError
from modalshell.mesh import plain_files, polygon_files, welding

POINTS = ["v 0 0 0", "v 1 0 0", "v 0 1.5e-3 0", "v -.5 +1. 2E1"]
FACES = ["f 1 2 3", "f 1 3 4"]
ODD_POINTS = (
    "v 1 2", "v 1 2 3 4", "v 1 2 3 .1 .2 .3", "v 1-2 3", "v 1.5.2 3", "v 1_0 2 3", "v nan 2 3", "v 1 inf 3",
    "v 0x10 2 3", "v 1d3 2 3", "v 1,5 2 3", "v 1e400 2 3", "v 1 2 3 # 4", "v\t1 2 3", " v 1 2 3", "v  1\t2  3 ",
    "v 1 2 3\x00", "v", "v ", "v 1 2 \x1c3", "v 1 2 \u00a03", "v 1\x0b2 3", "vn 1 2 3", "vt 1 2", "# v 1 2 3", "o name",
    "v 1 2 3\rv 1 2 4", "v 1 2 \\\n3", "\u00bd", "v 1 2 three",
)  # fmt: skip
ODD_FACES = (
    "f 1/1 2/2 3/3", "f 1//1 2//2 3//3", "f 1/2/3\t2/3/4 3/4/5", "f 1/ 2/ 3/", "f /1 2 3", "f 1 2", "f", "f ",
    "f 0 1 2", "f 0 0 0", "f 1 2 3 0", "f 1.0 2 3", "f -1 -2 -3", "f 1 2 99", "f +1 2 3", "f 1 2 3 # 4", "f 1/2#c 2 3",
    "f 1/2#c 2/2 3", "f 1/2\x1c3 2 1", "f 1/2\u00a03 2 1", "f 1 2 3 4", "f 1_0 2 3", "f 1 2 99999999999999999999",
    "f\t1 2 3", "f 1 2-3", "f 1 2 \\\n3", "  f 1 2 3", "f 1/a/b 2 3", "f 1 2 3\x00", "f one two three",
)  # fmt: skip


def outcome(text):
    try:
        found = polygon_files.read_obj(text.encode())
    except MeshError as error:
        return str(error)
    return [(array.dtype, array.tobytes()) for array in (found.vertices, found.corners, found.sizes)]


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_an_obj_reads_the_same_line_by_line(ending, monkeypatch):
    texts = [ending.join([*POINTS, odd, *FACES, ""]) for odd in ODD_POINTS]
    texts += [ending.join([*POINTS, *FACES, odd]) for odd in ODD_FACES]
    texts += ["", ending.join(POINTS), ending.join(FACES), ending.join([*FACES, *POINTS])]
    whole = [outcome(text) for text in texts]
    monkeypatch.setattr(polygon_files, "read_plain_obj", lambda _: None)
    for text, found in zip(texts, whole, strict=True):
        assert found == outcome(text), text


def test_coordinates_keep_every_bit():
    bits = np.random.default_rng(0).integers(0, 2**64, (3000, 3), dtype=np.uint64).view(np.float64)
    points = np.vstack([bits[np.isfinite(bits).all(axis=1)], np.random.default_rng(1).standard_normal((3000, 3))])
    text = "\n".join([*(f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()), *FACES])
    found = plain_files.read_plain_obj(text.encode())
    assert found is not None
    assert found.vertices.tobytes() == points.tobytes()


@pytest.mark.parametrize("faces", [FACES, ["f 1/1 2/2 3/3"], ["f 1//4 2//4 3//4 4//4"], ["f 1/2/3\t2/3/4 3/4/5"]])
def test_plain_objs_are_not_left_to_the_other_reader(faces):
    text = "\n".join(["# made", "o one", *POINTS, "vn 0 0 1", "usemtl red", *faces, ""])
    assert plain_files.read_plain_obj(text.encode()) is not None


def test_vertices_are_told_apart_where_their_numbers_clash(monkeypatch):
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    for clash in (False, True):
        if clash:
            monkeypatch.setattr(welding, "_keys", lambda vertices: np.zeros(len(vertices), dtype=np.uint64))
        first, inverse = welding._distinct(points)
        np.testing.assert_array_equal(first[inverse], [0, 1, 0, 3, 1])
