"""Cases computed by a cluster of dask.distributed."""

from __future__ import annotations

import importlib.util
import itertools
import re
from collections.abc import Generator, Sequence
from typing import Any

from modalshell.checks import shortened, shown
from modalshell.errors import OptionError, WorkerError
from modalshell.outcome import Outcome
from modalshell.sweep.case import CaseResult, Task, run_case

_SECONDS = 5
"""How long a scheduler may take to answer, and to have a first worker."""
_AHEAD = 4
"""Cases that the scheduler holds for each thread of its workers: their meshes are not all sent at once."""


def connect(address: str) -> Any:
    """A client of the scheduler at ``address``, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    OptionError
        If dask.distributed is not installed.
    WorkerError
        If no scheduler answers there within a few seconds, or it has no workers.
    """
    if importlib.util.find_spec("distributed") is None:
        raise OptionError("a cluster needs dask.distributed: pip install 'modalshell[cluster]'")
    from distributed import Client

    try:
        if not re.search(r"://|:\d+$", address):
            raise ValueError("the address names no port")
        client = Client(address, timeout=_SECONDS, set_as_default=False)
    except Exception as error:  # AssertionError too, from addresses of other protocols
        raise WorkerError(
            f"no scheduler of dask.distributed answers at {shown(address)}: start one with 'dask scheduler' and give "
            f"its address, such as tcp://10.0.0.1:8786 ({type(error).__name__}: {shortened(str(error))})"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_SECONDS)
    except OSError as error:
        client.close()
        raise WorkerError(
            f"the scheduler at {address} has no workers: start some with 'dask worker {address} --nworkers auto'"
        ) from error
    return client


def run_on_cluster(tasks: Sequence[Task], client: Any) -> Generator[CaseResult, None, None]:
    """Compute cases on a cluster; yield each result as it is found.

    The cluster does a killed worker's cases again, up to its ``allowed-failures``, three unless it is told otherwise.

    Raises
    ------
    WorkerError
        If the cluster is lost, or its workers cannot compute any case.
    """
    from distributed import KilledWorker, as_completed

    threads = sum(worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values())
    rest = iter(tasks)

    def submit(task: Task) -> Any:
        return client.submit(run_case, task, key=f"modalshell-{task.digest}", pure=True)

    first = [submit(task) for task in itertools.islice(rest, _AHEAD * threads)]
    ahead = as_completed(first, loop=client.loop)
    for future in ahead:
        if future.status == "finished":
            yield future.result()
        else:
            error = future.exception() if future.status == "error" else None
            if not isinstance(error, KilledWorker):
                raise WorkerError(
                    f"the cluster gives no result but {future.status!r} ({type(error).__name__}: {error}); what it has "
                    "given is stored, and starting the sweep again does the rest"
                ) from error
            digest = future.key.removeprefix("modalshell-")
            yield CaseResult(digest, Outcome.FAILED, "the cluster's workers died at it")
        future.release()
        ahead.update([submit(task) for task in itertools.islice(rest, 1)])
