"""Build a static site that opens from disk: documents, theory, studies, tutorials with outputs, and the API reference.

Run ``python -m studies.site`` in a checkout with the extra ``docs``; it writes into ``results/site``, whose start is
``index.html``. Formulas become MathML, which browsers draw without scripts or a network. A link that leads nowhere, a
formula that cannot be read and every warning end the build with an error.
"""

from __future__ import annotations

import argparse
import html
import os
import re
import shutil
import sys
import warnings
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path, PurePosixPath

from modalshell.files.atomic_io import write_text
from studies.site_text import (
    bibliography_html,
    highlighted,
    linked_text,
    markdown_html,
    pygments_style,
    with_formulas,
)
from studies.site_tutorials import notebook_html

ROOT = Path(__file__).resolve().parents[1]
STARTS = ("README.md", "studies/README.md", "studies/theory/README.md", ".github/CONTRIBUTING.md", "CHANGELOG.md")
SHOWN = {".py", ".toml", ".bib", ".cff", ""}
"""Suffixes of files that are shown as text."""
_NEEDED = ("pdoc", "numpydoc", "latex2mathml", "markdown_it", "pygments")
"""Modules of the extra ``docs``."""
NAVIGATION = {
    "Start": "index.html",
    "Studies": "studies/README.html",
    "Theory": "studies/theory/README.html",
    "Tutorials": "studies/README.html#tutorials",
    "Scenes": "studies/README.html#scenes",
    "Reference": "api/modalshell.html",
    "Literature": "references.html",
    "Contributing": ".github/CONTRIBUTING.html",
    "Changes": "CHANGELOG.html",
}
_REFERENCE_STYLE = (
    ".equation { display: flex; overflow-x: auto; overflow-y: hidden; margin: 0.8em 0; } .equation math { flex: 1; } "
    ".pdoc .attr, .pdoc .signature, .pdoc .annotation { overflow-wrap: anywhere; } "
    ".pdoc .pdoc-code, .pdoc .param, .pdoc .multiline, .pdoc .annotation { white-space: pre-wrap !important; } "
    "main.pdoc { min-width: 0; overflow-x: hidden; }"
)
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<link rel="stylesheet" href="{up}style.css">
</head>
<body>
<nav>{links}</nav>
<main>
{body}
</main>
</body>
</html>
"""


class SiteError(Exception):
    """What is wrong with the site, a line each."""


class Site:
    """A site while it is built: what waits to be written, and what was wrong."""

    def __init__(self, folder: Path, run_tutorials: bool) -> None:
        self.folder, self.run_tutorials = folder, run_tutorials
        self.waiting, self.done = [ROOT / name for name in STARTS], set[Path]()
        self.faults: list[str] = []

    def build(self) -> None:
        """Write every page that the starting ones lead to."""
        while self.waiting:
            source = self.waiting.pop()
            if source not in self.done:
                self.done.add(source)
                self._write(source)
        text = (ROOT / "modalshell" / "references.bib").read_text(encoding="utf-8")
        self.page("references.html", "Literature", bibliography_html(text))
        style = (ROOT / "studies" / "site.css").read_text(encoding="utf-8")
        write_text(self.folder / "style.css", style + pygments_style())

    def page(self, name: str, title: str, body: str) -> None:
        """Write a page of the site."""
        up = "../" * (len(PurePosixPath(name).parts) - 1)
        links = "".join(f'<a href="{up}{target}">{shown}</a>' for shown, target in NAVIGATION.items())
        whole = PAGE.format(title=html.escape(title), up=up, links=links, body=body)
        write_text(self.folder / name, whole)

    def _write(self, source: Path) -> None:
        """Write the page of one file of the repository, or copy it."""
        name, place = self.name_of(source), source.relative_to(ROOT).as_posix()
        if source.suffix == ".md":
            body = self._relinked(self._read(place, lambda: markdown_html(source.read_text(encoding="utf-8"))), source)
            up = "../" * (len(PurePosixPath(name).parts) - 1)
            titled = re.search(r"<h1[^>]*>(.*?)</h1>", body, re.DOTALL)
            title = html.unescape(re.sub(r"<.*?>", "", titled[1])) if titled else place
            self.page(name, title, linked_text(body, up, ROOT / "studies" / "theory"))
        elif source.parent.name == "tutorials" and source.suffix == ".py":
            body = notebook_html(source, self.folder / "studies" / "tutorials", self.run_tutorials)
            self.page(name, source.stem, body)
        elif source.suffix in SHOWN:
            shown = highlighted(source.read_text(encoding="utf-8"), source.suffix[1:] or "text")
            self.page(name, place, f"<h1>{html.escape(place)}</h1>\n{shown}")
        else:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, self.folder / name)

    def _read(self, place: str, made: Callable[[], str]) -> str:
        """What ``made`` gives; where a formula cannot be read, a fault."""
        try:
            return made()
        except ValueError as fault:
            self.faults.append(f"{place}: {fault}")
            return ""

    def name_of(self, source: Path) -> str:
        """Where the page of a file of the repository is in the site."""
        place = source.relative_to(ROOT).as_posix()
        if place == "README.md":
            return "index.html"
        if source.suffix == ".md":
            return place.removesuffix(".md") + ".html"
        return f"{place}.html" if source.suffix in SHOWN else place

    def _relinked(self, body: str, source: Path) -> str:
        """A document's links as those of its page; what they lead to waits to be written."""

        def replaced(found: re.Match[str]) -> str:
            name, target = found[1], html.unescape(found[2])
            if re.match(r"[a-z]+:", target) or target.startswith("#"):
                return found[0]
            path, _, anchor = target.partition("#")
            file = (source.parent / path).resolve()
            if not file.is_file():
                self.faults.append(f"{source.relative_to(ROOT)}: {target} leads nowhere")
                return found[0]
            self.waiting.append(file)
            here = os.path.relpath(self.name_of(file), PurePosixPath(self.name_of(source)).parent)
            return f'{name}="{here}{"#" if anchor else ""}{anchor}"'

        return re.sub(r'\b(href|src)="([^"]*)"', replaced, body)


