"""Sweep files and options that no sweep can have."""

from pathlib import Path

import pytest
from scenes import SWEPT_BEAM

import modalshell as ms
from modalshell.sweep import load_sweep


def test_absurd_numbers_are_refused(tmp_path):
    path = tmp_path / "sweep.toml"
    forces = '[[scene.loads.forces]]\nwhere = "x > 0.9"\ntotal = [0, 0, 1]\n'
    axes = "[axes]\n" + f'"loads.forces.{"1" * 5000}.total" = [[0, 0, 1], [0, 0, 2]]\n'
    path.write_text(SWEPT_BEAM.format(duration=1) + forces + axes)
    with pytest.raises(ms.SceneError, match="must name an entry of a list") as caught:
        ms.run_sweep(path)
    assert len(str(caught.value)) < 1000
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
    distributed = pytest.importorskip("distributed", reason="needs dask.distributed (extra 'cluster')")
    asked = []

    def client(_address, security, **_):
        asked.append(security)
        raise OSError("nobody is here")

    monkeypatch.setattr(distributed, "Client", client)
    files = [tmp_path / name for name in ("ca.pem", "cert.pem", "key.pem")]
    for file in files:
        file.write_text("x")
    sweep = load_sweep(Path(__file__).parents[1] / "fuzzing" / "sweep.toml")
    with pytest.raises(ms.WorkerError, match=r"dask scheduler --host 127\.0\.0\.1.*with TLS .*it unpickles"):
        ms.run_sweep(sweep, out=tmp_path / "out", cluster="tls://127.0.0.1:9", certificates=files)
    assert asked[0].require_encryption
    assert (asked[0].tls_ca_file, asked[0].tls_client_cert, asked[0].tls_client_key) == tuple(map(str, files))
