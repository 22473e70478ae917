"""A basis for other programs: arrays in an NPZ file, and a JSON file that describes them.

No public format of modal bodies serves several engines: Newton 1.8 has no such bodies, Chrono reduces assemblies of
its own, and OpenFAST reads superelements of Craig-Bampton matrices about the motions of one interface. The
layout holds what a floating frame of reference needs [shabana2020]: lumped masses, mass-orthonormal modes with their
rotations, and the constant integrals that couple them with rigid motion. ``studies/tutorials/other_engines.py`` reads
it back and moves it by NumPy alone and in Newton.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np

from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError
from modalshell.files.atomic_io import write_npz, write_text
from modalshell.modes import Basis

LAYOUT = "modalshell modal body, version 1"
_ARRAYS = {
    "vertices": "(n, 3) positions at rest [m]",
    "faces": "(T, 3) triangles, counted from 0",
    "masses": "(n,) lumped masses [kg]; their sum is the body's mass",
    "held": "(n,) whether a vertex is held by supports",
    "modes": "(m, n, 3) displacement fields phi_i, sum_v m_v phi_i . phi_j = 1 if i = j else 0 [1/sqrt(kg)]",
    "rotations": "(m, n, 3) rotation vectors of the vertices in each mode [rad / (m sqrt(kg))]",
    "eigenvalues": "(m,) squared angular frequencies lambda [1/s^2]: q'' + lambda q = phi . f; 0 for rigid motions",
    "frequencies": "(m,) natural frequencies [Hz]",
    "centre": "(3,) centre of mass [m]",
    "inertia": "(3, 3) inertia about the centre [kg m^2]",
    "translation": "(m, 3) sum_v m_v phi_i [sqrt(kg)]",
    "rotation": "(m, 3) sum_v m_v (x_v - centre) x phi_i [m sqrt(kg)]",
}


def save_modal_body(basis: Basis, path: str | os.PathLike[str]) -> list[Path]:
    """Write a basis to an NPZ file ``path``, with a JSON file of its name that has the layout, units and every array.

    OptionError if the file's name does not end in ``.npz``.
    """
    checked_kind("basis", basis, Basis)
    target = Path(path)
    if target.suffix != ".npz":
        raise OptionError(f"path must end in .npz (got {target.name!r})")
    shell, masses = basis.shell, basis.shell.mass
    x = shell.rest_positions
    modes, rotations = (np.moveaxis(each.reshape(*x.shape, -1), 2, 0) for each in (basis.modes, basis.rotations))
    centre = masses @ x / masses.sum()
    arms = x - centre
    squares = np.einsum("v,vi,vj->ij", masses, arms, arms)
    arrays = {
        "vertices": x,
        "faces": np.asarray(shell.mesh.faces),
        "masses": masses,
        "held": shell.clamped,
        "modes": modes,
        "rotations": rotations,
        "eigenvalues": basis.eigenvalues,
        "frequencies": basis.frequencies,
        "centre": centre,
        "inertia": np.trace(squares) * np.eye(3) - squares,
        "translation": np.einsum("v,mvi->mi", masses, modes),
        "rotation": np.einsum("v,mvi->mi", masses, np.cross(arms, modes)),
    }
    document = {
        "layout": LAYOUT,
        "units": {"length": "m", "mass": "kg", "time": "s"},
        "file": target.name,
        "modes": basis.count,
        "rigid_modes": basis.rigid_modes,
        "mass": float(masses.sum()),
        "arrays": {name: {"shape": list(arrays[name].shape), "is": meaning} for name, meaning in _ARRAYS.items()},
    }
    written = [write_npz(target, **arrays)]
    return [*written, write_text(target.with_suffix(".json"), json.dumps(document, indent=1) + "\n")]
