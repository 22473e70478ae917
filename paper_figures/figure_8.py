"""Paper Fig. 8: stills and a film of the dancer in shells (reads the study ``dancing_character``)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views, write_film
from paper_figures.glyphs import GlyphMesh, joined, rod, sphere

SKIN, SHIRT, TROUSERS, SHOES, EYES = "#e8b98f", "#3f78c4", "#8a7762", "#3b3b44", "#2a2a2a"
COLORS = {"hat": "#c8382e", "torso": SHIRT, "leg_left": TROUSERS, "leg_right": TROUSERS}
CAMERA = (0.3, -1.0, 0.22)
STAGE = 0.72
LIGHT = np.array([-0.10, -0.16, 1.0])
STILLS = (0.5, 2.5, 3.75, 4.75, 6.27, 8.0)

# What the shells do not cover: colour, joint on which it hangs, and rods [m] as in the rest pose, left side first.
LIMBS: list[tuple[str, str, tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float]]]] = [
    (SKIN, "elbow_left", ((0.19, 0.0, 1.13), (0.19, 0.0, 0.90), (0.040, 0.030))),
    (SKIN, "wrist_left", ((0.19, 0.0, 0.86), (0.19, -0.01, 0.81), (0.042, 0.034))),
    (SHIRT, "shoulder_left", ((0.175, 0.0, 1.395), (0.19, 0.0, 1.12), (0.066, 0.055))),
    (SHOES, "ankle_left", ((0.095, 0.03, 0.055), (0.095, -0.14, 0.040), (0.052, 0.038))),
]
BODY = [
    (SKIN, "neck", rod((0.0, 0.0, 1.42), (0.0, 0.0, 1.53), (0.052, 0.050))),
    (TROUSERS, "pelvis", rod((-0.05, 0.0, 0.92), (0.05, 0.0, 0.92), (0.098, 0.098))),
]


def head() -> list[tuple[str, str, GlyphMesh]]:
    """Head, nose, ears and eyes."""
    vertices, faces = sphere((0.0, 0.0, 0.0), 0.115, detail=3)
    skull = (vertices * [0.92, 1.0, 1.14] + [0.0, -0.005, 1.605], faces)
    round_parts = [skull, sphere((0.0, -0.122, 1.585), 0.019)]
    round_parts += [sphere((side * 0.106, 0.0, 1.59), 0.026) for side in (-1, 1)]
    eyes = joined([sphere((side * 0.042, -0.105, 1.618), 0.0135) for side in (-1, 1)])
    return [(SKIN, "head", joined(round_parts)), (EYES, "head", eyes)]


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw from the result in ``results`` into ``folder``; return the paths of the PNG and the MP4."""
    result = StudyResult.load(results, "dancing_character")
    surfaces, motions = scene(result)
    times = result.arrays["times"]
    views = []
    for still in STILLS:
        frame = int(np.argmin(np.abs(times - min(still, still / STILLS[-1] * times[-1]))))
        posed = [
            surface if motion is None else replace(surface, vertices=motion[frame])
            for surface, motion in zip(surfaces, motions, strict=True)
        ]
        views.append(View(posed, title=f"t = {times[frame]:.2f} s", camera=CAMERA))
    rows = result.findings["rows"]
    vertices, residual = sum(row["vertices"] for row in rows), max(row["position_residual"] for row in rows)
    title = (
        f"{len(result.findings['joints'])} joints, {len(rows)} shells, {vertices:,} vertices: "
        f"MWTS under constraints, met within {residual:.0e} m"
    )
    picture = draw_views(views, folder / "figure_8.png", columns=3, size=(1800, 1760), title=title)
    film = write_film(folder / "figure_8.mp4", surfaces, motions, fps=30.0, camera=CAMERA, size=(560, 720))
    return [picture, film]


def scene(result: StudyResult) -> tuple[list[ShadedSurface], list[NDArray[np.float64] | None]]:
    """Floor, shadow, body and shells; and how each moves."""
    arrays = result.arrays
    parts: list[tuple[str, NDArray[np.float64], NDArray[np.int64]]] = [
        (color, arrays[f"{name}_positions"].astype(np.float64), arrays[f"{name}_faces"].astype(np.int64))
        for name, color in COLORS.items()
    ]
    parts += [(color, motion, faces) for color, (motion, faces) in body(result).items()]
    shadow = np.concatenate([motion for _, motion, _ in parts], axis=1)
    starts = np.cumsum([0, *(motion.shape[1] for _, motion, _ in parts)])
    shade = np.concatenate([faces + start for (_, _, faces), start in zip(parts, starts, strict=False)])
    shadow = shadow - shadow[..., 2:] / LIGHT[2] * LIGHT
    # What falls beside the floor is drawn in to its rim.
    away = np.linalg.norm(shadow[..., :2], axis=2, keepdims=True)
    shadow *= np.minimum(1.0, 0.995 * STAGE / np.maximum(away, 1e-9))
    shadow[..., 2] = 0.002
    floor, rings = stage()
    surfaces = [
        ShadedSurface(*floor, "#fffdf6"),
        ShadedSurface(*rings, "#cfcabd", style="outline"),
        ShadedSurface(shadow[0], shade, "#bdb8ad", lined=False),
    ]
    surfaces += [ShadedSurface(motion[0], faces, color, smooth=True) for color, motion, faces in parts]
    return surfaces, [None, None, shadow, *(motion for _, motion, _ in parts)]


def body(result: StudyResult) -> dict[str, tuple[NDArray[np.float64], NDArray[np.int64]]]:
    """The rigid parts of each colour: positions in every frame, and faces."""
    names = result.findings["joints"]
    places = dict(zip(names, np.moveaxis(result.arrays["joints"], 1, 0), strict=True))
    turns = dict(zip(names, np.moveaxis(result.arrays["turns"], 1, 0), strict=True))
    pieces = [*BODY, *head()]
    for color, joint, (start, end, radii) in LIMBS:
        pieces.append((color, joint, rod(start, end, radii)))
        mirror = np.array([-1.0, 1.0, 1.0])
        pieces.append((color, joint.replace("left", "right"), rod(mirror * start, mirror * end, radii)))
    rest = dict(zip(names, result.arrays["rest_joints"], strict=True))
    gathered: dict[str, list[tuple[NDArray[np.float64], NDArray[np.int64]]]] = {}
    for color, joint, (vertices, faces) in pieces:
        turned = Rotation.from_rotvec(turns[joint]).as_matrix()
        motion = np.einsum("fij,nj->fni", turned, vertices - rest[joint]) + places[joint][:, None]
        gathered.setdefault(color, []).append((motion, faces))
    joined_parts = {}
    for color, group in gathered.items():
        starts = np.cumsum([0, *(motion.shape[1] for motion, _ in group)])
        faces = np.concatenate([faces + start for (_, faces), start in zip(group, starts, strict=False)])
        joined_parts[color] = (np.concatenate([motion for motion, _ in group], axis=1), faces)
    return joined_parts


def stage() -> tuple[GlyphMesh, GlyphMesh]:
    """A round floor, and rings on it, drawn by their borders."""
    angles = np.linspace(0.0, 2.0 * np.pi, 97)[:-1]
    circle = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(96)])
    fan = np.column_stack([np.full(96, 96), np.arange(96), (np.arange(96) + 1) % 96])
    disc = (np.vstack([STAGE * circle, np.zeros((1, 3))]), fan)
    raised = np.array([0.0, 0.0, 0.001])
    rings = [(np.vstack([share * STAGE * circle, np.zeros((1, 3))]) + raised, fan) for share in (0.25, 0.5, 0.75)]
    return disc, joined(rings)
