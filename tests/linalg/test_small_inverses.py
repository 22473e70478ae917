import importlib

import numpy as np
import pytest

import modalshell as ms

small = importlib.import_module("modalshell.linalg.small_inverses")

MANY = 10**9
KINDS = {
    "random": lambda a: a,
    "with equal entries": lambda a: np.round(2.0 * a) / 2.0 + 5.0 * np.eye(a.shape[1]),
    "symmetric": lambda a: a @ a.transpose(0, 2, 1) + 0.1 * np.eye(a.shape[1]),
    "of great ratios": lambda a: a * 10.0 ** np.linspace(-12.0, 12.0, len(a))[:, None, None],
}


def matrices(size, kind):
    return KINDS[kind](np.random.default_rng(size).standard_normal((2000, size, size)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [3, 5])
def test_the_bits_are_those_of_numpy(size, kind):
    given = matrices(size, kind)
    np.testing.assert_array_equal(small.inverses(given, of=MANY), np.linalg.inv(given))


@pytest.mark.parametrize("once", [True, False])
@pytest.mark.parametrize("size", [3, 5])
def test_the_kernel_inverts_whatever_numpy_does(size, once):
    given = matrices(size, "symmetric")
    found = np.empty(given.shape)
    assert small.small_inverses(given, once, found)
    residual = np.abs(found @ given - np.eye(size)).max(axis=(1, 2))
    assert (residual <= 1e-14 * np.linalg.cond(given)).all()


def test_what_has_no_ordinary_pivots_is_left_to_numpy():
    given = matrices(3, "random")
    given[7] = 0.0
    with pytest.raises(np.linalg.LinAlgError):
        small.inverses(given, of=MANY)
    given[7] = np.nan
    np.testing.assert_array_equal(small.inverses(given, of=MANY), np.linalg.inv(given))


def test_large_shells_have_the_bits_that_numpy_gives_them(monkeypatch):
    mesh = ms.flat_beam(cells=(24, 10), family="delaunay")
    material = ms.Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0)

    def stiffness():
        return ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-9).stiffness()

    expected = stiffness()
    monkeypatch.setattr(small, "_MANY", 0)
    np.testing.assert_array_equal(stiffness().data, expected.data)
