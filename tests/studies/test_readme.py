import pytest

from studies import readme
from studies.pages import number, numbers, read_tables
from studies.reproduce import studies

PAGE = """# Title

| a | b | b |
|---|---|---|
| **x 1** | -1,234.5 % | 1e-03 |
| y | | - |

Text.

| c |
|---|
| 2 |
"""


def test_readme_is_what_the_command_writes():
    written = (readme.FOLDER / "README.md").read_text(encoding="utf-8")
    assert written == readme.page(), "a page, a picture or a finding has changed: python -m studies.readme"


def test_every_scene_has_its_page_or_the_command_that_makes_it():
    text = readme.scenes()
    for file in (readme.FOLDER / "scenes").glob("*.toml"):
        command = f"`modalshell page studies/scenes/{file.name} --out {file.stem}.html`"
        page = f"[moving](scenes/{file.stem}.html)"
        assert (page in text) == file.with_suffix(".html").is_file()
        assert (page in text) != (command in text)


@pytest.mark.parametrize("name", studies())
def test_every_study_has_a_page_and_a_finding_with_numbers(name):
    row = readme.row(name)
    assert f"]({name}.md)" in row
    assert any(letter.isdigit() for letter in row.split(" | ")[-1])
    text = (readme.FOLDER / f"{name}.md").read_text(encoding="utf-8")
    assert text.startswith(f"# {name}\n\n{studies()[name].__doc__.splitlines()[0]}\n")


def test_tables_are_read_by_their_headings():
    first, second = read_tables(PAGE)
    assert first == [{"a": "x 1", "b": "-1,234.5 %", "b (2)": "1e-03"}, {"a": "y", "b": "", "b (2)": "-"}]
    assert second == [{"c": "2"}]
    assert numbers(first, "b") == [-1234.5]
    assert number(first[0]["b (2)"]) == 1e-3
    with pytest.raises(ValueError, match="no number in '-'"):
        number("-")


def test_a_finding_follows_its_page():
    study = studies()["flat_vs_v_beam"]
    text = (readme.FOLDER / "flat_vs_v_beam.md").read_text(encoding="utf-8")
    changed = text.replace("0.139", "0.439")
    assert changed != text
    assert study.finding(read_tables(changed)) != study.finding(read_tables(text))
