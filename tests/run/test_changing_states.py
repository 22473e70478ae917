"""Runs of motions whose states change their kind are stored, and resume to the last bit."""

import numpy as np
import pytest
from stopping import Stopped, stop_after

import modalshell as ms

FOLD = """
[mesh]
shape = "v_beam"
length = 0.4
width = 0.12
cells = [10, 4]
[material]
young = 5e7
poisson = 0.3
thickness = 1e-3
density = 900.0
[supports]
clamped = "x < 0.05"
[loads]
gravity = [0.3, 0.5, -3.0]
{more}
[model]
{model}
[motion]
duration = 0.4
dt = 0.02
"""
BALL = """[[contacts]]
kind = "sphere"
center = [0.38, 0.0, -0.112]
radius = 0.1
friction = 0.3"""
GUST = """[[loads.wind]]
velocity = [0.3, 0.2, 1.0]
times = [0.0, 0.1, 0.3]
factors = [0.0, 1.0, 0.2]"""


@pytest.mark.by_default("coarse DS on a ball")
@pytest.mark.parametrize(
    ("model", "more"),
    [
        pytest.param('name = "coarse-ds"\ncells = [5, 2]', BALL, id="coarse DS on a ball"),
        pytest.param('name = "ds"\nintegrator = "linear_implicit"', BALL, id="linear implicit steps on a ball"),
        pytest.param('name = "hybrid"\ncells = [5, 2]\nmodes = 12\nmotions = 6', GUST, id="hybrid and coarse DS"),
    ],
)
@pytest.mark.filterwarnings("ignore::modalshell.ModalShellWarning")
def test_motions_whose_states_change_their_kind_resume(tmp_path, model, more):
    """States of coarse positions after reduced ones, contact forces and remarks are kept in the checkpoint, too."""
    scene = tmp_path / "fold.toml"
    scene.write_text(FOLD.format(model=model, more=more))
    expected = ms.load_trajectory(ms.run_scene(scene, out=tmp_path / "whole").files[0])
    for steps in (7, 12):
        with pytest.raises(Stopped):
            ms.run_scene(scene, out=tmp_path / "stopped", on_step=stop_after(steps))
    again = ms.run_scene(scene, out=tmp_path / "stopped")
    assert again.resumed >= 12
    found = ms.load_trajectory(again.files[0])
    for name in ("positions", "energies", "in_contact", "contact_forces"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    assert (found.message, found.status) == (expected.message, expected.status)
    assert expected.in_contact.any() or "answered by coarse DS" in expected.message
