"""Every code block, command, link and docstring example of the documents, run."""

import contextlib
import doctest
import importlib
import inspect
import os
import pkgutil
import re
import shlex
import shutil
import sqlite3
import subprocess
import sys
import tomllib
import urllib.parse
import warnings
from contextlib import closing

import pytest
from guide import CONTRIBUTING, PAGES, ROOT, blocks, commands, source
from installed import NAME, put_into

import modalshell as ms
from modalshell import springs
from modalshell.commands.cli import app, main

README = ROOT / "README.md"
FLAT_BEAM, PANEL = "studies/scenes/flat_beam.toml", "studies/scenes/panel_wind.toml"
SNAPPING = "studies/scenes/v_beam_stiff.toml"
SWEEP = "studies/sweeps/v_beam_gravity.toml"
SMALLER = {
    FLAT_BEAM: {"cells = [40, 8]": "cells = [16, 4]", "x < 0.026": "x < 0.07"},
    PANEL: {"duration = 4.0": "duration = 0.5"},
    SNAPPING: {"cells = [80, 16]": "cells = [20, 4]", "x < 0.026": "x < 0.076"},
    SWEEP: {", [0, 0, -1], [0, 0, -2], [0, 0, -4], [0, 0, -8]]": "]", "../scenes": str(ROOT / "studies" / "scenes")},
}
"""What is changed in copies of scenes and sweeps that take long: they lie in the folder where commands run."""
ADVISE = f"modalshell advise {FLAT_BEAM} --error 0.02 --fps 60"
TRADEOFF = f"modalshell tradeoff {FLAT_BEAM}"
VIEW = "modalshell view studies/scenes/leaf.toml"
SHORTER = {
    ADVISE: "modalshell advise flat_beam.toml --error 0.02 --fps 60 --modes 4",
    TRADEOFF: "modalshell tradeoff flat_beam.toml --modes 4 --quick",
    f"modalshell path {SNAPPING}": "modalshell path v_beam_stiff.toml",
    f"modalshell run {PANEL}": "modalshell run panel_wind.toml",
    f"modalshell sweep {SWEEP}": "modalshell sweep v_beam_gravity.toml --workers 1",
    VIEW: f"{VIEW} --screenshot leaf.png",
    "modalshell simulate meshes/leaf.obj": "modalshell simulate meshes/leaf.obj --duration 0.5",
    "modalshell bench": "modalshell bench --only hinge_kernel",
    "modalshell reproduce --only flat_vs_v_beam": "modalshell reproduce --only flat_vs_v_beam --quick",
    "python -m pytest -n auto": "python -m pytest --collect-only -q tests/core",
    "ruff check . && ruff format --check . && mypy": "ruff check tests && ruff format --check tests && mypy --version",
    "python -m studies.benchmarks.ranks --rows 256 --columns 256": "python -m studies.benchmarks.ranks --help",
}
"""In place of what needs a display, takes an hour, does what another command does, or is as it stands in .ci/run."""
SET_UP = {
    ".venv/bin/modalshell reproduce": ".venv/bin/modalshell reproduce --quick --only folded_map",
    ".venv/bin/python -m pytest -n auto": ".venv/bin/python -m pytest -n 0 --collect-only -q",
    ".venv/bin/pip install -e '.[dev,docs]'": ".venv/bin/pip install --dry-run -e '.[docs]'",
}
"""The same for what follows the making of an environment, by a study of few kernels, which that copy compiles anew.

.ci/run takes those commands as they stand, all extras but ``docs`` among them.
"""
MADE = "python3 -m venv .venv"
GENERATED = "modalshell/shell/kernels/generated"
ALL = list(dict.fromkeys(line for page in PAGES for line in commands(page)))
OWN = [line for line in ALL if line.startswith("modalshell ")]
SETTING_UP = [line for line in ALL if MADE in line]
OTHERS = [line for line in ALL if line not in OWN and line not in SETTING_UP]
INLINE = sorted({span for page in PAGES for span in re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8"))})


def test_the_documents_have_what_is_run_here():
    assert len(OWN) >= 10
    assert len(SETTING_UP) == 3
    assert set(SHORTER) <= set(ALL)
    assert len(README.read_text(encoding="utf-8").splitlines()) < 180


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder from which the documents' paths lead to the repository's meshes, studies and pictures.

    With smaller copies of what takes long.
    """
    for name in ("meshes", "studies", "paper_figures"):
        (tmp_path / name).symlink_to(ROOT / name)
    for file, changes in SMALLER.items():
        text = (ROOT / file).read_text(encoding="utf-8")
        for old, new in changes.items():
            assert text.count(old) == 1, f"{old!r} is not once in {file}"
            text = text.replace(old, new)
        (tmp_path / os.path.basename(file)).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def call(line):
    """Run a command of the package in this process; its exit status."""
    with warnings.catch_warnings():  # which the command prints
        warnings.simplefilter("ignore", ms.ModalShellWarning)
        try:
            main(shlex.split(line)[1:])
        except SystemExit as end:
            return end.code or 0
    return 0


def test_the_python_of_readme_runs(folder, capsys):
    (block,) = blocks(README, "python")
    exec(compile(block, "README.md", "exec"), {})
    printed = capsys.readouterr().out.split()
    assert printed[:2] == ["converged", "converged"]
    assert float(printed[2]) < 0.1
    assert float(printed[3]) > 0.0
    assert "completed" in printed
    assert ms.load_trajectory(folder / "beam.npz").positions.shape == (61, 369, 3)


def test_every_python_block_of_contributing_has_a_name_and_is_run_by_a_test():
    named = re.findall(r"^\*\*`([\w/.]+\.py)`\*\*", CONTRIBUTING.read_text(encoding="utf-8"), re.MULTILINE)
    assert [source(name) for name in named] == blocks(CONTRIBUTING, "python")
    tests = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_extending_*.py"))
    studies = {"studies/tip_drop.py", "paper_figures/tip_drop.py"}  # named by their packages there
    assert {name for name in named if f'source("{name}")' not in tests} == studies
    for name in re.findall(r"`(tests/[\w/]+\.py)`", CONTRIBUTING.read_text(encoding="utf-8")):
        assert (ROOT / name).is_file()


@pytest.fixture
def written_guide(tmp_path):
    """The Python of CONTRIBUTING.md as files, the two of the study apart, with the configuration of the repository."""
    named = re.findall(r"^\*\*`([\w/.]+\.py)`\*\*", CONTRIBUTING.read_text(encoding="utf-8"), re.MULTILINE)
    for name in named:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(source(name), encoding="utf-8")
    return tmp_path


def test_the_python_of_contributing_meets_the_rules_of_style(written_guide):
    pytest.importorskip("ruff")
    shared = ["--config", str(ROOT / "pyproject.toml"), "--no-cache", "."]
    ignored = ["--ignore", "I001,ARG002"]  # which modules are the package's own, and arguments of an interface
    for command in (["check", *ignored], ["format", "--check"]):
        run = subprocess.run(
            [sys.executable, "-m", "ruff", *command, *shared], cwd=written_guide, capture_output=True, text=True
        )
        assert run.returncode == 0, run.stdout + run.stderr


def copy_of_known_types(folder):
    """What mypy keeps of a run on the checkout, where there was one; a run that goes on meanwhile may keep a part."""
    for kept in (ROOT / ".mypy_cache").rglob("cache*.db"):
        copy = folder / kept.relative_to(ROOT / ".mypy_cache")
        copy.parent.mkdir(parents=True, exist_ok=True)
        found = closing(sqlite3.connect(kept)), closing(sqlite3.connect(copy))
        with found[0] as one, found[1] as other, contextlib.suppress(sqlite3.Error):
            one.backup(other)
    return folder


@pytest.mark.slow
def test_the_python_of_contributing_has_the_types_that_it_needs(written_guide, tmp_path_factory):
    """It is read with the package, of which mypy may know the types already."""
    pytest.importorskip("mypy")
    (written_guide / "toy_fibres" / "kernel.py").touch()
    files = sorted(str(path.relative_to(written_guide)) for path in written_guide.rglob("*.py"))
    options = ["--config-file", str(ROOT / "pyproject.toml"), "--explicit-package-bases", "--namespace-packages"]
    options += ["--cache-dir", str(copy_of_known_types(tmp_path_factory.mktemp("types")))]
    environment = {**os.environ, "MYPYPATH": str(ROOT)}
    run = subprocess.run(
        [sys.executable, "-m", "mypy", *options, *files],
        cwd=written_guide,
        env=environment,
        capture_output=True,
        text=True,
    )
    assert [line for line in run.stdout.splitlines() if line.startswith(tuple(files))] == [], run.stdout
    assert f"{len(files)} source files" in run.stdout, run.stdout + run.stderr


def test_the_project_file_of_contributing_names_its_modules():
    written = tomllib.loads(source("pyproject.toml"))
    modules = {*written["tool"]["setuptools"]["py-modules"], *written["tool"]["setuptools"]["packages"]}
    text = CONTRIBUTING.read_text(encoding="utf-8")
    assert modules == {name.split("/")[0] for name in re.findall(r"^\*\*`(toy_\w+)", text, re.MULTILINE)}
    assert set(written["project"]["entry-points"]["modalshell"].values()) <= modules


def test_the_scene_of_readme_runs(folder):
    (block,) = blocks(README, "toml")
    (folder / "plate.toml").write_text(block, encoding="utf-8")
    assert call("modalshell run plate.toml") == 0
    assert (folder / "results" / "plate.png").stat().st_size > 1000
    scene = ms.load_scene(folder / "plate.toml")
    positions = ms.load_trajectory(folder / "results" / "plate.npz").positions[-1]
    assert 1e-3 < positions[:, 2].max() < 5e-3
    assert scene.build_shell().fields(positions).von_mises.max() > 1e7


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_commands_run():
    """In the documents' order, in one folder, since some read what others write."""
    failed = {line: status for line in OWN if line != VIEW and (status := call(SHORTER.get(line, line))) != 0}
    assert not failed


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_the_command_of_the_viewer_runs(folder, monkeypatch):
    monkeypatch.delenv("MODALSHELL_RENDERER")
    assert call(SHORTER[VIEW]) == 0
    assert (folder / "leaf.png").stat().st_size > 1000


def test_commands_and_options_exist():
    """Of those in the text, too, whose files need not be there."""
    lines = [span for span in INLINE if re.match(r"(\.venv/bin/)?modalshell [\w-]", span)]
    assert len(lines) > 5
    for line in OWN + lines:
        tokens = shlex.split(line)[1:]
        if tokens[0] == "COMMAND" or "--install-completion" in tokens:
            continue
        if tokens[0] == "view" and tokens[1:2] == ["--attach"]:
            tokens[2] = "folder"
        app.parse_args([token for token in tokens if token != "NAME"], exit_on_error=False, print_error=False)


def test_every_command_shows_an_example_that_it_takes(capsys):
    for name in app:
        if name.startswith("-") and name != "--install-completion":
            continue
        call(f"modalshell {name} --help")
        shown = " ".join(capsys.readouterr().out.split())
        found = re.search(r"Example: (modalshell .*?) ╭", shown) or re.search(r"Example: (modalshell .*)", shown)
        assert found, f"modalshell {name} --help has no example"
        if name != "--install-completion":
            app.parse_args(shlex.split(found[1])[1:], exit_on_error=False, print_error=False)


def test_completion_installs(folder, capsys):
    assert call("modalshell --install-completion --shell bash --output completion.sh") == 0
    capsys.readouterr()
    assert "tradeoff" in (folder / "completion.sh").read_text(encoding="utf-8")
    if shutil.which("bash"):
        subprocess.run(["bash", "-n", "completion.sh"], check=True)


def test_packages_and_files_named_in_the_text_exist():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for span in INLINE:
        for named in re.findall(r"\[([\w,]+)\]'", span):
            assert set(named.split(",")) <= set(extras), span
        for file in re.findall(r"(?<![\w/])(?:tests|modalshell|studies)/[\w/]+\.\w+", span):
            assert (ROOT / file).exists() or "tip_drop" in file or "NAME" in file, span


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md", ROOT / "meshes" / "README.md"], ids=str)
def test_relative_links_resolve(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    targets = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'src="([^"]+)"', text)
    missing = [
        target
        for target in map(urllib.parse.unquote, targets)
        if not re.match(r"[a-z]+:", target) and not (page.parent / target.partition("#")[0]).exists()
    ]
    assert not missing


# ---- commands on a copy of the checkout


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A copy of the repository that commands may write into, with this Python first on the path.

    With what Python has compiled of it, which stands for the same sources there.
    """
    copy = tmp_path_factory.mktemp("checkout") / "modalshell"
    left_out = shutil.ignore_patterns("results", ".git", ".venv", ".*_cache", ".hypothesis", "*.mp4")
    shutil.copytree(ROOT, copy, ignore=left_out)
    return copy


def in_shell(line, folder, **changes):
    """Run a line as a shell would, this Python's programs first; its output where it fails."""
    path = os.pathsep.join([os.path.dirname(sys.executable), os.environ["PATH"]])
    found = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PATH": path, "PYTHONPATH": found, "OPENBLAS_NUM_THREADS": "1", **changes}
    done = subprocess.run(line, shell=True, cwd=folder, env=environment, capture_output=True, text=True, timeout=1500)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("line", OTHERS)
def test_commands_of_a_checkout_run(line, checkout):
    for part in SHORTER.get(line, line).split(" && "):
        program = shlex.split(part)
        module = program[2] if program[:2] == ["python", "-m"] else program[0]
        if module in ("ruff", "mypy", "studies.site"):
            needed = "latex2mathml" if module == "studies.site" else module
            pytest.importorskip(needed, reason=f"{needed} is not installed (extras dev and docs)")
        if "ranks" in part:
            pytest.importorskip("petsc4py", reason="petsc4py is not installed (extra mpi)")
        status, output = in_shell(part, checkout, PYTHONHASHSEED="4242")
        assert status == 0, output[-4000:]
        if module == "modalshell.symbolic":  # what it generates depends on no seed of hashes
            assert {path.name: path.read_bytes() for path in (checkout / GENERATED).glob("*.py")} == {
                path.name: path.read_bytes() for path in (ROOT / GENERATED).glob("*.py")
            }


@pytest.mark.slow
@pytest.mark.parametrize("line", SETTING_UP)
def test_environments_are_made_as_the_documents_say(line, checkout):
    """One after the other, as a reader does, in an environment that is made once; skipped where no index answers.

    What is installed here is linked, and pip gets the rest; from the index alone .ci/run gets `.[dev]`, no other extra.
    """
    site = checkout / ".venv" / "lib" / "python{}.{}".format(*sys.version_info) / "site-packages"
    for part in line.split(" && "):
        if part == MADE and (checkout / ".venv" / "pyvenv.cfg").exists():
            continue
        if wanted := re.fullmatch(r".*pip install '?\.(\[\w+\])?'?", part):
            put_into(site, NAME + (wanted[1] or ""))
        status, output = in_shell(SET_UP.get(part, part), checkout, PYTHONPATH="", PIP_NO_COMPILE="0")  # to pip: yes
        if status != 0 and re.search(r"No matching distribution|ConnectionError|NewConnectionError", output):
            pytest.skip("no package index answers here")
        assert status == 0, output[-4000:]


# ---- docstrings


def modules():
    """Every module of the package with an example in it that imports here."""
    for info in pkgutil.walk_packages(ms.__path__, "modalshell."):
        place = ROOT.joinpath(*info.name.split("."))
        file = place / "__init__.py" if info.ispkg else place.with_suffix(".py")
        if info.name.endswith(("__main__", "blender_clip")) or ">>>" not in file.read_text(encoding="utf-8"):
            continue
        with contextlib.suppress(ImportError):  # of an extra that is not installed
            yield importlib.import_module(info.name)


@pytest.mark.usefixtures("folder")
def test_docstring_examples_run():
    results = [doctest.testmod(module, optionflags=doctest.NORMALIZE_WHITESPACE) for module in modules()]
    assert sum(result.attempted for result in results) >= 3
    assert sum(result.failed for result in results) == 0


OPTIONAL_SECTIONS = {"SA01", "EX01", "ES01"}
"""Codes of numpydoc for sections that a docstring may do without: See Also, Examples, an extended summary."""
STYLE = {"PR08", "SS05"}
"""A description may begin with a symbol, a summary with a noun that ends in s."""
ONE_SENTENCE = {"PR01", "RT01"}
"""Missing sections of parameters and results: methods of one sentence, and records, whose attributes say it."""


def public():
    """(name, whether all its parameters must be documented) of everything that users import, methods included."""
    for module in (ms, springs):
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.ismodule(value) or not getattr(value, "__module__", "").startswith("modalshell"):
                continue
            yield f"{module.__name__}.{name}", inspect.isfunction(value)
            for method in vars(value) if inspect.isclass(value) else ():
                if not method.startswith("_") and inspect.isfunction(vars(value)[method]):
                    yield f"{module.__name__}.{name}.{method}", False


def test_public_docstrings_are_valid_numpydoc():
    validate = pytest.importorskip("numpydoc.validate", reason="numpydoc is not installed (extra docs)").validate
    wrong = []
    for name, whole in public():
        left_out = OPTIONAL_SECTIONS | STYLE | (set() if whole else ONE_SENTENCE)
        if name != "modalshell.models":  # a function with the name of a folder, which numpydoc takes for that
            wrong += [(name, *fault) for fault in validate(name)["errors"] if fault[0] not in left_out]
    assert wrong == []


@pytest.mark.slow
def test_the_api_reference_builds_without_a_warning(tmp_path):
    pytest.importorskip("pdoc", reason="pdoc is not installed (extra docs)")
    line = f"{sys.executable} -W error -m pdoc -d numpy -o {tmp_path} modalshell modalshell.springs"
    status, output = in_shell(line, ROOT)
    assert status == 0, output[-4000:]
    assert "warn" not in output.lower()
    page = (tmp_path / "modalshell.html").read_text(encoding="utf-8")
    assert all(f'id="{name}"' in page for name in ms.__all__ if name != "measure")
    assert (tmp_path / "modalshell" / "springs.html").stat().st_size > 1000
