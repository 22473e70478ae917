"""Code blocks and commands of the Markdown pages, which tests run."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CONTRIBUTING = ROOT / ".github" / "CONTRIBUTING.md"
PAGES = (ROOT / "README.md", CONTRIBUTING, ROOT / "studies" / "README.md")


def blocks(page, language):
    """Every fenced block of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def source(name):
    """The block of CONTRIBUTING.md under the title ``name``."""
    text = CONTRIBUTING.read_text(encoding="utf-8")
    (block,) = re.findall(rf"^\*\*`{re.escape(name)}`\*\*[^\n]*\n\n```\w+\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return block


def commands(page):
    """Every command line of a page's ``sh`` blocks, without comments."""
    lines = "".join(blocks(page, "sh")).splitlines()
    return [line.split(" #")[0].strip() for line in lines if line.strip()]
