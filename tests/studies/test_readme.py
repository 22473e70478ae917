import subprocess
import sys

import numpy as np
import pytest

from modalshell.files.study_result import StudyResult
from studies import pages, readme
from studies.pages import committed, markdown
from studies.reproduce import studies


@pytest.mark.slow
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


@pytest.mark.parametrize("name", studies())
def test_a_page_is_that_of_the_committed_findings(name):
    """But for findings that were read from a page, to its precision."""
    result = committed(name)
    page = (readme.FOLDER / f"{name}.md").read_text(encoding="utf-8")
    if result.record != {"from": f"studies/{name}.md, to the precision of that page"}:
        assert page.endswith(f"\n\n{studies()[name].table(result)}\n")


PLUGGED = """
from modalshell import ModelSpec
from modalshell.models.linear import LinearModal
from modalshell.models.registry import register
register(ModelSpec("extra", "extra", LinearModal, "basis", cost=15, color="#112233"))
from studies import readme
from studies.pages import committed
from studies.reproduce import studies
assert (readme.FOLDER / "README.md").read_text(encoding="utf-8") == readme.page()
for name, study in studies().items():
    result = committed(name)
    page = (readme.FOLDER / f"{name}.md").read_text(encoding="utf-8")
    if result.record != {"from": f"studies/{name}.md, to the precision of that page"}:
        assert page.endswith(f"\\n\\n{study.table(result)}\\n"), name
"""


@pytest.mark.slow
def test_a_model_of_another_package_changes_no_committed_page():
    """Findings and tables name the models of the result, not those that are registered where they are read."""
    subprocess.run([sys.executable, "-c", PLUGGED], cwd=readme.FOLDER.parent, check=True, timeout=120)


def test_a_run_is_taken_over_with_its_page(tmp_path, monkeypatch):
    for module in (readme, pages):
        monkeypatch.setattr(module, "FOLDER", tmp_path / "studies")
    (tmp_path / "studies").mkdir()
    run = StudyResult("x", {"rows": [{"a": 1.5}]}, {"p": np.eye(2)}, {"seed": 1})
    run.save(tmp_path)
    (tmp_path / "x.md").write_text("# x\n")
    readme.take(tmp_path, "x")
    assert (tmp_path / "studies" / "x.md").read_text() == "# x\n"
    assert (committed("x").findings, committed("x").record) == (run.findings, run.record)


def test_a_finding_follows_the_committed_findings():
    study, result = studies()["flat_vs_v_beam"], committed("flat_vs_v_beam")
    text = study.finding(result)
    result.findings["rows"][0]["ds_tip_drop"] *= 2.0
    assert study.finding(result) != text


def test_cells_of_a_table():
    rows = [{"a": 0.1234, "b": [1.0, None], "c": {"d": None}}, {"a": 2.0, "b": [3.0, 4.0], "c": {"d": "e"}}]
    assert markdown("a | b | b | c", "{a:100*.1f} % | {b:.2f} | {c[d]:|none}", rows) == (
        "| a | b | b | c |\n|---|---|---|---|\n| 12.3 % | 1.00 | - | none |\n| 200.0 % | 3.00 | 4.00 | e |"
    )


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (75.46, 2, "76"),
        (0.00642, 2, "0.0065"),
        (2.1e-13, 1, "3e-13"),
        (0.3, 2, "0.3"),
        (0.1 + 0.2, 2, "0.3"),
        (0, 2, "0"),
    ],
)
def test_a_bound_is_rounded_up(value, digits, text):
    assert pages.at_most(value, digits) == text
