"""Files of trained hybrids, and the shells that they are made of."""

from __future__ import annotations

import os

import numpy as np

from modalshell.core.checks import LARGEST, checked_kind
from modalshell.core.errors import OptionError, SupportError
from modalshell.core.typing import Array
from modalshell.files.archive import Archive, Field
from modalshell.files.atomic_io import write_npz
from modalshell.models.hybrid.assumed_stress import measures_of
from modalshell.models.hybrid.coarse_states import flying_frames
from modalshell.models.hybrid.training import Trained
from modalshell.shell import Shell
from modalshell.shell.split_fold_energy import SplitFoldEnergy

_HYBRID = Archive(
    "a trained hybrid",
    "modalshell_hybrid",
    {
        "basis": Field("f", ("N", "m"), "1/sqrt(kg)"),
        "stresses": Field("f", ("e", "K")),
        "held_out_error": Field("f", (), ""),
        "strain_limit": Field("f", (), ""),
        "energy": Field("f", (), "J"),
        "description": Field("U"),
        "coarse_errors": Field("f", ("c", 2), ""),
        "turned": Field("iu", ("t",)),
        "rest": Field("f", ("n", 3), "m"),
        "faces": Field("iu", ("T", 3)),
        "held": Field("b", ("n",)),
        "quotients": Field("f", (2, "m")),
    },
    most=LARGEST,
    version=4,
)
_OF_SHELL = "rest", "faces", "held", "quotients"
"""What tells the coarse shell."""
_SAME = 1e-4
"""Relative difference up to which quotients are equal: those of thin sheets keep no more digits."""


def trainable(coarse: Shell) -> Shell:
    """``coarse`` itself; an error if no hybrid can be made of it."""
    checked_kind("coarse", coarse, Shell)
    folded = isinstance(coarse.elastic_energy, SplitFoldEnergy)
    if coarse.energies or not (folded or len(coarse.elements) == 3):
        raise OptionError("the hybrid rung knows the energies of a material alone: leave the further energies out")
    coarse.refuse_creases_in("the hybrid rung")
    if coarse.stressed:
        raise OptionError(
            "the hybrid rung knows no rest shape other than the mesh's: leave prestrain, rest_curvature, "
            "temperature and rest out, or take coarse-ds or ds"
        )
    if folded and any(support.mirror() is not None for support in coarse.supports):
        raise SupportError(
            "the hybrid rung takes no planes of symmetry of a shell of split folds (got one): take a mesh of the "
            "whole surface"
        )
    if coarse.has_dashpots:
        raise OptionError("the hybrid rung knows no dashpots: leave the viscosities of elements out")
    flying_frames(coarse)  # refuses what is held in part
    return coarse


def write_trained(path: str | os.PathLike[str], trained: Trained, coarse: Shell) -> None:
    """Write what was trained on a coarse shell to an ``.npz`` file (no pickle)."""
    values = {name: getattr(trained, name) for name in _HYBRID.fields if name not in _OF_SHELL}
    still = {"rest": coarse.rest_positions, "faces": coarse.mesh.faces, "held": coarse.clamped}
    write_npz(path, **_HYBRID.arrays(values | still | {"quotients": _quotients(coarse, trained.basis)}))


def read_trained(path: str | os.PathLike[str], coarse: Shell) -> Trained:
    """What :func:`write_trained` wrote for the same shell; FileFormatError if it is damaged or of another."""
    with _HYBRID.read(path) as data:
        same = np.array_equal(data["rest"], coarse.rest_positions) and np.array_equal(data["faces"], coarse.mesh.faces)
        if not same or not np.array_equal(data["held"], coarse.clamped):
            raise ValueError("it was trained on another coarse shell")
        turned = data["turned"]
        if turned.min(initial=0) < 0:
            raise ValueError(f"turned must be numbers of folds from 0 on (got {turned.min()})")
        size = measures_of(coarse, turned).state_size  # an IndexError where there are fewer folds
        if len(data["basis"]) != coarse.rest_positions.size or len(data["stresses"]) != size:
            raise ValueError(f"its stresses are of {len(data['stresses'])} numbers, those of this shell of {size}")
        if not np.allclose(_quotients(coarse, data["basis"]), data["quotients"], rtol=_SAME, atol=0.0):
            raise ValueError(
                "it was trained on another coarse shell, of this mesh but of another material or other supports: train "
                "one on this shell (HybridStress.trained)"
            )
        arrays = data["basis"], data["stresses"]
        numbers = float(data["held_out_error"]), float(data["strain_limit"]), float(data["energy"])
        return Trained(*arrays, *numbers, str(data["description"]), data["coarse_errors"], turned)


def _quotients(coarse: Shell, basis: Array) -> Array:
    """Stiffness at rest and mass of each vector of the basis (2, m): they tell the material and the supports."""
    vectors = basis.reshape(coarse.rest_positions.size, -1)
    stiffness = coarse.stiffness(coarse.rest_positions) @ vectors
    return np.array([(vectors * stiffness).sum(axis=0), np.repeat(coarse.mass, 3) @ vectors**2])
