"""Reading and writing meshes: round trips, and every damaged file named."""

import errno
import json
import os
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from modalshell.core.errors import MeshError, ModalShellWarning
from modalshell.mesh import TriangleMesh, leaf, load_mesh, save_mesh, v_beam

HERE = Path(__file__).resolve().parents[1]
SHARED = HERE.parents[1] / "shared" / "meshes"

BAD = {
    "not_finite.obj": "line 3: vertex 2 .*not finite",
    "index_out_of_range.obj": "line 6: face 1 .*names vertex 9 .*out of range",
    "zero_area.obj": r"face 2, vertices \(0, 1, 4\) .*degenerate.*zero area",
    "no_faces.obj": "4 vertices and no faces",
    "empty.obj": "empty",
    "truncated.ply": "cut short.*12917 vertices and 25830 faces",
}


def refuse(path, message):
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", BAD)
def test_bad_file(name):
    refuse(HERE / "data" / "bad" / name, BAD[name])


@pytest.mark.parametrize("name", BAD)
def test_shared_bad_file(name):
    if not (SHARED / "bad" / name).exists():
        pytest.skip("the shared meshes are not on this machine; tests/data/bad holds copies")
    refuse(SHARED / "bad" / name, BAD[name])


def test_files_with_junctions_and_one_sided_strips(tmp_path):
    ribbed = load_mesh(HERE / "data" / "joints" / "three_faces_one_edge.obj")
    strip = load_mesh(HERE / "data" / "joints" / "mobius.obj")
    assert (len(ribbed.junctions), len(ribbed.seams)) == (1, 0)
    assert len(strip.junctions) == 0
    assert len(strip.seams) > 0
    for number, mesh in enumerate((ribbed, strip)):
        for suffix in (".obj", ".ply", ".off"):
            path = save_mesh(mesh, tmp_path / f"{number}{suffix}") or tmp_path / f"{number}{suffix}"
            np.testing.assert_array_equal(load_mesh(path).faces, mesh.faces)


@pytest.mark.by_default("camel_25830.ply")
@pytest.mark.parametrize("name", ["dino_25830.ply", "camel_25830.ply"])
def test_shared_models(name):
    if not (SHARED / name).exists():
        pytest.skip("the shared meshes are not on this machine")
    mesh = load_mesh(SHARED / name)
    assert (len(mesh.vertices), len(mesh.faces)) == (12917, 25830)
    assert len(mesh.boundary_vertices) == 0


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".off"])
def test_exact_round_trip(tmp_path, suffix):
    mesh = leaf(cells=(10, 6))
    mesh = TriangleMesh(mesh.vertices * np.pi * 1e-7, mesh.faces)
    path = tmp_path / f"leaf{suffix}"
    save_mesh(mesh, path)
    back = load_mesh(path)
    np.testing.assert_array_equal(back.vertices, mesh.vertices)
    np.testing.assert_array_equal(back.faces, mesh.faces)


@pytest.mark.parametrize("suffix", [".glb", ".stl", ".STL"])
def test_single_precision_round_trip(tmp_path, suffix):
    mesh = v_beam(cells=(10, 4))
    path = tmp_path / f"beam{suffix}"
    save_mesh(mesh, str(path))
    back = load_mesh(str(path))
    assert (len(back.vertices), len(back.edges)) == (len(mesh.vertices), len(mesh.edges))
    np.testing.assert_allclose(back.vertices[back.faces], mesh.vertices[mesh.faces], atol=1e-7)


def test_gltf_with_its_buffer_beside_it(tmp_path):
    mesh = v_beam(cells=(4, 2))
    files = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type="gltf")
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    assert load_mesh(tmp_path / "model.gltf").area == pytest.approx(mesh.area, rel=1e-6)


