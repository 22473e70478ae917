"""Running and resuming a sweep."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from modalshell.core.checks import checked_callback, checked_count, checked_folder, checked_number, shown
from modalshell.core.cores import usable_cores
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Progress
from modalshell.sweep.case import CaseResult, Task
from modalshell.sweep.cluster import connect, run_on_cluster
from modalshell.sweep.figure import checked_value, draw_summary
from modalshell.sweep.grid import Sweep, load_sweep
from modalshell.sweep.local import run_locally
from modalshell.sweep.plan import Plan
from modalshell.sweep.store import CaseFolder
from modalshell.sweep.summary import (
    MEASURES,
    SummaryRow,
    refuse_parquet_without_pyarrow,
    run_rows,
    summary_rows,
    unit_rows,
    write_csv,
    write_parquet,
)

_LONGEST_LIMIT = 1e9
"""Seconds beyond which no time limit can be waited for."""
_AGAIN = (Outcome.FAILED, Outcome.STOPPED)
"""Outcomes that may differ at another time or on another machine; repeated only on request."""


@short_repr
@dataclass(frozen=True)
class SweepResult:
    """Result of a sweep.

    Attributes
    ----------
    rows : list of dict
        The summary: a row for each case in the order of the grid, the last axis first; None where there is no value.
    files : list of Path
        ``NAME_sweep.csv``, the requested formats, ``NAME_sweep_runs.csv``, and the units of the summary's columns in
        ``NAME_sweep_units.csv``.
    computed, stored : int
        Cases that were computed now, and that were there from before; each truth counts as one.
    note : str
        "", or why there is no picture.
    """

    rows: list[SummaryRow]
    files: list[Path]
    computed: int
    stored: int
    note: str = ""

    def counts(self) -> dict[Outcome, int]:
        """Rows by outcome."""
        return dict(Counter(Outcome(row["outcome"]) for row in self.rows))


def run_sweep(
    sweep: Sweep | str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    certificates: Sequence[str | os.PathLike[str]] | None = None,
    time_limit: float | None = None,
    retry: bool = False,
    on_check: Progress | None = None,
    on_step: Progress | None = None,
) -> SweepResult:
    """Run all cases of a sweep that are not stored yet, and write a summary.

    Every scene of the grid is checked before the first case is run. Each finished case is stored at once, in a file of
    ``NAME_cases`` named by the digest of its scene and mesh: however often a sweep is stopped, or its workers are
    killed, no result is lost or there twice, and the summary is that of an undisturbed sweep to the last bit. Cases
    that a changed sweep has in common with an earlier one are not computed again.

    Parameters
    ----------
    sweep : Sweep or path
        The sweep or its file; see :func:`~modalshell.sweep.load_sweep`.
    out : path, optional
        Folder for the results; by default the sweep's.
    workers : int, optional
        Processes on this machine, each on one thread; by default one per core.
    cluster : str, optional
        Address of a scheduler of dask.distributed that computes the cases instead.
    certificates : sequence of path, optional
        Files of the authority, the certificate and the key of a ``tls://`` cluster.
    time_limit : float, optional
        Time [s] after which a case is aborted and recorded as stopped (not on a cluster).
    retry : bool
        Whether to compute again the stored cases that failed or were stopped by the time limit.
    on_check : callable, optional
        Called with the scenes checked before the first case is run, and their total.
    on_step : callable, optional
        Called with the cases stored and their total.

    Returns
    -------
    SweepResult
        Rows of the summary, and files.

    Raises
    ------
    SceneError
        Where the sweep or a scene of its grid is refused.
    OptionError
        For a bad option, or if another process runs this sweep in this folder.
    WorkerError
        If worker processes do not start, or the cluster does not answer or is lost.
    KeyboardInterrupt
        When stopped, with a message of how much is stored.
    """
    on_check = checked_callback("on_check", on_check)
    on_step = checked_callback("on_step", on_step)
    folder = None if out is None else checked_folder("out", out)
    declared = sweep if isinstance(sweep, Sweep) else load_sweep(checked_folder("sweep", sweep))
    folder = folder or Path(declared.output.folder)
    compute = _checked_means(workers, cluster, certificates, time_limit)
    value = checked_value(declared.output.value, declared.truth is not None, MEASURES, declared.file)
    if "parquet" in declared.output.formats:
        refuse_parquet_without_pyarrow()
    plan = Plan(declared, on_check)
    with CaseFolder(folder / f"{declared.name}_cases") as store:
        results = {digest: result for digest in plan.tasks if (result := store.read(digest)) is not None}
        if retry:
            results = {digest: result for digest, result in results.items() if result.outcome not in _AGAIN}
        stored = len(results)
        _complete(results, plan, store, compute, on_step)
        files, rows, note = _write(declared, plan, results, folder, value)
    return SweepResult(rows, files, len(plan.tasks) - stored, stored, note)


def _checked_means(
    workers: int | None,
    cluster: str | None,
    certificates: Sequence[str | os.PathLike[str]] | None,
    time_limit: float | None,
) -> Callable[[list[Task]], Generator[CaseResult, None, None]]:
    """What computes cases, on this machine or on a cluster, by options that go together."""
    count = usable_cores() if workers is None else checked_count("workers", workers)
    if time_limit is not None:
        checked_number("time_limit", time_limit, above=0.0, at_most=_LONGEST_LIMIT, unit="s")
    if cluster is None:
        if certificates is not None:
            raise OptionError(f"certificates are for a cluster: give its address tls://... (got {shown(certificates)})")
        return lambda tasks: run_locally(tasks, count, time_limit)
    if time_limit is not None or workers is not None:
        raise OptionError("workers and a time limit are for this machine: leave them out with a cluster")
    if not isinstance(cluster, str):
        raise OptionError(f"cluster must be a scheduler's address, as tcp://10.0.0.1:8786 (got {shown(cluster)})")

    def on_cluster(tasks: list[Task]) -> Generator[CaseResult, None, None]:
        with connect(cluster, certificates) as client:
            yield from run_on_cluster(tasks, client)

    return on_cluster


def _complete(
    results: dict[str, CaseResult],
    plan: Plan,
    store: CaseFolder,
    compute: Callable[[list[Task]], Generator[CaseResult, None, None]],
    on_step: Progress,
) -> None:
    """Compute the cases of a plan that have no result yet; each is stored at once, and added to ``results``."""
    missing = [task for digest, task in plan.tasks.items() if digest not in results]
    if not missing:
        return
    try:
        with closing(compute(missing)) as computed:
            for result in computed:
                store.write(result)
                results[result.digest] = result
                on_step(len(results), len(plan.tasks))
    except KeyboardInterrupt as stop:
        # From the files: a stop may fall between the writing of one and its count.
        stored = sum(store.read(digest) is not None for digest in plan.tasks)
        done = f"{stored} of {len(plan.tasks)} cases are stored"
        raise KeyboardInterrupt(f"{done}; starting the sweep again does the rest") from stop


def _write(
    sweep: Sweep, plan: Plan, results: Mapping[str, CaseResult], folder: Path, value: str
) -> tuple[list[Path], list[SummaryRow], str]:
    stem, note = f"{sweep.name}_sweep", ""
    rows = summary_rows(plan, [axis.key for axis in sweep.axes], results)
    units = unit_rows(rows, (scene for _, scene in sweep.points()))
    files = [write_csv(folder / f"{stem}.csv", rows)]
    if "parquet" in sweep.output.formats:
        files.append(write_parquet(folder / f"{stem}.parquet", rows))
    if "png" in sweep.output.formats:
        picture = folder / f"{stem}.png"
        named = {row["column"]: row["unit"] for row in units}
        note = draw_summary(rows, sweep.axes, value, picture, sweep.name, named)
        if note:
            picture.unlink(missing_ok=True)  # one of an earlier sweep would be taken for this one's
        else:
            files.append(picture)
    files.append(write_csv(folder / f"{stem}_runs.csv", run_rows(plan, results)))
    files.append(write_csv(folder / f"{stem}_units.csv", units))
    return files, rows, note
