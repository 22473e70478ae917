"""Processes that begin at once on an empty cache compile each kernel once, and wait for nobody who has gone."""

import os
import subprocess
import sys
import threading

import pytest
from kernels.test_compiler import ALONE

from modalshell.kernels import turns

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no turns are taken under Windows")

TOGETHER = """
import numpy as np
from numba.core import event
from modalshell.models.reduction import blocks
log = []
class Spy(event.Listener):
    def on_start(self, event):
        log.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass
event.register("numba:compile", Spy())
print("ready", flush=True)
sys.stdin.readline()
out = np.empty((3, 1))
blocks.multiply(np.array([0, 3, 6, 9]), np.tile(np.arange(3), 3), np.ones(9), np.ones((3, 1)), out)
assert out.sum() == 9.0
print(*log)
"""


@pytest.mark.slow
def test_kernels_are_compiled_by_one_of_processes_that_begin_at_once(tmp_path):
    command, pipe = [sys.executable, "-c", ALONE + TOGETHER], subprocess.PIPE
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    started = [subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True) for _ in range(3)]
    assert [process.stdout.readline() for process in started] == 3 * ["ready\n"]
    for process in started:
        process.stdin.write("go\n")
        process.stdin.flush()
    compiled = [name for process in started for name in process.communicate(timeout=300)[0].split()]
    assert [process.returncode for process in started] == [0, 0, 0]
    assert compiled.count("multiply") == 1
    assert len(set(compiled)) == len(compiled)


HOLDING = """
import pathlib, time
from modalshell.kernels import turns
assert turns._locked(pathlib.Path({folder!r}), 7)
print("held", flush=True)
time.sleep(300.0)
"""


class Dispatcher:
    """What is asked of a kernel's dispatcher: ``first`` is done before the cache is looked into, which stays empty."""

    def __init__(self, first=lambda: None):
        self.py_func, self._cache = first, self
        self.load_overload = lambda *_: None
        self.compile = lambda signature: (first(), self._cache.load_overload(signature, None))


def test_who_waits_too_long_or_for_a_process_that_was_killed_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(turns, "_opened", {})
    monkeypatch.setattr(turns, "_LONGEST", 0.2)
    dispatcher, looked = Dispatcher(), []
    monkeypatch.setattr(turns.zlib, "crc32", lambda _: 7)
    dispatcher.load_overload = lambda *asked: looked.append(asked)
    turns.take_turns(dispatcher, tmp_path)
    command = [sys.executable, "-c", ALONE + HOLDING.format(folder=str(tmp_path))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holding:
        assert holding.stdout.readline() == "held\n"
        assert turns._locked(tmp_path, 7) is False
        dispatcher.compile("i8")
        assert len(looked) > 2  # it looks again and again whether the kernel has come
        holding.kill()
        holding.wait()
    looked.clear()
    dispatcher.compile("i8")
    assert len(looked) == 2
    assert turns._held.bytes == []
    assert turns._locked(tmp_path / "missing", 9) is None  # no folder, no lock
    os.close(turns._opened[tmp_path])


def test_threads_of_a_process_free_their_own_turns_alone(tmp_path, monkeypatch):
    """One begins while the other compiles, and looks into the cache when that is done, as NUMBA's lock has it."""
    monkeypatch.setattr(turns, "_opened", {})
    begun, done, held = threading.Event(), threading.Event(), []
    first = Dispatcher(lambda: begun.wait(30.0))
    second = Dispatcher(lambda: (begun.set(), done.wait(30.0)))
    for dispatcher in (first, second):
        turns.take_turns(dispatcher, tmp_path)

    def compile_kernel(dispatcher, signature, then):
        dispatcher.compile(signature)
        held.extend(turns._held.bytes)
        then.set()

    threads = [
        threading.Thread(target=compile_kernel, args=(first, "i8", done)),
        threading.Thread(target=compile_kernel, args=(second, "f8", threading.Event())),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert held == []
    os.close(turns._opened[tmp_path])
