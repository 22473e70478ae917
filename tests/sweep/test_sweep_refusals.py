"""Sweep files and options that no sweep can have."""

import contextlib
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from scenes import SWEPT_BEAM

import modalshell as ms
from modalshell.sweep import load_sweep


def test_absurd_numbers_and_scenes_are_refused(tmp_path):
    path = tmp_path / "sweep.toml"
    forces = '[[scene.loads.forces]]\nwhere = "x > 0.9"\ntotal = [0, 0, 1]\n'
    axes = "[axes]\n" + f'"loads.forces.{"1" * 5000}.total" = [[0, 0, 1], [0, 0, 2]]\n'
    path.write_text(SWEPT_BEAM.format(duration=1) + forces + axes)
    with pytest.raises(ms.SceneError, match="must name an entry of a list") as caught:
        ms.run_sweep(path)
    assert len(str(caught.value)) < 1000
    scene = Path(__file__).parents[2] / "studies" / "scenes" / "v_beam.toml"
    with pytest.raises(ms.SceneError, match="mesh: a scene is not a sweep: `modalshell run` takes scenes"):
        ms.run_sweep(scene)
    with pytest.raises(ms.OptionError, match=r"time_limit must be a finite number .* at most 1e\+09"):
        ms.run_sweep(load_sweep(Path(__file__).parents[1] / "fuzzing" / "sweep.toml"), time_limit=1e40)


@pytest.mark.parametrize(
    ("cluster", "certificates", "words"),
    [
        (None, ["ca.pem", "cert.pem", "key.pem"], "are for a cluster"),
        ("tcp://127.0.0.1:9", ["ca.pem", "cert.pem", "key.pem"], r"for tls:// \(got 3 files for 'tcp://127.0.0.1:9'\)"),
        ("tls://127.0.0.1:9", ["ca.pem", "cert.pem"], "got 2 files"),
        ("tls://127.0.0.1:9", ["ca.pem", "cert.pem", "none.pem"], "got no file none.pem"),
    ],
)
def test_certificates_are_three_files_for_tls(cluster, certificates, words, tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs dask.distributed (extra 'cluster')")
    monkeypatch.chdir(tmp_path)
    for name in ("ca.pem", "cert.pem", "key.pem"):
        (tmp_path / name).write_text("x")
    sweep = load_sweep(Path(__file__).parents[1] / "fuzzing" / "sweep.toml")
    with pytest.raises(ms.OptionError, match=words):
        ms.run_sweep(sweep, out=tmp_path / "out", cluster=cluster, certificates=certificates)


def test_tls_takes_the_certificates_and_the_advice_is_safe(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs dask.distributed (extra 'cluster')")
    asked = []

    async def nobody(_address, security):
        asked.append(security)
        raise OSError("nobody is here")

    monkeypatch.setattr("modalshell.sweep.cluster._asked", nobody)
    files = [tmp_path / name for name in ("ca.pem", "cert.pem", "key.pem")]
    for file in files:
        file.write_text("x")
    sweep = load_sweep(Path(__file__).parents[1] / "fuzzing" / "sweep.toml")
    with pytest.raises(ms.WorkerError, match=r"dask scheduler --host 127\.0\.0\.1.*with TLS .*it unpickles"):
        ms.run_sweep(sweep, out=tmp_path / "out", cluster="tls://127.0.0.1:9", certificates=files)
    assert asked[0].require_encryption
    assert (asked[0].tls_ca_file, asked[0].tls_client_cert, asked[0].tls_client_key) == tuple(map(str, files))


@pytest.fixture
def answering():
    """Starts a server on 127.0.0.1 that sends each caller some bytes and keeps the line open; its port."""
    servers, lines = [], []

    def start(data):
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)

        def serve():
            with contextlib.suppress(OSError):
                while True:
                    lines.append(server.accept()[0])
                    lines[-1].sendall(data)

        threading.Thread(target=serve, daemon=True).start()
        return server.getsockname()[1]

    yield start
    for one in (*servers, *lines):
        one.close()


CALLS = """
import sys
from modalshell.commands.cli import main

for address in sys.argv[3:]:
    try:
        main(["sweep", sys.argv[1], "--out", sys.argv[2], "--cluster", address])
    except SystemExit as end:
        assert end.code == 2, (address, end.code)
    else:
        raise AssertionError(address)
"""


@pytest.mark.slow
def test_what_is_no_scheduler_is_told_in_one_line(answering, tmp_path):
    """A silent one, and some of other kinds.

    In a process of their own: a client without a connection prints a traceback when it is dropped."""
    pytest.importorskip("distributed", reason="dask.distributed is not installed (pip install 'modalshell[cluster]')")
    sweep = tmp_path / "beams.toml"
    sweep.write_text(SWEPT_BEAM.format(duration=0.2) + '[axes]\n"model.name" = ["lma", "mwts"]\n')
    schedulers = [("tcp://127.0.0.1:{}", b""), ("tcp://127.0.0.1:{}", b"\xff" * 4096)]
    schedulers += [("ucx://127.0.0.1:{}", b""), ("inproc://nothing:{}", b"")]
    addresses = [address.format(answering(data)) for address, data in schedulers]
    command = [sys.executable, "-c", CALLS, str(sweep), str(tmp_path / "out"), *addresses]
    found = subprocess.run(command, capture_output=True, text=True, timeout=60 * len(addresses), check=False)
    assert found.returncode == 0, found.stderr
    assert "Traceback" not in found.stderr
    lines = [line for line in found.stderr.splitlines() if "scenes checked" not in line]
    assert len(lines) == len(addresses)
    for line, address in zip(lines, addresses, strict=True):
        assert line.startswith(f"modalshell: no scheduler of dask.distributed answers at {address!r}")
