"""What every sheet of shell theory gives its shells, whatever it is made of; and the checks of its constants."""

from __future__ import annotations

import copy
from abc import ABC
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from modalshell.core.checks import LARGEST, as_array, shown
from modalshell.core.errors import MaterialError
from modalshell.core.registry import Registry
from modalshell.core.thread_safety import ReadOnlyArrays
from modalshell.core.typing import Array
from modalshell.mesh import TriangleMesh
from modalshell.shell.elasticity import Elasticity, directions_on

Field = float | Array | Callable[[Array], Array]
"""One number, one per triangle (T,), or a function of the triangles' centroids (T, 3) [m]."""
Direction = float | tuple[float, float, float] | Array | Callable[[Array], Array]
"""An angle [deg] from the x axis, a vector, one of them per triangle, (T,) or (T, 3), or a function that gives it."""
IMAGINARY = 1e-30
"""Imaginary step of a constant in elasticities of slopes, whose derivatives have no rounding of differences."""


SHEETS: Registry[type[Sheet]] = Registry("sheet")
"""Every class of sheets by its kind."""


class Sheet(ReadOnlyArrays, ABC):
    """An elastic sheet of the split-fold energy, a Kirchhoff shell; a frozen dataclass of its constants."""

    kind: ClassVar[str]
    source = ""
    """Where the constants are from, of a card."""

    def __init_subclass__(cls, *, kind: str) -> None:
        cls.kind = kind
        SHEETS[kind] = cls

    def _check(self, units: Mapping[str, str]) -> None:
        """Check the constants with these units that are no functions; those without a unit may have any sign."""
        for name, unit in units.items():
            if not callable(raw := getattr(self, name)):
                direction = name == "direction"
                value = checked_direction(raw) if direction else checked_constant(name, raw, unit, ratio=not unit)
                object.__setattr__(self, name, value)

    def sourced(self, source: str) -> Self:
        """The same sheet that says where its constants are from."""
        other = copy.copy(self)
        object.__setattr__(other, "source", source)
        return other

    def on(self, mesh: TriangleMesh) -> Self:
        """The same sheet, functions evaluated on the triangles of ``mesh``; MaterialError where fields misfit."""
        values: dict[str, Any] = {}
        for name, raw in self._given():
            if isinstance(raw, tuple) and name != "direction":
                values[name] = tuple(evaluated(f"{name}[{k}]", part, mesh) for k, part in enumerate(raw))
            else:
                values[name] = evaluated(name, raw, mesh)
        return type(self)(**values)

    def area_density(self, mesh: TriangleMesh) -> Array:
        """Mass per area of every triangle (T,) [kg/m^2]: the density, times the thickness where there is one."""
        sheet: Any = self.on(mesh)
        density, thickness = np.broadcast_to(sheet.density, (len(mesh.faces),)), sheet.thicknesses(mesh)
        return np.asarray(density if thickness is None else density * thickness)

    def elasticity(self, mesh: TriangleMesh) -> tuple[Array, Array, Array]:
        """Membrane stiffness [N/m], bending stiffness [N m] and Poisson's ratio of every triangle (T,).

        Of a sheet that is not isotropic they are means over directions, by which scales and pairs are chosen.
        """
        parts = self.directed(mesh)
        assert parts is not None  # an isotropic sheet has its own
        return parts[0].mean()[0], *parts[1].mean()

    def directed(self, mesh: TriangleMesh, slope: str | None = None) -> tuple[Elasticity, Elasticity] | None:  # noqa: ARG002
        """Elasticity of membrane and bending, or their ``slope`` by a constant; None of an isotropic sheet."""
        return None

    def face_stresses(self, mesh: TriangleMesh, force: Array, moment: Array) -> tuple[Array, Array] | None:
        """Stress tensors (T, 3) [Pa] at the face to which the normals point and the other; None without a thickness.

        ``force`` [N/m] and ``moment`` [N] (T, 3) are those of the membrane and of bending in the triangles' axes.
        """
        thickness = self.thicknesses(mesh)
        if thickness is None:
            return None
        depth = thickness[:, None]
        bent = 6.0 * moment / depth**2
        return force / depth + bent, force / depth - bent

    def thicknesses(self, mesh: TriangleMesh) -> Array | None:
        """Thickness of every triangle (T,) [m]; None of a sheet known by its stiffnesses alone."""
        thickness = getattr(self.on(mesh), "thickness", None)
        return None if thickness is None else np.asarray(np.broadcast_to(thickness, (len(mesh.faces),)))

    def plain(self, mesh: TriangleMesh) -> dict[str, Any]:
        """The constants on a mesh as numbers and lists, functions evaluated."""
        return {name: _listed(value) for name, value in self.on(mesh)._given()}

    def _given(self) -> Iterator[tuple[str, Any]]:
        """What the sheet is made of, by name."""
        for field in fields(self):  # type: ignore[arg-type]
            yield field.name, getattr(self, field.name)

    @classmethod
    def of_plain(cls, values: Mapping[str, Any]) -> Self:
        """The sheet of constants as :meth:`plain` gives them."""
        return cls(**values)

    @property
    def constants(self) -> dict[str, float]:
        """The constants that are one number, by name; of tuples with their place, from 1, after an underscore."""
        found = {}
        for name, value in self._given():
            if isinstance(value, float):
                found[name] = value
            elif isinstance(value, tuple) and name != "direction":
                found |= {f"{name}_{k + 1}": part for k, part in enumerate(value) if isinstance(part, float)}
        return found

    def with_constants(self, values: Mapping[str, Any]) -> Self:
        """The sheet with other values of some constants."""
        changed: dict[str, Any] = {}
        for name, value in values.items():
            whole, _, place = name.rpartition("_")
            if place.isdigit():
                parts = list(changed.get(whole, getattr(self, whole)))
                parts[int(place) - 1] = value
                changed[whole] = tuple(parts)
            else:
                changed[name] = value
        return replace(self, **changed)  # type: ignore[type-var]


