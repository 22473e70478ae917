"""Text of the site: Markdown, formulas as MathML, code in colours, the bibliography, links to theory and literature."""

from __future__ import annotations

import html
import re
from pathlib import Path

REFERENCE = re.compile(r"\b([Tt]heory (\d+))((?:, eq\. |\s*,\s*eq\.\s+)(\d+))?")
CITATION = re.compile(r"\b[a-z]{2,}(?:19|20)\d\d\b")
_KEPT = "\ue000{}\ue001"
"""Stands for a formula while Markdown is read."""
_REWRITTEN = {r"\cr": r"\\", r"\lt": "<", r"\gt": ">", r"\textrm": r"\text"}
"""Commands that the converter to MathML knows by other names."""


def formula_html(tex: str, *, display: bool = False) -> str:
    """A formula as MathML, numbered where its tag says so.

    Raises
    ------
    ValueError
        Where a command is left that MathML does not have.
    """
    from latex2mathml.converter import convert

    number = re.search(r"\\tag\{(\d+)\}", tex)
    plain = re.sub(r"\\tag\{\d+\}", "", tex)
    for old, new in _REWRITTEN.items():
        plain = re.sub(re.escape(old) + r"(?![a-zA-Z])", new.replace("\\", r"\\"), plain)
    plain = re.sub(r"\\(q?quad)(?=[a-zA-Z])", r"\\\1 ", plain)  # pdoc joins the lines of a formula
    made: str = convert(plain.strip(), display="block" if display else "inline")
    if left := re.findall(r"\\[a-zA-Z]+", re.sub(r"<annotation.*?</annotation>", "", made, flags=re.DOTALL)):
        raise ValueError(f"{', '.join(sorted(set(left)))} in ${tex.strip()}$ is no command that MathML has")
    if not display:
        return made
    numbered = f'<span><a href="#eq-{number[1]}">({number[1]})</a></span>' if number else ""
    place = f' id="eq-{number[1]}"' if number else ""
    return f'<div class="equation"{place}>{made}{numbered}</div>'


def with_formulas(page: str) -> str:
    r"""HTML whose ``\( \)`` and ``$$ $$`` are MathML; ValueError where one cannot be read."""

    def shown(found: re.Match[str]) -> str:
        if found[1] is None and found[2] is None:
            return found[0]
        tex = html.unescape(re.sub(r"<.*?>", " ", found[1] or found[2]))
        return formula_html(tex, display=found[1] is not None)

    return re.sub(r"<(?:script|pre)\b.*?</(?:script|pre)>|\$\$(.*?)\$\$|\\\((.*?)\\\)", shown, page, flags=re.DOTALL)


def markdown_html(text: str) -> str:
    """A document as HTML, with formulas, coloured code, and places in it by its headings."""
    from markdown_it import MarkdownIt

    formulas: list[str] = []

    def kept(found: re.Match[str]) -> str:
        if found["code"]:
            return found[0]
        formulas.append(formula_html(found["block"] or found["inline"], display=found["block"] is not None))
        return _KEPT.format(len(formulas) - 1)

    pattern = r"(?P<code>```.*?```|`[^`\n]+`)|\$\$(?P<block>.*?)\$\$|(?<![\w$])\$(?P<inline>[^$\n]+)\$(?!\w)"
    read = MarkdownIt("commonmark", {"highlight": lambda code, language, _: highlighted(code, language)})
    body: str = read.enable("table").render(re.sub(pattern, kept, text, flags=re.DOTALL))
    body = re.sub(r"<h(\d)>(.*?)</h\1>", _placed, body, flags=re.DOTALL)
    body = body.replace("<table>", '<div class="table"><table>').replace("</table>", "</table></div>")
    body = re.sub(r"\ue000(\d+)\ue001", lambda found: formulas[int(found[1])], body)
    return re.sub(r"<p>(\s*<div class=\"equation\".*?</div>\s*)</p>", r"\1", body, flags=re.DOTALL)


