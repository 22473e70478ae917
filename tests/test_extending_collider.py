"""A collider of another package takes one file: a class with a key, which scenes then know."""

import numpy as np
import pytest
from guide import source

import modalshell as ms
from modalshell.contact import COLLIDERS

TABLE = '[[contacts]]\nkind = "ring"\ncenter = [0.7, 0.0, -0.15]\nradius = 0.1\ntube = 0.05\n'


@pytest.fixture
def ring(install_modules):
    install_modules("ring = toy_ring", toy_ring=source("toy_ring.py"))
    ms.models()
    yield
    COLLIDERS.pop("ring", None)


@pytest.mark.usefixtures("ring")
def test_its_gap_has_the_derivatives_it_states_and_its_surface_is_where_the_gap_is_zero():
    from toy_ring import Ring

    collider = Ring((0.1, 0.2, 0.3), 0.5, 0.1)
    rng = np.random.default_rng(1)
    x, step = rng.normal(size=(20, 3)), 1e-6 * rng.normal(size=(20, 3))
    _, normal, curvature = collider.gap(x)
    before, after = collider.gap(x - step), collider.gap(x + step)
    np.testing.assert_allclose(after[0] - before[0], 2.0 * (normal * step).sum(axis=1), atol=1e-12)
    np.testing.assert_allclose(after[1] - before[1], 2.0 * np.einsum("nij,nj->ni", curvature, step), atol=1e-10)
    corners, triangles = collider.surface(x)
    np.testing.assert_allclose(collider.gap(corners)[0], 0.0, atol=1e-12)
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    assert np.einsum("ni,ni", np.cross(b - a, c - a), collider.gap((a + b + c) / 3.0)[1]) > 0.0


@pytest.mark.slow
@pytest.mark.usefixtures("ring")
def test_a_scene_lies_on_a_collider_of_another_package(scene_file):
    file = scene_file(("[motion]\nduration = 1\n", ""), ("[model]", f"{TABLE}[model]"))
    state = ms.load_scene(file).build().equilibrium()
    assert state.in_contact.any()
    assert state.deepest < 1e-6
    assert state.contact_forces[:, 2].sum() > 0.0
    with pytest.raises(ms.SceneError, match=r"contacts\[0\]\.tub: unknown key; did you mean 'tube'"):
        ms.load_scene(scene_file(("[model]", f"{TABLE.replace('tube', 'tub')}[model]")))
