"""Cards: sheets with measured constants, each with its source and with measurements to compare it with.

A number without a source is no card. Every card hangs over an edge as its bending stiffness and weight say, and meets
one measurement that it was not fitted to. That proves its bending and weight; the stretch of fabrics is the tangent at
no strain of their source, which no test here confirms.
"""

from __future__ import annotations

import difflib
from typing import NamedTuple, final

from modalshell.core.checks import shown
from modalshell.core.errors import OptionError
from modalshell.shell.fabric import Fabric
from modalshell.shell.isotropic import Isotropic
from modalshell.shell.sheet import Sheet

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2] of overhang lengths."""


@final
class Measurement(NamedTuple):
    """A measurement that a card is compared with."""

    what: str
    value: float
    unit: str
    spread: float
    """Relative difference within which the card meets it."""
    source: str
    """Where it is from."""
    fitted: bool = False
    """Whether a constant of the card was fitted to it."""


@final
class Card(NamedTuple):
    """A sheet with the record of where its constants are from."""

    material: Sheet
    """The sheet; its ``source`` is the card's."""
    what: str
    """What the sheet is."""
    source: str
    """Publication, with its key in the references."""
    measured: tuple[Measurement, ...]
    """Measurements to compare it with, one of them at least not fitted."""

    @property
    def bending(self) -> float:
        """Bending stiffness along axis 1 [N m], of strips too wide and thin to curl across."""
        if isinstance(self.material, Fabric):
            return float(self.material.bending[0])  # type: ignore[arg-type]
        sheet = self.material
        assert isinstance(sheet, Isotropic)
        young, poisson, thickness = (float(sheet.constants[name]) for name in ("young", "poisson", "thickness"))
        return young * thickness**3 / (12.0 * (1.0 - poisson**2))

    @property
    def weight(self) -> float:
        """Mass per area [kg/m^2]."""
        if isinstance(self.material, Isotropic):
            return float(self.material.density) * float(self.material.thickness)  # type: ignore[arg-type]
        assert isinstance(self.material, Fabric)
        return float(self.material.density)  # type: ignore[arg-type]

    @property
    def bending_length(self) -> float:
        """Length ``(B / (rho g))^(1/3)`` [m] of axis 1; strips hang to 41.5 degrees at an overhang of 2.0003 of it."""
        return bending_length(self.bending, self.weight)


def bending_length(stiffness: float, weight: float) -> float:
    """``(B / (rho g))^(1/3)`` [m] of a bending stiffness [N m] and a mass per area [kg/m^2]."""
    return float((stiffness / (weight * GRAVITY)) ** (1.0 / 3.0))


_WANG = (
    "H. Wang, J. F. O'Brien, R. Ramamoorthi, Data-Driven Elastic Models for Cloth, 2011 [wang2011]: bending at 0, 45 "
    "and 90 degrees at no curvature, stretch at no strain"
)
_SPEEDS = "CRC Handbook of Chemistry and Physics, Speed of Sound in Various Media [crc2016]"
_FABRICS: dict[str, tuple[str, float, tuple[float, float, float], tuple[float, float, float, float]]] = {
    "tango-red-jet-set": (
        "jacket, polyester",
        0.113,
        (14.293814, 21.951700, 20.345654),
        (43.067627, 171.424835, 14.314700, 54.373299),
    ),
    "gray-interlock": (
        "T-shirt, cotton 60 %, polyester 40 %",
        0.187,
        (23.191698, 24.749964, 14.267624),
        (16.593832, 34.477123, 36.860302, -14.695990),
    ),
    "camel-ponte-roma": (
        "jacket, polyester 60 %, rayon 40 %",
        0.284,
        (36.348366, 33.013252, 37.157593),
        (31.146198, 44.028667, 31.896357, -12.802702),
    ),
    "ivory-rib-knit": (
        "underwear, cotton 95 %, spandex 5 %",
        0.276,
        (46.237591, 30.015930, 32.243889),
        (42.871021, 65.166023, 83.175644, -0.234556),
    ),
    "white-dots-on-blk": (
        "tablecloth, polyester",
        0.128,
        (51.713814, 40.659470, 31.282822),
        (2002.08618, 2027.48559, 19.189022, 0.345588),
    ),
    "navy-sparkle-sweat": (
        "sweater, polyester 96 %, spandex 4 %; its coupling leaves it unstable at no strain, and is left out",
        0.224,
        (59.469658, 40.072277, 45.625023),
        (12.486332, 3.272434, 17.616289, 0.0),
    ),
    "white-swim-solid": (
        "swimsuit, nylon 87 %, spandex 13 %",
        0.204,
        (60.237942, 58.803211, 51.018833),
        (47.971176, 104.615456, 60.773663, 6.834521),
    ),
    "11oz-black-denim": (
        "jeans, cotton 99 %, spandex 1 %",
        0.324,
        (64.196457, 73.384567, 96.951576),
        (205.352005, 1013.88629, 53.387184, 10.234077),
    ),
    "pink-ribbon-brown": (
        "blanket, polyester",
        0.228,
        (117.070122, 87.509773, 59.774277),
        (151.503906, 244.830673, 30.250183, 106.028160),
    ),
    "royal-target": (
        "trousers, cotton 65 %, polyester 35 %",
        0.220,
        (125.409805, 107.997696, 125.409805),
        (2016.55456, 2034.97644, 104.759674, 9.170511),
    ),
}
"""What a fabric is, mass [kg/m^2], bending at 0, 45 and 90 degrees [1e-6 N m], and C1, C2, G, C12 [N/m]."""


