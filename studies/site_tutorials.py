"""Tutorials as notebooks of the site: the cells of a script, with what each prints and draws."""

from __future__ import annotations

import contextlib
import html
import io
import os
import re
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from studies.site_text import highlighted, markdown_html

_PICTURES = (".png",)


def cells(text: str) -> list[tuple[str, str]]:
    """Kind ("markdown" or "code") and content of each cell of a script with ``# %%`` lines."""
    found = []
    for part in re.split(r"^# %%", text, flags=re.MULTILINE)[1:]:
        head, _, body = part.partition("\n")
        if "[markdown]" in head:
            found.append(("markdown", "\n".join(re.sub(r"^# ?", "", line) for line in body.splitlines())))
        else:
            found.append(("code", body.strip("\n")))
    return found


class Executed(NamedTuple):
    """A cell of a script that was run: kind and content, what it printed, and the pictures that it wrote, by name."""

    kind: str
    content: str
    printed: str = ""
    pictures: Mapping[str, bytes] = MappingProxyType({})


def executed(script: Path) -> Iterator[Executed]:
    """Run the cells of a script one after the other, in a folder that is not kept.

    Raises
    ------
    Exception
        Whatever a cell raises.
    """
    names: dict[str, Any] = {"__name__": "__main__"}
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        for kind, content in cells(script.read_text(encoding="utf-8")):
            if kind == "markdown":
                yield Executed(kind, content)
                continue
            try:
                os.chdir(folder)
                printed, pictures = _run(content, names, Path(folder), script.stem)
            finally:
                os.chdir(home)
            yield Executed(kind, content, printed, pictures)


def _run(code: str, names: dict[str, Any], folder: Path, stem: str) -> tuple[str, dict[str, bytes]]:
    """Run a cell; what it prints, and the pictures that it writes."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        exec(compile(code, stem, "exec", dont_inherit=True), names)
    printed.write("".join(f"{one.category.__name__}: {one.message}\n" for one in warned))
    written = (path for path in sorted(folder.rglob("*")) if before.get(path) != path.stat().st_mtime_ns)
    return printed.getvalue(), {path.name: path.read_bytes() for path in written if path.suffix in _PICTURES}


def question_of(script: Path) -> str:
    """The question that a tutorial answers: its docstring."""
    return script.read_text(encoding="utf-8").split('"""')[1]


def notebook_html(script: Path, pictures: Path, run: bool) -> str:
    """The body of a tutorial's page; with ``run`` it has outputs, whose pictures go into a folder.

    Raises
    ------
    Exception
        Whatever a cell raises.
    """
    parts = [f"<p><em>{html.escape(question_of(script))}</em></p>"]
    told = cells(script.read_text(encoding="utf-8"))
    for cell in executed(script) if run else (Executed(*one) for one in told):
        if cell.kind == "markdown":
            parts.append(markdown_html(cell.content))
            continue
        parts.append(highlighted(cell.content, "python"))
        if cell.printed:
            parts.append(f'<pre class="output">{html.escape(cell.printed)}</pre>')
        for name, data in cell.pictures.items():
            pictures.mkdir(parents=True, exist_ok=True)
            (pictures / f"{script.stem}_{name}").write_bytes(data)
            parts.append(f'<p><img src="{script.stem}_{name}" alt="{script.stem}: {Path(name).stem}"></p>')
    return "\n".join(parts)
