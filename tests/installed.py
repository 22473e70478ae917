"""Packages that are installed here, put into another environment: what pip would get, unpack and compile once more."""

import os
import shutil
import tomllib
from importlib.metadata import PackageNotFoundError, distribution

from guide import ROOT
from packaging.requirements import Requirement

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
NAME = PROJECT["name"]


def needed(text):
    """Distributions installed here that ``text``, a requirement of the project, asks for, and all that these need.

    Those that are missing, or of another version than is asked for, are left to pip.
    """
    waiting, asked, found = [Requirement(text)], set(), {}
    while waiting:
        requirement = waiting.pop()
        try:
            there = None if requirement.name == NAME else distribution(requirement.name)
        except PackageNotFoundError:
            continue
        if there is not None and not requirement.specifier.contains(there.version, prereleases=True):
            continue
        found[requirement.name] = there
        for extra in {"", *requirement.extras} - {extra for name, extra in asked if name == requirement.name}:
            asked.add((requirement.name, extra))
            for line in requirements_of(there, extra):
                other = Requirement(line)
                if other.marker is None or other.marker.evaluate({"extra": extra}):
                    waiting.append(other)
    return [there for there in found.values() if there is not None]


def requirements_of(there, extra):
    """What a distribution asks for, of all extras; of the project itself (None) by the checkout."""
    if there is not None:
        return there.requires or ()
    return PROJECT["optional-dependencies"][extra] if extra else PROJECT["dependencies"]


def put_into(site, text):
    """Link the files of ``needed(text)`` into the folder of packages ``site``, also what Python compiled of them."""
    for there in needed(text):
        for name in {file.parts[0] for file in there.files or ()} - {"..", "__pycache__"}:
            source, target = there.locate_file(name), site / name
            if os.path.isdir(source):
                shutil.copytree(source, target, copy_function=link, dirs_exist_ok=True)
            else:
                link(source, target)


def link(source, target):
    """The same file under another name, or its copy on another disk; what is there already stays."""
    if not os.path.exists(target):
        try:
            os.link(source, target)
        except OSError:
            shutil.copy2(source, target)
