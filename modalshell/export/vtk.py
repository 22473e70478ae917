"""Trajectories for ParaView and other VTK readers: one temporal VTKHDF file, or a PVD collection of VTP files."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modalshell.core.errors import FileFormatError
from modalshell.core.typing import Progress, unheard
from modalshell.export.frame_arrays import of_triangles, of_vertices
from modalshell.files.atomic_io import replacing, write_text
from modalshell.motion import Trajectory

_CHUNK = 25_000
"""Points or triangles of a chunk at most, as VTK has them."""
_ROOM = 65536
"""Bytes that must be free once a file is closed."""


def save_vtkhdf(run: Trajectory, path: Path, on_frame: Progress = unheard) -> Path:
    """Write one temporal VTKHDF file, frame by frame; VTK rounds its times to float32."""
    from vtkmodules.util.vtkAlgorithm import VTKPythonAlgorithmBase
    from vtkmodules.vtkCommonDataModel import vtkPolyData
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline as Pipeline
    from vtkmodules.vtkIOHDF import vtkHDFWriter

    cells = _cells(run)
    times = [float(time) for time in run.times]
    stops: list[BaseException] = []

    class Frames(VTKPythonAlgorithmBase):
        """Hands the writer the frame of the time that it asks for."""

        def __init__(self) -> None:
            super().__init__(nInputPorts=0, nOutputPorts=1, outputType="vtkPolyData")  # type: ignore[no-untyped-call]

        def RequestInformation(self, _request: Any, _inputs: Any, outputs: Any) -> int:
            info = outputs.GetInformationObject(0)
            info.Set(Pipeline.TIME_STEPS(), times, len(times))
            info.Set(Pipeline.TIME_RANGE(), [times[0], times[-1]], 2)
            return 1

        def RequestData(self, _request: Any, _inputs: Any, outputs: Any) -> int:
            info = outputs.GetInformationObject(0)
            asked = info.Get(Pipeline.UPDATE_TIME_STEP()) if info.Has(Pipeline.UPDATE_TIME_STEP()) else times[0]
            index = int(np.argmin(np.abs(run.times - asked)))
            surface = vtkPolyData.GetData(outputs)
            _fill_surface(surface, cells, run, index)
            surface.GetInformation().Set(surface.DATA_TIME_STEP(), times[index])
            if not stops:
                try:
                    on_frame(index + 1, len(times))
                except BaseException as stop:  # VTK would swallow it, and asks on for ever where a frame fails
                    stops.append(stop)
            return 1

    frames = Frames()
    with replacing(path) as temporary:
        writer = vtkHDFWriter()
        writer.SetInputConnection(frames.GetOutputPort())
        writer.SetFileName(str(temporary))
        writer.SetWriteAllTimeSteps(True)
        # Files consist of whole chunks: of VTK's own size, a small run would take megabytes.
        writer.SetChunkSize(min(_CHUNK, max(run.positions.shape[1], len(run.faces))))
        if not writer.Write() or not temporary.exists():
            raise FileFormatError(f"VTK could not write {path}: is there room in its folder?")
        del writer  # closes the file
        with open(temporary, "r+b") as file:  # HDF5 is silent where a disk is full at its close: nothing more fits then
            size = file.seek(0, os.SEEK_END)
            file.write(bytes(_ROOM))
            os.fsync(file.fileno())
            file.truncate(size)
        if stops:
            raise stops[0]
    return path


def save_pvd(run: Trajectory, path: Path, on_frame: Progress = unheard) -> Path:
    """Write ``NAME.pvd`` and, in the folder ``NAME_frames``, one VTP file a frame."""
    from xml.sax.saxutils import quoteattr  # loads what reads addresses of the web: not before it is needed

    from vtkmodules.vtkCommonDataModel import vtkPolyData
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    folder = path.with_name(f"{path.stem}_frames")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part_frames")
    cells = _cells(run)
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="0.1">', "<Collection>"]
    try:
        temporary.mkdir(parents=True)
        for index, time in enumerate(run.times):
            surface = vtkPolyData()
            _fill_surface(surface, cells, run, index)
            writer = vtkXMLPolyDataWriter()
            writer.SetInputData(surface)
            writer.SetFileName(str(temporary / f"{index:06d}.vtp"))
            if not writer.Write():
                raise FileFormatError(f"VTK could not write the frames of {path}: is there room in its folder?")
            name = quoteattr(f"{folder.name}/{index:06d}.vtp")
            lines.append(f'<DataSet timestep="{float(time)!r}" part="0" file={name}/>')
            on_frame(index + 1, len(run.times))
        # The collection comes last and goes first, so that it never names frames of two runs.
        others = [file.name for file in folder.glob("*") if not re.fullmatch(r"\d{6}\.vtp", file.name)]
        if others:
            raise FileFormatError(f"{folder} holds {others[0]!r}, which is none of a run's frames: give another name")
        path.unlink(missing_ok=True)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(temporary, folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return write_text(path, "\n".join([*lines, "</Collection>", "</VTKFile>", ""]))


def _fill_surface(surface: Any, cells: Any, run: Trajectory, index: int) -> None:
    """A frame's positions and triangles, and what is known of its vertices and triangles, with units.

    VTK's XML files keep units as information of an array; VTKHDF files keep no such information, so that both name them
    in field data too, as ``NAME_unit``.
    """
    from vtkmodules.vtkCommonCore import vtkDataArray, vtkPoints, vtkStringArray

    points = vtkPoints()
    points.SetData(_vtk_array(run.positions[index]))
    surface.SetPoints(points)
    surface.SetPolys(cells)
    arrays = [(array, surface.GetPointData()) for array in of_vertices(run, index)]
    arrays += [(array, surface.GetCellData()) for array in of_triangles(run, index)]
    for known, attributes in arrays:
        array = _vtk_array(known.values)
        array.SetName(known.name)
        for number, component in enumerate(known.components):
            array.SetComponentName(number, component)
        array.GetInformation().Set(vtkDataArray.UNITS_LABEL(), known.unit)
        attributes.AddArray(array)
        label = vtkStringArray()
        label.SetName(f"{known.name}_unit")
        label.InsertNextValue(known.unit or "1")
        surface.GetFieldData().AddArray(label)
    surface.GetPointData().SetActiveVectors("displacement")


def _cells(run: Trajectory) -> Any:
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    cells = vtkCellArray()
    cells.SetData(3, _vtk_array(run.faces.astype(np.int64).ravel()))
    return cells


def _vtk_array(values: NDArray[Any]) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtk

    return numpy_to_vtk(np.ascontiguousarray(values), deep=True)  # type: ignore[no-untyped-call]
