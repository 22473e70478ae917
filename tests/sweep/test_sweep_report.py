"""Reports on sweeps: their numbers against the summary's, the picture and the table, and what went wrong."""

import csv
import json
import re

import pytest
from printed import check_numbers, rows_of
from scenes import GRAVITIES, SWEEP_AXES

from modalshell.commands.cli import main
from modalshell.sweep.case import run_case


@pytest.fixture
def report(tmp_path, monkeypatch):
    """The exit status of a report; cases are computed in this process, which has no workers to start."""
    monkeypatch.setattr("modalshell.sweep.driver.run_locally", lambda tasks, *_: (run_case(task) for task in tasks))
    monkeypatch.chdir(tmp_path)

    def report(*arguments):
        with pytest.raises(SystemExit) as end:
            main(["report", *map(str, arguments)])
        return end.value.code or 0

    return report


@pytest.mark.slow
def test_a_report_has_the_cases_of_the_sweep(report, write, tmp_path):
    file = write(SWEEP_AXES, more='[truth]\nname = "ds"\n')
    assert report(file.name) == 0
    numbers = json.loads((tmp_path / "results" / "beams_sweep_report.json").read_text())
    page = (tmp_path / "results" / "beams_sweep_report.html").read_text()
    with (tmp_path / "results" / "beams_sweep.csv").open(newline="") as text:
        table = list(csv.DictReader(text))
    assert len(numbers["cases"]) == len(table) == 6
    for case, row in zip(numbers["cases"], table, strict=True):
        for key in ("displacement", "error", "elastic_energy"):
            assert case[key] == float(row[key])
    errors = [case["error"] for case in numbers["cases"]]
    assert numbers["value"] == "error"
    assert numbers["extremes"]["largest"] == {"case": errors.index(max(errors)) + 1, "error": max(errors)}
    assert numbers["extremes"]["least"] == {"case": errors.index(min(errors)) + 1, "error": min(errors)}
    assert numbers["counts"] == {"converged": 6}
    assert check_numbers(rows_of(page), [numbers]) > 40
    assert page.count("<img") == 1
    assert not re.search(r'(?:src|href)="https?:', page)
    rows = [row for row in rows_of(page) if len(row) == 8]
    assert [row[1:3] for row in rows] == [[f"(0, 0, {g})", name] for g in (-1, -2) for name in ("lma", "mwts", "ds")]
    for row, case in zip(rows, numbers["cases"], strict=True):
        assert (row[4], row[5]) == (f"{case['displacement']:.5g}", f"{case['error']:.5g}")


@pytest.mark.slow
def test_a_second_report_computes_nothing_and_is_the_same(report, write, tmp_path, monkeypatch):
    file = write(GRAVITIES)
    assert report(file.name) == 0
    page = (tmp_path / "results" / "beams_sweep_report.html").read_text()
    monkeypatch.setattr("modalshell.sweep.driver.run_locally", None)
    assert report(file.name, "--out", "again.html") == 0
    assert (tmp_path / "again.html").read_text() == page


def test_a_report_says_which_cases_have_no_answer_and_why(report, write, tmp_path):
    file = write('"model.modes" = [4, 9999]\n"loads.gravity" = [[0, 0, -1], [0, 0, -2]]\n')
    assert report(file.name) == 1
    numbers = json.loads((tmp_path / "results" / "beams_sweep_report.json").read_text())
    rows = dict(row for row in rows_of((tmp_path / "results" / "beams_sweep_report.html").read_text()) if len(row) == 2)
    assert [case["outcome"] for case in numbers["cases"]] == ["converged", "converged", "refused", "refused"]
    assert rows["Cases 3, 4"] == f"refused: {numbers['cases'][2]['message']}"
    assert "9999" in rows["Cases 3, 4"]


def test_a_sweep_without_a_value_has_no_picture_and_says_so(report, write, tmp_path):
    file = write('"model.modes" = [9999]\n')
    assert report(file.name) == 1
    page = (tmp_path / "results" / "beams_sweep_report.html").read_text()
    assert "<img" not in page
    assert "No picture: no case has a value of" in page
    assert json.loads((tmp_path / "results" / "beams_sweep_report.json").read_text())["extremes"] is None


@pytest.mark.slow
def test_a_report_on_a_sweep_prints_and_fits_a_phone(report, write, tmp_path, browser):
    assert report(write(SWEEP_AXES, more='[truth]\nname = "ds"\n').name) == 0
    page = browser.new_page(viewport={"width": 390, "height": 800})
    page.goto((tmp_path / "results" / "beams_sweep_report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.pdf(path=tmp_path / "beams.pdf", prefer_css_page_size=True)
    assert 1 <= len(re.findall(rb"/Type\s*/Page\b", (tmp_path / "beams.pdf").read_bytes())) <= 2
    page.set_viewport_size({"width": 700, "height": 900})  # about a printed page: no table is cut there
    assert page.evaluate("[...document.querySelectorAll('.data')].every(one => one.scrollWidth <= one.clientWidth)")
    page.close()


def test_a_report_says_what_it_may_be_of(report, capsys):
    """A sweep's table was taken for a run, whose record names none."""
    assert report("beams_sweep.csv") == 2
    assert re.search(r"scene or sweep file \(\.toml\).*\(got\s+beams_sweep\.csv\)", capsys.readouterr().err, re.DOTALL)
