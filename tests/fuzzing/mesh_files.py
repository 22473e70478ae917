"""Mesh files: valid files of every format, damaged, and what can be done with those that are still accepted."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from hypothesis import strategies as st

import modalshell as ms
from fuzzing.harness import Input
from fuzzing.mutations import byte_damage, damaged, text_damage
from modalshell.mesh.files import READABLE

BAD = Path(__file__).resolve().parents[1] / "data" / "bad"


@cache
def seeds() -> tuple[tuple[str, bytes], ...]:
    """Valid files: suffix and content."""
    mesh = ms.v_beam(cells=(2, 2))
    plain = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".obj", ".ply", ".stl", ".off", ".glb"):
            ms.save_mesh(mesh, Path(folder) / f"mesh{suffix}")
            found.append((suffix, (Path(folder) / f"mesh{suffix}").read_bytes()))
    found.append((".ply", plain.export(file_type="ply", encoding="ascii")))
    found.append((".stl", plain.export(file_type="stl_ascii").encode()))
    gltf = plain.export(file_type="gltf", embed_buffers=True)
    found.append((".gltf", gltf["model.gltf"]))
    quads = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\ng side\nusemtl x\nf 1/1/1 2/1/1 3/1/1 4/1/1\n"
    found.append((".obj", quads.encode()))
    found.append((".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 5 5\nf -4 -3 \\\n-2\n"))
    found.append((".obj", b"\xef\xbb\xbf" + found[0][1]))
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
    header += "property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n"
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], "<f4").tobytes()
    mixed = b"\x04" + np.arange(4, dtype="<i4").tobytes() + b"\x03" + np.array([1, 4, 2], "<i4").tobytes()
    found.append((".ply", header.encode() + points + mixed))
    found.append((".off", b"COFF 3 1 0 # colours\n0 0 0 1 1 1\n1 0 0 1 1 1\n0 1 0 1 1 1\n3 0 1 2\n"))
    return tuple(found)


def use(path: Path, save_as: str) -> list[Any]:
    """Load a mesh, hang it by its lowest corner, write it and read it again."""
    mesh = ms.load_mesh(path)
    answers: list[Any] = [mesh]
    try:
        size = float(np.ptp(mesh.vertices, axis=0).max())
        material = ms.Material.from_physical(young=1e6, poisson=0.3, thickness=size / 50, density=1e3, mesh=mesh)
        shell = ms.Shell(mesh, material, mesh.faces[0])
        basis = ms.solve_modes(shell, 1)
        answers += [material, basis, ms.ModalWarping(basis).equilibrium(gravity=(0.0, 0.0, -9.81))]
    finally:
        ms.save_mesh(mesh, path.with_name(f"again{save_as}"))
    if save_as in (".obj", ".off", ".ply"):
        again = ms.load_mesh(path.with_name(f"again{save_as}"))
        assert np.array_equal(again.vertices, mesh.vertices), "a written mesh reads back otherwise"
    return answers


def make(folder: Path) -> st.SearchStrategy[Input]:
    """Inputs that are written into ``folder``."""

    def build(seed: tuple[str, bytes], damages: list[Any], suffix: str | None, save_as: str) -> Input:
        data = damaged(seed[1], damages)
        path = folder / f"mesh{suffix or seed[0]}"

        def call() -> Any:
            path.write_bytes(data)
            return use(path, save_as)

        return Input(f"{path.name} {data!r} saved as {save_as}", call)

    suffixes = st.one_of(st.none(), st.none(), st.none(), st.sampled_from((*READABLE, ".OBJ", ".txt", "", ".npz")))
    save_as = st.sampled_from((".obj", ".ply", ".off", ".stl", ".glb", ".gltf", ".txt"))
    text = [seed for seed in seeds() if b"\x00" not in seed[1]]
    files = st.one_of(
        st.builds(build, st.sampled_from(text), st.lists(text_damage, max_size=3), suffixes, save_as),
        st.builds(build, st.sampled_from(seeds()), st.lists(byte_damage, max_size=3), suffixes, save_as),
    )
    odd = ("", ".", "no/such.obj", "a\0.obj", "x" * 300 + ".obj", "folder.obj", "é\ud800.obj", "loop.obj")
    odd += ("pipe.obj", "zeros.stl", "sparse.ply")
    if not (folder / "pipe.obj").exists():
        os.mkfifo(folder / "pipe.obj")
        (folder / "zeros.stl").symlink_to("/dev/zero")
        with open(folder / "sparse.ply", "wb") as sparse:
            sparse.truncate(10**13)
    (folder / "folder.obj").mkdir(exist_ok=True)
    use(_written(folder / "first.obj", seeds()[0][1]), ".obj")  # compiles, which may take longer than an input may
    if not (folder / "loop.obj").is_symlink():
        (folder / "loop.obj").symlink_to("loop.obj")
    paths = st.sampled_from(odd).map(lambda name: Input(f"load_mesh({name!r})", lambda: ms.load_mesh(folder / name)))
    saves = st.sampled_from(odd).map(
        lambda name: Input(f"save_mesh({name!r})", lambda: ms.save_mesh(_triangle(), folder / name))
    )
    return st.integers(0, 49).flatmap(lambda roll: paths if roll in (0, 49) else saves if roll == 1 else files)


def _triangle() -> ms.TriangleMesh:
    return ms.TriangleMesh(np.eye(3), [[0, 1, 2]])


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path
