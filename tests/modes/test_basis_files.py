"""Saved bases: what comes back, and damaged files by their fault."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from scenes import SHELLS

from modalshell import Basis, Material, Shell, flat_beam, solve_modes
from modalshell.core.errors import FileFormatError, ModalShellError


@pytest.mark.parametrize("name", SHELLS)
def test_a_saved_basis_comes_back(name, tmp_path):
    basis = solve_modes(SHELLS[name], 9)
    basis.save(tmp_path / "basis.npz")
    loaded = Basis.load(tmp_path / "basis.npz")
    for field in ("eigenvalues", "modes", "rotations"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(basis, field))
    for field in ("rigid_modes", "residual", "backend", "count"):
        assert getattr(loaded, field) == getattr(basis, field)
    np.testing.assert_array_equal(loaded.shell.clamped, basis.shell.clamped)
    np.testing.assert_array_equal(loaded.shell.mesh.faces, basis.shell.mesh.faces)
    x = basis.shell.rest_positions + 0.01 * np.random.default_rng(0).standard_normal(basis.shell.rest_positions.shape)
    assert loaded.shell.energy(x) == basis.shell.energy(x)
    np.testing.assert_array_equal(loaded.shell.mass, basis.shell.mass)


def test_a_saved_basis_keeps_arrays_of_stiffness(tmp_path):
    mesh = flat_beam(cells=(10, 2), family="equilateral")
    material = Material.from_physical(young=1e6, poisson=0.3, thickness=1e-3, density=1e3, mesh=mesh)
    basis = solve_modes(Shell(mesh, material, mesh.vertices[:, 0] < 0.15), 4)
    basis.save(str(tmp_path / "basis.npz"))
    loaded = Basis.load(str(tmp_path / "basis.npz"))
    assert loaded.shell.material.correct_clamp
    for name in ("stretch", "shear", "flexure", "density"):
        np.testing.assert_array_equal(getattr(loaded.shell.material, name), getattr(material, name))
    for ours, theirs in zip(loaded.shell.elements, basis.shell.elements, strict=True):
        np.testing.assert_array_equal(ours.weight, theirs.weight)


def rewritten(path, **changes):
    """The saved basis with some arrays changed, or left out where the value is None."""
    with np.load(path) as stored:
        data = {name: stored[name] for name in stored.files} | changes
    np.savez(path, **{name: value for name, value in data.items() if value is not None})


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "basis.npz"
    solve_modes(SHELLS["clamped v_beam"], 3).save(path)
    return path


def refused(path):
    with pytest.raises(FileFormatError) as caught:
        Basis.load(path)
    assert isinstance(caught.value, ModalShellError)
    assert Path(path).name in str(caught.value)


def test_missing_file_is_named(tmp_path):
    refused(tmp_path / "nowhere.npz")


def test_other_files_are_refused(tmp_path):
    for name, content in (("text.npz", b"hello"), ("empty.npz", b""), ("zip.npz", b"PK\x03\x04 not really")):
        (tmp_path / name).write_bytes(content)
        refused(tmp_path / name)
    np.save(tmp_path / "array.npy", np.arange(3.0))
    refused(tmp_path / "array.npy")
    np.savez(tmp_path / "other.npz", a=np.arange(3.0))
    refused(tmp_path / "other.npz")
    refused(tmp_path)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9, 0.999])
def test_truncated_files_are_refused(saved, share):
    content = saved.read_bytes()
    saved.write_bytes(content[: int(share * len(content))])
    refused(saved)


def test_flipped_bytes_are_refused(saved):
    content = bytearray(saved.read_bytes())
    with zipfile.ZipFile(saved) as archive:
        info = archive.getinfo("modes.npy")
    middle = info.header_offset + 60 + info.compress_size // 2
    content[middle] ^= 0xFF
    saved.write_bytes(bytes(content))
    refused(saved)


def test_other_formats_are_refused(saved):
    rewritten(saved, modalshell_basis=np.array(999))
    refused(saved)
    rewritten(saved, modalshell_basis=np.array([1, 2]))
    refused(saved)


@pytest.mark.parametrize(
    "name", ["vertices", "supports", "stretch", "correct_clamp", "energies", "eigenvalues", "modes", "backend"]
)
def test_files_that_lack_an_array_are_refused(saved, name):
    rewritten(saved, **{name: None})
    refused(saved)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("modes", np.zeros((7, 3))),
        ("rotations", np.zeros((7, 3))),
        ("eigenvalues", np.zeros(5)),
        ("faces", np.array([[0, 1, 99999]])),
        ("supports", np.zeros(3, dtype=bool)),
        ("density", np.array(-1.0)),
        ("rigid_modes", np.array([1, 2])),
        ("modes", np.array(["a"])),
    ],
)
def test_files_with_arrays_that_do_not_fit_are_refused(saved, name, value):
    rewritten(saved, **{name: value})
    refused(saved)
