"""Numbers that a report prints, against those of its file."""

import html
import re


def numbers_in(content):
    """Every number in nested lists, tables and texts of JSON."""
    if isinstance(content, dict):
        return [value for part in content.values() for value in numbers_in(part)]
    if isinstance(content, list):
        return [value for part in content for value in numbers_in(part)]
    if isinstance(content, str):
        return [float(value) for value in re.findall(r"-?\d+\.?\d*(?:e[-+]?\d+)?", content)]
    return [float(content)] if isinstance(content, int | float) else []


def stands_for(shown, value):
    """Whether a printed number is ``value`` to its own digits, as it is, in percent or with a prefix of its unit."""
    digits = shown.lower().split("e")[0].lstrip("-").replace(",", "")
    step = 10.0 ** -len(digits.partition(".")[2]) * 10.0 ** float(shown.lower().partition("e")[2] or 0)
    seen = float(shown.replace(",", ""))
    return any(abs(seen - value * factor) <= 0.501 * step for factor in (1.0, 100.0, 1e-3, 1e-6, 1e-9, 1e3))


def rows_of(page):
    """The rows of all tables of a report, and its first paragraph as one more."""
    lines = [*re.findall(r"<tr>(.*?)</tr>", page, re.DOTALL), re.search(r"<p>.*?</p>", page, re.DOTALL)[0]]
    return [[html.unescape(cell) for cell in re.findall(r"<(?:td|p)>(.*?)</", line, re.DOTALL)] for line in lines]


def check_numbers(rows, files):
    """Assert that every printed number is in the files; return how many there are."""
    known, tried = numbers_in(files), 0
    for name, *shown in filter(None, rows):
        if name in ("Versions", "Computed", "Command") or "SHA-256" in name:
            continue
        for number in re.findall(r"(?<![\w.])-?\d[\d,]*\.?\d*(?:e[-+]?\d+)?", " ".join(shown or [name])):
            tried += 1
            assert any(stands_for(number.rstrip(","), value) for value in known), f"{name}: {number} is in no file"
    return tried