def broken_links(folder: Path) -> list[str]:
    """Links between the pages of a site that lead to no file, or to no place in it."""
    wrong, anchors = [], dict[Path, set[str]]()
    for page in sorted(folder.rglob("*.html")):
        text = re.sub(r"<script.*?</script>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in set(re.findall(r'\s(?:href|src)="([^"]*)"', text)):
            if re.match(r"[a-z]+:", target) or "scenes" in page.parts:
                continue
            path, _, anchor = html.unescape(target).partition("#")
            file = (page.parent / path).resolve() if path else page
            if not file.is_file():
                wrong.append(f"{page.relative_to(folder)}: {target}")
            elif anchor and file.suffix == ".html":
                if file not in anchors:
                    anchors[file] = set(re.findall(r'\sid="([^"]+)"', file.read_text(encoding="utf-8")))
                if anchor not in anchors[file]:
                    wrong.append(f"{page.relative_to(folder)}: {target}")
    return wrong


def write_reference(folder: Path) -> None:
    """The API reference, by pdoc, its formulas as MathML and its references to the theory as links."""
    import pdoc
    import pdoc.render

    pdoc.render.configure(docformat="numpy", footer_text="modalshell")
    pdoc.pdoc("modalshell", "modalshell.springs", output_directory=folder / "api")
    for page in (folder / "api").rglob("*.html"):
        up = "../" * (len(page.relative_to(folder).parts) - 1)
        text = with_formulas(page.read_text(encoding="utf-8"))
        home = f'<p style="padding: 0 0 0.5em"><a href="{up}index.html">modalshell: start, studies, theory</a></p>'
        text = re.sub(r'<nav class="pdoc">\s*', rf"\g<0>{home}", text, count=1)
        text = text.replace("</head>", f"<style>{_REFERENCE_STYLE}</style></head>", 1)
        write_text(page, linked_text(_without_dead_ends(text), up, ROOT / "studies" / "theory"))


def _without_dead_ends(page: str) -> str:
    """A page of pdoc without its links to members that it leaves out, because they have no docstring of their own."""
    places = set(re.findall(r'\sid="([^"]+)"', page))
    return re.sub(r'<a href="#([^"]+)">([^<]*)</a>', lambda found: found[0] if found[1] in places else found[2], page)


def build(folder: Path, *, reference: bool = True, run_tutorials: bool = True) -> list[Path]:
    """Build the site; return its pages.

    Raises
    ------
    SiteError
        With the links that lead nowhere and the formulas that cannot be read.
    """
    site = Site(folder, run_tutorials)
    with warnings.catch_warnings(action="error"):
        if reference:
            write_reference(folder)
        elif not (folder / "api" / "modalshell.html").is_file():
            site.page("api/modalshell.html", "modalshell", "<p>The reference was left out.</p>")
        site.build()
    if faults := site.faults + broken_links(folder):
        raise SiteError("\n".join(faults))
    return sorted(folder.rglob("*.html"))


def main(arguments: list[str] | None = None) -> None:
    """Build the site that the command line names."""
    parser = argparse.ArgumentParser(prog="python -m studies.site", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("results/site"), help="results/site if omitted")
    parser.add_argument("--quick", action="store_true", help="leave the reference and the tutorials' outputs out")
    chosen = parser.parse_args(arguments)
    if not (ROOT / "README.md").is_file():
        sys.exit(f"the site is made of a checkout's documents (got {ROOT}, without README.md): run it in a checkout")
    if missing := [name for name in _NEEDED if find_spec(name) is None]:
        sys.exit(f"the site is made by packages that are not installed ({', '.join(missing)}): pip install '.[docs]'")
    try:
        pages = build(chosen.folder.resolve(), reference=not chosen.quick, run_tutorials=not chosen.quick)
    except SiteError as fault:
        sys.exit(f"the site is not whole:\n{fault}")
    print(f"{chosen.folder / 'index.html'}: {len(pages)} pages")


if __name__ == "__main__":
    main()
