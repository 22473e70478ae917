"""Compiled kernels are kept in a folder that can be written to, and where there is none the package still works."""

import os
import re
import stat
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from modalshell.kernels import compiler
from modalshell.kernels.compiler import cache_folder, njit

USE = """
import tempfile
tempfile.tempdir = {temporary!r}
import numpy as np
from modalshell.kernels.compiler import cache_folder
from modalshell.kernels.blocks import multiply
out = np.empty((3, 1))
multiply(np.array([0, 3, 6, 9]), np.tile(np.arange(3), 3), np.ones(9), np.ones((3, 1)), out)
assert out.sum() == 9.0
print(cache_folder())
"""


def used(temporary="/dev/null/nowhere", **variables):
    """Where a process that can write to nothing else keeps its kernels, and what it has to say."""
    environment = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "LOCALAPPDATA")}
    environment |= {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/nowhere"} | variables
    command = [sys.executable, "-c", USE.format(temporary=str(temporary))]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no place that nobody can write to")
def test_the_package_works_where_nothing_can_be_written(tmp_path):
    assert used(NUMBA_CACHE_DIR="/dev/null/nowhere").stdout == "None\n"
    temporary = used(tmp_path, NUMBA_CACHE_DIR="/dev/null/nowhere").stdout
    assert Path(temporary.strip()).parent == tmp_path
    assert stat.S_IMODE(Path(temporary.strip()).stat().st_mode) == 0o700
    assert any(Path(temporary.strip()).rglob("*.nbi"))


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no place that nobody can write to")
def test_folders_go_by_rank_and_code_of_others_is_not_loaded(tmp_path):
    chosen, user = tmp_path / "chosen", tmp_path / "user"
    assert used(NUMBA_CACHE_DIR=str(chosen), XDG_CACHE_HOME=str(user)).stdout == f"{chosen}\n"
    assert used(XDG_CACHE_HOME=str(user)).stdout == f"{user / 'modalshell'}\n"
    (user / "modalshell").chmod(0o777)
    assert used(XDG_CACHE_HOME=str(user)).stdout == "None\n"


def test_kernels_leave_nothing_in_the_package():
    assert cache_folder() is None or not cache_folder().is_relative_to(Path(njit.__code__.co_filename).parent)


@pytest.mark.parametrize("count", ["0", pytest.param("-3", marks=pytest.mark.slow)])
def test_a_number_of_threads_that_numba_refuses_is_ignored(count, tmp_path):
    answer = used(tmp_path, NUMBA_NUM_THREADS=count)
    assert f"NUMBA_NUM_THREADS must be a positive integer (got '{count}')" in answer.stderr


def test_a_notice_tells_of_kernels_that_are_compiled_and_not_of_cached_ones(tmp_path):
    first = used(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)).stderr
    assert re.fullmatch(r"modalshell: compiling kernels, once, up to about \d+ s\n", first)
    assert used(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)).stderr == ""


def test_the_notice_is_of_this_package_alone_and_comes_once(monkeypatch, capsys):
    monkeypatch.setattr(compiler.notice, "due", True)
    numba.njit(lambda x: x + 1.0)(1.0)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(compiler, "cache_folder", lambda: None)

    def twice(x):
        return 2.0 * x

    twice.__module__ = "modalshell.kernels.twice"
    assert numba.njit(twice)(2.0) == 4.0
    assert "at each start" in capsys.readouterr().err
    assert numba.njit(twice)(np.float32(2.0)) == 4.0
    assert capsys.readouterr().err == ""
