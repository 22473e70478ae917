"""Damaged archives and clips are refused by what reads them."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import cantilever

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.files.atomic_io import write_npz


@pytest.fixture(scope="module")
def run():
    model = ms.ModalWarping(ms.solve_modes(cantilever((8, 4)), 4))
    return ms.simulate(model, duration=0.5, dt=0.05, gravity=(0, 0.5, -6), damping=(0.5, 0.001))


@pytest.mark.parametrize("kind", ["pc2", "clip", "page", "mdd"])
def test_export_verifies_archives_of_any_size(run, tmp_path, monkeypatch, capsys, kind):
    data = bytearray(ms.save_trajectory(run, tmp_path / "run.npz").read_bytes())
    data[data.rindex(b"positions.npy", 0, len(data) - 500) + 2000] ^= 1
    (tmp_path / "run.npz").write_bytes(data)
    monkeypatch.setattr("modalshell.export.archive._VERIFIED", 100)
    with pytest.raises(SystemExit) as stop:
        main(["export", str(tmp_path / "run.npz"), "--to", kind])
    assert stop.value.code == 2
    assert "CRC" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def entry(index, value):
    def change(array):
        changed = array.copy()
        changed[index] = value
        return changed

    return change


DAMAGE = [
    ("times", entry(3, np.nan)),
    ("times", lambda a: a[::-1]),
    ("times", lambda a: a.astype(str)),
    ("times", lambda a: a[:0]),
    ("times", lambda a: a.astype(complex)),
    ("rest", entry((0, 0), np.inf)),
    ("rest", lambda a: a[:-1]),
    ("rest", lambda a: a.astype(np.int32)),
    ("rest", lambda a: a.astype(float) * 1e100),
    ("faces", lambda a: a.astype(float)),
    ("faces", lambda a: a.astype(np.int64) - 5),
    ("faces", lambda a: a + 500),
    ("faces", lambda a: a[:0]),
    ("faces", lambda a: a[:, :2]),
    ("shapes", lambda a: a.astype(float) * np.nan),
    ("shapes", lambda a: a.astype(np.int64) * 2**40),
    ("shapes", lambda a: a.astype(np.uint16)),
    ("shapes", lambda a: a[:, ::2]),
    ("scales", lambda a: -a),
    ("scales", lambda a: a * 0.0),
    ("scales", lambda a: a[:, None]),
    ("scales", lambda a: np.full_like(a, 1e308)),
    ("amplitudes", entry((0, 0), np.nan)),
    ("amplitudes", lambda a: a.T),
    ("amplitudes", lambda a: a.astype(bool)),
    ("error", lambda a: -a - 1.0),
    ("error", lambda _: np.array(np.nan)),
    ("error", lambda _: np.zeros(2)),
    ("error", lambda _: np.array("small")),
    ("units", lambda _: np.array("furlongs")),
    ("unit_system", lambda _: np.array(["furlong", "kg", "s"])),
    ("unit_system", lambda _: np.array(["mm", "t", "s"])),
    ("unit_system", lambda _: np.array(["m", "kg"])),
    ("unit_system", lambda _: np.arange(3)),
    ("modalshell_clip", lambda _: np.array(2)),
]


@pytest.mark.parametrize(("name", "change"), DAMAGE)
def test_clips_of_other_arrays_are_refused(run, tmp_path, name, change):
    with np.load(ms.save_trajectory(run, tmp_path / "run.clip")) as data:
        arrays = {key: data[key] for key in data if key != "sha256"}
    arrays[name] = change(arrays[name])
    with open(tmp_path / "run.clip", "wb") as file:
        np.savez(file, **arrays)
    with pytest.raises(ms.FileFormatError, match="cannot read a clip"):
        ms.load_clip(tmp_path / "run.clip")


@pytest.mark.parametrize("units", [("furlong", "kg", "s"), ("m", "pound", "s"), ("m", "kg", 3), ("", "kg", "s")])
def test_units_are_those_that_are_known(units):
    from modalshell.core.units import UnitSystem

    with pytest.raises(ms.OptionError, match="the unit of"):
        UnitSystem(*units)


def test_a_clip_without_its_units_is_refused(run, tmp_path):
    with np.load(ms.save_trajectory(run, tmp_path / "run.clip")) as data:
        arrays = {key: data[key] for key in data if key not in ("sha256", "unit_system")}
    with open(tmp_path / "run.clip", "wb") as file:
        np.savez(file, **arrays)
    with pytest.raises(ms.FileFormatError, match="unit_system"):
        ms.load_clip(tmp_path / "run.clip")


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("basis", "it is a basis that modalshell saved, not a saved trajectory"),
        ("birds", "it is not a saved trajectory but other arrays, for numpy.load to read: directions, levels$"),
        ("cut", "it is cut off, or not a saved trajectory"),
        ("turned", "times must increase"),
    ],
)
def test_what_is_no_trajectory_is_told_by_what_it_is(run, tmp_path, name, told):
    """Names of members in archives said nothing to who exported a flock; times that fall were played."""
    file = tmp_path / f"{name}.npz"
    if name == "basis":
        ms.solve_modes(cantilever((8, 4)), 2).save(file)
    elif name == "birds":
        write_npz(file, directions=np.zeros((3, 2, 3)), levels=np.zeros(3))
    else:
        whole = ms.save_trajectory(run, file)
        if name == "cut":
            file.write_bytes(whole.read_bytes()[:900])
        else:
            arrays = dict(np.load(whole))
            np.savez(file, **arrays | {"times": arrays["times"][::-1]})
    with pytest.raises(ms.FileFormatError, match=told):
        ms.load_trajectory(file)


@pytest.mark.parametrize("missing", [("deepest",), ("contact_forces", "in_contact")])
def test_a_trajectory_with_a_part_of_what_touches_is_refused(run, tmp_path, missing):
    """Without ``deepest`` it loaded as one of no contacts, whose next copy had lost the forces, too."""
    frames, count = run.positions.shape[:2]
    touching = {"contact_forces": np.zeros((frames, count, 3)), "in_contact": np.zeros((frames, count), bool)}
    whole = ms.save_trajectory(replace(run, **touching, deepest=np.zeros(frames)), tmp_path / "run.npz")
    ms.load_trajectory(whole)
    with np.load(whole) as data:
        np.savez(tmp_path / "part.npz", **{name: data[name] for name in data if name not in missing})
    with pytest.raises(ms.FileFormatError, match=f"without {', '.join(missing)}, which go with it"):
        ms.load_trajectory(tmp_path / "part.npz")
