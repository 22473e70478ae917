"""Rectangular sheet of masses with three families of springs, as in classical cloth programs [provot1995]."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_count, checked_number, checked_vectors, shown, vector_count
from modalshell.core.errors import LoadError, MaterialError, MeshError, OptionError, SupportError
from modalshell.core.short_repr import short_repr
from modalshell.core.units import at_most
from modalshell.mesh import sheet
from modalshell.page import Page
from modalshell.page.html import filled_page
from modalshell.springs.springs import Springs

FAMILIES = {"structural": ((0, 1), (1, 0)), "shear": ((1, 1), (1, -1)), "flexion": ((0, 2), (2, 0))}
"""Half of each family's neighbours, as (rows, columns); the other half are their opposites."""


_COINCIDENT = 1e-12
"""Distance of two masses over the spacing, far below which the force between them is none."""
_AXES = ("rows", "columns")
_MOST = 100_000_000
"""Masses; more do not fit the memory of a common machine."""
_MOST_STEPS = 40
"""Steps of a page's frame at most."""
_PICTURE = 48
"""Cells along each side of a page's picture of the sheet at rest."""
_WAVES = 96
"""Wave numbers along each axis among which the fastest wave is looked for."""


@final
@short_repr
@dataclass(frozen=True, kw_only=True, eq=False)
class SheetGrid:
    """Equal masses on a regular grid, each tied to 4 neighbours, 4 diagonals and 4 second neighbours (Provot 1995).

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of masses, each at least 3.
    spacing : float
        Distance of neighbours at rest [m].
    particle_mass : float
        Of each mass [kg].
    structural, shear, flexion : float
        Stiffness of a spring of each family [N/m].
    drag : float
        Deceleration over velocity [1/s].
    spring_damping : float
        Force along a spring over the rate of its length [N s/m].
    pinned : ndarray, shape (rows, columns), bool
        Masses that do not move.
    gravity : ndarray, shape (3,)
        [m/s^2].
    """

    shape: tuple[int, int]
    spacing: float
    particle_mass: float
    structural: float
    shear: float
    flexion: float
    drag: float = 0.0
    spring_damping: float = 0.0
    pinned: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((1, 1), bool))
    gravity: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        """Check every value before any work is done with it."""
        if vector_count(self.shape) != 2:
            raise MeshError(f"shape must be two numbers, rows and columns (got {shown(self.shape)})")
        rows, columns = (checked_count(name, n, at_least=3) for name, n in zip(_AXES, self.shape, strict=True))
        if rows * columns > _MOST:
            raise MeshError(f"shape must be at most {_MOST:,} masses in all (got {rows} x {columns})")
        object.__setattr__(self, "shape", (rows, columns))
        units = {"structural": "N/m", "shear": "N/m", "flexion": "N/m", "drag": "1/s", "spring_damping": "N s/m"}
        for name, unit in {"spacing": "m", "particle_mass": "kg", **units}.items():
            bound = {"at_least": 0.0} if name in units else {"above": 0.0}
            value = checked_number(name, getattr(self, name), MaterialError, unit=unit, **bound)
            object.__setattr__(self, name, value)  # a large whole number is no number of NumPy's
        if not isinstance(self.pinned, np.ndarray) or self.pinned.dtype != bool or np.ma.is_masked(self.pinned):
            raise SupportError(f"pinned must be an array of bool (got {shown(self.pinned)})")
        pinned = self.pinned
        if pinned.shape not in (self.shape, (1, 1)):
            raise SupportError(f"pinned must have the shape {self.shape} (got {pinned.shape})")
        object.__setattr__(self, "pinned", np.array(np.broadcast_to(pinned, self.shape)))
        object.__setattr__(self, "gravity", checked_vectors("gravity", self.gravity, (3,), LoadError).copy())

    @property
    def count(self) -> int:
        """Masses."""
        return self.shape[0] * self.shape[1]

    def rest_positions(self) -> NDArray[np.float64]:
        """Places at rest [m], shape (rows * columns, 3): flat, columns along x and rows along y."""
        row, column = np.divmod(np.arange(self.count), self.shape[1])
        return np.column_stack([self.spacing * column, self.spacing * row, np.zeros(self.count)])

    def stable_step(self) -> float:
        """Largest stable step [s] of Verlet, drag taken at mid-step, about the rest shape.

        ``h^2 omega^2 + 2 h c < 4`` for the largest omega^2 and damping rate c of the endless sheet, found among its
        plane waves (theory 17, eq. 1): a sheet with edges or pinned masses has none larger. Springs that are stretched
        far or turn over in large motion ask for shorter steps: 0.7 of this kept the energy of a sheet swinging by two
        corners, 0.9 did not.
        """
        squared, rate = (self._largest_rate(stiffness) for stiffness in (None, self.spring_damping))
        if squared == 0.0:
            return float("inf") if rate == 0.0 else 2.0 / rate
        return float((np.sqrt(rate**2 + 4.0 * squared) - rate) / squared)

    def page(
        self, path: str | os.PathLike[str] | None = None, *, dt: float | None = None, title: str = "modalshell"
    ) -> Page:
        """A self-contained web page that steps the sheet on the browser's GPU by Verlet's method, in single precision.

        Parameters
        ----------
        path : str or path, optional
            HTML file to write.
        dt : float, optional
            Time step [s]; by default half of the stable one.
        title : str
            Headline of the page.

        Raises
        ------
        OptionError
            For a step above the stable one, or a sheet with dashpots.
        """
        if self.spring_damping > 0.0:
            raise OptionError(
                f"a page steps no dashpots (got spring_damping={self.spring_damping:g} N s/m): set it to 0"
            )
        stable = self.stable_step()
        dt = 0.5 * stable if dt is None else checked_number("dt", dt, above=0.0, unit="s")
        if dt > stable:
            raise OptionError(f"Verlet needs a step of at most {at_most(stable, 3)} s on this sheet (got {dt:.3g} s)")
        rows, columns = self.shape
        middle = [0.5 * self.spacing * (columns - 1), 0.5 * self.spacing * (rows - 1)]
        data = {
            "rows": rows,
            "columns": columns,
            "spacing": self.spacing,
            "stiffness": [k / self.particle_mass for k in (self.structural, self.shear, self.flexion)],
            "drag": self.drag,
            "pinned": np.flatnonzero(self.pinned).tolist(),
            "gravity": self.gravity.tolist(),
            "dt": dt,
            "tiny": self.tiny,
            "most": _MOST_STEPS,
            "size": 2.0 * max(middle),
            "middle": middle,
        }
        picture = sheet(length=2.0 * middle[0], width=2.0 * middle[1], cells=(_PICTURE, _PICTURE))
        page = filled_page("sheet", title, data, picture.vertices, picture.faces, __package__)
        if path is not None:
            page.save(path)
        return page

    def _largest_rate(self, stiffness: float | None) -> float:
        """Largest eigenvalue of ``M^-1 K`` over all plane waves, with each family's stiffness or one for all."""
        phase = np.linspace(-np.pi, np.pi, 2 * _WAVES + 1)
        rows, columns = phase[_WAVES:, None], phase[None]
        xx = yy = xy = np.zeros((_WAVES + 1, 2 * _WAVES + 1))
        for family, offsets in FAMILIES.items():
            for down, right in offsets:
                size = (2.0 if stiffness is None else 2.0 * stiffness) / (down**2 + right**2)
                size *= getattr(self, family) if stiffness is None else 1.0
                wave = size * (1.0 - np.cos(down * rows + right * columns))
                xx, yy, xy = xx + right**2 * wave, yy + down**2 * wave, xy + down * right * wave
        largest = 0.5 * (xx + yy) + np.sqrt(0.25 * (xx - yy) ** 2 + xy**2)
        return float(largest.max()) / self.particle_mass

    @property
    def tiny(self) -> float:
        """Squared distance of two masses [m^2], far below which the force between them is none."""
        return (_COINCIDENT * self.spacing) ** 2

    def springs(self) -> Springs:
        """All springs, about 6 a mass."""
        index = np.arange(self.count).reshape(self.shape)
        parts = []
        for family, offsets in FAMILIES.items():
            for down, right in offsets:
                rows, columns = self.shape[0] - down, self.shape[1] - abs(right)
                first = index[:rows, max(0, -right) : max(0, -right) + columns].ravel()
                second = index[down:, max(0, right) : max(0, right) + columns].ravel()
                numbers = self.spacing * np.hypot(down, right), getattr(self, family), self.spring_damping
                parts.append((np.column_stack([first, second]), *(np.full(len(first), value) for value in numbers)))
        pairs, lengths, stiffness, damping = (np.concatenate(each) for each in zip(*parts, strict=True))
        return Springs(pairs, lengths, stiffness, damping)
