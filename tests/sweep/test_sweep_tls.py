"""A sweep on a cluster behind TLS: a handshake with certificates that the test makes, and none without them."""

import shutil
import subprocess

import pytest
from later import later
from scenes import SWEPT_BEAM

import modalshell as ms
from modalshell.commands.cli import main

distributed = later("distributed", "needs dask.distributed (extra 'cluster')")
pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here to make certificates with")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """A key and a certificate that signs itself, authority and member of the cluster at once."""
    folder = tmp_path_factory.mktemp("tls")
    certificate, key = folder / "certificate.pem", folder / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    return certificate, certificate, key


@pytest.mark.slow
def test_a_sweep_shakes_hands_over_tls(certificates, tmp_path, capsys):
    authority, certificate, key = map(str, certificates)
    roles = {f"tls_{role}_{part}": path for role in ("scheduler", "worker", "client")
             for part, path in (("cert", certificate), ("key", key))}  # fmt: skip
    security = distributed.Security(require_encryption=True, tls_ca_file=authority, **roles)
    sweep = tmp_path / "beams.toml"
    sweep.write_text(SWEPT_BEAM.format(duration=0.2) + '[axes]\n"model.name" = ["lma", "mwts"]\n')
    options = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(n_workers=1, security=security, protocol="tls://", **options) as cluster:
        address = cluster.scheduler_address
        assert address.startswith("tls://")
        with pytest.raises(ms.WorkerError, match="no scheduler"):
            ms.run_sweep(sweep, out=tmp_path / "plain", cluster=address.replace("tls://", "tcp://"))
        command = ["sweep", str(sweep), "--out", str(tmp_path / "out"), "--cluster", address, "--certificates"]
        with pytest.raises(SystemExit) as ended:
            main([*command, authority, certificate, key])
    assert ended.value.code == 0
    assert "2 cases, 2 completed; 2 computed now" in capsys.readouterr().out
