"""The sweep file that several test files run."""

import pytest
from scenes import LOADED_BEAM, SWEEP_AXES


@pytest.fixture
def write(tmp_path):
    """A sweep file, ``top`` above its axes and ``more`` below them."""

    def write(axes=SWEEP_AXES, top="", more="", scene=LOADED_BEAM):
        (tmp_path / "base.toml").write_text(scene)
        file = tmp_path / "beams.toml"
        file.write_text(f'scene = "base.toml"\n{top}\n[axes]\n{axes}\n{more}')
        return file

    return write
