"""glTF files of mode shapes and motions as morph targets, in metres, with y up by a rotated node."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from modalshell.core.typing import Array
from modalshell.export.compression import compress
from modalshell.export.near_origin import centre_of, centred
from modalshell.files.atomic_io import write_bytes
from modalshell.modes import Basis
from modalshell.motion import Trajectory

_SHOWN_SHARE = 0.2
"""Largest displacement of a mode at weight 1, as a share of the shell's size."""
_TURN = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Quaternion that turns z up into glTF's y up."""


def save_gltf(run: Trajectory, path: Path) -> Path:
    """Write a binary glTF file whose morph targets, with weights over time, bake the motion."""
    near, centre = centred(run)
    motion, metres = compress(near), run.units.metres
    shapes, names, weights = [], [], []
    for k, (shape, amplitude) in enumerate(zip(motion.displacements(), motion.amplitudes.T.astype(float), strict=True)):
        for sign in (1.0, -1.0):  # readers clamp weights to [0, 1], so that each side has a target of its own
            weight = np.maximum(sign * amplitude, 0.0)
            if reach := weight.max():
                shapes.append(metres * (sign * reach * shape))
                names.append(f"shape {k + 1}{'+' if sign > 0 else '-'}")
                weights.append(weight / reach)
    moved = (run.units.seconds * motion.times, np.array(weights).T)
    rest = metres * motion.rest_positions.astype(float)
    return _write(path, rest, motion.faces, shapes, names, moved, metres * centre)


def save_modes_gltf(basis: Basis, path: Path) -> Path:
    """Write a binary glTF file with a morph target a mode; at weight 1 a mode moves by a fifth of the shell's size."""
    modes = basis.modes.T.reshape(basis.count, -1, 3)
    reach = np.linalg.norm(modes, axis=2).max(axis=1)
    shapes = modes * (_SHOWN_SHARE * basis.shell.size / reach)[:, None, None]
    names = [f"mode {k + 1}, {frequency:.4g} Hz" for k, frequency in enumerate(basis.frequencies)]
    rest = basis.shell.rest_positions
    centre = centre_of(rest)
    return _write(path, rest - centre, basis.shell.mesh.faces, shapes, names, None, centre)


def _write(
    path: Path,
    rest: Array,
    faces: Any,
    shapes: Iterable[Array],
    names: Sequence[str],
    weights: tuple[Array, Array] | None,
    centre: Array,
) -> Path:
    """A mesh about a centre (3,), with morph targets (K, n, 3), and an animation of their weights (F, K) at times (F,).

    The node is turned to y up first and moved to the centre then.
    """
    import pygltflib as gltf

    blob, views, accessors = bytearray(), [], []

    def add(array: Any, kind: str, component: int, *, bounds: bool = False, target: int | None = None) -> int:
        data = np.ascontiguousarray(array).tobytes()
        views.append(gltf.BufferView(buffer=0, byteOffset=len(blob), byteLength=len(data), target=target))
        blob.extend(data)  # four-byte numbers throughout, so that everything is aligned
        extremes = {}
        if bounds:
            table = array if array.ndim == 2 else array[:, None]
            extremes = {"min": table.min(axis=0).tolist(), "max": table.max(axis=0).tolist()}
        accessors.append(
            gltf.Accessor(bufferView=len(views) - 1, componentType=component, count=len(array), type=kind, **extremes)
        )
        return len(accessors) - 1

    points = {"kind": gltf.VEC3, "component": gltf.FLOAT, "bounds": True, "target": gltf.ARRAY_BUFFER}
    points_at = add(np.asarray(rest, np.float32), **points)
    triangles = np.asarray(faces, np.uint32).ravel()
    index = add(triangles, gltf.SCALAR, gltf.UNSIGNED_INT, target=gltf.ELEMENT_ARRAY_BUFFER)
    targets = [{"POSITION": add(np.asarray(shape, np.float32), **points)} for shape in shapes]
    primitive = gltf.Primitive(
        attributes=gltf.Attributes(POSITION=points_at), indices=index, material=0, targets=targets or None
    )
    mesh = gltf.Mesh(primitives=[primitive], weights=[0.0] * len(targets), extras={"targetNames": list(names)})
    colour = gltf.PbrMetallicRoughness(baseColorFactor=[0.36, 0.55, 0.78, 1.0], metallicFactor=0.0, roughnessFactor=0.8)
    x, y, z = map(float, centre)
    node = gltf.Node(mesh=0, name="Shell", rotation=_TURN, translation=[x, z, -y] if centre.any() else None)
    document = gltf.GLTF2(
        asset=gltf.Asset(version="2.0", generator="modalshell"),
        scene=0,
        scenes=[gltf.Scene(nodes=[0])],
        nodes=[node],
        meshes=[mesh],
        materials=[gltf.Material(pbrMetallicRoughness=colour, doubleSided=True)],
    )
    if weights is not None and targets:
        times = add(np.asarray(weights[0], np.float32), gltf.SCALAR, gltf.FLOAT, bounds=True)
        values = add(np.asarray(weights[1], np.float32).ravel(), gltf.SCALAR, gltf.FLOAT)
        sampler = gltf.AnimationSampler(input=times, output=values, interpolation="LINEAR")
        channel = gltf.AnimationChannel(sampler=0, target=gltf.AnimationChannelTarget(node=0, path="weights"))
        document.animations = [gltf.Animation(name="motion", samplers=[sampler], channels=[channel])]
    document.bufferViews, document.accessors = views, accessors
    document.buffers = [gltf.Buffer(byteLength=len(blob))]
    document.set_binary_blob(bytes(blob))
    return write_bytes(path, b"".join(document.save_to_bytes()))
