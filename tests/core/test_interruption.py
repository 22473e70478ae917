"""Ctrl-C ends the command with one line, whenever it comes, and its import looks for no cyclic garbage."""

import gc
import os
import subprocess
import sys

import pytest

from modalshell.commands.cli import main
from modalshell.core.interruption import is_command


def interrupted(folder, *command, by="raise KeyboardInterrupt"):
    """Run Python where the import of a library is interrupted."""
    (folder / "trimesh.py").write_text(f"{by}\n")
    (folder / "numba.py").write_text(f"{by}\n")
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, check=False)


def test_an_interrupted_import_is_one_line(tmp_path):
    found = interrupted(tmp_path, "-m", "modalshell", "doctor")
    assert found.returncode not in (0, 1, 2)
    assert found.stderr == "modalshell: stopped\n"


def test_the_import_of_the_command_alone_looks_for_no_cyclic_garbage(tmp_path):
    by = "import gc; raise SystemExit(str(gc.isenabled()))"
    assert interrupted(tmp_path, "-m", "modalshell", by=by).stderr == "False\n"
    assert interrupted(tmp_path, "-c", "import modalshell", by=by).stderr == "True\n"


@pytest.mark.parametrize("arguments", [["modalshell", "doctor"], ["python", "mine.py"]])
def test_the_command_alone_looks_for_it_again(arguments, monkeypatch):
    monkeypatch.setattr(sys, "orig_argv", arguments)
    gc.disable()
    try:
        with pytest.raises(SystemExit):
            main(["--version"])
        assert gc.isenabled() is is_command(arguments)
    finally:
        gc.enable()


@pytest.mark.slow
def test_other_programs_keep_their_traceback(tmp_path):
    assert "Traceback" in interrupted(tmp_path, "-c", "import modalshell").stderr


@pytest.mark.parametrize(
    ("arguments", "command"),
    [
        (["python", "-m", "modalshell", "run"], True),
        (["python", "-X", "dev", "-m", "modalshell"], True),
        (["/usr/bin/python3", "/usr/local/bin/modalshell", "run"], True),
        (["modalshell.exe", "run"], True),
        (["python", "-m", "pytest", "modalshell"], False),
        (["python", "-m"], False),
        (["python", "mine.py"], False),
        (["python", "/usr/bin/pytest", "-m", "modalshell"], False),
        ([], False),
    ],
)
def test_the_command_is_told_from_other_programs(arguments, command):
    assert is_command(arguments) is command
