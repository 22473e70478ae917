"""USD files of a mesh with time-sampled points, in the unit of length and with the axis up that they name."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from modalshell.core.typing import Array, Progress, unheard
from modalshell.export.near_origin import centred
from modalshell.files.atomic_io import replacing
from modalshell.motion import Trajectory

RATE = 24.0
"""Frames, and time codes, a second: what programs play that do not take the rate from the file, as Blender.

Frames of the motion lie between whole time codes, where they have their own times; players interpolate.
"""


def save_usd(run: Trajectory, path: Path, on_frame: Progress = unheard, up: Literal["y", "z"] = "z") -> Path:
    """Write a USD stage (``.usdc`` binary, ``.usda`` text) with the mesh ``/Shell``, at real speed.

    Positions of the run, whose z points up, are turned so that the axis ``up`` of the file does.
    """
    from pxr import Tf

    with replacing(path) as temporary:
        try:
            _write_stage(*centred(run), temporary, on_frame, up)
        except Tf.ErrorException as error:
            raise OSError("USD could not write it: is there room in its folder?") from error
    return path


def _write_stage(run: Trajectory, centre: Array, file: Path, on_frame: Progress, up: str) -> None:
    """Write the stage of a run that lies about the origin, moved by ``centre`` (3,) [m]."""
    from pxr import Gf, Usd, UsdGeom, Vt

    times = run.units.seconds * run.times
    order, signs = ([0, 2, 1], [1.0, 1.0, -1.0]) if up == "y" else ([0, 1, 2], [1.0, 1.0, 1.0])
    stage = Usd.Stage.CreateNew(str(file))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y if up == "y" else UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, run.units.metres)
    stage.SetTimeCodesPerSecond(RATE)
    stage.SetFramesPerSecond(RATE)
    stage.SetStartTimeCode(float(times[0]) * RATE)
    stage.SetEndTimeCode(float(times[-1]) * RATE)
    shell = UsdGeom.Mesh.Define(stage, "/Shell")
    stage.SetDefaultPrim(shell.GetPrim())
    if centre.any():
        shell.AddTranslateOp().Set(Gf.Vec3d(*map(float, centre[order] * signs)))
    shell.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    shell.CreateDoubleSidedAttr(True)
    shell.CreateFaceVertexCountsAttr(Vt.IntArray(len(run.faces), 3))
    shell.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(run.faces.astype(np.int32).ravel()))
    points, extent = shell.CreatePointsAttr(), shell.CreateExtentAttr()
    for index, time in enumerate(times):
        frame = np.ascontiguousarray(run.positions[index][:, order] * signs, dtype=np.float32)
        code = float(time) * RATE
        points.Set(Vt.Vec3fArray.FromNumpy(frame), code)
        corners = [Gf.Vec3f(*map(float, corner)) for corner in (frame.min(axis=0), frame.max(axis=0))]
        extent.Set(Vt.Vec3fArray(corners), code)
        on_frame(index + 1, len(run.times))
    stage.GetRootLayer().Save()
