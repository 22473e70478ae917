"""Compiled kernels are kept in a folder that can be written to, and where there is none the package still works."""

import gc
import io
import os
import pickle
import re
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import ClassVar

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.compiler import Flags
from numba.core.targetconfig import TargetConfig

from modalshell.kernels import callees, compiler, quick_options
from modalshell.kernels.compiler import cache_folder, njit

ALONE = f"""
import sys, types
from pathlib import Path
from typing import ClassVar
for name in ("modalshell", "modalshell.models", "modalshell.models.reduction"):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__path__ = [str(Path({str(Path(compiler.__file__).parents[2])!r}, *name.split(".")))]
"""
"""Modules without what their packages import, which takes longer than all that these tests do."""
USE = """
import tempfile
tempfile.tempdir = {temporary!r}
import numpy as np
from modalshell.kernels.compiler import cache_folder
from modalshell.models.reduction.blocks import multiply
out = np.empty((3, 1))
multiply(np.array([0, 3, 6, 9]), np.tile(np.arange(3), 3), np.ones(9), np.ones((3, 1)), out)
assert out.sum() == 9.0
print(cache_folder())
"""


def used(temporary="/dev/null/nowhere", head=ALONE, **variables):
    """Where a process that can write to nothing else keeps its kernels, and what it has to say."""
    environment = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "LOCALAPPDATA")}
    environment |= {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/nowhere"} | variables
    command = [sys.executable, "-c", head + USE.format(temporary=str(temporary))]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no place that nobody can write to")
def test_the_package_works_where_nothing_can_be_written():
    assert used(head="", NUMBA_CACHE_DIR="/dev/null/nowhere").stdout == "None\n"


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="no place that nobody can write to")
def test_folders_go_by_rank_and_code_of_others_is_not_loaded(tmp_path, monkeypatch):
    folder = cache_folder.__wrapped__
    chosen, user = tmp_path / "chosen", tmp_path / "user"
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(chosen))
    monkeypatch.setenv("XDG_CACHE_HOME", str(user))
    assert folder() == chosen
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(tempfile, "tempdir", "/dev/null/nowhere")
    assert folder() == user / "modalshell"
    (user / "modalshell").chmod(0o777)
    assert folder() is None
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert folder().parent == tmp_path
    assert stat.S_IMODE(folder().stat().st_mode) == 0o700
    monkeypatch.setattr(numba.config, "CACHE_DIR", "/dev/null/nowhere")
    assert folder().parent == tmp_path


def test_kernels_leave_nothing_in_the_package():
    assert cache_folder() is None or not cache_folder().is_relative_to(Path(njit.__code__.co_filename).parent)


@pytest.mark.slow
def test_a_number_of_threads_that_numba_refuses_is_ignored(tmp_path):
    answer = used(tmp_path, NUMBA_NUM_THREADS="-3")
    assert "NUMBA_NUM_THREADS must be a positive integer (got '-3')" in answer.stderr


@pytest.mark.slow
def test_a_notice_tells_of_kernels_that_are_compiled_and_not_of_cached_ones(tmp_path):
    first = used(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)).stderr
    assert re.fullmatch(r"modalshell: compiling kernels, once, up to about \d+ s\n", first)
    assert used(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)).stderr == ""


ORDER = """
import sys
from numba.core import event
from numba.core.compiler import Flags
from numba.core.targetconfig import TargetConfig
log = []
class Spy(event.Listener):
    def on_start(self, event):
        log.append("compilation")
    def on_end(self, event):
        pass
class Stream:
    def write(self, text):
        log.extend(text.splitlines())
    def flush(self):
        pass
event.register("numba:compile", Spy())
import modalshell as ms
assert not log, log
event.register("numba:compile", Spy())  # after the package's own, which speaks first
import numpy as np
from modalshell.models.reduction.blocks import multiply
ms.flat_beam(cells=(2, 1))  # imports what it needs
out = np.empty((3, 1))
assert not log, log
sys.stderr = Stream()
multiply(np.array([0, 3, 6, 9]), np.tile(np.arange(3), 3), np.ones(9), np.ones((3, 1)), out)
sys.stderr = sys.__stderr__
print(log.index("compilation"), next(k for k, word in enumerate(log) if word.startswith("modalshell: compiling")))
print(*({"scipy.stats", "matplotlib.pyplot", "pyvista", "sympy"} & set(sys.modules)))
"""


