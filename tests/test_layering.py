"""Who may import whom: every import in the packages, lazy ones inside functions included, against one table."""

import ast
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
ROOT = "modalshell"
PACKAGE = REPOSITORY / ROOT
PACKAGES = (ROOT, "studies", "paper_figures")
_FOR_FIGURES = ("render", "study", "compare.draw", "engines.engine", "models.registry", "typing")
FIGURES_MAY_IMPORT = tuple(f"modalshell.{name}" for name in _FOR_FIGURES)

# Top-level module -> the top-level modules that it imports, no more and no fewer, in the order of the pipeline: no row
# names one below it. "modalshell" itself (ROOT) stands for the names that modalshell/__init__.py hands out.
MAY_IMPORT: dict[str, set[str]] = {
    "brief": set(),
    "errors": set(),
    "interruption": set(),
    "outcome": set(),
    "sharing": set(),
    "symbolic": set(),
    "timings": set(),
    "typing": set(),
    "units": set(),
    "work": set(),
    "checks": {"errors"},
    "kernels": {"errors"},
    "lock": {"errors"},
    "memory": {"errors"},
    "provenance": {"errors"},
    "triangles": {"typing"},
    "linalg": {"errors", "kernels", "typing"},
    "plugins": {"checks", "errors"},
    "reading": {"memory"},
    "atomic_io": {"checks", "errors", "memory", "reading"},
    "render": {"atomic_io", "checks", "errors", "kernels", "memory", "typing"},
    "study": {"atomic_io", "checks", "errors"},
    "mesh": {"brief", "checks", "errors", "memory", "reading", "render", "sharing", "triangles"},
    "page": {"atomic_io", "checks", "errors", "mesh", "render", "typing"},
    "selection": {"checks", "errors", "mesh", "sharing"},
    "loads": {"checks", "errors", "kernels", "mesh", "selection", "sharing", "typing"},
    "supports": {"checks", "errors", "mesh", "selection", "sharing", "typing"},
    "shell": {
        "brief",
        "checks",
        "errors",
        "kernels",
        "loads",
        "memory",
        "mesh",
        "sharing",
        "supports",
        "typing",
        "work",
    },
    "constraints": {"checks", "errors", "kernels", "sharing", "shell", "typing"},
    "measure": {"checks", "errors", "loads", "mesh", "shell", "triangles", "typing"},
    "modes": {
        "atomic_io",
        "brief",
        "checks",
        "errors",
        "linalg",
        "loads",
        "memory",
        "mesh",
        "page",
        "plugins",
        "render",
        "sharing",
        "shell",
        "supports",
        "typing",
        "units",
        "work",
    },
    "springs": {"brief", "checks", "errors", "kernels", "mesh", "page", "shell", "supports", "typing"},
    "doctor": {"errors", "modes", "render"},
    "engines": {"brief", "errors", "mesh", "modes", "shell", "supports", "typing"},
    "statics": {
        "brief",
        "checks",
        "constraints",
        "errors",
        "kernels",
        "loads",
        "modes",
        "outcome",
        "sharing",
        "shell",
        "timings",
        "typing",
        "work",
    },
    "integrators": {
        "checks",
        "errors",
        "kernels",
        "linalg",
        "modes",
        "sharing",
        "shell",
        "springs",
        "statics",
        "timings",
        "typing",
        "work",
    },
    "reduction": {
        "brief",
        "checks",
        "errors",
        "kernels",
        "loads",
        "memory",
        "mesh",
        "modes",
        "sharing",
        "shell",
        "statics",
        "supports",
        "timings",
        "triangles",
        "typing",
        "work",
    },
    "models": {
        "atomic_io",
        "brief",
        "checks",
        "constraints",
        "errors",
        "integrators",
        "kernels",
        "linalg",
        "loads",
        "memory",
        "mesh",
        "modes",
        "outcome",
        "page",
        "plugins",
        "reduction",
        "render",
        "selection",
        "sharing",
        "shell",
        "springs",
        "statics",
        "timings",
        "typing",
        "work",
    },
    "crowd": {"checks", "errors", "integrators", "kernels", "models", "modes", "page", "reduction", "typing"},
    "motion": {
        "brief",
        "checks",
        "constraints",
        "errors",
        "kernels",
        "loads",
        "memory",
        "models",
        "outcome",
        "reduction",
        "render",
        "shell",
        "statics",
        "timings",
        "typing",
        "units",
    },
    "export": {
        "atomic_io",
        "checks",
        "errors",
        "modes",
        "motion",
        "outcome",
        "reading",
        "sharing",
        "shell",
        "typing",
        "units",
    },
    "scene": {
        "atomic_io",
        "brief",
        "checks",
        "constraints",
        "crowd",
        "errors",
        "loads",
        "mesh",
        "models",
        "modes",
        "motion",
        "page",
        "plugins",
        "provenance",
        "reading",
        "selection",
        "shell",
        "supports",
        "typing",
        "units",
    },
    "compare": {
        "atomic_io",
        "brief",
        "checks",
        "engines",
        "errors",
        "integrators",
        "measure",
        "mesh",
        "models",
        "modes",
        "motion",
        "outcome",
        "provenance",
        "render",
        "scene",
        "shell",
        "statics",
        "study",
        "timings",
        "triangles",
        "typing",
        "work",
    },
    "run": {
        "atomic_io",
        "brief",
        "checks",
        "crowd",
        "errors",
        "export",
        "lock",
        "memory",
        "models",
        "motion",
        "outcome",
        "provenance",
        "reading",
        "render",
        "scene",
        "shell",
        "statics",
        "timings",
        "triangles",
        "typing",
        "units",
    },
    "sweep": {
        "atomic_io",
        "brief",
        "checks",
        "errors",
        "lock",
        "measure",
        "mesh",
        "models",
        "motion",
        "outcome",
        "provenance",
        "reading",
        "render",
        "scene",
        "timings",
        "typing",
        "units",
    },
    ROOT: {
        "compare",
        "constraints",
        "crowd",
        "errors",
        "export",
        "interruption",
        "loads",
        "measure",
        "mesh",
        "models",
        "modes",
        "motion",
        "outcome",
        "reduction",
        "run",
        "scene",
        "shell",
        "statics",
        "supports",
        "sweep",
        "units",
    },
    "viewer": {
        "checks",
        "errors",
        "models",
        "modes",
        "motion",
        "outcome",
        "render",
        "run",
        "scene",
        "shell",
        "timings",
        "typing",
    },
    "commands": {
        "atomic_io",
        "checks",
        "errors",
        "export",
        "mesh",
        ROOT,
        "models",
        "modes",
        "motion",
        "outcome",
        "page",
        "reading",
        "render",
        "run",
        "scene",
        "selection",
        "statics",
        "timings",
        "typing",
        "viewer",
    },
    "cli": {"atomic_io", "checks", "commands", "compare", "doctor", "errors", "memory", ROOT, "provenance", "scene"},
    "__main__": {"cli"},
}


