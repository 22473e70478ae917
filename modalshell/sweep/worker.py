"""Worker process of a sweep: tasks from standard input, results to standard output."""

from __future__ import annotations

import faulthandler
import os
import queue
import signal
import sys
import threading
from typing import IO

import msgspec

from modalshell.sweep.case import Task, run_case

READY = b"ready\n"


def main() -> None:
    """Answer tasks, one line of JSON each, until the driver ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the whole group: the driver ends its workers
    faulthandler.enable()
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not get among the answers
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, tasks), daemon=True).start()
    answers.write(READY)
    answers.flush()
    while True:
        result = run_case(msgspec.json.decode(tasks.get(), type=Task))
        answers.write(msgspec.json.encode(result) + b"\n")
        answers.flush()


def _listen(given: IO[bytes], tasks: queue.SimpleQueue[bytes]) -> None:
    """Pass tasks on; leave at once when the driver's end closes, even by a kill and in the middle of a case."""
    while line := given.readline():
        tasks.put(line)
    os._exit(0)


if __name__ == "__main__":
    main()
