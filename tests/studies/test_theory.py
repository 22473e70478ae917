"""The theory manual: its numbers, equations, links and citations, and the references to it in docstrings."""

import importlib
import re
from functools import cache
from itertools import chain

import pytest
from guide import ROOT

FOLDER = ROOT / "studies" / "theory"
INDEX = FOLDER / "README.md"
CHAPTERS = {int(path.name.split("_")[1]): path for path in sorted(FOLDER.glob("chapter_*.md"))}
SLOW = {2, 3, 10, 13, 14, 15}
"""Chapters whose scripts take more than two seconds."""
SCRIPT_LINES = 80
NUMBER = re.compile(r"(?<![\w.])\d+\.\d+(?:e-?\d+)?|(?<![\w.])\d+(?= (?:%|times))")
CITATION = re.compile(r"\b[a-z]{2,}(?:19|20)\d\d\b")
REFERENCE = re.compile(r"[Tt]heory (\d+)(?:, eq\. (\d+)(?: (?:and|to) (\d+))?)?")
FORMULA = re.compile(r"\$\$.*?\$\$|\$[^$\n]+\$|`[^`\n]+`", re.DOTALL)


def plain(text):
    return " ".join(text.split())


@cache
def read(path):
    return path.read_text(encoding="utf-8")


@cache
def equations(chapter):
    """Numbers of a chapter's equations in their order."""
    return [int(number) for number in re.findall(r"\\tag\{(\d+)\}", read(CHAPTERS[chapter]))]


@cache
def statements(chapter):
    """The parts of a chapter with numbers in them, as its script makes them."""
    return [plain(text) for text in importlib.import_module(f"studies.theory.{CHAPTERS[chapter].stem}").statements()]


def written():
    """Modules, documents and chapters in which the theory and the bibliography are cited."""
    folders = [sorted((ROOT / name).rglob("*.py")) for name in ("modalshell", "studies", "paper_figures", "tests")]
    return chain(*folders, sorted(FOLDER.glob("*.md")), [ROOT / "README.md", ROOT / "studies" / "README.md"])


def unresolved(text):
    """References to chapters and equations that do not exist."""
    return [
        found[0]
        for found in REFERENCE.finditer(plain(text))
        if int(found[1]) not in CHAPTERS
        or any(int(number) not in equations(int(found[1])) for number in found.groups()[1:] if number)
    ]


@pytest.mark.by_default("16")
@pytest.mark.parametrize(
    "chapter", [pytest.param(each, marks=pytest.mark.slow) if each in SLOW else each for each in CHAPTERS]
)
def test_the_script_makes_every_number_of_its_chapter(chapter):
    text = plain(read(CHAPTERS[chapter]))
    assert [each for each in statements(chapter) if each not in text] == []
    made = set(chain.from_iterable(NUMBER.findall(each) for each in statements(chapter)))
    assert [each for each in NUMBER.findall(FORMULA.sub(" ", read(CHAPTERS[chapter]))) if each not in made] == []


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_scripts_are_short(chapter):
    assert len(read(CHAPTERS[chapter].with_suffix(".py")).splitlines()) <= SCRIPT_LINES


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_equations_are_numbered_and_their_numbers_resolve(chapter):
    text = read(CHAPTERS[chapter])
    assert equations(chapter) == list(range(1, len(equations(chapter)) + 1))
    assert text.count("$$") == 2 * len(equations(chapter)), "one number for each displayed equation"
    own = REFERENCE.sub(" ", re.sub(r"\[[a-z]+\d{4}[^\]]*\]", " ", plain(text)))
    found = re.findall(r"eqs?\. (\d+)(?:(?: and | to |, )(\d+))?", own)
    assert {int(number) for pair in found for number in pair if number} <= set(equations(chapter))


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_formulas_are_those_that_markdown_leaves_alone(chapter):
    text = re.sub(r"`[^`\n]+`", " ", read(CHAPTERS[chapter]))
    for formula in re.findall(r"\$\$(.*?)\$\$", text, re.DOTALL) + re.findall(r"(?<!\$)\$([^$\n]+)\$", text):
        assert formula.count("{") == formula.count("}"), formula
        assert len(re.findall(r"\\left\b", formula)) == len(re.findall(r"\\right\b", formula)), formula
        # Markdown takes a backslash before punctuation away, and < and > for tags.
        assert not re.search(r"\\[^a-zA-Z ]|[<>]", formula), formula
    assert text.replace("$$", "").count("$") % 2 == 0


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_lines_of_prose_fit_the_page(chapter):
    lines = re.sub(r"\$\$.*?\$\$", " ", read(CHAPTERS[chapter]), flags=re.DOTALL).splitlines()
    assert [line for line in lines if len(line) > 120] == []


def test_a_letter_of_the_notation_has_one_row():
    rows = re.findall(r"^\| (\$.*?\$) \|", read(CHAPTERS[1]), re.MULTILINE)
    letters = [each for row in rows for each in re.findall(r"\\?[A-Za-z]+(?:_[a-z])?", row.split(" = ")[0])]
    assert {"E", "H", "M", "\\Phi"} < set(letters)
    assert sorted(letters) == sorted(set(letters))


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_chapters_end_with_what_is_not_known_and_what_failed(chapter):
    titles = re.findall(r"^#+ (.*)$", read(CHAPTERS[chapter]), re.MULTILINE)
    assert titles[0].startswith(f"{chapter} ")
    assert titles[-2:] == ["What is not known", "What was tried and failed"]


def test_the_index_names_every_chapter():
    rows = re.findall(r"^\| (\d+) \| \[(.*?)\]\((chapter_\w+\.md)\) \| \[.*?\]\((.*?)\)", read(INDEX), re.MULTILINE)
    assert [int(number) for number, *_ in rows] == list(CHAPTERS)
    for number, title, page, script in rows:
        assert FOLDER / page == CHAPTERS[int(number)]
        assert script == page.replace(".md", ".py")
        assert read(FOLDER / page).startswith(f"# {number} {title}\n")


def test_links_of_the_manual_resolve():
    for page in FOLDER.glob("*.md"):
        for target in re.findall(r"\]\(([^)\s]+)\)", FORMULA.sub(" ", read(page))):
            assert re.match(r"[a-z]+:", target) or (page.parent / target).exists(), (page.name, target)


def test_references_to_the_theory_resolve():
    assert {str(path): found for path in written() if (found := unresolved(read(path)))} == {}


def test_every_citation_is_in_the_bibliography_and_every_entry_is_cited():
    entries = re.findall(r"^@\w+\{(\w+),", read(ROOT / "modalshell" / "references.bib"), re.MULTILINE)
    cited = {key for path in written() for key in CITATION.findall(read(path))}
    assert sorted(entries) == sorted(set(entries))
    assert cited - set(entries) == set()
    assert set(entries) - cited == set()


def test_the_checker_sees_what_does_not_resolve():
    last = max(CHAPTERS)
    assert unresolved(f"theory {last},\n    eq. 1, and theory {last}") == []
    assert unresolved(f"see theory {last + 50}") == [f"theory {last + 50}"]
    assert unresolved(f"(theory {last}, eq. 1 and 999)") == [f"theory {last}, eq. 1 and 999"]
    assert NUMBER.findall("0.5, 3 %, 7 times, 4 cells, 1.5e-3, [a, 2]") == ["0.5", "3", "7", "1.5e-3"]


def test_docstrings_cite_every_chapter_that_derives_something():
    cited = {int(one[1]) for path in (ROOT / "modalshell").rglob("*.py") for one in REFERENCE.finditer(read(path))}
    assert {each for each in CHAPTERS if equations(each)} - cited == set()
