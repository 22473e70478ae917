"""A basis as arrays for other engines."""

import json

import numpy as np
import pytest
from scenes import PLAIN

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.export import save_modal_body


@pytest.fixture(scope="module")
def basis():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=150.0, cells=(10, 4))
    return ms.solve_modes(ms.Shell(mesh, PLAIN), 10)


def test_the_arrays_are_what_the_document_says(basis, tmp_path):
    arrays_file, document_file = save_modal_body(basis, tmp_path / "strip.npz")
    document = json.loads(document_file.read_text())
    with np.load(arrays_file, allow_pickle=False) as arrays:
        assert set(arrays) - {"sha256"} == set(document["arrays"])
        for name, told in document["arrays"].items():
            assert list(arrays[name].shape) == told["shape"]
        masses, modes = arrays["masses"], arrays["modes"]
        gram = np.einsum("v,ivx,jvx->ij", masses, modes, modes)
        np.testing.assert_allclose(gram, np.eye(10), atol=1e-9)
        np.testing.assert_allclose(arrays["eigenvalues"], (2.0 * np.pi * arrays["frequencies"]) ** 2)
        assert document["mass"] == pytest.approx(masses.sum())
        # Of a free body elastic modes move neither its centre nor its angular momentum; rigid ones have all of both.
        integrals = np.hstack([arrays["translation"], arrays["rotation"]])
        assert np.abs(integrals[6:]).max() < 1e-8
        rigid = integrals[:6].T @ integrals[:6]
        np.testing.assert_allclose(rigid[:3, :3], document["mass"] * np.eye(3), atol=1e-9)
        np.testing.assert_allclose(rigid[3:, 3:], arrays["inertia"], atol=1e-9)


def test_the_command_writes_both_files(basis, tmp_path, capsys):
    basis.save(tmp_path / "strip.npz")
    with pytest.raises(SystemExit) as ended:
        main(["export", str(tmp_path / "strip.npz"), "--to", "body"])
    assert not ended.value.code
    assert "strip_body.json" in capsys.readouterr().out
    assert (tmp_path / "strip_body.npz").exists()
    assert json.loads((tmp_path / "strip_body.json").read_text())["modes"] == 10


def test_other_names_are_refused(basis, tmp_path):
    with pytest.raises(ms.OptionError, match=r"must end in \.npz"):
        save_modal_body(basis, tmp_path / "strip.dat")
