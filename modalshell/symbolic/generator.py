"""Code generator: numba source of the energies, one module each, with common subexpressions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import sympy as sp
from sympy.printing.pycode import PythonCodePrinter

from modalshell.symbolic.energies import Energy, all_energies

GENERATED = Path(__file__).resolve().parents[1] / "shell" / "kernels" / "generated"
_TEMPLATE = Path(__file__).with_name("kernel.py.template")


class _KernelPrinter(PythonCodePrinter):  # type: ignore[misc]
    """Prints for numba and NumPy alike: small powers as products, so that no call to ``pow`` is left."""

    def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:  # noqa: ARG002 (SymPy's signature)
        base, exponent = expr.as_base_exp()
        text = self.parenthesize(base, 100)
        if not (2 * exponent).is_Integer or abs(exponent) > 4:
            raise ValueError(f"the kernel printer has no form for the power {expr} (got exponent {exponent})")
        whole, half = divmod(abs(int(2 * exponent)), 2)
        factors = [text] * whole + [f"np.sqrt({self._print(base)})"] * half
        product = factors[0] if len(factors) == 1 else "({})".format(" * ".join(factors))
        return f"(1.0 / {product})" if exponent < 0 else product

    def _print_Rational(self, expr: sp.Rational) -> str:
        return repr(float(expr))

    def _print_atan2(self, expr: sp.atan2) -> str:
        return f"np.arctan2({self._print(expr.args[0])}, {self._print(expr.args[1])})"


@dataclass(frozen=True)
class Kernel:
    """Generated source of one energy."""

    name: str
    """Module name."""
    source: str
    """Python source."""
    operations: int
    """Arithmetic operations of measure, gradient and Hessian together."""


def _statements(outputs: dict[str, sp.Expr]) -> tuple[str, int]:
    """Body of a function that assigns ``outputs`` (target text -> expression), and its operation count."""
    printer = _KernelPrinter({"fully_qualified_modules": False})
    symbols = sp.numbered_symbols("t")
    shared, reduced = sp.cse(list(outputs.values()), symbols=symbols, order="canonical")
    operations = sum(int(sp.count_ops(expression)) for _, expression in shared)
    operations += sum(int(sp.count_ops(expression)) for expression in reduced)
    lines = [f"    {symbol} = {printer.doprint(expression)}" for symbol, expression in shared]
    lines += [f"    {target} = {printer.doprint(value)}" for target, value in zip(outputs, reduced, strict=True)]
    return "\n".join(lines), operations


def generate(energy: Energy) -> Kernel:
    """Derive the gradient and the Hessian of one energy's measure and print its kernel module."""
    hessian = energy.hessian()
    measure_body, _ = _statements({"value": energy.measure})
    outputs = {"value": energy.measure}
    outputs |= {f"gradient[{k}]": entry for k, entry in enumerate(energy.gradient)}
    first_body, first_operations = _statements(outputs)
    outputs |= {f"hessian[{k}]": entry for k, entry in enumerate(hessian)}
    second_body, second_operations = _statements(outputs)

    forms: dict[str, sp.Expr] = {}
    for j, (factor, form) in enumerate(energy.squares):
        forms |= {f"factors[{j}]": factor} | {f"squares[{j}, {k}]": entry for k, entry in enumerate(form)}
    for j, pair in enumerate(energy.products):
        for name, form in zip(("firsts", "seconds"), pair, strict=True):
            forms |= {f"{name}[{j}, {k}]": entry for k, entry in enumerate(form)}
    split_body, _ = _statements({target: sp.sympify(entry) for target, entry in forms.items()})

    count = energy.vertex_count
    arguments = ", ".join(str(unknown) for unknown in energy.unknowns)
    loads = [f"v{vertex} = stencils[element, {vertex}]" for vertex in range(count)]
    relative = [f"x[v{vertex}, {axis}] - x[v0, {axis}]" for vertex in range(1, count) for axis in range(3)]
    fields = {
        "NAME": energy.name,
        "FORMULA": energy.formula,
        "MEASURE_NAME": energy.measure_name,
        "STENCIL": energy.stencil,
        "UNKNOWNS": str(len(energy.unknowns)),
        "VERTICES": str(count),
        "PERIODIC": str(energy.periodic),
        "FIRST_OPERATIONS": str(first_operations),
        "SECOND_OPERATIONS": str(second_operations),
        "ARGUMENTS": arguments,
        "MEASURE_BODY": measure_body,
        "FIRST_BODY": first_body,
        "SECOND_BODY": second_body,
        "SPLIT_BODY": split_body,
        "SQUARES": str(len(energy.squares)),
        "PRODUCTS": str(len(energy.products)),
        "LOADS": "\n    ".join(loads),
        "RELATIVE": ",\n        ".join(relative),
    }
    source = _TEMPLATE.read_text(encoding="utf-8")
    for key, text in fields.items():
        source = source.replace(f"@{key}@", text)
    return Kernel(energy.name, source, second_operations)


def generate_all() -> dict[str, str]:
    """File name -> source of everything in ``modalshell/shell/kernels/generated``."""
    kernels = [generate(energy) for energy in all_energies()]
    files = {f"{kernel.name}.py": kernel.source for kernel in kernels}
    names = ", ".join(sorted(kernel.name for kernel in kernels))
    table = "\n".join(f"{kernel.name}: {kernel.operations} operations" for kernel in kernels)
    files["__init__.py"] = (
        "# Generated by `python -m modalshell.symbolic`. Do not edit.\n"
        f'"""Generated kernels; measure, gradient and Hessian of one element together take\n\n{table}\n"""\n\n'
        f"from modalshell.shell.kernels.generated import {names}\n\n"
        f"__all__ = {sorted(kernel.name for kernel in kernels)!r}\n".replace("'", '"')
    )
    return files


def write(folder: Path = GENERATED) -> list[Path]:
    """Write every generated file into ``folder`` and return the paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, source in generate_all().items():
        path = folder / name
        path.write_text(source, encoding="utf-8")
        written.append(path)
    return written
