"""Registry of models: one record per model, used by scenes, comparisons, viewer, pictures and studies."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from types import MappingProxyType
from typing import Literal, final, get_args

from modalshell.core.errors import OptionError
from modalshell.core.registry import Registry, load_features, load_plugins
from modalshell.core.typing import Array
from modalshell.models.auto.auto import Auto
from modalshell.models.base.model import Model
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.models.hybrid_stress import HybridStress
from modalshell.models.linear import LinearModal
from modalshell.models.modal_derivatives import ModalDerivatives
from modalshell.models.reduced_rotation_strain import trained_on_loads
from modalshell.models.rigid import RigidShell
from modalshell.models.rotation_strain import RotationStrain
from modalshell.models.warping import ModalWarping, consistent_warping
from modalshell.shell import Shell

Needs = Literal["shell", "basis", "training", "coarse mesh", "coarse training"]
Response = Literal["rigid", "linear", "nonlinear"]
_GIVEN: dict[Needs, int] = {"shell": 1, "basis": 1, "training": 2, "coarse mesh": 2, "coarse training": 3}
_KEY = "[a-z][a-z0-9-]*"


@final
@dataclass(frozen=True)
class ModelSpec:
    """What the package knows of a model.

    Attributes
    ----------
    key : str
        Its name in scenes and on the command line: lower-case letters, digits and hyphens.
    name : str
        Its name in tables and legends.
    builder : callable
        Makes the model from what it ``needs``, in this order: the shell; a basis; a basis and loads (k, n, 3) [N] to
        train on; the shell and the same surface as a coarse shell; the same with a load (n, 3) [N] to train on.
        Its further parameters are the keys of a scene's ``[model]`` table, with their types and defaults, as
        far as TOML can state them. A parameter ``count`` of modes is the key ``modes``; models on a basis have
        that key too.
    needs : {"shell", "basis", "training", "coarse mesh", "coarse training"}
        What the builder takes.
    cost : float
        Cost class: place on the ladder, cheapest and simplest first. DS has 100.
    quadratic : bool
        Whether the elastic energy is quadratic in modes about rest, so that the model knows no snap.
    constraints : bool
        Whether it takes position and orientation constraints.
    color, marker : str
        Of its lines and points in pictures (matplotlib).
    most_modes : int or None
        Largest mode count that the ladder tries.
    pictured : bool
        Whether pictures of shapes show it; not where its shape is that of another model.
    response : {"rigid", "linear", "nonlinear"}
        How it answers a load: without deformation, in proportion to the load, or otherwise.
    bends : bool
        Whether a flat shell has bending stiffness at small angles; springs across hinges have none.
    on_ladder : bool
        Whether comparisons of all models take it; not where it stands for several.
    """

    key: str
    name: str
    builder: Callable[..., Model]
    needs: Needs
    cost: float
    _: KW_ONLY
    quadratic: bool = False
    constraints: bool = False
    color: str = "0.5"
    marker: str = "h"
    most_modes: int | None = None
    pictured: bool = True
    response: Response = "nonlinear"
    bends: bool = True
    on_ladder: bool = True

    @property
    def given(self) -> int:
        """Number of leading parameters of the builder that the model needs."""
        return _GIVEN[self.needs]

    @property
    def on_coarse_mesh(self) -> bool:
        """Whether it needs a coarse shell."""
        return self.needs in ("coarse mesh", "coarse training")

    @property
    def on_modes(self) -> bool:
        """Whether it is built on a basis that the caller solves."""
        return self.needs in ("basis", "training")


MODELS: Registry[ModelSpec] = Registry("model")
"""Every model that is registered, by its key; :func:`models` also looks for those of other packages."""
TRUTH = "ds"
"""Key of the reference model."""


def register(spec: ModelSpec) -> ModelSpec:
    """Add a model to the registry; another package calls this in the module that its entry point names.

    OptionError for a key or name that is taken or invalid; see :class:`ModelSpec`.
    """
    if not re.fullmatch(_KEY, spec.key):
        raise OptionError(f"key must be lower-case letters, digits and hyphens, a letter first (got {spec.key!r:.60})")
    if spec.needs not in get_args(Needs):
        raise OptionError(f"needs must be one of {', '.join(get_args(Needs))} (got {spec.needs!r:.60})")
    for other in MODELS.values():
        if spec.name == other.name and spec.key != other.key:
            raise OptionError(f"model {other.key!r} is named {other.name!r} already: give {spec.key!r} another name")
    MODELS[spec.key] = spec
    return spec


def models() -> Mapping[str, ModelSpec]:
    """Every model by its key, cheapest first, those of installed packages included; see :class:`ModelSpec`."""
    load_features()
    load_plugins()
    return MappingProxyType({spec.key: spec for spec in sorted(MODELS.values(), key=lambda spec: spec.cost)})


def trained_on_load(
    shell: Shell, coarse: Shell, load: Array, *, modes: int | None = None, motions: int | None = None, seed: int = 0,
    error: float | None = None, integrator: str = "bdf2",
) -> HybridStress:  # fmt: skip
    """The rung trained about a load (n, 3) [N]; see :meth:`HybridStress.trained`."""
    return HybridStress.trained(
        shell, force=load, coarse=coarse, modes=modes, motions=motions, seed=seed, error=error, integrator=integrator
    )


for _spec in (
    ModelSpec("rigid", "rigid", RigidShell, "shell", 0, color="#777777", marker="X", pictured=False, response="rigid"),
    ModelSpec(
        "lma", "LMA", LinearModal, "basis", 10, quadratic=True, constraints=True, color="#c8322b", marker="o",
        response="linear",
    ),
    ModelSpec("mwts", "MWTS", ModalWarping, "basis", 20, quadratic=True, constraints=True, color="#2b5fc8", marker="s"),
    ModelSpec(
        "mwts-consistent", "MWTS, consistent", consistent_warping, "basis", 30, quadratic=True, constraints=True,
        color="#7fa8ee", marker="D", pictured=False,
    ),
    ModelSpec(
        "reduced-rsw", "reduced RSW", trained_on_loads, "training", 40, quadratic=True, constraints=True,
        color="#c77cd6", marker="v", pictured=False,
    ),
    ModelSpec("rsw", "RSW", RotationStrain, "basis", 50, quadratic=True, constraints=True, color="#7b2d8e", marker="^"),
    ModelSpec("md-rom", "MD-ROM", ModalDerivatives, "shell", 60, color="#d98200", marker="P", most_modes=8),
    ModelSpec("hybrid", "hybrid", trained_on_load, "coarse training", 65, color="#e7298a", marker="p"),
    ModelSpec("coarse-ds", "coarse DS", CoarseDiscreteShell, "coarse mesh", 70, color="#66c2a5"),
    ModelSpec(
        "auto", "auto", Auto, "shell", 80, constraints=True, color="#8c6d1f", marker="*", pictured=False,
        on_ladder=False,
    ),
    ModelSpec(TRUTH, "DS", DiscreteShell, "shell", 100, constraints=True, color="#2f9e44"),
):  # fmt: skip
    register(_spec)
