"""Paper Fig. 3: a large mesh in real time, four modes, driven by moving its supports unevenly.

A creature of 13,000 vertices stands on its open feet; the ground under it starts, stops and turns. MWTS with four modes
(paper: 13,117 vertices, 18 s of preprocessing, 200 frames/s) answers every frame; LMA is measured too. The study
lists what preprocessing costs, part by part, and the rate of whole frames: load, modal step and positions.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.compare.report import percent
from modalshell.core.typing import Progress
from modalshell.files.provenance import repository_file
from modalshell.files.study_result import StudyResult
from modalshell.modes.modal_rotation import rotation_matrix
from studies.pages import markdown, result_of

FIGURES = ("figure_3",)

MODES = 4
MATERIAL: dict[str, Any] = {"young": 2e5, "poisson": 0.3, "thickness": 0.01, "density": 300.0}
DURATION = 8.0
FRAME = 1.0 / 30.0
DAMPING = (0.4, 0.004)
KEYFRAMES = np.array(
    # time [s], x, y [m], turn about z [rad]: an uneven walk, a stop, a turn
    [
        [0.0, 0.0, 0.0, 0.0],
        [0.6, 0.35, 0.0, 0.0],
        [1.1, 0.1, 0.05, 0.1],
        [1.5, 0.5, 0.2, 0.25],
        [2.4, 0.5, 0.45, 0.25],
        [3.0, 0.1, 0.1, -0.2],
        [3.8, 0.3, -0.2, -0.3],
        [4.6, 0.0, 0.0, 0.0],
    ]
)


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Preprocess, drive and time the creature; ``quick`` simulates a quarter of the time."""
    duration = DURATION / 4 if quick else DURATION
    parts: dict[str, float] = {}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        answer = work()
        parts[name] = time.perf_counter() - start
        return answer

    mesh = ms.load_mesh(repository_file("meshes/creature.ply"))
    # Once on a small shell, so that compiling kernels is not counted.
    _shell(ms.sheet(cells=(12, 12)))
    mesh = timed("mesh and its edges", lambda: _touched(ms.TriangleMesh(mesh.vertices, mesh.faces)))
    material = timed("material", lambda: ms.Material.from_physical(**MATERIAL, mesh=mesh))
    clamped = mesh.vertices[:, 2] < 0.015
    shell = timed("shell", lambda: ms.Shell(mesh, material, clamped))
    timed("stiffness", shell.stiffness)
    timed("modal rotation matrix", lambda: rotation_matrix(mesh))
    basis = timed("modes, with the stiffness and the rotations", lambda: ms.solve_modes(shell, MODES))

    turns = np.zeros((len(KEYFRAMES), 3))
    turns[:, 2] = KEYFRAMES[:, 3]
    moved = np.column_stack([KEYFRAMES[:, 1:3], np.zeros(len(KEYFRAMES))])
    path = ms.SupportPath(KEYFRAMES[:, 0], moved, turns)
    # The creature at rest carries its weight already: gravity is left out, as the modes are about that shape.
    options: dict[str, Any] = {"dt": FRAME, "damping": DAMPING, "supports": path}
    warping = ms.ModalWarping(basis, integrator="implicit_euler")
    ms.simulate(warping, duration=2.0 * FRAME, **options)  # compiles what the clock is not to see
    options["duration"] = duration
    warped = ms.simulate(warping, **options, on_step=on_step)
    linear = ms.simulate(ms.LinearModal(basis, integrator="implicit_euler"), **options)

    length = float(np.ptp(mesh.vertices, axis=0).max())
    error = np.abs(warped.positions - linear.positions).max() / length
    findings = {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.faces),
        "edges": len(mesh.edges),
        "modes": MODES,
        "backend": basis.backend,
        "frequencies_hz": basis.frequencies,
        "preprocessing_seconds": parts,
        "frames_per_second": (len(warped.times) - 1) / warped.seconds,
        "largest_swing": float(np.abs(_relative(warped, path) - mesh.vertices).max()) / length,
        "largest_difference_lma_mwts": error,
        "area_change_mwts": max(abs(ms.measure.area_change(frame, mesh)) for frame in warped.positions[::8]),
        "area_change_lma": max(abs(ms.measure.area_change(frame, mesh)) for frame in linear.positions[::8]),
        "status": warped.status,
    }
    arrays = {
        "times": warped.times,
        "positions": warped.positions.astype(np.float32),
        "faces": mesh.faces.astype(np.int32),
        "rest": mesh.vertices,
    }
    return result_of("large_mesh", findings, arrays, duration=duration)


def _shell(mesh: ms.TriangleMesh) -> None:
    shell = ms.Shell(mesh, ms.Material.from_physical(**MATERIAL, mesh=mesh), mesh.vertices[:, 0] < 0.1)
    shell.stiffness()
    model = ms.ModalWarping(ms.solve_modes(shell, MODES), integrator="implicit_euler")
    ms.simulate(model, duration=FRAME, dt=FRAME)


def _touched(mesh: ms.TriangleMesh) -> ms.TriangleMesh:
    """The mesh with its hinges, areas and normals computed."""
    assert len(mesh.hinges) == len(mesh.hinge_edges)
    assert len(mesh.face_areas) == len(mesh.face_normals)
    return mesh


def _relative(run: ms.Trajectory, path: ms.SupportPath) -> np.ndarray:
    """Positions in the shell's frame."""
    poses = [path.at(float(time)) for time in run.times]
    moved = [(x - pose.pivot - pose.translation) @ pose.rotation for x, pose in zip(run.positions, poses, strict=True)]
    return np.array(moved)


def table(result: StudyResult) -> str:
    """The findings as Markdown tables."""
    found = result.findings
    parts = found["preprocessing_seconds"] | {"all": sum(found["preprocessing_seconds"].values())}
    facts = {
        "vertices, triangles, edges": "{vertices:,}, {triangles:,}, {edges:,}",
        "modes and their frequencies [Hz]": ", ".join(f"{value:.3f}" for value in found["frequencies_hz"]),
        "factorisation": "{backend}",
        "whole frames per second (load, step, positions; one thread)": "{frames_per_second:.0f}",
        "largest swing, of the creature's length": "{largest_swing:.0%}",
        "largest area change, MWTS and LMA": "{area_change_mwts:.1%}, {area_change_lma:.1%}",
    }
    lines = [f"| {name} | {value.format(**found).replace('%', ' %')} |" for name, value in facts.items()]
    seconds = [{"part": name, "seconds": value} for name, value in parts.items()]
    preprocessing = markdown("preprocessing | seconds", "{part} | {seconds:.3f}", seconds)
    return "\n".join([preprocessing, "", "| | |", "|---|---|", *lines])


def finding(result: StudyResult) -> str:
    """Size, speed and preprocessing."""
    found = result.findings
    return (
        f"{found['vertices']:,} vertices run at {found['frames_per_second']:.0f} whole frames a second on one thread "
        f"after {sum(found['preprocessing_seconds'].values()):.1f} s of preprocessing. Areas change by "
        f"{percent(found['area_change_mwts'], '.1f')} at most with MWTS, by {percent(found['area_change_lma'], '.1f')} "
        "with LMA."
    )