@pytest.mark.slow
def test_the_notice_comes_before_anything_is_compiled_and_without_heavy_imports(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", ORDER]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert answer.returncode == 0, answer.stderr
    # The first spy hears of the first compilation, then the notice is said, then the second spy hears of it.
    order, heavy = answer.stdout.split("\n")[:2]
    assert order == "0 1"
    assert heavy == ""


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_shows_a_bar_that_is_gone_when_the_kernels_are_there(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "__stderr__", terminal)
    for name, value in (("due", True), ("_most", 0.0), ("_spent", 0.0)):
        monkeypatch.setattr(compiler.notice, name, value)
    monkeypatch.setattr(compiler, "_most_seconds", lambda: 1e-3)

    def halved(x):
        return 0.5 * x

    halved.__module__ = "modalshell.kernels.halved"
    kernel = numba.njit(halved)
    assert (kernel(2.0), kernel(2)) == (1.0, 1.0)
    notice, bars = terminal.getvalue().split("\n")
    assert notice.startswith("modalshell: compiling kernels")
    first, gone, second, end = (text.rstrip(" ") for text in bars.split("\r")[1:-1] if text != "")
    assert first == f"[{' ' * 30}] halved"
    assert second == f"[{'#' * 30}] halved"
    assert gone == end == ""
    assert bars.endswith(" \r")


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


class Collection(event.Listener):
    """Notes whether garbage is collected while kernels are compiled."""

    def __init__(self):
        self.seen = []

    def on_start(self, event):  # noqa: ARG002 - the signature of a listener
        self.seen.append(gc.isenabled())

    def on_end(self, event):
        pass


@pytest.mark.parametrize("collects", [True, False])
def test_garbage_is_not_collected_while_a_kernel_is_compiled_and_after_it_as_before(collects):
    def inner(x):
        return x * x

    inner.__module__ = "modalshell.kernels.inner"
    callee = numba.njit(inner)

    def outer(x):
        return callee(x) + 1.0

    def wrong(x):
        return x.no_such_attribute

    outer.__module__ = wrong.__module__ = "modalshell.kernels.outer"
    before = gc.isenabled()
    (gc.enable if collects else gc.disable)()
    try:
        with event.install_listener("numba:compile", Collection()) as spy:
            assert numba.njit(outer)(3.0) == 10.0
            assert spy.seen == [False, False]  # that of the callee too
            assert gc.isenabled() == collects
            with pytest.raises(numba.TypingError):
                numba.njit(wrong)(3.0)
        assert spy.seen == [False] * 3
        assert gc.isenabled() == collects
    finally:
        (gc.enable if before else gc.disable)()


def test_kernels_of_others_that_belong_to_no_module_are_compiled():
    made = {}
    exec("def twice(x):\n    return 2.0 * x", made)
    assert made["twice"].__module__ is None or made["twice"].__module__ == "builtins"
    made["twice"].__module__ = None  # what exec() leaves where the namespace has no name
    assert numba.njit(made["twice"])(1.5) == 3.0


def test_an_index_of_kernels_that_names_a_class_of_another_version_is_made_anew(tmp_path, monkeypatch):
    monkeypatch.setattr(compiler, "cache_folder", lambda: tmp_path)
    made = njit(_doubled)
    index = Path(made._cache._cache_file._index_path)
    index.parent.mkdir(parents=True, exist_ok=True)
    gone = b"cmodalshell.kernels.compiler\nNoLongerThere\n."
    index.write_bytes(pickle.dumps(numba.__version__, protocol=pickle.HIGHEST_PROTOCOL) + gone)
    assert made(1.5) == 3.0
    again = njit(_doubled)
    assert again(2.5) == 5.0
    assert sum(again._cache_hits.values()) == 1


def _doubled(x):
    return 2.0 * x


@pytest.mark.slow
def test_a_kernel_is_compiled_again_where_one_that_it_calls_has_changed(tmp_path):
    """Numba looks at the file of a kernel alone, and would run what it had made of both."""
    package = tmp_path / "leaves"
    package.mkdir()
    (package / "__init__.py").write_text("")
    decorated = "from modalshell.kernels.compiler import njit\n{}@njit\ndef {}\n"
    outer = decorated.format("from leaves import between\n", "outer(x):\n    return between.inner(x) + 1.0")
    (package / "outer.py").write_text(outer)
    (package / "between.py").write_text("from leaves.inner import (\n    inner,\n)\n")
    command = [
        sys.executable,
        "-c",
        ALONE + "from leaves.outer import outer\nprint(outer(3.0), len(outer.stats.cache_hits))",
    ]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    printed = []
    for factor in ("2.0", "2.0", "5.0"):
        (package / "inner.py").write_text(decorated.format("", f"inner(x):\n    return {factor} * x"))
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)
        printed.append(done.stdout.strip())
    assert printed == ["7.0 0", "7.0 1", "16.0 0"]


