"""Model factory: builds models from their records and shares bases, training loads and coarse meshes among them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np

from modalshell.core.errors import OptionError
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array
from modalshell.models.base.model import Model
from modalshell.models.coarse.coarse_shell import CoarseMesh, coarse_shell, remeshed
from modalshell.models.registry import ModelSpec
from modalshell.modes import Basis, model_basis
from modalshell.shell import Shell

SolveModes = Callable[[Shell, int], Basis]
"""Gives the basis of a shell with a number of modes."""
MODE_COUNT = 8
"""Number of modes where none is named."""
TRAINING_SHARES = (0.2, 0.4, 0.6, 0.8, 1.0)
"""Shares of the load that models are trained on."""


@final
class FirstModes:
    """Solves the lowest modes of one shell: cuts them from the largest basis that is ``known`` so far."""

    def __init__(self, known: Basis | None = None) -> None:
        self.known = known

    def __call__(self, shell: Shell, count: int) -> Basis:
        """The basis of the lowest modes."""
        if self.known is None or self.known.count < count:
            self.known = model_basis(shell, count)
        whole = self.known
        return dataclasses.replace(
            whole,
            eigenvalues=whole.eigenvalues[:count],
            modes=np.ascontiguousarray(whole.modes[:, :count]),
            rotations=np.ascontiguousarray(whole.rotations[:, :count]),
            rigid_modes=min(whole.rigid_modes, count),
        )


@final
class ModelFactory:
    """Builds registered models on one shell; modes are solved once, and their time is charged to all who use them.

    Parameters
    ----------
    shell : Shell
        The shell.
    load : callable, optional
        Returns the whole load (n, 3) [N], fractions of which models are trained on.
    coarse : callable, optional
        Returns a coarse mesh of the shell's surface with these cells along and across, or about this many triangles, or
        by default for None of both. Without it a number of triangles is remeshed (extra ``remesh``).
    solve : callable, optional
        Returns the basis of a shell with a number of modes; :func:`~modalshell.modes.model_basis` by default.
    """

    def __init__(
        self,
        shell: Shell,
        load: Callable[[], Array] | None = None,
        coarse: Callable[[tuple[int, int] | None, int | None], CoarseMesh] | None = None,
        solve: SolveModes | None = None,
    ) -> None:
        self.shell = shell
        self._load, self._coarse, self._solve = load, coarse, solve or model_basis
        self.bases: dict[int, Basis] = {}
        self._seconds: dict[int, float] = {}
        self._charged = 0.0

    def basis(self, count: int) -> Basis:
        """The lowest ``count`` modes."""
        if count in self.bases:
            self._charged += self._seconds[count]
        else:
            watch = Stopwatch()
            self.bases[count], self._seconds[count] = self._solve(self.shell, count), watch()
        return self.bases[count]

    def build(self, spec: ModelSpec, options: Mapping[str, Any], coarse: CoarseMesh | None = None) -> Model:
        """The model of a record.

        OptionError for options that the model refuses, or where the load or the coarse mesh that it needs is not to be
        had.

        Parameters
        ----------
        spec : ModelSpec
            The record.
        options : mapping
            Keys of its ``[model]`` table; the others keep their defaults.
        coarse : CoarseMesh, optional
            The mesh of a model that needs a coarse one, in place of the options ``cells`` and ``triangles``.
        """
        rest = dict(options)
        if spec.needs == "shell":
            if "modes" in rest:
                rest["count"] = rest.pop("modes")
            return spec.builder(self.shell, **rest)
        if spec.on_coarse_mesh:
            size = rest.pop("cells", None), rest.pop("triangles", None)
            coarse = coarse or self._coarse_mesh(spec, *size)
            given = self.shell, coarse_shell(self.shell, coarse.mesh, coarse.material)
            if spec.needs == "coarse training":
                return spec.builder(*given, self._training_load(spec), **rest)
            return spec.builder(*given, **rest)
        basis = self.basis(rest.pop("modes", MODE_COUNT))
        if spec.needs == "basis":
            return spec.builder(basis, **rest)
        load = self._training_load(spec)
        return spec.builder(basis, np.array([share * load for share in TRAINING_SHARES]), **rest)

    def _coarse_mesh(self, spec: ModelSpec, cells: tuple[int, int] | None, triangles: int | None) -> CoarseMesh:
        if self._coarse is not None:
            return self._coarse(cells, triangles)
        if triangles is None:
            raise OptionError(f"{spec.name} needs a coarser mesh of the surface: give one, or a number of triangles")
        return remeshed(self.shell, triangles)

    def _training_load(self, spec: ModelSpec) -> Array:
        if self._load is None:
            raise OptionError(f"{spec.name} is trained on the load: give one")
        return self._load()

    def timed(
        self, spec: ModelSpec, options: Mapping[str, Any], coarse: CoarseMesh | None = None
    ) -> tuple[Model, float]:
        """The model of :meth:`build`, and the time to build it alone [s]."""
        self._charged = 0.0
        watch = Stopwatch()
        model = self.build(spec, options, coarse)
        return model, watch() + self._charged