def test_obj_with_quads_textures_relative_indices_and_continuation(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text(
        "# comment\nmtllib none.mtl\no a\nv 0 0 0\nv 1 0 0 # corner\n  v 1 1 0 0.5 0.5 0.5\nv 0 1 0\nvt 0 0\nvn 0 0 1\n"
        "usemtl x\nf 1/1/1 2/1/1 \\\n3/1/1 4/1/1\nf -4 -1 5\nv -1 0 0\n"
    )
    with pytest.raises(MeshError, match=r"line 13: face 1 .*names vertex 0, out of range"):
        load_mesh(_write(tmp_path / "zero.obj", path.read_text().replace("-1 5", "0 5")))
    mesh = load_mesh(path)
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 0, 0]]
    assert mesh.area == pytest.approx(1.5)


def test_unused_vertices_are_dropped_with_a_warning(tmp_path):
    text = "v 7 7 7\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 8 8 8\nf 2 3 4\n"
    with pytest.warns(ModalShellWarning, match=r"dropped 2 vertices .*first vertex 0 "):
        mesh = load_mesh(_write(tmp_path / "loose.obj", text))
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    # A fault is still named by the file's own indices.
    refuse(_write(tmp_path / "loose2.obj", text + "f 3 2 2\n"), r"face 1, vertices \(2, 1, 1\)")


def test_an_ascii_stl_is_read_whole(tmp_path):
    """A name with "vertex" in it made the file empty, and two spaces made it one cut short."""
    text = f"solid vertex model\n{FIRST}endsolid vertex model\nsolid\n{SECOND}endsolid\n"
    for name, written in (("lower", text), ("upper", text.upper()), ("crlf", text.replace("\n", "\r\n"))):
        mesh = load_mesh(_write(tmp_path / f"{name}.stl", written))
        assert mesh.vertices[:, 0].tolist() == [0.5, 1.0, 0.0, 1.0]
    in_one_line = f"solid\n{FIRST}{' '.join(SECOND.split())}\nendsolid\n"
    with pytest.raises(MeshError, match="1 of 2 facets have each vertex"):  # the second was left out without a word
        load_mesh(_write(tmp_path / "line.stl", in_one_line))


def test_collapsed_stl_triangle_warns(tmp_path):
    rows = [[0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 0, 0, 0, 0, 0, 1, 0, 0]]
    data = b"\0" * 80 + struct.pack("<I", 2) + b"".join(struct.pack("<12fH", 0, 0, 1, *row, 0) for row in rows)
    with pytest.warns(ModalShellWarning, match="dropped 1 of 2 triangles"):
        assert len(load_mesh(_write(tmp_path / "a.stl", data)).faces) == 1


@pytest.mark.parametrize("suffix", [".step", ".STP", ".igs"])
def test_files_of_cad_are_answered_with_what_to_do(tmp_path, suffix):
    path = tmp_path / f"part{suffix}"
    path.write_text("ISO-10303-21;\n")
    refuse(path, r"surfaces of CAD without triangles, where a mesh is expected: mesh the surface .*gmsh -2")


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".stl"])
def test_a_byte_order_mark_loses_no_vertex(tmp_path, suffix):
    path = tmp_path / f"beam{suffix}"
    save_mesh(v_beam(cells=(4, 2)), path)
    plain = load_mesh(path)
    marked = load_mesh(_write(tmp_path / f"marked{suffix}", b"\xef\xbb\xbf" + path.read_bytes()))
    np.testing.assert_array_equal(marked.vertices, plain.vertices)
    np.testing.assert_array_equal(marked.faces, plain.faces)


POINTS = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [1, 2, 0]]
POLYGONS = [[0, 1, 2, 3], [1, 4, 2], [4, 5, 6, 2]]
HEADER = (
    "ply\nformat {} 1.0\nelement vertex 7\nproperty uchar red\nproperty double x\nproperty float y\n"
    "property float z\nelement face 3\nproperty short part\nproperty list uchar int vertex_indices\n"
    "property list uchar float texcoord\nelement edge 1\nproperty int a\nend_header\n"
)


