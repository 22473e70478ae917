"""Sweeps under kill -9 of workers and drivers at random moments: nothing lost, nothing done twice, the same bits."""

import functools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scenes import SWEPT_BEAM

import modalshell as ms
from modalshell.sweep.case import run_case

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="workers are found through /proc")

AXES = """
[axes]
"model.name" = ["lma", "mwts"]
"model.modes" = {modes}
"loads.gravity" = [{gravities}]
[truth]
name = "rsw"
"""


def write(folder, modes, gravities, duration):
    file = folder / "beams.toml"
    values = ", ".join(f"[0, 0, {-0.5 * (k + 1)}]" for k in range(gravities))
    file.write_text(SWEPT_BEAM.format(duration=duration) + AXES.format(modes=list(modes), gravities=values))
    return file


def started(sweep, folder):
    command = [sys.executable, "-m", "modalshell", "sweep", str(sweep), "--out", str(folder), "--workers", "2"]
    # A shell's background job starts with Ctrl-C ignored, and hands that on.
    heed = functools.partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, preexec_fn=heed)


def finish(process):
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0, out
    return out


def workers_of(driver):
    """Its worker processes."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            command = (stat.parent / "cmdline").read_bytes()
        except (OSError, ValueError, IndexError):
            continue  # it is gone
        if parent == driver and b"modalshell.sweep.worker" in command:
            found.append(int(stat.parent.name))
    return found


def alive(worker):
    try:
        return b"modalshell.sweep.worker" in Path(f"/proc/{worker}/cmdline").read_bytes()
    except OSError:
        return False


def case_files(folder):
    return list((folder / "beams_cases").glob("[!.]*.json"))


def stored(folder):
    return {path.name: path.read_bytes() for path in case_files(folder)}


def sweep_under_kills(sweep, folder, moments, victims, delays, total):
    """Run on and kill -9 one victim each time the stored cases pass a moment; returns kills by victim, and orphans."""
    kills, orphans, before = {"driver": 0, "worker": 0}, [], {}
    driver = started(sweep, folder)
    for moment, victim, delay in zip(moments, victims, delays, strict=True):
        while len(case_files(folder)) < moment * total or not workers_of(driver.pid):
            assert driver.poll() is None, driver.communicate()
            time.sleep(2e-3)
        time.sleep(delay)
        workers = workers_of(driver.pid)
        if victim == "worker" and workers:
            os.kill(workers[int(1e4 * delay) % len(workers)], signal.SIGKILL)
            kills["worker"] += 1
        else:
            driver.kill()
            driver.communicate()
            kills["driver"] += driver.returncode == -signal.SIGKILL
            orphans += workers
            now = stored(folder)
            assert before.items() <= now.items()  # what was stored stays, untouched
            before = now
            driver = started(sweep, folder)
    out = finish(driver)
    assert before.items() <= stored(folder).items()
    return kills, orphans, out


def check(tmp_path, sweep, total, kills, last, seed):
    chance = np.random.default_rng(seed)
    moments = np.sort(chance.uniform(0.0, last, kills))
    victims = ["worker", "driver"] * (kills // 2)  # a case that a driver sees killed three times has failed
    delays = chance.uniform(0.0, 0.05, kills)
    done, orphans, _ = sweep_under_kills(sweep, tmp_path / "killed", moments, victims, delays, total)
    assert sum(done.values()) == kills
    assert min(done.values()) > 0
    # Nothing lost, nothing doubled: a file for each case, and the same summary to the last bit.
    whole, killed = stored(tmp_path / "whole"), stored(tmp_path / "killed")
    assert len(whole) == total
    assert killed.keys() == whole.keys()
    for name in ("beams_sweep.csv", "beams_sweep.png"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    left = sorted(path.name for path in (tmp_path / "killed").rglob(".*"))
    assert left == []
    until = time.monotonic() + 30.0
    while any(alive(worker) for worker in orphans):
        assert time.monotonic() < until, "workers outlive their driver"
        time.sleep(0.05)
    assert orphans
    return done


@pytest.mark.slow
def test_two_kills_of_a_sweep_of_twenty_cases(tmp_path, monkeypatch):
    """Against the sweep in this process, which no kill meets."""
    sweep = write(tmp_path, (2, 5), 4, 6.0)
    with monkeypatch.context() as patch:
        patch.setattr("modalshell.sweep.driver.run_locally", lambda tasks, *_: (run_case(task) for task in tasks))
        ms.run_sweep(sweep, out=tmp_path / "whole")
    check(tmp_path, sweep, 20, 2, 0.8, seed=0)


@pytest.mark.slow
def test_ctrl_c_stops_the_workers_and_says_how_to_go_on(tmp_path):
    sweep = write(tmp_path, (2, 4), 4, 60.0)  # so long that not all cases are done between two looks
    driver = started(sweep, tmp_path / "out")
    while not case_files(tmp_path / "out"):
        assert driver.poll() is None, driver.communicate()
        time.sleep(5e-3)
    workers = workers_of(driver.pid)
    for process in (driver.pid, *workers):  # as the terminal does
        os.kill(process, signal.SIGINT)
    out, _ = driver.communicate(timeout=60)
    assert driver.returncode == 130
    count = len(case_files(tmp_path / "out"))
    assert f"modalshell: stopped: {count} of 20 cases are stored; starting the sweep again does the rest" in out
    assert not any(alive(worker) for worker in workers)
