"""The studies' committed pages, ``studies/NAME.md``, read back as tables."""

from __future__ import annotations

import re

from modalshell.files.study_result import Table


def read_tables(text: str) -> list[Table]:
    """Every Markdown table of ``text``, each row by its headings; a heading that comes again is "heading (2)"."""
    found: list[Table] = []
    headings: list[str] = []
    for line in text.splitlines():
        cells = [cell.strip().strip("*") for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|"):
            headings = []
        elif not headings:
            headings = [f"{h} ({n})" if (n := cells[: k + 1].count(h)) > 1 else h for k, h in enumerate(cells)]
            found.append([])
        elif set(line) - set("|-: "):
            found[-1].append(dict(zip(headings, cells, strict=False)))
    return found


def number(cell: str) -> float:
    """First number of a cell such as "12,102" or "-3.1 %"; ValueError if there is none."""
    found = re.search(r"[-+]?\d[\d,]*(\.\d+)?(e[-+]?\d+)?", cell)
    if found is None:
        raise ValueError(f"no number in {cell!r}")
    return float(found.group().replace(",", ""))


def numbers(table: Table, heading: str) -> list[float]:
    """The numbers of a column, from the rows that have one."""
    return [number(row[heading]) for row in table if re.search(r"\d", row.get(heading, ""))]
