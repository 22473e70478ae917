"""Who may import whom: every import in the package, lazy ones inside functions included, against one table."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "modalshell"
ROOT = "modalshell"
LINE_LIMIT = 500

# Top-level module -> the top-level modules it may import. Left to right, as the pipeline runs; never back.
# "modalshell" itself stands for the names that modalshell/__init__.py hands out. A new top-level module is an error
# until it has its row here.
_PLAIN = {"errors", "checks", "files", "hold"}
_TO_MOTION = _PLAIN | {"kernels", "mesh", "shell", "modes", "springs", "rungs", "motion"}
MAY_IMPORT = {
    "errors": set(),
    "checks": {"errors"},
    "files": {"errors", "checks"},
    "hold": {"errors"},
    "bundled": {"errors", "files"},
    "kernels": {"errors"},
    "mesh": _PLAIN | {"kernels"},
    "shell": _PLAIN | {"kernels", "mesh"},
    "modes": _PLAIN | {"kernels", "mesh", "shell"},
    "springs": _PLAIN | {"kernels", "mesh", "shell"},
    "rungs": _PLAIN | {"kernels", "mesh", "shell", "modes", "springs"},
    "motion": _PLAIN | {"kernels", "mesh", "shell", "modes", "rungs"},
    "crowd": _PLAIN | {"kernels", "mesh", "shell", "modes", "rungs"},
    "measure": {"errors", "checks", "mesh", "shell"},
    "render": _PLAIN | {"mesh"},
    "selection": _TO_MOTION,
    "export": _TO_MOTION,
    "study": _TO_MOTION | {"measure", "selection", "bundled"},
    "scene": _TO_MOTION | {"crowd", "selection", "study"},
    "run": _TO_MOTION | {"crowd", "export", "render", "scene", "study"},
    "ladder": _TO_MOTION | {"measure", "render", "scene", "study"},
    "viewer": _TO_MOTION | {"render", "run", "scene"},
    "doctor": {"errors", "modes", "render"},
    "sweep": _TO_MOTION | {"measure", "render", "scene", "study"},
    "reproduce": _PLAIN | {"study", "bundled"},
    "cli": _TO_MOTION
    | {
        "measure",
        "selection",
        "export",
        "render",
        "study",
        "scene",
        "run",
        "ladder",
        "viewer",
        "doctor",
        "sweep",
        "reproduce",
        "bundled",
        ROOT,
    },
    "__main__": {"cli"},
    "symbolic": set(),
    ROOT: _TO_MOTION | {"crowd", "measure", "selection", "export", "study", "scene", "run", "ladder", "sweep"},
}


def module_name(path: Path) -> str:
    parts = [ROOT, *path.relative_to(PACKAGE).with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def layer(name: str) -> str:
    """Top-level module that a dotted name belongs to; the package's own name for modalshell/__init__.py."""
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else ROOT


FILES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imports(name: str, source: str, is_package: bool, known: set[str]) -> set[str]:
    """Modules of the package that ``source`` imports anywhere: at the top, in functions, through importlib."""
    found = set()

    def add(target: str) -> None:
        if target.split(".")[0] == ROOT:
            found.add(target)

    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                add(alias.name)
        elif isinstance(node, ast.ImportFrom):
            origin = node.module or ""
            if node.level:
                parts = name.split(".")
                parts = parts[: len(parts) - node.level + is_package]
                origin = ".".join([*parts, origin] if origin else parts)
            for alias in node.names:
                inner = f"{origin}.{alias.name}"
                add(inner if inner in known else origin)
        elif isinstance(node, ast.Call):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            constant = node.args and isinstance(node.args[0], ast.Constant) and isinstance(node.args[0].value, str)
            if called in ("import_module", "__import__") and constant:
                add(node.args[0].value)
    return found


def package_graph() -> dict[str, set[str]]:
    known = set(FILES)
    return {
        name: imports(name, path.read_text(encoding="utf-8"), path.name == "__init__.py", known)
        for name, path in FILES.items()
    }


