"""The generator of the kernels: what is committed is what it writes, and what it derives is right."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest
from later import later

from modalshell.shell.kernels import generated

_WHY = "SymPy generates the kernels: pip install 'modalshell[symbolic]'"
sp = later("sympy", _WHY)
energies = later("modalshell.symbolic.energies")
generator = later("modalshell.symbolic.generator")

REPOSITORY = Path(__file__).resolve().parents[2]
NAMES = ("stretch", "shear", "flexure")
DIGITS = 30


def random_point(energy, seed):
    """Rational unknowns, exact in SymPy: the point is the same at every precision."""
    numbers = np.random.default_rng(seed).integers(-999, 1000, len(energy.unknowns))
    return {unknown: sp.Rational(int(k), 500) for unknown, k in zip(energy.unknowns, numbers, strict=True)}


def evaluated(expression, point):
    return sp.N(expression.subs(point), DIGITS)


@pytest.fixture(scope="module")
def all_energies():
    return {energy.name: energy for energy in energies.all_energies()}


def committed():
    return {path.name: path.read_bytes() for path in generator.GENERATED.glob("*.py")}


def test_committed_files_are_what_the_generator_writes(tmp_path):
    """With this process's own hash seed; tests/test_documents.py generates them with a fixed one."""
    paths = generator.write(tmp_path / "fresh")
    assert {path.name for path in paths} == {"__init__.py", "stretch.py", "shear.py", "flexure.py"}
    assert {path.name: path.read_bytes() for path in paths} == committed()


@pytest.mark.by_default("stretch-1", "shear-0")
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", NAMES)
def test_closed_form_gradient_is_the_derivative_of_the_measure(all_energies, name, seed):
    energy = all_energies[name]
    point = random_point(energy, seed)
    for unknown, closed_form in zip(energy.unknowns, energy.gradient, strict=True):
        derivative = evaluated(sp.diff(energy.measure, unknown), point)
        assert abs(evaluated(closed_form, point) - derivative) <= sp.Float(10) ** (5 - DIGITS) * (1 + abs(derivative))


def test_fold_angle_is_the_atan2_of_the_paper(all_energies):
    energy = all_energies["flexure"]
    e, a, b = (sp.Matrix(energy.unknowns[k : k + 3]) for k in (0, 3, 6))
    n1, n2 = e.cross(a), b.cross(e)
    textbook = sp.atan2(n1.cross(n2).dot(e) / sp.sqrt(e.dot(e)), n1.dot(n2))
    for seed in range(3):
        point = random_point(energy, seed)
        assert abs(evaluated(energy.measure - textbook, point)) < sp.Float(10) ** (4 - DIGITS)


@pytest.mark.by_default("shear")
@pytest.mark.parametrize("name", NAMES)
def test_second_derivatives_are_symmetric(all_energies, name):
    energy = all_energies[name]
    size = len(energy.unknowns)
    lower = energy.hessian()
    assert len(lower) == size * (size + 1) // 2
    point = random_point(energy, 0)  # an identity that does not hold is off at any point
    for row in range(size):
        for column in range(row):
            packed = evaluated(lower[row * (row + 1) // 2 + column], point)
            mirror = evaluated(sp.diff(energy.gradient[column], energy.unknowns[row]), point)
            assert abs(packed - mirror) <= sp.Float(10) ** (5 - DIGITS) * (1 + abs(mirror))


@pytest.mark.by_default("shear-0")
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", NAMES)
def test_split_of_the_second_variation_adds_up(all_energies, name, seed):
    """Hess g = sum a r r^T + sum (m n^T + n m^T), with a positive and m, n orthogonal."""
    energy = all_energies[name]
    size = len(energy.unknowns)
    point = random_point(energy, seed)

    def row(form):
        return [evaluated(sp.sympify(entry), point) for entry in form]

    squares = [(evaluated(factor, point), row(form)) for factor, form in energy.squares]
    products = [(row(first), row(second)) for first, second in energy.products]
    assert all(factor > 0 for factor, _ in squares)
    tolerance = sp.Float(10) ** (6 - DIGITS)
    for first, second in products:
        lengths = sp.sqrt(sum(x * x for x in first) * sum(x * x for x in second))
        assert abs(sum(x * y for x, y in zip(first, second, strict=True))) <= tolerance * (1 + lengths)
    lower = iter(energy.hessian())
    for i in range(size):
        for j in range(i + 1):
            total = sum(factor * form[i] * form[j] for factor, form in squares)
            total += sum(m[i] * n[j] + n[i] * m[j] for m, n in products)
            exact = evaluated(next(lower), point)
            assert abs(total - exact) <= tolerance * (1 + abs(exact))


@pytest.mark.parametrize("name", NAMES)
def test_header_says_what_a_reader_needs(all_energies, name):
    source = committed()[f"{name}.py"].decode("utf-8")
    module = getattr(generated, name)
    energy = all_energies[name]
    assert "Do not edit" in source.splitlines()[0]
    assert "python -m modalshell.symbolic" in source.splitlines()[0]
    docstring = ast.get_docstring(ast.parse(source))
    assert energy.formula in docstring
    assert f"Stencil: {energy.stencil}." in docstring
    for vertex in range(energy.vertex_count):
        assert re.search(rf"\bx{vertex}\b", docstring)
    first, second = map(int, re.search(r"Operations of one element: (\d+) \(.*?\), (\d+) \(", docstring).groups())
    assert second == module.OPERATIONS
    assert 0 < first < second
    assert f"{name}: {second} operations" in generated.__doc__
    assert energy.vertex_count == module.VERTICES
    assert len(energy.unknowns) == module.UNKNOWNS
    assert module.PERIODIC is (name == "flexure")


@pytest.mark.parametrize("name", NAMES)
def test_operation_count_is_that_of_the_printed_code(name):
    """Counted anew in the source: operators and calls of ``_second``; SymPy counts a - b*c and signs a little apart."""
    tree = ast.parse(committed()[f"{name}.py"].decode("utf-8"))
    body = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "_second")
    printed = sum(
        isinstance(node, ast.BinOp | ast.Call) or (isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub))
        for node in ast.walk(body)
    )
    assert abs(getattr(generated, name).OPERATIONS - printed) <= 0.15 * printed


def test_hinge_is_as_lean_as_measured():
    """Nine edge-relative unknowns and the closed-form gradient: 542 operations or fewer, 2,517 over twelve unknowns."""
    assert generated.flexure.OPERATIONS <= 542


def test_generated_code_calls_no_power_and_no_acos():
    for name, source in committed().items():
        calls = {
            node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            for node in ast.walk(ast.parse(source))
            if isinstance(node, ast.Call)
        }
        assert not calls & {"pow", "power", "arccos", "acos"}, name
        assert not any(isinstance(node, ast.Pow) for node in ast.walk(ast.parse(source))), name


@pytest.mark.slow
def test_import_stays_light(imported):
    heavy = {"sympy", "pyvista", "vtkmodules", "matplotlib", "trimesh", "imageio_ffmpeg", "cyclopts", "dask", "warp"}
    assert {"modalshell.render", "modalshell.springs.device", "modalshell.crowd.device"} <= imported
    assert heavy & imported == set()
