"""Twenty meshes as other programs write them: formats, shading, axes and units of their own, of one curved sheet."""

import json
import struct

import numpy as np
import trimesh

import modalshell as ms

SIZE = (0.6, 0.3)
"""Length and width of the sheet [m]."""


def curved_sheet():
    """A sheet of 0.6 m by 0.3 m that is bent a little, z up."""
    flat = ms.flat_beam(length=SIZE[0], width=SIZE[1], cells=(8, 4))
    x, y, _ = flat.vertices.T
    return np.stack([x, y, 0.1 * x**2 + 0.05 * y], axis=1), np.array(flat.faces)


def _y_up(points):
    return points[:, [0, 2, 1]] * [1.0, 1.0, -1.0]


def _soup(points, faces):
    """Every triangle with vertices of its own, as flat shading needs."""
    return points[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def _normals(points, faces):
    """Mean normals of the vertices, which are those of the triangles where no vertex is shared."""
    return np.array(trimesh.Trimesh(points, faces, process=False).vertex_normals)


def _obj(path, points, faces, *, quads=False, flat=False):
    lines = ["# made by another program", "mtllib scene.mtl", "o Sheet"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "usemtl cloth", "s off" if flat else "s 1"]
    shaded = _soup(points, faces) if flat else (points, faces)
    normals = _normals(*shaded)
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals]
    if quads:
        count = 5
        cells = [(i * count + j, (i + 1) * count + j) for i in range(8) for j in range(4)]
        lines += [f"f {a + 1}/1 {b + 1}/2 {b + 2}/3 {a + 2}/4" for a, b in cells]
    else:
        for number, face in enumerate(faces):
            at = range(3 * number, 3 * number + 3) if flat else face
            lines.append(
                "f " + " ".join(f"{v + 1}/{1 + k}/{n + 1}" for k, (v, n) in enumerate(zip(face, at, strict=True)))
            )
    path.write_text("\n".join(lines) + "\n")


def _ply(path, points, faces, *, text=False, coloured=False):
    made = trimesh.Trimesh(points, faces, process=False)
    if coloured:
        made.visual.vertex_colors = np.tile([200, 30, 30, 255], (len(points), 1)).astype(np.uint8)
    path.write_bytes(made.export(file_type="ply", encoding="ascii" if text else "binary"))


def _stl(path, points, faces, *, text=False):
    made = trimesh.Trimesh(points, faces, process=False).export(file_type="stl_ascii" if text else "stl")
    path.write_bytes(made.encode() if isinstance(made, str) else made)


def _off(path, points, faces, *, coloured=False):
    head = "COFF" if coloured else "OFF"
    colour = " 255 0 0 255" if coloured else ""
    lines = [head, "# made by another program", f"{len(points)} {len(faces)} 0"]
    lines += [f"{x:.9g} {y:.9g} {z:.9g}{colour}" for x, y, z in points] + [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


def _gltf(path, points, faces, *, flat=False, node=None):
    """A .glb with normals, one primitive, and a node that may place it; y is up by definition."""
    points, faces = _soup(points, faces) if flat else (points, faces)
    arrays = [points.astype("<f4"), _normals(points, faces).astype("<f4"), faces.ravel().astype("<u2")]
    binary, views = b"", []
    for array in arrays:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        binary += array.tobytes() + b"\0" * (-array.nbytes % 4)
    low, high = arrays[0].min(axis=0).tolist(), arrays[0].max(axis=0).tolist()
    vectors = {"componentType": 5126, "count": len(points), "type": "VEC3"}
    accessors = [
        {"bufferView": 0, **vectors, "min": low, "max": high},
        {"bufferView": 1, **vectors},
        {"bufferView": 2, "componentType": 5123, "count": faces.size, "type": "SCALAR"},
    ]
    document = {
        "asset": {"version": "2.0", "generator": "another program"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    whole = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(binary))
    parts = (struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(binary), b"BIN\0"), binary)
    path.write_bytes(whole + b"".join(parts))


def _usd(path, points, faces, *, up="Z", metres=1.0, flat=False, left=False, placed=False):
    from pxr import Gf, Usd, UsdGeom, UsdUtils

    stored = path.with_suffix(".usdc") if path.suffix == ".usdz" else path
    stage = Usd.Stage.CreateNew(str(stored))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    root = UsdGeom.Xform.Define(stage, "/World")
    stage.SetDefaultPrim(root.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/World/Sheet")
    points, faces = _soup(points, faces) if flat else (points, faces)
    if placed:  # stored half as large and moved; the places of both prims put it back
        root.AddScaleOp().Set(Gf.Vec3f(2.0, 2.0, 2.0))
        mesh.AddTranslateOp().Set(Gf.Vec3d(1.0, 0.0, 0.0))
        points = points / (2.0 * metres) - [1.0, 0.0, 0.0]
    else:
        points = points / metres
    mesh.CreatePointsAttr([Gf.Vec3f(*map(float, point)) for point in points])
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr((faces[:, ::-1] if left else faces).ravel().tolist())
    mesh.CreateSubdivisionSchemeAttr("none")
    if left:
        mesh.CreateOrientationAttr("leftHanded")
    stage.Save()
    if path.suffix == ".usdz":
        UsdUtils.CreateNewUsdzPackage(str(stored), str(path))


MESHES = {
    "plain.obj": (_obj, "z", {}),
    "plain_y.obj": (_obj, "y", {}),
    "flat.obj": (_obj, "z", {"flat": True}),
    "quads_y.obj": (_obj, "y", {"quads": True}),
    "binary.ply": (_ply, "z", {}),
    "text_y.ply": (_ply, "y", {"text": True}),
    "coloured.ply": (_ply, "z", {"coloured": True}),
    "binary.stl": (_stl, "z", {}),
    "text_y.stl": (_stl, "y", {"text": True}),
    "plain.off": (_off, "z", {}),
    "coloured_y.off": (_off, "y", {"coloured": True}),
    "smooth.glb": (_gltf, "y", {}),
    "flat.glb": (_gltf, "y", {"flat": True}),
    "placed_z.glb": (_gltf, "z", {"node": {"rotation": [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]}}),
    "plain.usda": (_usd, "z", {}),
    "centimetres_y.usdc": (_usd, "y", {"metres": 0.01}),
    "flat_y.usda": (_usd, "y", {"flat": True}),
    "left_handed.usdc": (_usd, "z", {"left": True}),
    "placed.usd": (_usd, "z", {"placed": True, "metres": 0.01}),
    "packed_y.usdz": (_usd, "y", {}),
}
"""What writes each, the axis of its numbers that points up, and how."""


def write(name, folder):
    """Write one of :data:`MESHES` into a folder; return its path and the options that a stranger needs for it."""
    writer, axis, options = MESHES[name]
    points, faces = curved_sheet()
    if writer is _usd:
        options = options | {"up": axis.upper()}
    writer(folder / name, _y_up(points) if axis == "y" else points, faces, **options)
    stated = writer in (_gltf, _usd)
    return folder / name, {} if stated or axis == "z" else {"up": "y"}
