"""Thin shells from modal warping to discrete shells, and what each bit of accuracy costs."""

from modalshell.mesh import TriangleMesh, cylinder_panel, flat_beam, leaf, load_mesh, save_mesh, sheet, v_beam
from modalshell.modes import Basis, solve_modes
from modalshell.rungs import DiscreteShell, LinearModal, ModalWarping
from modalshell.shell import Material, Shell
