"""Sweeps over dask.distributed, on a cluster of worker processes that the test starts on this machine."""

import os
import signal

import pytest
from later import later
from scenes import SWEPT_BEAM

import modalshell as ms
from modalshell.sweep.case import run_case

distributed = later("distributed", "needs dask.distributed (extra 'cluster')")
dask = later("dask")

SWEEP = (
    SWEPT_BEAM.format(duration=3.0)
    + """
[axes]
"model.name" = ["lma", "mwts"]
"loads.gravity" = [[0, 0, -1], [0, 0, -2], [0, 0, -3], [0, 0, -4], [0, 0, -5], [0, 0, -6], [0, 0, -7], [0, 0, -8]]
"""
)


@pytest.fixture
def cluster(request):
    """As many workers as the test says."""
    quick = {"distributed.comm.timeouts.connect": "2s"}  # how long results are sought at a dead worker; else 30 s
    options = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None, "silence_logs": 50}
    local = distributed.LocalCluster  # imported before a setting of it is changed, and changed back
    with dask.config.set(quick), local(n_workers=request.param, **options) as started:
        yield started


@pytest.fixture
def sweep(tmp_path):
    file = tmp_path / "beams.toml"
    file.write_text(SWEEP)
    return file


@pytest.mark.slow
@pytest.mark.parametrize("cluster", [2], indirect=True)
def test_a_killed_worker_of_a_cluster_costs_nothing(cluster, sweep, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("modalshell.sweep.driver.run_locally", lambda tasks, *_: (run_case(task) for task in tasks))
        ms.run_sweep(sweep, out=tmp_path / "here")
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        victim = next(iter(client.run(os.getpid).values()))
    steps = []

    def kill(done, total):
        steps.append((done, total))
        assert len(list((tmp_path / "out" / "beams_cases").glob("*.json"))) == done  # each is stored at once
        if done == 3:
            os.kill(victim, signal.SIGKILL)

    result = ms.run_sweep(sweep, out=tmp_path / "out", cluster=cluster.scheduler_address, on_step=kill)
    assert steps == [(done, 16) for done in range(1, 17)]
    assert result.counts() == {"completed": 16}
    for name in ("beams_sweep.csv", "beams_sweep.png"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "here" / name).read_bytes()
    again = ms.run_sweep(sweep, out=tmp_path / "out", cluster=cluster.scheduler_address)
    assert (again.computed, again.rows) == (0, result.rows)


@pytest.mark.parametrize("cluster", [1], indirect=True)
def test_a_case_that_kills_the_clusters_workers_is_recorded(cluster, sweep, tmp_path, monkeypatch):
    def deadly(task):
        if task.scene["loads"]["gravity"][2] == -3:
            os.kill(os.getpid(), signal.SIGKILL)
        return run_case(task)

    monkeypatch.setattr("modalshell.sweep.cluster.run_case", deadly)
    sweep.write_text(SWEEP.replace('"lma", "mwts"', '"lma"').replace("3.0", "0.1"))
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        client.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0))
    result = ms.run_sweep(sweep, out=tmp_path / "out", cluster=cluster.scheduler_address)
    assert result.rows[2]["outcome"] == "failed"
    assert result.rows[2]["message"] == "the cluster's workers died at it"


@pytest.mark.by_default("127.0.0.1", "nowhere://a")
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "127.0.0.1", "nowhere://a"])
def test_an_address_that_answers_not_is_refused(sweep, tmp_path, monkeypatch, address):
    monkeypatch.setattr("modalshell.sweep.cluster._SECONDS", 1)
    with pytest.raises(ms.WorkerError, match=r"no scheduler of dask.distributed answers at .*dask scheduler"):
        ms.run_sweep(sweep, out=tmp_path / "out", cluster=address)


def test_a_cluster_needs_dask(sweep, tmp_path, monkeypatch):
    monkeypatch.setattr("modalshell.sweep.cluster.importlib.util.find_spec", lambda _name: None)
    with pytest.raises(ms.OptionError, match=r"pip install 'modalshell\[cluster\]'"):
        ms.run_sweep(sweep, out=tmp_path / "out", cluster="tcp://127.0.0.1:9")
