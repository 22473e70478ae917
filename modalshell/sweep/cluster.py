"""Sweep cases on a cluster, by dask.distributed."""

from __future__ import annotations

import importlib.util
import itertools
import os
import re
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from modalshell.core.checks import shortened, shown
from modalshell.core.errors import OptionError, WorkerError
from modalshell.core.outcome import Outcome
from modalshell.sweep.case import CaseResult, Task, run_case

_SECONDS = 5
"""How long a scheduler may take to answer, and to have a first worker."""
_AHEAD = 4
"""Cases that the scheduler holds for each thread of its workers: their meshes are not all sent at once."""


def connect(address: str, certificates: Sequence[str | os.PathLike[str]] | None = None) -> Any:
    """A client of the scheduler at ``address``, such as ``tcp://10.0.0.1:8786``.

    Whoever reaches a scheduler can run code on it and on its workers, for it unpickles what it is sent: it belongs on
    127.0.0.1, on a network of its own, or behind TLS, ``tls://10.0.0.1:8786`` with ``certificates``: the files of the
    authority, of this machine's certificate and of its key. OptionError if dask.distributed is not installed, or
    certificates are no three files, or not for ``tls://``. WorkerError if no scheduler answers there within a few
    seconds, or it has no workers.
    """
    if importlib.util.find_spec("distributed") is None:
        raise OptionError("a cluster needs dask.distributed: pip install 'modalshell[cluster]'")
    import asyncio  # with distributed, not before: its import takes long

    from distributed import Client, Security

    security = Security()
    if certificates is not None:
        files = [Path(file) for file in certificates]
        missing = [str(file) for file in files if not file.is_file()]
        if len(files) != 3 or missing or not address.startswith("tls://"):
            got = f"no file {missing[0]}" if missing else f"{len(files)} files for {shown(address)}"
            raise OptionError(
                f"certificates must be the files of authority, certificate and key, for tls:// (got {got})"
            )
        names = dict(zip(("tls_ca_file", "tls_client_cert", "tls_client_key"), map(str, files), strict=True))
        security = Security(require_encryption=True, **names)
    elif address.startswith("tls://") and security.get_connection_args("client")["ssl_context"] is None:
        raise OptionError(
            f"{shown(address)} needs certificates: give the files of authority, certificate and key (--certificates), "
            "or name them in the configuration of dask"
        )
    try:
        if not re.search(r"://|:\d+$", address):
            raise ValueError("the address names no port")
        with ThreadPoolExecutor(1) as pool:  # the caller may have an event loop of its own, as notebooks have
            pool.submit(asyncio.run, _asked(address, security)).result()
        client = Client(address, timeout=_SECONDS, set_as_default=False, security=security)
    except Exception as error:  # AssertionError too, from addresses of other protocols
        raise WorkerError(
            f"no scheduler of dask.distributed answers at {shown(address)}: start one with 'dask scheduler --host "
            "127.0.0.1', or with TLS where others reach it (it unpickles, and so runs, what it is sent), and give its "
            f"address, such as tcp://127.0.0.1:8786 ({type(error).__name__}: {shortened(str(error))})"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_SECONDS)
    except OSError as error:
        client.close()
        raise WorkerError(
            f"the scheduler at {address} has no workers: start some with 'dask worker {address} --nworkers auto'"
        ) from error
    return client


async def _asked(address: str, security: Any) -> None:
    """Ask a scheduler who it is.

    A client waits without end for one that is silent, and prints a traceback once it is dropped without a connection.
    """
    import asyncio

    from distributed.comm.core import connect as connected

    arguments = security.get_connection_args("client")
    comm = await asyncio.wait_for(connected(address, timeout=_SECONDS, **arguments), _SECONDS)
    try:
        await comm.write({"op": "identity", "reply": True})
        answer = await asyncio.wait_for(comm.read(), _SECONDS)
        if not (isinstance(answer, dict) and answer.get("type") == "Scheduler"):
            raise ValueError("what answers is no scheduler")
    finally:
        comm.abort()


def run_on_cluster(tasks: Sequence[Task], client: Any) -> Generator[CaseResult, None, None]:
    """Compute cases on a cluster; yield each result as it is ready.

    The cluster does a killed worker's cases again, up to its ``allowed-failures``, three by default. WorkerError if the
    cluster is lost, or its workers cannot compute any case.
    """
    from distributed import KilledWorker, as_completed

    threads = sum(worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values())
    rest = iter(tasks)

    def submit(task: Task) -> Any:
        return client.submit(run_case, task, key=f"modalshell-{task.digest}", pure=True)

    first = [submit(task) for task in itertools.islice(rest, _AHEAD * threads)]
    ahead = as_completed(first, loop=client.loop)
    for future in ahead:
        if future.status in ("lost", "pending"):  # its worker died with the result: the scheduler computes it again
            ahead.add(future)
            continue
        digest = future.key.removeprefix("modalshell-")
        try:
            result = future.result()
        except KilledWorker:
            result = CaseResult(digest, Outcome.FAILED, "the cluster's workers died at it")
        except Exception as error:
            raise WorkerError(
                f"the cluster gives no result but {future.status!r} ({type(error).__name__}: {error}); what it has "
                "given is stored, and starting the sweep again does the rest"
            ) from error
        yield result
        future.release()
        ahead.update([submit(task) for task in itertools.islice(rest, 1)])
