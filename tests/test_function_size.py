"""Functions are short and take few arguments, but for those of a table that says why."""

import ast

import pytest
from test_layering import REPOSITORY, ROOT

MOST_LINES, MOST_ARGUMENTS = 80, 8
OPTIONS = "public function of many keyword options, most with a default"
KERNEL = "kernel whose numbers stay in registers from line to line"
INTERFACE = "arguments of the generated kernels in whose place it stands"
REASONS = {
    "analysis.fit.fit": OPTIONS,
    "analysis.paths.equilibrium_path": OPTIONS,
    "compare.advise.advise": OPTIONS,
    "compare.tradeoff.tradeoff": OPTIONS,
    "crowd.flock.Flock.__init__": OPTIONS,
    "models.error_bars.error_bar": OPTIONS,
    "models.hybrid_stress.HybridStress.trained": OPTIONS,
    "motion.simulate.simulate": OPTIONS,
    "motion.stepping.Motion.__init__": OPTIONS,
    "page.shell_page.shell_page": OPTIONS,
    "render.film.write_film": OPTIONS,
    "render.views.draw_views": OPTIONS,
    "shell.shell.Shell.__init__": OPTIONS,
    "springs.spring_sheet.SpringSheet.__init__": OPTIONS,
    "sweep.driver.run_sweep": OPTIONS,
    "linalg.profile.factorise": KERNEL,
    "shell.mirrored_hinges.MirroredFlexure.add_stiffness": INTERFACE,
}
"""Why each function is longer than MOST_LINES or has more than MOST_ARGUMENTS; kernels' files take raw arrays."""


def is_of_kernels(path):
    """Whether a file is generated, or of kernels, which take raw arrays."""
    return {"generated", "kernels"} & set(path.parts[:-1]) or path.stem.endswith("_kernels")


def large_functions(name, source):
    """Dotted names of the functions that are too long or take too many arguments, without ``self`` and ``cls``."""
    found = []
    pending = [(name, ast.parse(source))]
    while pending:
        outer, node = pending.pop()
        for child in ast.iter_child_nodes(node):
            inner = f"{outer}.{child.name}" if hasattr(child, "name") and hasattr(child, "body") else outer
            pending.append((inner, child))
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                given = child.args.posonlyargs + child.args.args + child.args.kwonlyargs
                arguments = [each.arg for each in given if each.arg not in ("self", "cls")]
                if child.end_lineno - child.lineno >= MOST_LINES or len(arguments) > MOST_ARGUMENTS:
                    found.append(inner)
    return found


def test_functions_are_short_and_take_few_arguments_or_say_why_not():
    large, package = [], REPOSITORY / ROOT
    for path in sorted(package.rglob("*.py")):
        if not is_of_kernels(path.relative_to(package)):
            name = ".".join(path.relative_to(package).with_suffix("").parts)
            large += large_functions(name, path.read_text(encoding="utf-8"))
    assert sorted(set(large) - REASONS.keys()) == []
    assert sorted(REASONS.keys() - set(large)) == []  # rows of functions that have shrunk or gone


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("def f(a, b, c, d, e, f, g, h): pass", []),
        ("def f(a, b, /, c, d, *, e, f, g, h, i): pass", ["m.f"]),
        ("class A:\n def f(self, a, b, c, d, e, f, g, h, *i): pass", []),
        ("class A:\n async def f(self, a, b, c, d, e, f, g, h, i): pass", ["m.A.f"]),
        ("def f():\n def g(a, b, c, d, e, f, g, h, i): pass", ["m.f.g"]),
        ("def f():\n" + 79 * " pass\n", []),
        ("def f():\n" + 80 * " pass\n", ["m.f"]),
    ],
)
def test_the_checker_sees_large_functions(source, found):
    assert large_functions("m", source) == found
