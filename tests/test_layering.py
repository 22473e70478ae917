"""Who may import whom: every import of the packages, lazy ones included, runs down a list of layers."""

import ast
from functools import cache
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
ROOT = "modalshell"
PACKAGES = (ROOT, "studies", "paper_figures")
LAYERS = (
    "core", "files kernels", "linalg mesh", "loads supports", "shell", "modes",
    "statics", "contact integrators", "models", "analysis motion", "scene", "render", "page", "export plot springs",
    "compare run sweep", "crowd viewer", ROOT, "commands", "__main__ symbolic",
)  # fmt: skip
"""Folders and files of the package from the ground up; ROOT is its ``__init__.py``. None imports its own layer."""
FLOOR = {name: floor for floor, names in enumerate(LAYERS) for name in names.split()}
FORBIDDEN = {name: {"render", "page", "plot"} for name in ("mesh", "shell", "statics", "modes", "models", "motion")}
FORBIDDEN |= {"studies": {"paper_figures", "viewer", "__main__"}}
FOR_FIGURES = ("render", "files.study_result", "compare.draw", "compare.engines.engine", "models.registry")


@cache
def files_of(*packages):
    paths = (path for package in packages for path in sorted((REPOSITORY / package).rglob("*.py")))
    parts = ((path, path.relative_to(REPOSITORY).with_suffix("").parts) for path in paths)
    return {".".join(names[:-1] if names[-1] == "__init__" else names): path for path, names in parts}


def layer(name):
    """Folder or file of the package that a dotted name belongs to; outside the package its first part."""
    parts = name.split(".")
    return parts[1] if parts[0] == ROOT and len(parts) > 1 else parts[0]


def imports(name, source, is_package, known):
    """Modules of the packages that ``source`` imports anywhere: at the top, in functions, through importlib."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = name.split(".")[: len(name.split(".")) - node.level + is_package] if node.level else []
            origin = ".".join([*above, *filter(None, [node.module])])
            inner = {alias.name: f"{origin}.{alias.name}" for alias in node.names}
            found |= {inner[alias.name] if inner[alias.name] in known else origin for alias in node.names}
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in ("import_module", "__import__"):
                found.add(str(node.args[0].value))
    return {target for target in found if target.split(".")[0] in PACKAGES}


@cache
def imports_of_file(name):
    path, known = files_of(*PACKAGES)[name], set(files_of(*PACKAGES))
    return imports(name, path.read_text(encoding="utf-8"), path.name == "__init__.py", known)


def package_graph(*packages):
    return {name: imports_of_file(name) for name in files_of(*packages)}


def violations(graph):
    arrows = {(layer(name), layer(target), name, target) for name, targets in graph.items() for target in targets}
    return sorted(
        f"{name} imports {target}: {below} may not import {above}"
        for below, above, name, target in arrows
        if above in FORBIDDEN.get(below, ())
        or (below != above and below in FLOOR and FLOOR.get(above, len(LAYERS)) >= FLOOR[below])
    )


def cycle(graph):
    """Modules on an import cycle or on a path between two: what is left when leaves are trimmed at both ends."""
    edges = {name: targets & graph.keys() - {name} for name, targets in graph.items()}
    for _ in range(2):
        while leaves := {name for name, targets in edges.items() if not targets & edges.keys()}:
            edges = {name: targets for name, targets in edges.items() if name not in leaves}
        edges = {name: {user for user, targets in edges.items() if name in targets} for name in edges}
    return sorted(edges)


def test_every_folder_has_a_layer():
    assert {layer(name) for name in files_of(ROOT)} == set(FLOOR)


def test_imports_run_down():
    assert violations(package_graph(*PACKAGES)) == []


def test_imports_exist_and_make_no_cycle_between_files():
    graph, known = package_graph(*PACKAGES), files_of(*PACKAGES)
    assert [(name, target) for name, targets in graph.items() for target in targets if target not in known] == []
    assert cycle(graph) == []


def test_figures_read_results_and_simulate_nothing():
    allowed = (*(f"{ROOT}.{name}." for name in FOR_FIGURES), "paper_figures.")
    graph = package_graph("paper_figures")
    assert [(name, t) for name, targets in graph.items() for t in targets if not f"{t}.".startswith(allowed)] == []


def test_only_symbolic_imports_sympy():
    assert {layer(name) for name, path in files_of(ROOT).items() if "import sympy" in path.read_text()} == {"symbolic"}


def test_the_checker_sees_forbidden_imports_and_cycles():
    for source, target in (
        ("import modalshell.models", "modalshell.models"),
        ("def f():\n    from ..models import LinearModal", "modalshell.models"),
        ("import importlib\nimportlib.import_module('modalshell.render')", "modalshell.render"),
        ("if TYPE_CHECKING:\n    from modalshell import Shell", "modalshell"),
        ("from studies import tradeoff", "studies.tradeoff"),
    ):
        found = imports("modalshell.mesh.shapes", source, False, set(files_of(*PACKAGES)))
        assert found == {target}
        assert len(violations({"modalshell.mesh.shapes": found})) == 1
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["b", "c"]
    assert cycle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
