"""What takes modal coordinates from outside checks them."""

import numpy as np
import pytest
from fuzzing.world import world

import modalshell as ms

MODAL = ["mwts, free", *(key for key, spec in ms.models().items() if spec.on_modes)]


@pytest.mark.slow
def test_all_that_take_coordinates_are_tried():
    assert [name for name, model in world()["models"].items() if hasattr(model, "displacement")] == MODAL


@pytest.mark.parametrize("name", MODAL)
@pytest.mark.parametrize(
    "wrong", [lambda q: q[:-1], lambda q: q * np.nan, lambda q: q[:, None], lambda _: "x", lambda _: None]
)
def test_displacements_refuse_what_are_no_coordinates(name, wrong):
    model = world()["models"][name]
    q = np.full(model.basis.count, 1e-3)
    assert model.displacement(list(q)).shape == model.shell.rest_positions.shape
    with pytest.raises(ms.OptionError, match="q must"):
        model.displacement(wrong(q))