def _listed(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_listed(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def checked_constant(
    name: str, raw: object, unit: str, *, ratio: bool = False, each: str = "triangle"
) -> float | Array:
    """A positive number, or one per triangle (T,), read-only; or a ``ratio``, of any sign. MaterialError otherwise."""
    text = f" [{unit}]" if unit else ""
    value = as_array(name, raw, f"one number or one per {each}{text}", MaterialError).astype(np.float64)
    if value.ndim > 1 or not (np.abs(value) <= LARGEST).all():
        raise MaterialError(f"{name} must be finite, one number or one per {each}{text} (got {shown(raw)})")
    if not ratio and (value < 1.0 / LARGEST).any():
        raise MaterialError(f"{name} must be positive (got {value.min():g}{text})")
    value.flags.writeable = False
    return float(value) if value.ndim == 0 else value


def checked_direction(raw: object) -> float | tuple[float, float, float] | Array:
    """An angle, a vector, or one of them per triangle; MaterialError otherwise."""
    value = as_array("direction", raw, "an angle [deg], a vector, or one per triangle", MaterialError)
    value = value.astype(np.float64)
    vectors = value.shape == (3,) or value.ndim == 2
    if value.ndim > 2 or (value.ndim == 2 and value.shape[1] != 3) or not np.isfinite(value).all():
        raise MaterialError(
            "direction must be an angle [deg], a vector (x, y, z), or one of them per triangle, (T,) or (T, 3), finite "
            f"(got {shown(raw)})"
        )
    if vectors and not np.linalg.norm(value.reshape(-1, 3), axis=1).all():
        raise MaterialError(f"direction must not be the zero vector (got {shown(raw)})")
    if value.shape == (3,):
        return float(value[0]), float(value[1]), float(value[2])
    value.flags.writeable = False
    return float(value) if value.ndim == 0 else value


def axes_on(mesh: TriangleMesh, direction: Any, slope: str | None) -> Any:
    """Axis 1 (T, 3) of every triangle, with its imaginary turn in the plane for the ``slope`` by the direction."""
    along = directions_on(mesh, np.asarray(direction))
    if slope != "direction":
        return along
    return along + 1j * np.radians(IMAGINARY) * np.cross(mesh.face_normals, along)


def evaluated(name: str, raw: Any, mesh: TriangleMesh) -> Any:
    """A field, or its values (T, ...) where it is a function; MaterialError for another number of them."""
    value = raw(mesh.vertices[mesh.faces].mean(axis=1)) if callable(raw) else raw
    if not isinstance(value, tuple) and np.ndim(value) and len(np.asarray(value)) != len(mesh.faces):
        raise MaterialError(f"{name} has {len(np.asarray(value))} values, but the mesh has {len(mesh.faces)} triangles")
    return value