def _fabric(what: str, density: float, bending: tuple[float, ...], stretch: tuple[float, ...]) -> Card:
    first, askew, second = (1e-6 * value for value in bending)
    twist = askew - 0.25 * (first + second)
    material = Fabric(stretch=stretch, bending=(first, second, twist), density=density)  # type: ignore[arg-type]
    overhang = Measurement(
        "overhang at which a strip at 45 degrees to axis 1 hangs to 41.5 degrees",
        2.0003 * bending_length(askew, density),
        "m",
        0.05,
        _WANG,
        fitted=True,
    )
    apart = Measurement(
        "bending length at 45 degrees, from those of both axes alone, by B = ((B1^(1/2) + B2^(1/2)) / 2)^2",
        bending_length(askew, density),
        "m",
        0.1,
        _WANG,
    )
    return Card(material.sourced(_WANG), what, _WANG, (overhang, apart))


def _metal(what: str, sheet: Isotropic, source: str, speeds: tuple[float, float], spread: float) -> Card:
    names = ("speed of sound along a thin bar", "speed of shear waves")
    measured = (Measurement(name, value, "m/s", spread, _SPEEDS) for name, value in zip(names, speeds, strict=True))
    return Card(sheet.sourced(source), what, source, tuple(measured))


_STEEL = "EN 1993-1-1:2005, 3.2.6, and EN 1991-1-1:2002, table A.4 [en1993]"
_ALUMINIUM = "EN 1999-1-1:2007, 3.2.5 [en1999]"
_HIBBELER = "R. C. Hibbeler, Mechanics of Materials, 2014, Average Mechanical Properties [hibbeler2014]"
_PYREX = "Corning 7740 Pyrex borosilicate glass, properties [pyrex2026]"
_PET = "DuPont Teijin Films, Mylar polyester film, Physical-Thermal Properties, H-37232-3, gauge 92A [mylar2003]"
CARDS: dict[str, Card] = {
    **{key: _fabric(*values) for key, values in _FABRICS.items()},
    "steel-0.1mm": _metal(
        "structural steel, as a sheet of 0.1 mm",
        Isotropic(young=210e9, poisson=0.3, thickness=1e-4, density=7850.0),
        _STEEL,
        (5200.0, 3235.0),
        0.02,
    ),
    "aluminium-foil-25um": _metal(
        "aluminium foil of 25.4 um (1/1000 inch)",
        Isotropic(young=70e9, poisson=0.3, thickness=25.4e-6, density=2700.0),
        _ALUMINIUM,
        (5000.0, 3040.0),
        0.04,
    ),
    "stainless-steel-304-0.1mm": _metal(
        "stainless steel 304, as a sheet of 0.1 mm; compared with 347",
        Isotropic(young=193e9, poisson=0.27, thickness=1e-4, density=7860.0),
        _HIBBELER,
        (5000.0, 3100.0),
        0.02,
    ),
    "duralumin-0.1mm": _metal(
        "aluminium 2014-T6, as a sheet of 0.1 mm; compared with duralumin 17S",
        Isotropic(young=73.1e9, poisson=0.35, thickness=1e-4, density=2790.0),
        _HIBBELER,
        (5150.0, 3130.0),
        0.02,
    ),
    "borosilicate-glass-0.1mm": _metal(
        "borosilicate glass, as a sheet of 0.1 mm",
        Isotropic(young=64e9, poisson=0.2, thickness=1e-4, density=2230.0),
        _PYREX,
        (5170.0, 3280.0),
        0.06,
    ),
    "pet-film-23um": Card(
        Isotropic(young=490.0 * 9.80665e6, poisson=0.38, thickness=23.4e-6, density=1390.0).sourced(_PET),
        "biaxially drawn polyester film of 23.4 um; its modulus is that along the machine",
        _PET,
        (Measurement("Young's modulus across the machine", 510.0 * 9.80665e6, "Pa", 0.05, _PET),),
    ),
}
"""Every card by its key."""


def card(name: str) -> Sheet:
    """A sheet with measured constants, and where they are from in its ``source``; ``modalshell cards`` lists them.

    Parameters
    ----------
    name : str
        A key of :func:`cards`.

    Returns
    -------
    Sheet
        The sheet, in SI units; ``dataclasses.replace`` changes its direction, or the thickness of a metal.

    Raises
    ------
    OptionError
        For another name.
    """
    if not isinstance(name, str) or name not in CARDS:
        near = difflib.get_close_matches(str(name), CARDS, 1)
        advice = f"did you mean {near[0]!r}? " if near else ""
        raise OptionError(f"card must be one of {', '.join(CARDS)} (got {shown(name)}); {advice}".rstrip("; "))
    return CARDS[name].material


def cards() -> dict[str, Sheet]:
    """All cards by their keys.

    Returns
    -------
    dict of str to Sheet
        The sheets, as :func:`card` gives them.
    """
    return {key: record.material for key, record in CARDS.items()}