def _placed(found: re.Match[str]) -> str:
    """A heading with its place, named as on code hosts."""
    words = html.unescape(re.sub(r"<.*?>", "", found[2])).lower()
    place = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
    return f'<h{found[1]} id="{place}">{found[2]}</h{found[1]}>'


def highlighted(code: str, language: str) -> str:
    """Code in colours, as HTML."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import get_lexer_by_name

    known = {"py": "python", "python": "python", "toml": "toml", "bib": "bibtex", "cff": "yaml", "sh": "bash"}
    lexer = get_lexer_by_name(known.get(language, "text"))
    inner: str = highlight(code, lexer, HtmlFormatter(nowrap=True))
    return f'<pre class="code"><code>{inner}</code></pre>\n'


def pygments_style() -> str:
    """The style sheet of coloured code, by day and by night."""
    from pygments.formatters import HtmlFormatter

    others = r"^pre \{.*?\}$|^td\.linenos.*$|^span\.linenos.*$|^\.code \{.*\}$"
    rules, dark = (
        re.sub(others, "", str(HtmlFormatter(style=name).get_style_defs(".code")), flags=re.MULTILINE)
        for name in ("default", "github-dark")
    )
    return f"{rules}\n@media (prefers-color-scheme: dark) {{\n{dark}\n}}\n"


def linked_text(page: str, up: str, theory: Path) -> str:
    """HTML with links where its text names an equation of the theory or an entry of the bibliography."""
    chapters = {int(path.stem.split("_")[1]): path.stem for path in theory.glob("chapter_*.md")}
    keys = set(re.findall(r"@\w+\{(\w+),", (theory.parents[1] / "modalshell/references.bib").read_text("utf-8")))

    def to_theory(found: re.Match[str]) -> str:
        chapter = chapters.get(int(found[2]))
        if chapter is None:
            return found[0]
        anchor = f"#eq-{found[4]}" if found[4] else ""
        return f'<a href="{up}studies/theory/{chapter}.html{anchor}">{found[0]}</a>'

    def to_literature(found: re.Match[str]) -> str:
        return f'<a href="{up}references.html#{found[0]}">{found[0]}</a>' if found[0] in keys else found[0]

    def linked(found: re.Match[str]) -> str:
        if found["text"] is None:
            return found[0]
        return CITATION.sub(to_literature, REFERENCE.sub(to_theory, found["text"]))

    skipped = r"<(?P<tag>a|script|style|pre|svg|math|title|h1)\b.*?</(?P=tag)>|<[^>]*>"
    return re.sub(rf"{skipped}|(?P<text>[^<]+)", linked, page, flags=re.DOTALL)


def bibliography_html(text: str) -> str:
    """The entries of a BibTeX file as a list, each with its key as its place."""
    items = []
    for key, fields in re.findall(r"^@\w+\{(\w+),(.*?)^\}", text, re.MULTILINE | re.DOTALL):
        found = {
            name.lower(): re.sub(r"[{}]", "", " ".join((braced or quoted or bare).split()))
            for name, braced, quoted, bare in re.findall(
                r'(\w+)\s*=\s*(?:\{((?:[^{}]|\{[^{}]*\})*)\}|"([^"]*)"|(\d+))', fields
            )
        }
        where = found.get("journal") or found.get("booktitle") or found.get("publisher") or found.get("howpublished")
        parts = [found.get("author", "").replace(" and ", "; "), found.get("title"), where, found.get("year")]
        line = html.escape(". ".join(part for part in parts if part)) + "."
        if "doi" in found:
            line += f' <a href="https://doi.org/{html.escape(found["doi"])}">doi</a>'
        elif "url" in found:
            line += f' <a href="{html.escape(found["url"])}">link</a>'
        items.append(f'<li id="{key}"><code>{key}</code>: {line}</li>')
    return "<h1>Literature</h1>\n<ul>\n" + "\n".join(sorted(items)) + "\n</ul>\n"