def violations(graph: dict[str, set[str]]) -> list[str]:
    return [
        f"{name} imports {target}: {layer(name)} may not import {layer(target)}"
        for name, targets in sorted(graph.items())
        for target in sorted(targets)
        if layer(target) != layer(name) and layer(target) not in MAY_IMPORT.get(layer(name), set())
    ]


def trimmed(edges: dict[str, set[str]]) -> dict[str, set[str]]:
    """The graph without the modules whose imports end: taken away leaf by leaf."""
    left = dict(edges)
    while leaves := {name for name, targets in left.items() if not targets & left.keys()}:
        left = {name: targets for name, targets in left.items() if name not in leaves}
    return left


def cycle(graph: dict[str, set[str]]) -> list[str]:
    """Modules on an import cycle or on a path between two: what is left when both ends are trimmed."""
    edges = {name: {target for target in targets if target in graph} - {name} for name, targets in graph.items()}
    left = trimmed(edges)
    users = {name: {user for user, targets in left.items() if name in targets} for name in left}
    return sorted(trimmed(users))


def test_every_top_level_module_has_a_row():
    present = {layer(name) for name in FILES}
    assert present - set(MAY_IMPORT) == set(), "add the new module, and what it may import, to MAY_IMPORT"
    folders = {path.name for path in PACKAGE.iterdir() if path.is_dir() and any(path.rglob("*.py"))}
    assert folders - set(MAY_IMPORT) == set()


def test_imports_run_left_to_right():
    assert violations(package_graph()) == []


def test_the_table_itself_has_no_cycle():
    rows = {f"{ROOT}.{name}" if name != ROOT else ROOT: targets for name, targets in MAY_IMPORT.items()}
    graph = {name: {f"{ROOT}.{t}" if t != ROOT else ROOT for t in targets} for name, targets in rows.items()}
    assert cycle(graph) == []
    assert set().union(*MAY_IMPORT.values()) <= set(MAY_IMPORT)
    assert not any("symbolic" in targets for targets in MAY_IMPORT.values())
    assert [name for name, targets in MAY_IMPORT.items() if "cli" in targets] == ["__main__"]


def test_no_import_cycles_between_files():
    assert cycle(package_graph()) == []


def test_every_import_of_the_package_exists():
    graph = package_graph()
    missing = [(name, target) for name, targets in graph.items() for target in targets if target not in FILES]
    assert missing == []


def test_only_symbolic_imports_sympy():
    users = set()
    for name, path in FILES.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(imported.split(".")[0] == "sympy" for imported in names):
                users.add(layer(name))
    assert users == {"symbolic"}


@pytest.mark.parametrize("folder", ["modalshell", "studies", "paper_figures", "meshes", "tests"])
def test_files_are_short(folder):
    files = [path for path in (PACKAGE.parent / folder).rglob("*.py") if path.parent.name != "generated"]
    assert files
    long = [path.name for path in files if len(path.read_text(encoding="utf-8").splitlines()) > LINE_LIMIT]
    assert long == []


@pytest.mark.parametrize(
    ("source", "target"),
    [
        ("import modalshell.rungs", "modalshell.rungs"),
        ("def f():\n    from modalshell.rungs import linear", "modalshell.rungs.linear"),
        ("def f():\n    from ..rungs import LinearModal", "modalshell.rungs"),
        ("class A:\n    def f(self):\n        import modalshell.rungs.linear as x", "modalshell.rungs.linear"),
        ("import importlib\nimportlib.import_module('modalshell.rungs')", "modalshell.rungs"),
        ("if TYPE_CHECKING:\n    from modalshell import Shell", "modalshell"),
    ],
)
def test_the_checker_sees_forbidden_imports(source, target):
    found = imports("modalshell.mesh.shapes", source, False, set(FILES))
    assert found == {target}
    assert len(violations({"modalshell.mesh.shapes": found})) == 1


def test_the_checker_sees_cycles():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["b", "c"]
    assert cycle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
