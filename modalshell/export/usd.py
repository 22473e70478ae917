"""USD files of a mesh with time-sampled points, in the unit of length that they name, z up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modalshell.core.typing import Progress
from modalshell.export.near_origin import centred
from modalshell.files.atomic_io import replacing
from modalshell.motion import Trajectory

_RATE = 30.0
"""Time codes a second of a single frame."""


def save_usd(run: Trajectory, path: Path, on_frame: Progress | None = None) -> Path:
    """Write a USD stage (``.usdc`` binary, ``.usda`` text) with the mesh ``/Shell``."""
    from pxr import Gf, Usd, UsdGeom, Vt

    run, centre = centred(run)
    times = run.units.seconds * run.times
    steps = np.diff(times)
    rate = float(1.0 / steps[0]) if len(steps) else _RATE
    with replacing(path) as temporary:
        stage = Usd.Stage.CreateNew(str(temporary))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, run.units.metres)
        stage.SetTimeCodesPerSecond(rate)
        stage.SetFramesPerSecond(rate)
        stage.SetStartTimeCode(float(times[0]) * rate)
        stage.SetEndTimeCode(float(times[-1]) * rate)
        shell = UsdGeom.Mesh.Define(stage, "/Shell")
        stage.SetDefaultPrim(shell.GetPrim())
        if centre.any():
            shell.AddTranslateOp().Set(Gf.Vec3d(*map(float, centre)))
        shell.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        shell.CreateDoubleSidedAttr(True)
        shell.CreateFaceVertexCountsAttr(Vt.IntArray(len(run.faces), 3))
        shell.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(run.faces.astype(np.int32).ravel()))
        points, extent = shell.CreatePointsAttr(), shell.CreateExtentAttr()
        for index, time in enumerate(times):
            frame = np.ascontiguousarray(run.positions[index], dtype=np.float32)
            code = float(time) * rate
            points.Set(Vt.Vec3fArray.FromNumpy(frame), code)
            corners = [Gf.Vec3f(*map(float, corner)) for corner in (frame.min(axis=0), frame.max(axis=0))]
            extent.Set(Vt.Vec3fArray(corners), code)
            if on_frame is not None:
                on_frame(index + 1, len(run.times))
        stage.GetRootLayer().Save()
        del stage
    return path
