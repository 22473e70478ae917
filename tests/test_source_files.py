"""Files are short, pages small, and studies keep to what other studies make public."""

import ast
import subprocess

import pytest
from test_layering import REPOSITORY, ROOT, files_of, layer, package_graph

LINE_LIMITS = {ROOT: 400, "studies": 400, "paper_figures": 400, "tests": 500}
LARGEST_PAGE = 500_000
"""Bytes of the largest web page that is committed; of others studies/README.md has the command."""


def private_names(source: str) -> set[str]:
    """Names with an underscore that ``source`` takes from a module of the studies."""
    taken, modules = set(), set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "studies":
            modules |= {alias.asname or alias.name for alias in node.names}
            taken |= {alias.name for alias in node.names if alias.name.startswith("_")}
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.attr.startswith("_"):
            taken |= {f"{node.value.id}.{node.attr}"}
    return {name for name in taken if "." not in name or name.split(".")[0] in modules}


def test_studies_use_the_package_and_what_other_studies_make_public():
    for name, targets in package_graph("studies").items():
        assert {layer(target) for target in targets} & {"paper_figures", "cli", "viewer", "__main__"} == set(), name
    assert {name: private_names(path.read_text()) for name, path in files_of("studies").items()} == {
        name: set() for name in files_of("studies")
    }


@pytest.mark.parametrize("folder", LINE_LIMITS)
def test_files_are_short(folder):
    files = [path for path in (REPOSITORY / folder).rglob("*.py") if path.parent.name != "generated"]
    assert files
    limit = LINE_LIMITS[folder]
    long = [path.name for path in files if len(path.read_text(encoding="utf-8").splitlines()) > limit]
    assert long == []


def test_web_pages_are_small():
    listed = subprocess.run(["git", "ls-files", "-z", "*.html"], cwd=REPOSITORY, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no checkout of git")
    pages = [REPOSITORY / name for name in listed.stdout.split("\0") if name]
    assert pages
    large = [page.name for page in pages if page.exists() and page.stat().st_size > LARGEST_PAGE]
    assert large == []


def test_the_checker_sees_private_names_of_studies():
    assert private_names("from studies.tradeoff import _row") == {"_row"}
    assert private_names("from studies import tradeoff as t\nt._row()") == {"t._row"}
    assert private_names("from modalshell import _row\nself._row()") == set()
