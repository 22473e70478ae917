"""Triangle meshes: the data structure, its validation, files and parametric shapes."""

from modalshell.mesh.files import load_mesh, save_mesh
from modalshell.mesh.remesh import remesh
from modalshell.mesh.repair import RepairReport, repair
from modalshell.mesh.shapes import cylinder_panel, flat_beam, leaf, paper_bird, sheet, v_beam
from modalshell.mesh.triangle_mesh import TriangleMesh

__all__ = [
    "RepairReport",
    "TriangleMesh",
    "cylinder_panel",
    "flat_beam",
    "leaf",
    "load_mesh",
    "paper_bird",
    "remesh",
    "repair",
    "save_mesh",
    "sheet",
    "v_beam",
]
