"""The words of the package: a list of old ones with the field's terms, which keeps the old ones from coming back.

Module headlines, docstrings, help texts and messages of ``modalshell``, ``studies`` and ``paper_figures`` are read, and
the documents.
"""

import ast
import re
from functools import cache

import pytest
from guide import CONTRIBUTING, ROOT

REPLACED = {
    r"in earnest": "really",
    r"without a word": "silently",
    r"carr(y|ies|ied) (up|to the fine mesh)": "prolong",
    r"hand(s|ed)? down": "restrict",
    r"puts? away": "save, checkpoint",
    r"tak(e|es|en|ing) up": "restore, resume",
    r"whole or not (there|at all)": "atomic",
    r"(go|goes|going|gone|went) on (after|where|with|from there|from a)": "continue, resume",
    r"begun anew|anew": "again, restarted",
    r"besides?": "next to, in addition to, with",
    r"shall": "must, will; a prescribed position",
    r"given up": "aborted",
    r"mend(s|ed|ing)?": "repair, correct",
    r"told": "reported",
    r"in words": "as text",
    r"so many": "this many; 'number of'",
    r"held against": "compared with",
    r"where there (is|are|can be) none": "if there is none",
    r"what (else )?(is|has) to be said": "message, note",
    r"one an? (vertex|triangle|mode|line|frame|step|row)": "one per",
    r"one (row|value|sample|number) an? \w+": "one ... per",
    r"anyhow|likewise|if need be": "(leave it out)",
    r"holding a file": "file lock",
    r"packed numbers": "SIMD vectors",
    r"workshop": "factory",
    r"a push on": "generalised force",
}
"""Old word -> what to write."""
ONLY_IN = {
    r"flexion": ("modalshell/springs", "modalshell/kernels", "studies"),
    r"pinned": ("modalshell/springs", "modalshell/supports", "modalshell/kernels"),
}
"""Words of one place: springs across second neighbours and masses that do not move, as their public names are."""
ELSEWHERE = {"flexion": "flexure", "pinned": "clamped; Pin"}


@cache
def read(path):
    """(line, text) of every docstring and message of a module, or of every line of a document; the first docstring."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return list(enumerate(source.splitlines(), start=1)), ""
    tree = ast.parse(source)
    strings = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))
    texts = [(node.lineno, " ".join(node.value.split())) for node in strings if " " in node.value]
    return texts, ast.get_docstring(tree) or ""


@cache
def files():
    theory = sorted((ROOT / "studies" / "theory").glob("*.md"))
    written = (ROOT / "README.md", ROOT / "studies" / "README.md", CONTRIBUTING, *theory)
    modules = (
        path
        for package in ("modalshell", "studies", "paper_figures")
        for path in sorted((ROOT / package).rglob("*.py"))
        if "generated" not in path.parts
    )
    return (*written, *modules)


def places(word, left_out=()):
    """Where a word stands, outside of some folders and files."""
    pattern = re.compile(rf"\b({word})\b", re.IGNORECASE)
    for path in files():
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith(tuple(left_out)):
            yield from (f"{name}:{line}" for line, text in read(path)[0] if pattern.search(text))


@pytest.mark.parametrize("old", REPLACED)
def test_old_words_stay_away(old):
    found = list(places(old))
    assert not found, f"write {REPLACED[old]!r} instead of {old!r}: {found}"


@pytest.mark.parametrize("word", ONLY_IN)
def test_words_of_one_place_stay_there(word):
    found = list(places(word, ONLY_IN[word]))
    assert not found, f"write {ELSEWHERE[word]!r} instead of {word!r}: {found}"


def test_the_list_finds_what_it_is_for(tmp_path, monkeypatch):
    module = tmp_path / "module.py"
    module.write_text('"""Files that are whole or not\nthere."""\n', encoding="utf-8")
    monkeypatch.setattr("test_words.files", lambda: (module,))
    monkeypatch.setattr("test_words.ROOT", tmp_path)
    assert list(places("whole or not (there|at all)")) == ["module.py:1"]


def test_every_module_begins_with_a_headline_of_one_sentence():
    for path in files():
        if path.suffix == ".py":
            headline = read(path)[1].split("\n\n")[0]
            assert headline.endswith((".", ":")), path
