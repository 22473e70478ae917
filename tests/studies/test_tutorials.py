"""Tutorials: each script runs from its first cell to its last, and says what it promises."""

import base64
import json
import re
import runpy
from io import BytesIO
from pathlib import Path

import pytest

from studies.notebooks import document, scripts, shown
from studies.site_tutorials import cells, executed

FOLDER = Path(__file__).resolve().parents[2] / "studies" / "tutorials"
PROMISES = {
    "first_film": ("converged", "completed 31 frames"),
    "other_engines": ("NumPy and LMA differ by at most", "NumPy and MWTS differ by"),
    "plate_stress": ("converged", "reactions -200.000 N"),
    "snap": ("limit at", "linear buckling at"),
    "which_model": ("MWTS: ", "| rung |", "Take "),
}
WRITES = {
    "first_film": ("leaf.html", "leaf.clip", "modes.png"),
    "other_engines": ("strip.npz", "warped.png"),
    "which_model": ("tradeoff.png",),
}


def test_every_tutorial_is_run():
    assert {path.stem for path in FOLDER.glob("*.py")} - {"__init__"} == set(PROMISES)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROMISES)
def test_a_tutorial_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    text = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    assert text.count("# %%") >= 6
    found = runpy.run_path(str(FOLDER / f"{name}.py"))
    said = capsys.readouterr().out
    for promise in PROMISES[name]:
        assert promise in said
    assert all((tmp_path / file).stat().st_size > 1000 for file in WRITES.get(name, ()))
    if name == "plate_stress":
        assert found["deflection"] == pytest.approx(found["navier"], rel=0.03)
        assert found["at_middle"] == pytest.approx(found["expected"], rel=0.05)
    if name == "other_engines":
        assert found["apart_linear"] < 1e-12
        assert found["apart_warped"] < 2e-3
        assert found.get("apart_newton", 0.0) < 1e-3  # where Newton is installed


def test_the_notebooks_are_those_of_the_scripts():
    """Made anew by ``python -m studies.notebooks`` where this fails; outputs are compared by their kinds."""
    assert {path.stem for path in FOLDER.glob("*.ipynb")} == set(PROMISES)
    size = 0
    for script in scripts():
        notebook = json.loads(script.with_suffix(".ipynb").read_text(encoding="utf-8"))
        size += script.with_suffix(".ipynb").stat().st_size
        told = cells(script.read_text(encoding="utf-8"))
        expected = [(kind, shown(text) if kind == "code" else text.strip("\n")) for kind, text in told]
        assert [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"][1:]] == expected
        printed = ""
        for (kind, code), cell in zip(told, notebook["cells"][1:], strict=True):
            if kind == "code":
                drawn = [one for one in cell["outputs"] if one["output_type"] == "display_data"]
                assert len(drawn) == len(re.findall(r"\.png\"\)", code))
                printed += "".join("".join(one["text"]) for one in cell["outputs"] if one["output_type"] == "stream")
        assert all(promise in printed for promise in PROMISES[script.stem])
        assert not re.search(r"(?<![\w.])/(?:root|home|tmp|work|usr)/", json.dumps(notebook["cells"]))
    assert size < 1_000_000


@pytest.mark.slow
def test_a_notebook_has_what_its_cells_print_and_shows_what_they_draw(tmp_path):
    from matplotlib.image import imread

    script = tmp_path / "small.py"
    script.write_text(
        '"""A question?"""\n\n# %% [markdown]\n# # Told\n\n# %%\nimport modalshell as ms\n\n'
        'mesh = ms.sheet(cells=(2, 2))\nmesh.plot(size=(320, 200)).save("mesh.png")\nprint("drawn")\n'
    )
    made = document(script, executed(script))
    asked, told, code = made["cells"]
    assert (asked["source"], told["source"]) == (["*A question?*"], ["# Told"])
    assert "display(mesh.plot(size=(320, 200)))" in "".join(code["source"])
    assert "save" not in "".join(code["source"])
    said, drawn = code["outputs"]
    assert said["text"] == ["drawn\n"]
    assert imread(BytesIO(base64.b64decode(drawn["data"]["image/png"]))).shape[:2] == (200, 320)
    assert len({cell["id"] for cell in made["cells"]}) == 3
    assert (made["nbformat"], made["nbformat_minor"]) == (4, 5)
    names = {"display": lambda picture: picture.data, "__name__": "__main__"}
    exec("".join(code["source"]), names)  # what the notebook runs again works, too
