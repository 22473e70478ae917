"""Sweep cases on worker processes of this machine, one thread each.

Every worker gets one case at a time through its own pipes, so that its death identifies the case and leaves
the other workers alone; ``ProcessPoolExecutor`` breaks as a whole, and its workers outlive a killed driver.
"""

from __future__ import annotations

import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Generator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

import msgspec

from modalshell.core.cores import ONE_THREAD
from modalshell.core.errors import WorkerError
from modalshell.core.outcome import Outcome
from modalshell.sweep.case import CaseResult, Task
from modalshell.sweep.worker import READY

ATTEMPTS = 3
"""Number of processes that may die at a case before it is recorded as failed."""
_STARTS = 5
"""Number of successive processes that may die before they get a case."""


def run_locally(
    tasks: Sequence[Task], workers: int, time_limit: float | None = None
) -> Generator[CaseResult, None, None]:
    """Compute cases in ``workers`` processes; yield each result as it is ready.

    A case whose process dies is done again, up to three processes; one that takes longer than ``time_limit`` [s] is
    aborted. Closing the iterator, like the end of this process however it comes, ends the workers. WorkerError if
    worker processes cannot be started.
    """
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    for task in tasks:
        waiting.put(task)
    results: queue.SimpleQueue[CaseResult | BaseException] = queue.SimpleQueue()

    def serve(slot: _Slot) -> None:
        try:
            while not slot.stopped:
                results.put(slot.compute(waiting.get_nowait(), time_limit))
        except queue.Empty:
            pass
        except BaseException as error:  # raised where the results are waited for
            results.put(error)
        finally:
            slot.end()

    slots = [_Slot() for _ in range(min(workers, len(tasks)))]
    threads = [threading.Thread(target=serve, args=(slot,), daemon=True) for slot in slots]
    try:
        for thread in threads:
            thread.start()
        for _ in tasks:
            result = results.get()
            if isinstance(result, BaseException):
                raise result
            yield result
    finally:
        for slot in slots:
            slot.stop()
        for thread in threads:
            thread.join()


class _Death(Exception):
    """A worker died; the message is its last output. ``asked``: whether it had a case."""

    def __init__(self, message: str, asked: bool) -> None:
        super().__init__(message)
        self.asked = asked


class _Slot:
    """A place for one worker process at a time."""

    def __init__(self) -> None:
        self.stopped = False
        self._worker: _Worker | None = None
        self._lock = threading.Lock()

    def compute(self, task: Task, limit: float | None) -> CaseResult:
        """Compute a case, restarting the worker as often as allowed."""
        deaths, idle_deaths = 0, 0
        while True:
            try:
                worker = self._worker or self._start()
                result = worker.ask(task, limit)
            except _Death as death:
                self.end()
                deaths, idle_deaths = deaths + death.asked, idle_deaths + (not death.asked)
                if self.stopped or idle_deaths == _STARTS:
                    raise WorkerError(f"worker processes die before they are given a case ({death})") from death
                if deaths == ATTEMPTS:
                    return CaseResult(task.digest, Outcome.FAILED, f"{deaths} processes died at it ({death})")
            else:
                if worker.late:
                    self.end()
                return result

    def stop(self) -> None:
        """Kill the worker, and have no other one; from any thread."""
        with self._lock:
            self.stopped = True
            if self._worker is not None:
                self._worker.process.kill()

    def end(self) -> None:
        """Kill the worker and close its pipes; call this from the thread that uses it."""
        with self._lock:
            if self._worker is not None:
                self._worker.end()
            self._worker = None

    def _start(self) -> _Worker:
        with self._lock:
            if self.stopped:
                raise _Death("the sweep is stopped", asked=False)
            self._worker = _Worker()
        self._worker.wait()
        return self._worker


class _Worker:
    """One worker process. ``late``: whether it was killed over a time limit."""

    def __init__(self) -> None:
        root = str(Path(__file__).resolve().parents[2])  # the worker runs this copy of the package
        paths = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self.late = False
        self._noise = tempfile.TemporaryFile()  # noqa: SIM115 (closed with the process)
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "modalshell.sweep.worker"],
            env=os.environ | ONE_THREAD | {"PYTHONPATH": paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._noise,
        )

    @property
    def _pipes(self) -> tuple[IO[bytes], IO[bytes]]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        return self.process.stdin, self.process.stdout

    def wait(self) -> None:
        """Return when it is ready; _Death if it never is."""
        if self._pipes[1].readline() != READY:
            raise self._death(asked=False)

    def ask(self, task: Task, limit: float | None) -> CaseResult:
        """What becomes of a case; _Death if the process dies at it or has died before."""
        tasks, answers = self._pipes
        try:
            tasks.write(msgspec.json.encode(task) + b"\n")
            tasks.flush()
        except OSError:
            raise self._death(asked=False) from None
        timer = None if limit is None else threading.Timer(limit, self._give_up)
        if timer is not None:
            timer.start()
        answer = answers.readline()
        if timer is not None:
            timer.cancel()
            timer.join()
        if answer.endswith(b"\n"):
            return msgspec.json.decode(answer, type=CaseResult)
        if self.late:
            return CaseResult(task.digest, Outcome.STOPPED, f"took longer than {limit:g} s")
        raise self._death(asked=True)

    def end(self) -> None:
        """Kill the process, whatever it is at."""
        self.process.kill()
        self.process.wait()
        for file in (*self._pipes, self._noise):
            with suppress(OSError):  # a task that was not taken
                file.close()

    def _give_up(self) -> None:
        self.late = True
        self.process.kill()

    def _death(self, asked: bool) -> _Death:
        code = self.process.wait()
        self._noise.seek(0)
        lines = [line for line in self._noise.read().decode(errors="replace").splitlines() if line.strip()]
        fatal = [line for line in lines if line.startswith("Fatal Python error")]
        said = (fatal or lines[-1:] or ["no message"])[0]
        return _Death(f"exit status {code}: {said:.200}", asked)
