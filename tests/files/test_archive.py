"""Archives: what is read is what was written, and what does not fit its table is refused by name."""

import numpy as np
import pytest

from modalshell.core.errors import FileFormatError
from modalshell.core.units import UnitSystem
from modalshell.files.archive import Archive, Field
from modalshell.files.atomic_io import write_npz

KIND = Archive(
    "a saved walk",
    "modalshell_walk",
    {
        "times": Field("f", ("F",), "s"),
        "places": Field("f", ("F", 3), "m"),
        "steps": Field("iu"),
        "name": Field("U"),
    },
    most=1e3,
)
VALUES = {"times": np.arange(4.0), "places": np.ones((4, 3)), "steps": 7, "name": "home"}


def test_arrays_come_back_with_their_units(tmp_path):
    units = UnitSystem("mm", "t", "s")
    write_npz(tmp_path / "walk.npz", **KIND.arrays(VALUES, units))
    with KIND.read(tmp_path / "walk.npz") as data:
        for name, value in VALUES.items():
            np.testing.assert_array_equal(data[name], value)
        assert KIND.check(data) == units


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"times": np.arange(5.0)}, r"places must be finite numbers \(5, 3\)"),
        ({"places": np.full((4, 3), np.nan)}, "places must be finite numbers"),
        ({"places": np.full((4, 3), 2e3)}, "places must be finite numbers"),
        ({"steps": np.array(1.5)}, "steps must be whole numbers"),
        ({"name": np.array(1)}, "name must be text"),
        ({"modalshell_walk": np.array(2)}, r"format 2 \(this version reads 1\): read it with a newer version"),
        ({"modalshell_walk": np.array(0)}, r"format 0 \(this version reads 1\): make it again with this version"),
        ({"units": np.array('{"times": "h", "places": "m"}')}, "units are not those of m, kg, s"),
        ({"steps": None}, "steps"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path, change, reason):
    arrays = {name: value for name, value in (KIND.arrays(VALUES) | change).items() if value is not None}
    write_npz(tmp_path / "walk.npz", **arrays)
    with (
        pytest.raises(FileFormatError, match=f"cannot read a saved walk from .*{reason}"),
        KIND.read(tmp_path / "walk.npz"),
    ):
        pass


def test_faults_found_while_reading_are_those_of_the_file(tmp_path):
    write_npz(tmp_path / "walk.npz", **KIND.arrays(VALUES))
    with pytest.raises(FileFormatError, match="too short"), KIND.read(tmp_path / "walk.npz"):
        raise ValueError("too short")


def test_files_hold_the_arrays_that_were_given_and_no_pickles(tmp_path):
    write_npz(tmp_path / "a.npz", x=np.arange(3))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as data:
        assert set(data) - {"sha256"} == {"x"}
    with pytest.raises(ValueError, match="y holds Python objects"):
        write_npz(tmp_path / "b.npz", x=np.arange(3), y=np.array([None]))
    assert not (tmp_path / "b.npz").exists()
