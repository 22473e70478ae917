"""Write the tutorials as notebooks with their outputs, next to the scripts: ``python -m studies.notebooks [NAME ...]``.

The cells are those of the script; where it saves a picture, the notebook shows it instead.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from modalshell.files.atomic_io import write_text
from studies.site_tutorials import Executed, executed, question_of

FOLDER = Path(__file__).parent / "tutorials"
_SAVED = re.compile(r'^(.*\.plot\(.*\))\.save\("[\w.]+\.png"\)$', re.MULTILINE)
_COLORS = 256
"""Of a picture: half of the file, and no difference that one sees."""


def scripts() -> list[Path]:
    """The tutorials."""
    return sorted(FOLDER.glob("[!_]*.py"))


def shown(code: str) -> str:
    """A cell of a script as a notebook has it: pictures that the script saves are displayed."""
    return _SAVED.sub(r"display(\1)", code)


def document(script: Path, ran: Iterable[Executed]) -> dict[str, Any]:
    """A notebook, format 4.5, of a script whose cells were run."""
    told = [_cell("markdown", f"*{question_of(script)}*", 0)]
    told += [_of(number, one) for number, one in enumerate(ran, start=1)]
    return {
        "cells": told,
        "metadata": {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def _of(number: int, ran: Executed) -> dict[str, Any]:
    """A cell with its outputs."""
    if ran.kind == "markdown":
        return _cell("markdown", ran.content, number)
    outputs: list[dict[str, Any]] = []
    if ran.printed:
        outputs.append({"name": "stdout", "output_type": "stream", "text": ran.printed.splitlines(keepends=True)})
    for data in ran.pictures.values():
        drawn = {"image/png": base64.b64encode(_few_colors(data)).decode()}
        outputs.append({"data": drawn, "metadata": {}, "output_type": "display_data"})
    return _cell("code", shown(ran.content), number) | {"execution_count": None, "outputs": outputs}


def _cell(kind: str, text: str, number: int) -> dict[str, Any]:
    return {
        "cell_type": kind,
        "id": f"cell-{number}",
        "metadata": {},
        "source": text.strip("\n").splitlines(keepends=True),
    }


def _few_colors(png: bytes) -> bytes:
    """The picture with a palette."""
    from PIL import Image

    written = io.BytesIO()
    with Image.open(io.BytesIO(png)) as image:
        image.convert("RGB").quantize(_COLORS, dither=Image.Dither.NONE).save(written, "PNG", optimize=True)
    return written.getvalue()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the named tutorials, or all, and write their notebooks."""
    parser = argparse.ArgumentParser(prog="python -m studies.notebooks", description=__doc__)
    names = [script.stem for script in scripts()]
    parser.add_argument("names", nargs="*", metavar="NAME", choices=[*names, []], help="tutorials; all if omitted")
    chosen = parser.parse_args(arguments).names or names
    for script in scripts():
        if script.stem in chosen:
            made = json.dumps(document(script, executed(script)), indent=1, ensure_ascii=False)
            print(write_text(script.with_suffix(".ipynb"), made + "\n"))


if __name__ == "__main__":
    main()
