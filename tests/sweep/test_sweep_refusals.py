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
