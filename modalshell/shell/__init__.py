"""Thin shells: materials, supports, their elastic energies over the generated kernels, and the assembly."""

from modalshell.shell.cards import card, cards
from modalshell.shell.creases import Crease, CreaseState
from modalshell.shell.elastic_energy import EXACT, GAUSS_NEWTON, MIXED, PROJECTED
from modalshell.shell.fabric import Fabric
from modalshell.shell.fields import ShellFields
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.laminate import Laminate, Ply
from modalshell.shell.material import Material
from modalshell.shell.orthotropic import Orthotropic
from modalshell.shell.rest_shape import Temperature
from modalshell.shell.sheet import Sheet
from modalshell.shell.shell import Shell

__all__ = [
    "EXACT",
    "GAUSS_NEWTON",
    "MIXED",
    "PROJECTED",
    "Crease",
    "CreaseState",
    "Fabric",
    "Isotropic",
    "Laminate",
    "Material",
    "Orthotropic",
    "Ply",
    "Sheet",
    "Shell",
    "ShellFields",
    "Temperature",
    "card",
    "cards",
]
