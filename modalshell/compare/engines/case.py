"""What adapters of engines read: mesh, constants, supports and loads of a shell, in SI units."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.compare.engines.engine import Engine
from modalshell.core.errors import ModalShellWarning, OptionError
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.modes import lowest_modes
from modalshell.modes.rigid import rigid_motions
from modalshell.shell import Isotropic, Material, Shell
from modalshell.shell.energies_of import material_constants
from modalshell.shell.split_folds import mirror_images
from modalshell.supports import Clamp, Pin

CONSTANTS = ("young", "poisson", "thickness", "density")
_PERIODS = 4.0
"""Periods of the lowest mode after which motion with 0.7 of critical damping counts as at rest."""
STEPS = (30, 100, 300)
"""Steps a period that are tried, the longest first."""


def engine_case(
    engine: Engine, shell: Shell, loads: Sequence[tuple[Array | None, Array | None]], first: int = 0
) -> dict[str, Any]:
    """A shell under loads of gravity (3,) [m/s^2] and force (n, 3) [N]; OptionError where no engine can express it.

    Steps in time begin with the ``first`` of :data:`STEPS`.
    """
    constants = material_constants(shell.material)
    if not isinstance(shell.material, Isotropic) or set(CONSTANTS) - set(constants):
        raise OptionError("engines take one Young's modulus, Poisson's ratio, thickness and density: use ms.Isotropic")
    shell.refuse_creases("an engine")
    if shell.stressed:
        raise OptionError("engines know no prestrain, rest_curvature, temperature or rest")
    if shell.energies:
        raise OptionError("engines know no energies but the material's")
    if shell.mesh.joints.edges.size:
        raise OptionError("engines bend no edge with three triangles: take a mesh without junctions (mesh.junctions)")
    kinds = {type(support) for support in shell.supports}
    if kinds not in ({Clamp}, {Pin}):
        raise OptionError("engines take supports that are all clamps, or all pins")
    clamped, count = kinds == {Clamp}, len(shell.mesh.vertices)
    mesh, held = shell.mesh, shell.clamped
    if rigid_motions(shell).shape[1]:
        raise OptionError("engines take shells that their supports hold")
    if clamped and not engine.has_turns:
        _refuse_clamps_inside(mesh, held)
        mesh, held = with_images(mesh, held)
    hinges, masses = _hinges(mesh, held, constants)
    circular = 2.0 * np.pi * float(lowest_modes(shell, 1)[0].frequencies[0])
    period = 2.0 * np.pi / circular
    return {
        **{name: constants[name] for name in CONSTANTS},
        **engine.options,
        "vertices": mesh.vertices.tolist(),
        "faces": mesh.faces.tolist(),
        "held": np.flatnonzero(held).tolist(),
        "clamped": clamped,
        "masses": masses.tolist(),
        "hinges": hinges,
        "damping": 1.4 * circular,
        "duration": _PERIODS * period,
        "steps": [period / steps for steps in STEPS[first:]],
        "bound": 10.0 * float(np.abs(mesh.vertices).max()),
        "loads": [_load(gravity, force, len(mesh.vertices) - count) for gravity, force in loads],
    }


def _refuse_clamps_inside(mesh: TriangleMesh, held: NDArray[np.bool_]) -> None:
    """OptionError where a clamped edge has two triangles that move: without turns they would tilt about it together."""
    inside = held[mesh.edges].all(axis=1) & (mesh.edge_faces[:, 1] >= 0)
    fixed: NDArray[np.bool_] = np.asarray(held[mesh.faces].all(axis=1))
    if count := int((inside & ~fixed[mesh.edge_faces].any(axis=1)).sum()):
        raise OptionError(
            "this engine can clamp edges of the boundary and whole triangles only, as its vertices do not turn (got "
            f"{count} clamped edges inside the sheet): clamp two rows of vertices there"
        )


def with_images(mesh: TriangleMesh, held: NDArray[np.bool_]) -> tuple[TriangleMesh, NDArray[np.bool_]]:
    """``mesh`` with held mirror images of its triangles behind clamped boundary edges, and what is held of it."""
    edges = np.flatnonzero((mesh.edge_faces[:, 1] < 0) & held[mesh.edges].all(axis=1))
    rows = mesh.edge_faces[edges, 0]
    chosen = ~held[mesh.faces[rows]].all(axis=1)
    edges, rows = edges[chosen], rows[chosen]
    first, second = mesh.edges[edges].T
    apex = mesh.faces[rows].sum(axis=1) - first - second
    x = mesh.vertices
    mirrored = mirror_images(x, first, second, apex)
    # Triangles at one apex over edges in line have one image.
    keys = np.column_stack([apex, np.round(mirrored / (1e-9 * mesh.size))])
    _, kept, places = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    images = len(x) + places.ravel()
    faces = mesh.faces[rows][:, ::-1].copy()  # reversed, so that they face as the others do
    faces[faces == apex[:, None]] = images
    further = TriangleMesh(np.vstack([x, mirrored[kept]]), np.vstack([mesh.faces, faces]))
    return further, np.append(held, np.ones(kept.size, dtype=bool))


def _hinges(mesh: TriangleMesh, held: NDArray[np.bool_], constants: dict[str, float]) -> tuple[list[Any], Array]:
    """Ends and stiffness [N] of every hinge, calibrated as this package's own are; and the lumped masses [kg]."""
    with warnings.catch_warnings(action="ignore", category=ModalShellWarning):
        material = Material.from_physical(mesh=mesh, **{name: constants[name] for name in CONSTANTS})  # type: ignore[arg-type]
        shell = Shell(mesh, material, held)
    hinges = shell.elements[2]
    ends = hinges.stencils[:, :2]
    lengths = np.linalg.norm(mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]], axis=1)
    weights = (2.0 * hinges.weight / lengths).tolist()
    return [[*pair, weight] for pair, weight in zip(ends.tolist(), weights, strict=True)], np.asarray(shell.mass)


def _load(gravity: Array | None, force: Array | None, images: int) -> dict[str, Any]:
    load: dict[str, Any] = {"gravity": [0.0, 0.0, 0.0] if gravity is None else np.asarray(gravity).tolist()}
    if force is not None:
        load["force"] = np.vstack([force, np.zeros((images, 3))]).tolist()
    return load
