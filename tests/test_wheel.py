"""The wheel and the source archive: they hold what they must, and an installed copy works away from the checkout."""

import os
import re
import subprocess
import sys
import tarfile
import zipfile

import pytest
from guide import ROOT

import modalshell as ms

SMOKE = """
import sys
import modalshell as ms
import modalshell.springs
assert ms.__file__.startswith(sys.argv[1]), ms.__file__
from modalshell.commands.cli import main

ms.load_mesh(sys.argv[1] + "/modalshell/bundled/meshes/leaf.obj")
for line in ("run scene.toml --out results", "page scene.toml --out scene.html", "licences"):
    try:
        main(line.split())
    except SystemExit as end:
        assert not end.code, line
assert ms.load_trajectory("results/scene.npz").positions.shape == (1, 81, 3)
"""
"""One process for most of it: each imports everything, and this copy's kernels are in no cache yet."""
SCENE = """
[mesh]
shape = "sheet"
cells = [8, 8]
[material]
young = 1e8
poisson = 0.3
thickness = 2e-3
density = 700.0
[[supports]]
kind = "pin"
sel = "boundary"
[loads]
gravity = [0, 0, -0.1]
[model]
name = "lma"
"""


def test_the_citation_names_the_version():
    assert re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1] == ms.__version__
    assert f"## {ms.__version__}" in (ROOT / "CHANGELOG.md").read_text()


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """The wheel and the source archive of this checkout; skipped where no package index gives what builds them."""
    pytest.importorskip("build", reason="build is not installed")
    folder = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [sys.executable, "-m", "build", "--outdir", str(folder)], cwd=ROOT, capture_output=True, text=True
    )
    if done.returncode and "No matching distribution" in done.stdout + done.stderr:
        pytest.skip("no package index answers")
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


@pytest.mark.slow
def test_the_archives_hold_what_they_must(archives):
    wheel, source = archives
    names = set(zipfile.ZipFile(wheel).namelist())
    inside = {"modalshell/py.typed", "modalshell/references.bib", "modalshell/page/view.js", "studies/reproduce.py"}
    assert inside | {"modalshell/bundled/meshes/leaf.obj", "paper_figures/__init__.py"} <= names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert not any(name.startswith("tests/") or name.endswith((".png", ".mp4")) for name in names)
    with tarfile.open(source) as archive:
        files = {name.partition("/")[2] for name in archive.getnames()}
    assert {"README.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "tests/test_wheel.py", "pyproject.toml"} <= files


@pytest.mark.slow
def test_an_installed_copy_works_away_from_the_checkout(archives, tmp_path):
    site, work = tmp_path / "site", tmp_path / "work"
    work.mkdir()
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-compile", "--no-deps"]
    subprocess.run([*pip, "--target", str(site), str(archives[0])], check=True, capture_output=True)
    (work / "scene.toml").write_text(SCENE)
    environment = {**os.environ, "PYTHONPATH": str(site), "MODALSHELL_RENDERER": "built-in"}
    for arguments in (
        ["-c", SMOKE, str(site)],
        ["-m", "modalshell", "doctor"],
    ):
        done = subprocess.run([sys.executable, *arguments], cwd=work, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, (arguments, done.stdout[-1000:], done.stderr[-2000:])
    assert (work / "results" / "scene.npz").stat().st_size > 1000
    assert (work / "scene.html").stat().st_size > 10_000
