"""Ctrl-C ends the command with one line, whenever it comes."""

import os
import subprocess
import sys

import pytest

from modalshell.core.interruption import is_command


def interrupted(folder, *command):
    """Run Python where the import of a library is interrupted."""
    (folder / "trimesh.py").write_text("raise KeyboardInterrupt\n")
    (folder / "numba.py").write_text("raise KeyboardInterrupt\n")
    path = os.pathsep.join([str(folder), *filter(None, sys.path)])
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, check=False)


def test_an_interrupted_import_is_one_line(tmp_path):
    found = interrupted(tmp_path, "-m", "modalshell", "doctor")
    assert found.returncode not in (0, 1, 2)
    assert found.stderr == "modalshell: stopped\n"


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
        ([], False),
    ],
)
def test_the_command_is_told_from_other_programs(arguments, command):
    assert is_command(arguments) is command