def polygon_ply(kind):
    """Quads beside triangles, further properties, and an element that is not asked for."""
    header = HEADER.format(kind).encode()
    if kind == "ascii":
        rows = [f"9 {x} {y} {z}" for x, y, z in POINTS]
        rows += [" ".join(map(str, [5, len(p), *p, 2, 0.5, 0.5])) for p in POLYGONS]
        return header + "\n".join([*rows, "1"]).encode()
    order = "<" if kind == "binary_little_endian" else ">"
    rows = [struct.pack(f"{order}Bdff", 9, *point) for point in POINTS]
    rows += [struct.pack(f"{order}hB{len(p)}iBff", 5, len(p), *p, 2, 0.5, 0.5) for p in POLYGONS]
    return header + b"".join(rows) + struct.pack(f"{order}i", 1)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_of_quads_and_triangles_is_split(tmp_path, kind):
    mesh = load_mesh(_write(tmp_path / "a.ply", polygon_ply(kind)))
    assert mesh.vertices.tolist() == POINTS
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2], [4, 5, 6], [4, 6, 2]]
    refuse(_write(tmp_path / "cut.ply", polygon_ply(kind)[:-40]), "cut short")


def test_messages_say_how_faces_are_counted(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 2 2\n"
    refuse(_write(tmp_path / "a.obj", text), r"face 2, vertices \(0, 1, 1\).*add one.*faces are counted after")
    data = polygon_ply("ascii").replace(b"5 3 1 4 2", b"5 3 1 4 9")
    refuse(_write(tmp_path / "a.ply", data), "face 1 names vertex 9, out of range")


def gltf(change):
    files = trimesh.Trimesh(POINTS[:3], [[0, 1, 2]], process=False).export(file_type="gltf", embed_buffers=True)
    document = json.loads(files["model.gltf"])
    change(document)
    return json.dumps(document).encode()


def test_gltf_that_is_read_in_part_only_is_refused(tmp_path):
    draco = gltf(lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]))
    refuse(_write(tmp_path / "draco.gltf", draco), "requires KHR_draco_mesh_compression")
    body = draco + b" " * (-len(draco) % 4)
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(body), len(body), 0x4E4F534A)
    refuse(_write(tmp_path / "draco.glb", head + body), "requires KHR_draco_mesh_compression")
    for name in ("POSITION", "indices"):

        def thin(document, name=name):
            part = document["meshes"][0]["primitives"][0]
            index = part["indices"] if name == "indices" else part["attributes"]["POSITION"]
            document["accessors"][index]["sparse"] = {"count": 1}

        refuse(_write(tmp_path / "sparse.gltf", gltf(thin)), "as sparse, which is not read")
    unlit = gltf(lambda d: d.update(extensionsRequired=["KHR_materials_unlit"]))
    assert len(load_mesh(_write(tmp_path / "unlit.gltf", unlit)).faces) == 1


PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
)
FACET = "facet  normal 0 0 1\n outer loop\n" + 3 * " vertex {}\n" + " endloop\nendfacet\n"
FIRST, SECOND = FACET.format("0.5 0 0", "1 0 0", "0 1 0"), FACET.format("0 1 0", "1 0 0", "1 1 0")
ROWS = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
DAMAGED = {
    "a.xyz": ("0 0 0", "suffix '.xyz'; expected one of .obj"),
    "text.obj": ("hello\n", "no vertices"),
    "short_vertex.obj": ("v 0 0\nf 1 1 1\n", "line 1: vertex 0 .* has 2 coordinates"),
    "word_vertex.obj": ("v 0 0 x\n", "line 1: vertex 0 .*expected three numbers"),
    "word_face.obj": ("v 0 0 0\nf a b c\n", "line 2: face 0 .*whole vertex numbers"),
    "line.obj": ("v 0 0 0\nf 1 1\n", "line 2: face 0 .* has 2 corners"),
    "nohead.ply": ("solid", "no complete PLY header"),
    "badhead.ply": ("ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "'element vertex many'"),
    "points.ply": (PLY.replace("face 2", "face 0") + ROWS, "4 vertices and no faces"),
    "short.ply": (PLY + ROWS + "3 0 1 2\n", "cut short.* 2 faces"),
    "junk.ply": (PLY + ROWS.replace("1 1 0", "foo 1 0") + "3 0 1 2\n3 0 2 3\n", "damaged.*PLY"),
    "nan.ply": (PLY + ROWS.replace("1 1 0", "nan 1 0") + "3 0 1 2\n3 0 2 3\n", "vertex 2 .*not finite"),
    "range.ply": (PLY + ROWS + "3 0 1 2\n3 0 2 9\n", "face 1 names vertex 9, out of range"),
    "text.off": ("hello", "does not start with 'OFF'"),
    "counts.off": ("OFF\nmany faces\n", "OFF header"),
    "points.off": ("OFF\n4 0 0\n" + ROWS, "4 vertices and 0 faces"),
    "short.off": ("OFF\n4 2 0\n" + ROWS + "3 0 1 2\n", "cut short.*5 rows"),
    "nan.off": ("OFF\n4 1 0\n" + ROWS.replace("1 1 0", "nan 1 0") + "3 0 1 2\n", "line 5: vertex 2 .*not finite"),
    "range.off": ("OFF\n4 2 0\n" + ROWS + "3 0 1 2\n3 0 2 9\n", "line 8: face 1 names vertex 9, out of range"),
    "word.off": ("OFF\n4 1 0\n" + ROWS + "3 0 1 x\n", "line 7: face 0 reads '3 0 1 x'"),
    "corners.off": ("OFF\n4 1 0\n" + ROWS + "3 0 1\n", "line 7: face 0 reads '3 0 1'"),
    "tiny.stl": ("abc", "cut short: 3 bytes"),
    "short.stl": (b"\0" * 80 + struct.pack("<I", 5) + b"\0" * 60, "cut short.*5 triangles take 334 bytes"),
    "ascii.stl": ("solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n", "ASCII STL is cut short"),
    "none.stl": (b"\0" * 84, "no faces"),
    "word.stl": (f"solid\n{FIRST}{FIRST.replace('0.5', 'nil')}endsolid\n", "line 11: vertex 3 .*'nil 0 0'"),
    "corners.stl": (f"solid\n{FIRST}{FIRST.replace(' vertex 1 0 0', '')}endsolid\n", "line 15: facet 1 .*after 5"),
    "a.glb": ("glTF", "damaged, cut short or not GLB"),
    "a.gltf": ("{", "damaged, cut short or not GLTF"),
    "blank.ply": ("  \n", "file is empty"),
}


def _write(path, content):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_file(tmp_path, name):
    content, message = DAMAGED[name]
    refuse(_write(tmp_path / name, content), message)


@pytest.mark.parametrize("suffix", ["glb", "stl", "ply", "off"])
def test_every_cut_is_refused(tmp_path, suffix):
    whole = tmp_path / f"whole.{suffix}"
    save_mesh(v_beam(cells=(4, 2)), whole)
    data = whole.read_bytes()
    for keep in (1, 20, 90, len(data) // 3, len(data) // 2, len(data) - 30):
        refuse(_write(tmp_path / f"cut.{suffix}", data[:keep]), "cut")


def test_missing_file_folder_and_unwritable(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    for name in ("nowhere.obj", "nowhere", "nowhere.toml"):
        refuse(tmp_path / name, "no such file")
    refuse(_write(tmp_path / "a.toml", b"[mesh]"), "a scene, where a mesh is expected")
    refuse(_write(tmp_path / "a.vtk", b""), r"cannot read files with suffix '\.vtk'")
    (tmp_path / "folder.obj").mkdir()
    refuse(tmp_path / "folder.obj", "cannot be read")
    mesh = v_beam(cells=(4, 2))
    with pytest.raises(MeshError, match="cannot be written"):
        save_mesh(mesh, tmp_path / "no" / "a.obj")
    save_mesh(mesh, tmp_path / "full.ply")
    whole = (tmp_path / "full.ply").read_bytes()
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MeshError, match=r"cannot be written \(No space"):  # half of it took the place of the old one
        save_mesh(v_beam(cells=(6, 2)), tmp_path / "full.ply")
    assert (tmp_path / "full.ply").read_bytes() == whole
    with pytest.raises(MeshError, match=r"cannot write files with suffix '\.vtk'"):
        save_mesh(mesh, tmp_path / "a.vtk")
    far = TriangleMesh(mesh.vertices + 1e5, mesh.faces)  # it was written, and its shape lost
    with pytest.raises(MeshError, match=r"GLB files hold coordinates of 1e\+05 to 0\.006, of a shell of .* write PLY"):
        save_mesh(far, tmp_path / "far.glb")


def test_repository_meshes_load():
    folder = HERE.parent / "meshes"
    blade, beam = load_mesh(folder / "leaf.obj"), load_mesh(folder / "v_beam.obj")
    np.testing.assert_allclose(blade.vertices, leaf().vertices, atol=1e-12)
    np.testing.assert_allclose(beam.vertices, v_beam().vertices, atol=1e-12)
    np.testing.assert_array_equal(beam.faces, v_beam().faces)


def test_messages_on_damaged_numbers_stay_short(tmp_path):
    rows = "0 0 0\n1 0 0\n0 1 " + "[" * 3000 + "\n3 0 1 2\n"
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    file = tmp_path / "mesh.ply"
    file.write_text(f"{header}element face 1\nproperty list uchar int vertex_indices\nend_header\n{rows}")
    with pytest.raises(MeshError, match="damaged or not PLY") as refused:
        load_mesh(file)
    assert len(str(refused.value)) < 600


@pytest.mark.parametrize("first", range(6))
def test_a_polygon_with_a_corner_on_a_straight_side_has_no_flat_triangle(tmp_path, first):
    corners = np.roll([1, 2, 3, 6, 5, 4], first)
    points = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (2, 1)]
    lines = [f"v {x} {y} 0" for x, y in points] + ["f " + " ".join(map(str, corners))]
    (tmp_path / "hexagon.obj").write_text("\n".join(lines))
    mesh = load_mesh(tmp_path / "hexagon.obj")
    assert len(mesh.faces) == 4
    assert mesh.face_areas.sum() == pytest.approx(2.0)
    assert mesh.face_areas.min() > 0.2


@pytest.mark.parametrize("order", [(0, 1, 3, 2), (0, 2, 1, 3)])
def test_polygons_that_cross_themselves_are_refused(tmp_path, order):
    """Split as if they did not, each was folded flat on itself without a word, and the sheet in pieces."""
    sheet = [f"v {x} {y} 0" for y in range(2) for x in range(4)]
    quads = [[i, i + 1, i + 5, i + 4] for i in range(3)]
    named = [" ".join(str(quad[k] + 1) for k in order) for quad in quads]
    bent = ["v 4 0 0.4", "v 4 1 0.5", f"f 4 {len(sheet) + 1} {len(sheet) + 2} 8"]  # not plane, and right
    for lines in (named, named[1:2]):
        text = "\n".join([*sheet, *bent, *(f"f {line}" for line in lines)])
        refuse(_write(tmp_path / "pixels.obj", text.encode()), "polygon 1 crosses itself")
    right = "\n".join([*sheet, *bent, *(f"f {a + 1} {b + 1} {c + 1} {d + 1}" for a, b, c, d in quads)])
    assert len(load_mesh(_write(tmp_path / "quads.obj", right.encode())).faces) == 8
