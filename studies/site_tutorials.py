"""Tutorials as notebooks of the site: the cells of a script, with what each prints and draws."""

from __future__ import annotations

import contextlib
import html
import io
import os
import re
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any

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


def notebook_html(script: Path, pictures: Path, run: bool) -> str:
    """The body of a tutorial's page; with ``run`` it has outputs, whose pictures go into a folder.

    Raises
    ------
    Exception
        Whatever a cell raises.
    """
    text = script.read_text(encoding="utf-8")
    question = text.split('"""')[1]
    parts = [f"<p><em>{html.escape(question)}</em></p>"]
    names: dict[str, Any] = {"__name__": "__main__"}
    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        try:
            os.chdir(folder)
            for kind, content in cells(text):
                if kind == "markdown":
                    parts.append(markdown_html(content))
                    continue
                parts.append(highlighted(content, "python"))
                if run:
                    parts.append(_output(content, names, Path(folder), pictures, script.stem))
        finally:
            os.chdir(home)
    return "\n".join(parts)


def _output(code: str, names: dict[str, Any], folder: Path, pictures: Path, stem: str) -> str:
    """Run a cell; what it prints, and the pictures that it writes."""
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        exec(compile(code, stem, "exec", dont_inherit=True), names)
    printed.write("".join(f"{one.category.__name__}: {one.message}\n" for one in warned))
    shown = [f'<pre class="output">{html.escape(printed.getvalue())}</pre>'] if printed.getvalue() else []
    for path in sorted(folder.rglob("*")):
        if path.suffix in _PICTURES and before.get(path) != path.stat().st_mtime_ns:
            pictures.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, pictures / f"{stem}_{path.name}")
            shown.append(f'<p><img src="{stem}_{path.name}" alt="{stem}: {path.stem}"></p>')
    return "\n".join(shown)
