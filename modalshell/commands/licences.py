"""Licences of everything that modalshell or one of its extras installs, and which of them are copyleft."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, final

from rich.table import Table

from modalshell.commands.terminal import CONSOLE, say
from modalshell.core.short_repr import short_repr

OWN = "modalshell"
CORE = "core"
KNOWN = {
    "numpy": "BSD-3-Clause", "scipy": "BSD-3-Clause", "numba": "BSD-2-Clause", "trimesh": "MIT",
    "matplotlib": "PSF-2.0", "pillow": "MIT-CMU", "imageio-ffmpeg": "BSD-2-Clause", "cyclopts": "Apache-2.0",
    "rich": "MIT", "msgspec": "BSD-3-Clause", "threadpoolctl": "BSD-3-Clause", "pyvista": "MIT", "vtk": "BSD-3-Clause",
    "sympy": "BSD-3-Clause", "trame": "Apache-2.0", "trame-vtk": "BSD-3-Clause", "trame-vuetify": "MIT",
    "usd-core": "LicenseRef-TOST-1.0", "pygltflib": "MIT", "pymeshlab": "GPL-3.0-only", "warp-lang": "Apache-2.0",
    "mujoco": "Apache-2.0", "newton": "Apache-2.0", "petsc4py": "BSD-2-Clause", "distributed": "BSD-3-Clause",
    "pyarrow": "Apache-2.0", "pdoc": "MIT-0", "numpydoc": "BSD-2-Clause", "latex2mathml": "MIT",
    "markdown-it-py": "MIT", "pygments": "BSD-2-Clause", "pytest": "MIT", "pytest-xdist": "MIT",
    "hypothesis": "MPL-2.0", "ipctk": "MIT", "meshio": "MIT",
    "playwright": "Apache-2.0", "build": "MIT", "ruff": "MIT", "mypy": "MIT", "scipy-stubs": "BSD-3-Clause",
}  # fmt: skip
"""SPDX licences of what modalshell and its extras name, for machines without it; what is installed says its own."""
WORDS = {
    "pymeshlab": "only the extras remesh and dev install it, and modalshell runs without it; whoever passes on a "
    "program that contains it passes that on under GPL-3",
    "hypothesis": "tests alone import it; MPL-2.0 binds changes of its own files",
    "certifi": "a list of certificates, read as it stands; MPL-2.0 binds changes of its own files",
    "pathspec": "of the type checker, which nothing at run time needs; MPL-2.0 binds changes of its own files",
    "docutils": "of the documentation's checker; a few of its files are under GPL, most in the public domain",
    "imageio-ffmpeg": "its wheel carries the program ffmpeg, built with parts under GPL-3, which is started as a "
    "process of its own to write films; to pass on a bundle, leave it out or pass on ffmpeg's source",
}
"""What to know of packages that are copyleft, or carry something that is."""
CARRIERS = ("imageio-ffmpeg",)
"""Packages under a permissive licence whose wheels carry something that is copyleft."""
_COPYLEFT = re.compile(
    r"\b(?:A|L)?GPL|General Public|\bMPL|Mozilla|\bEPL|Eclipse Public|\bEUPL|\bCDDL|CC-BY-SA|\bOSL", re.I
)
_SHORT = {
    "MIT License": "MIT", "BSD License": "BSD", "Apache Software License": "Apache-2.0", "BSD 3-Clause License": "BSD",
    "Python Software Foundation License": "PSF-2.0", "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "GNU General Public License (GPL)": "GPL", "Public Domain": "public domain",
}  # fmt: skip


@final
@short_repr
@dataclass(frozen=True)
class Licence:
    """The licence of one package."""

    package: str
    licence: str
    """An SPDX expression where the package gives one, else what its metadata say; "unknown" where they say nothing."""
    needed_by: tuple[str, ...]
    """The extras that install it, or the packages that need it; "core" of what all installations have."""
    version: str
    """Of what is installed; empty where it is not."""

    @property
    def copyleft(self) -> bool:
        """Whether it is copyleft, or carries what is, without a choice of another licence."""
        choices = re.split(r"\s+OR\s+", self.licence)
        return self.package in CARRIERS or all(_COPYLEFT.search(one) for one in choices)

    @property
    def remark(self) -> str:
        """What to know of it; empty where there is nothing."""
        if self.package in WORDS:
            return WORDS[self.package]
        if self.licence == "unknown":
            return "its metadata name no licence: look it up"
        return "copyleft, and nothing is known of it here: look it up" if self.copyleft else ""


def requirements(pyproject: Path | None = None) -> dict[str, set[str]]:
    """The packages that modalshell names, each with "core" or the extras that install it.

    They are read from a ``pyproject.toml``: the checkout's, where there is one, else from the installed metadata.
    """
    file = pyproject or Path(__file__).resolve().parents[2] / "pyproject.toml"
    found: dict[str, set[str]] = {}
    if file.is_file():
        project = tomllib.loads(file.read_text(encoding="utf-8"))["project"]
        groups: Mapping[str, Iterable[str]] = {CORE: project["dependencies"], **project["optional-dependencies"]}
        named = [(line, group) for group, lines in groups.items() for line in lines]
    else:
        named = []
        for line in distribution(OWN).requires or ():
            extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", line)
            named.append((line, extra[1] if extra else CORE))
    inner = [(one, group) for line, group in named if _name(line) == OWN for one in _extras(line)]
    for line, group in named:
        found.setdefault(_name(line), set()).add(group)
    for _ in inner:  # extras of extras
        for one, group in inner:
            for groups_of in found.values():
                if one in groups_of:
                    groups_of.add(group)
    found.pop(OWN, None)
    return found


def licences() -> list[Licence]:
    """The licence of every package that modalshell, an extra, or one of those needs, as far as it is installed."""
    direct = requirements()
    rows = {name: _row(name, tuple(sorted(groups))) for name, groups in direct.items()}
    waiting = list(direct)
    while waiting:
        name = waiting.pop()
        if (installed := _installed(name)) is None:
            continue
        for line in installed.requires or ():
            inner = _name(line)
            if inner in rows or inner == OWN or re.search(r"\bextra\s*==", line) or _installed(inner) is None:
                continue
            rows[inner] = _row(inner, (name,))
            waiting.append(inner)
    return sorted(rows.values(), key=lambda row: (not row.copyleft, row.package))


def show_licences() -> int:
    """Print the table of licences; 1 if something copyleft or unknown has no word about it, else 0."""
    rows = licences()
    table = Table(show_edge=False, pad_edge=False)
    for title in ("package", "licence", "version", "needed by"):
        table.add_column(title, overflow="fold")
    for row in rows:
        mark = "copyleft: " if row.copyleft else ""
        table.add_row(row.package, f"{mark}{row.licence}", row.version or "not installed", ", ".join(row.needed_by))
    CONSOLE.print(table)
    for row in rows:
        if row.remark:
            say(f"{row.package}: {row.remark}")
    without = [row.package for row in rows if row.remark and row.package not in WORDS]
    strict = [row.package for row in rows if row.copyleft]
    say(f"modalshell is under MIT; {len(rows)} packages, {len(strict)} of them copyleft or with parts that are")
    return 1 if without else 0


def _row(name: str, needed_by: tuple[str, ...]) -> Licence:
    """The licence of a package, from what is installed or else what is known."""
    installed = _installed(name)
    stated = "unknown" if installed is None else _stated(installed.metadata)
    if stated == "unknown":
        stated = KNOWN.get(name, "unknown")
    return Licence(name, stated, needed_by, "" if installed is None else installed.version)


def _stated(metadata: Any) -> str:
    """The licence that a package's metadata state: its expression, its classifiers, or the first words of its text."""
    if metadata.get("License-Expression"):
        return str(metadata["License-Expression"])
    kinds = [one.split(" :: ")[-1] for one in metadata.get_all("Classifier") or () if one.startswith("License ::")]
    kinds = [_SHORT.get(one, one) for one in kinds if one != "OSI Approved"]
    if kinds:
        return " and ".join(kinds)
    text = str(metadata.get("License") or "").strip().split("\n")[0]
    return text[:60] if text and text.upper() != "UNKNOWN" else "unknown"


def _installed(name: str) -> Distribution | None:
    """A package's metadata; None where it is not installed."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def _name(requirement: str) -> str:
    """The package that a requirement names, in the spelling of package indices."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\s\[<>=!~;(]", requirement.strip(), maxsplit=1)[0]).lower()


def _extras(requirement: str) -> list[str]:
    """The extras that a requirement asks for."""
    found = re.search(r"\[([^\]]*)\]", requirement)
    return [one.strip() for one in found[1].split(",")] if found else []