def module_name(path: Path) -> str:
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def layer(name: str) -> str:
    """Top-level module that a dotted name belongs to; the package's own name outside it and for its __init__.py."""
    parts = name.split(".")
    return parts[1] if parts[0] == ROOT and len(parts) > 1 else parts[0]


def files_of(*packages: str) -> dict[str, Path]:
    return {module_name(path): path for package in packages for path in sorted((REPOSITORY / package).rglob("*.py"))}


def imports(name: str, source: str, is_package: bool, known: set[str]) -> set[str]:
    """Modules of the packages that ``source`` imports anywhere: at the top, in functions, through importlib."""
    found = set()

    def add(target: str) -> None:
        if target.split(".")[0] in PACKAGES:
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


def package_graph(*packages: str) -> dict[str, set[str]]:
    known = set(files_of(*PACKAGES))
    return {
        name: imports(name, path.read_text(encoding="utf-8"), path.name == "__init__.py", known)
        for name, path in files_of(*packages or (ROOT,)).items()
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
    present = {layer(name) for name in files_of(ROOT)}
    assert present - set(MAY_IMPORT) == set(), "add the new module, and what it may import, to MAY_IMPORT"
    folders = {path.name for path in PACKAGE.iterdir() if path.is_dir() and any(path.rglob("*.py"))}
    assert folders - set(MAY_IMPORT) == set()


def test_imports_run_left_to_right():
    assert violations(package_graph()) == []


def test_the_table_is_exact():
    used: dict[str, set[str]] = {name: set() for name in MAY_IMPORT}
    for name, targets in package_graph().items():
        used[layer(name)] |= {layer(target) for target in targets} - {layer(name)}
    assert used == MAY_IMPORT, "delete the permissions that nothing uses, and add those that are new"


def test_rows_run_along_the_pipeline():
    rows = list(MAY_IMPORT)
    assert [(name, target) for k, name in enumerate(rows) for target in MAY_IMPORT[name] if target in rows[k:]] == []


def test_the_table_itself_has_no_cycle():
    rows = {f"{ROOT}.{name}" if name != ROOT else ROOT: targets for name, targets in MAY_IMPORT.items()}
    graph = {name: {f"{ROOT}.{t}" if t != ROOT else ROOT for t in targets} for name, targets in rows.items()}
    assert cycle(graph) == []
    assert set().union(*MAY_IMPORT.values()) <= set(MAY_IMPORT)
    assert not any("symbolic" in targets for targets in MAY_IMPORT.values())
    assert [name for name, targets in MAY_IMPORT.items() if "cli" in targets] == ["__main__"]


def test_no_import_cycles_between_files():
    assert cycle(package_graph(*PACKAGES)) == []


def test_every_import_of_the_packages_exists():
    graph, known = package_graph(*PACKAGES), files_of(*PACKAGES)
    missing = [(name, target) for name, targets in graph.items() for target in targets if target not in known]
    assert missing == []


def test_figures_read_results_and_simulate_nothing():
    for name, targets in package_graph("paper_figures").items():
        allowed = (*FIGURES_MAY_IMPORT, "paper_figures")
        assert [t for t in targets if not any(t == a or t.startswith(f"{a}.") for a in allowed)] == [], name


def test_only_symbolic_imports_sympy():
    users = set()
    for name, path in files_of(ROOT).items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(imported.split(".")[0] == "sympy" for imported in names):
                users.add(layer(name))
    assert users == {"symbolic"}


@pytest.mark.parametrize(
    ("source", "target"),
    [
        ("import modalshell.models", "modalshell.models"),
        ("def f():\n    from modalshell.models import linear", "modalshell.models.linear"),
        ("def f():\n    from ..models import LinearModal", "modalshell.models"),
        ("class A:\n    def f(self):\n        import modalshell.models.linear as x", "modalshell.models.linear"),
        ("import importlib\nimportlib.import_module('modalshell.models')", "modalshell.models"),
        ("if TYPE_CHECKING:\n    from modalshell import Shell", "modalshell"),
        ("from studies import tradeoff", "studies.tradeoff"),
    ],
)
def test_the_checker_sees_forbidden_imports(source, target):
    found = imports("modalshell.mesh.shapes", source, False, set(files_of(*PACKAGES)))
    assert found == {target}
    assert len(violations({"modalshell.mesh.shapes": found})) == 1


def test_the_checker_sees_cycles():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": set()}) == ["b", "c"]
    assert cycle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []
