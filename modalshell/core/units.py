"""Units of the numbers in results: SI, or those that a scene names."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import floor, isclose, log10
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from modalshell.core.checks import checked_choice
from modalshell.core.errors import ModalShellError, ModalShellWarning

_DIMENSIONS: Final[dict[str, tuple[int, int, int]]] = {
    "m": (1, 0, 0),
    "kg": (0, 1, 0),
    "s": (0, 0, 1),
    "1/m": (-1, 0, 0),
    "1/s": (0, 0, -1),
    "1/s^2": (0, 0, -2),
    "m/s": (1, 0, -1),
    "m/s^2": (1, 0, -2),
    "kg/m^2": (-2, 1, 0),
    "kg/m^3": (-3, 1, 0),
    "N": (1, 1, -2),
    "N/m": (0, 1, -2),
    "N m": (2, 1, -2),
    "Pa": (-1, 1, -2),
    "J": (2, 1, -2),
    "J/m^2": (0, 1, -2),
}
"""Powers of length, mass and time."""
LENGTHS: Final = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048}
"""Known units of length [m]."""
MASSES: Final = {"kg": 1.0, "g": 1e-3, "mg": 1e-6, "t": 1e3, "lb": 0.45359237}
"""Known units of mass [kg]."""
TIMES: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}
"""Known units of time [s]."""
_TENS: Final = {
    name: round(log10(size))
    for known in (LENGTHS, MASSES, TIMES)
    for name, size in known.items()
    if isclose(size, 10.0 ** round(log10(size)))
}
"""Powers of ten of the units that have a place in SI."""
_SAID: Final = re.compile(
    rf"(?<=\d )({'|'.join(re.escape(unit) for unit in sorted([*_DIMENSIONS, 'Hz'], key=len, reverse=True))})"
    r"(?=$|[\s,;:)]|\.(?!\w))"
)
"""Units of SI after numbers in sentences."""
_PREFIXES: Final = {-3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
"""What SI calls powers of ten."""
_EARTH: Final = 9.81
"""Gravity on Earth [m/s^2]."""
_AIR: Final = 1.2
"""Density of air [kg/m^3], as :class:`modalshell.loads.Wind` has it."""


@final
@dataclass(frozen=True)
class UnitSystem:
    """Units of length, mass and time, from which all others follow.

    Attributes
    ----------
    length, mass, time : str
        Such as "mm", "t" and "s".

    Raises
    ------
    OptionError
        For units that are not known.
    """

    length: str = "m"
    mass: str = "kg"
    time: str = "s"

    def __post_init__(self) -> None:
        for name, known in (("length", LENGTHS), ("mass", MASSES), ("time", TIMES)):
            checked_choice(f"the unit of {name}", getattr(self, name), tuple(known))

    @classmethod
    def from_array(cls, names: NDArray[Any]) -> UnitSystem:
        """The units of an archive's ``unit_system``: three texts; ValueError for another array."""
        if names.shape != (3,) or names.dtype.kind != "U":
            raise ValueError(f"unit_system must be three names (got {names.dtype} {names.shape})")
        return cls(*map(str, names))

    @property
    def metres(self) -> float:
        """The unit of length [m]."""
        return LENGTHS[self.length]

    @property
    def seconds(self) -> float:
        """The unit of time [s]."""
        return TIMES[self.time]

    @property
    def earth(self) -> float:
        """Gravity on Earth in these units: 9810 with mm and s."""
        return _EARTH * self.seconds**2 / self.metres

    @property
    def air(self) -> float:
        """Density of air in these units: 1.2e-12 with mm and t."""
        return _AIR * self.metres**3 / MASSES[self.mass]

    def of(self, unit: str) -> str:
        """What a unit of SI is here: "Pa" is "MPa" with mm, t and s, "kg/(ft s^2)" with ft, kg and s."""
        if self == SI or unit not in _DIMENSIONS:
            return unit
        if (named := self._named(unit)) is not None:
            return named
        powers = list(zip((self.mass, self.length, self.time), (_DIMENSIONS[unit][k] for k in (1, 0, 2)), strict=True))
        above, below = (
            [name if abs(power) == 1 else f"{name}^{abs(power)}" for name, power in powers if sign * power > 0]
            for sign in (1, -1)
        )
        under = f"/({' '.join(below)})" if len(below) > 1 else "".join(f"/{name}" for name in below)
        return (" ".join(above) or "1") + under

    def _named(self, unit: str) -> str | None:
        """A unit made of N, Pa or J by its prefix here; None where SI has no name for it."""
        first, *rest = re.split(r"(?=[ /])", unit, maxsplit=1)
        system = (self.length, self.mass, self.time)
        if first not in ("N", "Pa", "J") or not all(name in _TENS for name in system):
            return None
        ten = sum(power * _TENS[name] for power, name in zip(_DIMENSIONS[first], system, strict=True))
        if ten not in _PREFIXES:
            return None
        return _PREFIXES[ten] + first + "".join(rest).replace("m", self.length)

    def restated(self, text: str) -> str:
        """A model's message in SI, rewritten in these units: "at 120 s" is "at 120 ms" with ms."""
        if self == SI:
            return text
        names = {"Hz": self.of("1/s").replace("1/s", "Hz")}
        return _SAID.sub(lambda found: names.get(found[1]) or self.of(found[1]), text)

    @contextmanager
    def said(self) -> Iterator[None]:
        """Give what is refused or warned of within in these units; see :meth:`restated`.

        Yields
        ------
        None
            Errors of this package that are raised within are restated and pass on, as warnings are.
        """
        if self == SI:
            yield
            return
        try:
            with warnings.catch_warnings():
                show = warnings.showwarning

                def shown(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
                    own = issubclass(category, ModalShellWarning)
                    show(category(self.restated(str(message))) if own else message, category, *rest, **more)

                warnings.showwarning = shown
                yield
        except ModalShellError as error:
            error.args = (self.restated(str(error)), *error.args[1:])
            raise

    def labels(self, units: Mapping[str, str]) -> dict[str, str]:
        """Names with their units here; "1" for plain numbers."""
        return {name: self.of(unit) or "1" for name, unit in units.items()}

    def array(self, units: Mapping[str, str]) -> NDArray[np.str_]:
        """The names with their units as the text of a JSON object: what archives hold as ``units``."""
        return np.array(json.dumps(self.labels(units)))


SI: Final = UnitSystem()
"""Metres, kilograms and seconds."""


def with_unit(name: str, unit: str) -> str:
    """The name of a quantity with its unit in brackets; the name alone of a plain number, whose unit is "" or "1"."""
    return f"{name} [{unit}]" if unit not in ("", "1") else name


def in_two_digits(value: float) -> str:
    """A number to two digits; "900" rather than "9e+02"."""
    text = f"{value:.2g}"
    return f"{float(text):.0f}" if "e+0" in text and abs(float(text)) < 1e6 else text


def at_most(value: float, digits: int = 2) -> str:
    """A positive bound in a number of digits, rounded towards zero: what obeys the text obeys the bound."""
    text = f"{value:.{digits}g}"
    last = 10.0 ** (floor(log10(value)) + 1 - digits)
    if float(text) > value:
        text = f"{value - 0.5 * last:.{digits}g}"
    return f"{float(text):g}"


def in_percent(share: float) -> str:
    """A share in percent, to two digits."""
    return f"{in_two_digits(100.0 * share)} %"
