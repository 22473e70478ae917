"""The discrete-shell energies in a compiled step: their kernels add blocks straight into the profile."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from modalshell.core.typing import Array, Index
from modalshell.kernels.compiler import UNCOUNTED, njit
from modalshell.kernels.read_only import unwritten
from modalshell.linalg import Profile
from modalshell.models.coarse import profile_elasticity as elasticity
from modalshell.models.coarse.profile_elasticity import block_places
from modalshell.models.coarse.profile_hinge_kernels import harden_edges, harden_hinges, harden_triangles
from modalshell.shell import MIXED, Shell
from modalshell.shell.kernels.generated import flexure, shear, stretch
from modalshell.statics.mixed_newton import operation_of

KERNELS = (stretch, shear, flexure)
"""Kernels of the element sets that a shell must have, in this order."""
_LINEARISED = np.int64(MIXED)  # a plain integer is compiled in as a constant

_options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True} | UNCOUNTED


class Elements(NamedTuple):
    """Element sets as the kernels take them, and where their blocks go in the profile."""

    stencils: Index
    rest: Array
    weight: Array
    slots: Index


class Hinges(NamedTuple):
    """Elements of triangles, edges and hinges."""

    triangles: Elements
    edges: Elements
    hinges: Elements

    def room(self) -> Stresses:
        """Room for one step."""
        sizes = [elements.rest.size for elements in self]
        triangles, edges, hinges = map(np.empty, sizes)
        return Stresses(triangles, edges, hinges, np.zeros(max(sizes)))

    @property
    def evaluated(self) -> int:
        """Elements that an evaluation takes."""
        return sum(elements.rest.size for elements in self)

    def damped(self, shell: Shell) -> tuple[Hinges, float]:
        """The energy of a shell of the same elements, of other weights and measures at rest, and its factor."""
        own = zip(self, shell.elements, strict=True)
        return Hinges(*(known._replace(rest=e.rest, weight=e.weight) for known, e in own)), 1.0


class Stresses(NamedTuple):
    """Stresses of the elements, and weights of zero."""

    triangles: Array
    edges: Array
    hinges: Array
    nothing: Array

    def forget(self) -> None:
        """Forget the measures; none are known."""


def hinges_of(shell: Shell, profile: Profile, place: Index) -> Hinges:
    """The energies of a shell whose vertices have the blocks ``place`` (n,) of a profile, -1 of held ones."""

    def elements(index: int) -> Elements:
        given = shell.elements[index]
        of = place[given.stencils]
        slots = block_places(profile, of[:, :, None], of[:, None, :])
        # As a shell's own energy has them, or their kernels would be compiled for another kind of arguments.
        return Elements(given.stencils, given.rest.copy(), given.weight.copy(), slots.astype(np.int32))

    return Hinges(*(elements(index) for index in range(len(KERNELS))))


@operation_of(Hinges, elasticity.assemble, **_options)
def _assemble(elastic, body, room, x):  # type: ignore[no-untyped-def]
    """Write the elastic gradient and Hessian at ``x``, its geometric part with the stresses in ``room``."""
    _add(elastic, body, room, x, elastic.triangles.weight, elastic.edges.weight, elastic.hinges.weight)


@operation_of(Hinges, elasticity.soften, **_options)
def _soften(elastic, body, room, x):  # type: ignore[no-untyped-def]
    """Write the geometric part alone: the rest has weights of zero."""
    nothing = room.elastic.nothing
    _add(elastic, body, room, x, nothing, nothing, nothing)


@njit(**_options)
def _add(elastic, body, room, x, triangles, edges, hinges):  # type: ignore[no-untyped-def]
    """Write the gradient and the Hessian with these weights, its geometric part with the stresses in ``room``."""
    s, x = room.elastic, unwritten(x)
    strides, values, gradient = body.strides, room.values, room.gradient
    values[:] = 0.0
    gradient[:] = 0.0
    t, e, h, kind = elastic.triangles, elastic.edges, elastic.hinges, _LINEARISED
    stretch.add_stiffness(x, t.stencils, t.rest, triangles, s.triangles, kind, t.slots, strides, values, gradient)
    shear.add_stiffness(x, e.stencils, e.rest, edges, s.edges, kind, e.slots, strides, values, gradient)
    flexure.add_stiffness(x, h.stencils, h.rest, hinges, s.hinges, kind, h.slots, strides, values, gradient)


@operation_of(Hinges, elasticity.harden, **_options)
def _harden(elastic, body, room, x):  # type: ignore[no-untyped-def]
    """Write the gradient and the first part of the Hessian at ``x``."""
    matrix, gradient = (room.second, body.strides), room.gradient
    room.second[:] = 0.0
    gradient[:] = 0.0
    t, e, h = elastic.triangles, elastic.edges, elastic.hinges
    harden_triangles(x, (t.stencils, t.weight, t.slots), t.rest, matrix, gradient)
    harden_edges(x, (e.stencils, e.weight, e.slots), e.rest, matrix, gradient)
    harden_hinges(x, (h.stencils, h.weight, h.slots), h.rest, matrix, gradient)


@operation_of(Hinges, elasticity.resist, **_options)
def _resist(elastic, room, x):  # type: ignore[no-untyped-def]
    """Write forces against ``room.step``."""
    forces, step, x = room.gradient, unwritten(room.step), unwritten(x)
    forces[:] = 0.0
    t, e, h = elastic.triangles, elastic.edges, elastic.hinges
    stretch.add_damping(x, step, t.stencils, t.weight, forces)
    shear.add_damping(x, step, e.stencils, e.weight, forces)
    flexure.add_damping(x, step, h.stencils, h.weight, forces)


@operation_of(Hinges, elasticity.energy, **_options)
def _energy(elastic, room, x):  # type: ignore[no-untyped-def]
    """Elastic energy; its gradient goes to ``room``."""
    gradient = room.gradient
    gradient[:] = 0.0
    t, e, h, x = elastic.triangles, elastic.edges, elastic.hinges, unwritten(x)
    return (
        stretch.add_gradient(x, t.stencils, t.rest, t.weight, gradient)
        + shear.add_gradient(x, e.stencils, e.rest, e.weight, gradient)
        + flexure.add_gradient(x, h.stencils, h.rest, h.weight, gradient)
    )


@operation_of(Hinges, elasticity.predict, **_options)
def _predict(elastic, room, x):  # type: ignore[no-untyped-def]
    """Write the stresses after ``room.step``, by the measures linearised at ``x``."""
    t, e, h, x = elastic.triangles, elastic.edges, elastic.hinges, unwritten(x)
    step, stresses = unwritten(room.step), room.elastic
    stretch.linear_stress(x, step, t.stencils, t.rest, t.weight, stresses.triangles)
    shear.linear_stress(x, step, e.stencils, e.rest, e.weight, stresses.edges)
    flexure.linear_stress(x, step, h.stencils, h.rest, h.weight, stresses.hinges)
