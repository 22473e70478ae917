"""The words of the package: a list of old ones with the field's terms, which keeps the old ones from coming back.

Module headlines, docstrings, help texts and messages of ``modalshell``, ``studies`` and ``paper_figures`` are read, and
the documents.
"""

import ast
import re

import pytest
from guide import CONTRIBUTING, ROOT

REPLACED = {
    r"in earnest": "really",
    r"carried up|carries up": "prolonged, interpolated",
}
"""Old word -> what to write."""
PACKAGES = ("modalshell", "studies", "paper_figures")


def texts(path):
    """(line, text) of every docstring and message of a module, or of every line of a document."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return list(enumerate(source.splitlines(), start=1))
    nodes = ast.walk(ast.parse(source))
    strings = (node for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str))
    return [(node.lineno, node.value) for node in strings if " " in node.value]


def files():
    yield from (ROOT / "README.md", CONTRIBUTING)
    for package in PACKAGES:
        yield from (path for path in sorted((ROOT / package).rglob("*.py")) if "generated" not in path.parts)


@pytest.mark.parametrize("old", REPLACED)
def test_old_words_stay_away(old):
    pattern = re.compile(rf"\b({old})\b", re.IGNORECASE)
    found = [
        f"{path.relative_to(ROOT)}:{line}: {match[0]!r}"
        for path in files()
        for line, text in texts(path)
        for match in pattern.finditer(" ".join(text.split()))
    ]
    assert not found, f"write {REPLACED[old]!r} instead: {found}"