@pytest.mark.slow
def test_copies_of_the_package_share_what_is_compiled_of_the_same_sources(tmp_path):
    root = Path(compiler.__file__).parents[2]
    copy = tmp_path / "copy"
    shutil.copytree(root / "modalshell" / "kernels", copy / "modalshell" / "kernels")
    for name in ("core", "models/reduction"):
        shutil.copytree(root / "modalshell" / name, copy / "modalshell" / name)
    use = USE.replace("print(cache_folder())", "print(len(multiply.stats.cache_hits))").format(temporary=str(tmp_path))
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def loaded(folder):
        command = [sys.executable, "-c", ALONE.replace(repr(str(root)), repr(str(folder))) + use]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)
        return done.stdout.strip()

    assert [loaded(root), loaded(copy)] == ["0", "1"]
    changed = copy / "modalshell" / "models" / "reduction" / "blocks.py"
    changed.write_text(changed.read_text() + "\n# not what it was\n")
    assert [loaded(copy), loaded(root)] == ["0", "1"]
    kept = tmp_path / "cache" / "modalshell.models.reduction.blocks"
    assert len(list(kept.iterdir())) == 2


def test_of_earlier_sources_some_are_kept(tmp_path):
    made = [callees.folder_of(tmp_path, "shell.kernels", f"{number:064d}"[::-1]) for number in range(9)]
    for age, folder in enumerate(made):
        if folder.is_dir():
            os.utime(folder, (1e9 + age, 1e9 + age))
    assert callees.folder_of(tmp_path, "shell.kernels", "f" * 64).is_dir()
    assert sum(folder.is_dir() for folder in made) == callees._KEPT - 1
    assert made[-1].is_dir()


def test_options_of_compilation_are_told_as_numba_tells_them():
    flags, other = Flags(), Flags()
    flags.nrt, flags.fastmath, flags.error_model = True, True, "numpy"
    assert flags.values() == {name: getattr(flags, name) for name in Flags.options}
    assert list(flags.values()) == list(Flags.options)
    assert flags == flags.copy()
    assert hash(flags) == hash(flags.copy())
    assert flags != other
    other.nrt = False
    assert other == Flags()  # set to what it is by default
    assert TargetConfig.values is quick_options.values


def test_options_that_are_kept_otherwise_are_left_alone():
    class Kept:
        """As another version of numba might keep them."""

        options: ClassVar[dict] = {}

        def values(self):
            return {"nrt": True}

    class Own(Kept):
        _values: ClassVar[dict] = {"nrt": False}

    before = Kept.values
    quick_options.apply(Kept)
    assert Kept.values is before
