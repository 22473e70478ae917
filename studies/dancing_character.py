"""Paper Fig. 8: a dancer whose hat, shirt and trouser legs are shells, led by the joints of a skeleton.

Each shell is clamped where it is worn and lives in the moving frame of that joint, so it feels the dance as inertial
loads; position and orientation constraints on rings lead it to the joints further down. MWTS answers every frame.
The skeleton and its dance are in ``studies/character``.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

import modalshell as ms
from modalshell.core.typing import Progress
from modalshell.files.study_result import StudyResult
from studies.character import clothes, skeleton
from studies.pages import at_most, counted, markdown, result_of

FIGURES = ("figure_8",)

DT = 1.0 / 30.0
SPACING, QUICK_SPACING = 0.026, 0.034
QUICK_DURATION = 0.4


class Garment(NamedTuple):
    """A shell, what it hangs on and what leads it.

    ``held`` are the heights of its clamped rings, from the lowest to the highest [m]. Each of ``led`` is the height of
    a ring and the joints that lead it: it goes with the first, turned half way towards the second.
    """

    name: str
    profile: Sequence[tuple[float, float, float, float]]
    shift: float
    joint: str
    held: tuple[float, float]
    led: tuple[tuple[float, str, str], ...]
    membrane: float
    flexure: float
    density: float
    modes: int
    damping: tuple[float, float]


def leg(side: str, shift: float) -> Garment:
    """A trouser leg: it hangs on the hip and is led at the knee and, with the shin, above the ankle."""
    hip, knee = f"hip_{side}", f"knee_{side}"
    led = ((0.5, knee, hip), (0.15, knee, knee))
    return Garment(f"leg_{side}", clothes.LEG, shift, hip, (0.85, 1.0), led, 6.0, 0.02, 0.3, 24, (1.5, 0.004))


GARMENTS = (
    Garment("hat", clothes.HAT, 0.0, "head", (1.67, 1.73), (), 0.45, 0.0006, 0.3, 16, (0.8, 0.004)),
    Garment(
        "torso", clothes.TORSO, 0.0, "chest", (1.36, 1.50),
        ((1.10, "spine", "pelvis"), (1.02, "pelvis", "pelvis")), 4.0, 0.02, 0.3, 24, (1.2, 0.004),
    ),
    leg("left", 0.095),
    leg("right", -0.095),
)  # fmt: skip


def main(quick: bool = False, on_step: Progress | None = None) -> StudyResult:
    """Dance; ``quick`` takes coarser shells and the first moments."""
    dancer = skeleton.Skeleton()
    duration = QUICK_DURATION if quick else dancer.duration
    rows: list[dict[str, Any]] = []
    arrays: dict[str, np.ndarray] = {}
    for garment in counted(GARMENTS, on_step):
        begin = time.perf_counter()
        tube = clothes.Tube(garment.profile, QUICK_SPACING if quick else SPACING, garment.shift)
        height = tube.mesh.vertices[:, 2]
        worn = (height >= garment.held[0]) & (height <= garment.held[1])
        material = ms.Material(garment.membrane, garment.membrane, garment.flexure, garment.density)
        shell = ms.Shell(tube.mesh, material, worn)
        basis = ms.solve_modes(shell, garment.modes)
        prepared = time.perf_counter() - begin
        path, constraints = led_by(dancer, garment, tube)
        model = ms.ModalWarping(basis, integrator="implicit_euler")
        led: dict[str, Any] = {"dt": DT, "damping": garment.damping, "supports": path, "constraints": constraints}
        ms.simulate(model, duration=2.0 * DT, **led)  # compiles what the clock is not to see
        run = ms.simulate(model, duration=duration, **led)
        rows.append(findings(garment, basis, run, path, prepared))
        arrays[f"{garment.name}_positions"] = run.positions.astype(np.float32)
        arrays[f"{garment.name}_faces"] = tube.mesh.faces.astype(np.int32)
    poses = [dancer.pose(float(t)) for t in run.times]
    arrays["times"] = run.times
    arrays["rest_joints"] = np.array(list(dancer.rest.values()))
    arrays["joints"] = np.array([[pose[name].position for name in dancer.rest] for pose in poses])
    arrays["turns"] = np.array([[pose[name].rotation.as_rotvec() for name in dancer.rest] for pose in poses])
    bends = [[bend(pose, side) for side in ("left", "right")] for pose in poses]
    found = {"joints": list(dancer.rest), "largest_knee_bend_degrees": float(np.max(bends)), "rows": rows}
    return result_of("dancing_character", found, arrays, duration=duration)


def led_by(
    dancer: Any, garment: Garment, tube: Any
) -> tuple[ms.SupportPath, list[ms.PositionConstraint | ms.OrientationConstraint]]:
    """The path of the joint on which a garment hangs, and the constraints of the joints that lead it."""
    anchor = dancer.rest[garment.joint]

    def support(time: float) -> tuple[np.ndarray, np.ndarray]:
        pose = dancer.pose(time)[garment.joint]
        return pose.position - anchor, pose.rotation.as_rotvec()

    given: list[ms.PositionConstraint | ms.OrientationConstraint] = []
    for height, first, second in garment.led:
        ring = tube.patch(height)
        arm = tube.mesh.vertices[ring].mean(axis=0) - dancer.rest[first]

        def turn(time: float, first: str = first, second: str = second) -> Rotation:
            pose = dancer.pose(time)
            both = Rotation.concatenate([pose[first].rotation, pose[second].rotation])
            return Slerp([0.0, 1.0], both)(0.5)

        def place(time: float, first: str = first, arm: np.ndarray = arm, turn: Any = turn) -> np.ndarray:
            return np.asarray(dancer.pose(time)[first].position + turn(time).apply(arm))

        def vector(time: float, turn: Any = turn) -> np.ndarray:
            return np.asarray(turn(time).as_rotvec())

        given += [ms.PositionConstraint(ring, place), ms.OrientationConstraint(ring, vector)]
    return ms.SupportPath.from_function(support, dancer.duration, pivot=anchor), given


def findings(
    garment: Garment, basis: ms.Basis, run: ms.Trajectory, path: ms.SupportPath, prepared: float
) -> dict[str, Any]:
    """What one garment did."""
    mesh = basis.shell.mesh
    size = float(np.ptp(mesh.vertices, axis=0).max())
    worn = [path.at(float(t)).to_shell(x) - mesh.vertices for t, x in zip(run.times, run.positions, strict=True)]
    ends = run.positions[:, mesh.edges]
    stretches = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2) / mesh.edge_lengths
    residuals = run.constraint_residuals
    return {
        "garment": garment.name,
        "vertices": len(mesh.vertices),
        "modes": basis.count,
        "frequencies_hz": basis.frequencies,
        "constraints": residuals.shape[1],
        "position_residual": float(residuals[:, 0::2].max(initial=0.0)),
        "orientation_residual": float(residuals[:, 1::2].max(initial=0.0)),
        "largest_displacement": float(np.linalg.norm(worn, axis=2).max()) / size,
        "largest_area_change": max((ms.measure.area_change(x, mesh) for x in run.positions), key=abs),
        "shortest_and_longest_edge": [float(stretches.min()), float(stretches.max())],
        "preprocessing_seconds": prepared,
        "frames_per_second": (len(run.times) - 1) / run.seconds,
        "status": run.status,
    }


def bend(pose: dict[str, Any], side: str) -> float:
    """Angle of a knee [degrees]."""
    turn = pose[f"hip_{side}"].rotation.inv() * pose[f"knee_{side}"].rotation
    return float(np.degrees(turn.magnitude()))


def whole_rate(rows: list[dict[str, Any]]) -> float:
    """Frames a second of all shells together."""
    return float(1.0 / sum(1.0 / row["frames_per_second"] for row in rows))


def table(result: StudyResult) -> str:
    """The findings as a Markdown table."""
    found, rows = result.findings, []
    for row in found["rows"]:
        residuals = [row[f"{kind}_residual"] if row["constraints"] else None for kind in ("position", "orientation")]
        edges = "x{:.2f} to x{:.2f}".format(*row["shortest_and_longest_edge"])
        rows.append({**row, "name": row["garment"].replace("_", " "), "residuals": residuals, "edges": edges})
    shells = markdown(
        "shell | vertices | modes | constraints | residual, position [m] | orientation [rad] | displacement | area "
        "| edges | frames/s | status",
        "{name} | {vertices} | {modes} | {constraints} | {residuals:.0e} | {largest_displacement:100*.0f} % "
        "| {largest_area_change:100*+.1f} % | {edges} | {frames_per_second:.0f} | {status}",
        rows,
    )
    return (
        f"{shells}\n\n{len(found['joints'])} joints; knees bend by up to {found['largest_knee_bend_degrees']:.0f} "
        f"degrees. All four shells together: {whole_rate(rows):.0f} "
        "frames a second. Displacement: the largest of a vertex in its shell's frame, of the shell's size. Area and "
        "edges: extremes over the dance, against rest. A knee is a smooth bend of few modes: cloth is pressed together "
        "behind it and stretched over it instead of creasing, as the edges say. Shells collide neither with each "
        "other nor with the body (the shirt ends where no raised thigh reaches it), and carry their weight at rest "
        "already."
    )


def finding(result: StudyResult) -> str:
    """Size, speed and accuracy of the four shells."""
    rows = result.findings["rows"]
    vertices = sum(row["vertices"] for row in rows)
    area = max(abs(row["largest_area_change"]) for row in rows)
    residual = max(row["position_residual"] for row in rows)
    return (
        f"{len(rows)} shells of {vertices:,} vertices follow the joints at {whole_rate(rows):.0f} frames "
        f"a second and meet their constraints within {at_most(residual, 1)} m; no area changes by more than "
        f"{at_most(100 * area)} %."
        " A few modes bend a knee smoothly: its edges shorten and stretch instead of creasing."
    )
