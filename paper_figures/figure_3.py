"""Paper Fig. 3: snapshots and a film of the creature on moving ground (reads the study ``large_mesh``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.files.study_result import StudyResult
from modalshell.render import ShadedSurface, View, draw_views, write_film

COLOR = "#7fae72"
CAMERA = (0.5, -1.0, 0.3)
SNAPSHOTS = 6


def draw(results: Path, folder: Path) -> list[Path]:
    """Draw from the result in ``results`` into ``folder``; return the paths of the PNG and the MP4."""
    result = StudyResult.load(results, "large_mesh")
    positions, faces, times = result.arrays["positions"], result.arrays["faces"], result.arrays["times"]
    rest = result.arrays["rest"]
    # The frames that differ most from those before them, in order: the liveliest ones.
    chosen = [0]
    shapes = positions - positions.mean(axis=1, keepdims=True)
    while len(chosen) < min(SNAPSHOTS, len(times)):
        apart = [min(float(np.abs(shapes[k] - shapes[c]).mean()) for c in chosen) for k in range(len(times))]
        chosen.append(int(np.argmax(apart)))
    views = []
    for frame in sorted(chosen):
        # Each view stands where the feet are, so that the shapes can be compared.
        feet = rest[:, 2] < 1e-6
        ground = positions[frame][feet].mean(axis=0) - rest[feet].mean(axis=0)
        surface = ShadedSurface(positions[frame] - ground, faces, color=COLOR, smooth=True)
        views.append(View([surface], title=f"t = {times[frame]:.2f} s", camera=CAMERA))
    found = result.findings
    title = f"{found['vertices']:,} vertices, {found['modes']} modes, MWTS, supports moved unevenly"
    picture = draw_views(views, folder / "figure_3.png", columns=3, size=(1800, 1150), title=title)
    surface = ShadedSurface(positions[0], faces, color=COLOR, smooth=True)
    film = write_film(folder / "figure_3.mp4", [surface], [positions], camera=CAMERA, size=(960, 640))
    return [picture, film]
