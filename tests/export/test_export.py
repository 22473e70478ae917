import importlib.util
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from later import later
from scenes import cantilever

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.export import check_formats
from modalshell.shell.fields import FIELDS

pyvista = later("pyvista")


@pytest.fixture(scope="module")
def run():
    shell = cantilever((8, 4))
    mesh = shell.mesh
    tip = ms.PositionConstraint(len(mesh.vertices) - 1, mesh.vertices[-1] + [-0.05, 0.0, 0.05])
    model = ms.ModalWarping(ms.solve_modes(shell, 8))
    return ms.simulate(model, duration=0.5, dt=0.05, gravity=(0, 0, -1), constraints=[tip])


ARRAYS = ("times", "positions", "energies", "constraint_residuals", "faces", "rest_positions")


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_archives_keep_every_bit(run, tmp_path, dtype):
    saved = replace(run, positions=run.positions.astype(dtype))
    path = ms.save_trajectory(saved, tmp_path / "run.npz")
    loaded = ms.load_trajectory(path)
    for name in ARRAYS:
        assert getattr(loaded, name).dtype == getattr(saved, name).dtype
        np.testing.assert_array_equal(getattr(loaded, name), getattr(saved, name))
    for name in ("outcome", "status", "message", "unconverged_steps", "seconds"):
        assert getattr(loaded, name) == getattr(saved, name)


def test_positions_stay_on_disk_until_looked_at(run, tmp_path):
    loaded = ms.load_trajectory(ms.save_trajectory(run, tmp_path / "run.npz"))
    assert isinstance(loaded.positions, np.memmap)
    assert loaded.positions.ctypes.data % 64 == 0
    assert not loaded.positions.flags.writeable


def test_numpy_reads_archives_without_pickle(run, tmp_path):
    with np.load(ms.save_trajectory(run, tmp_path / "run.npz"), allow_pickle=False) as stored:
        np.testing.assert_array_equal(stored["positions"], run.positions)
        assert str(stored["status"]) == run.status


def test_equal_trajectories_make_equal_files(run, tmp_path):
    files = [ms.save_trajectory(run, tmp_path / name) for name in ("a.npz", "b.npz")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_strided_positions_are_saved(run, tmp_path):
    wide = np.zeros((*run.positions.shape[:2], 4))
    wide[..., :3] = run.positions
    path = ms.save_trajectory(replace(run, positions=wide[..., :3]), tmp_path / "run.npz")
    np.testing.assert_array_equal(ms.load_trajectory(path).positions, run.positions)


def test_damaged_archives_are_refused(run, tmp_path):
    data = ms.save_trajectory(run, tmp_path / "run.npz").read_bytes()
    with zipfile.ZipFile(tmp_path / "run.npz") as archive:
        spans = [(info.header_offset, info.header_offset + info.file_size) for info in archive.infolist()]
    chance = np.random.default_rng(0)
    damaged = tmp_path / "damaged.npz"
    for size in chance.integers(0, len(data), 30):
        damaged.write_bytes(data[:size])
        with pytest.raises(ms.FileFormatError, match="saved trajectory"):
            ms.load_trajectory(damaged, verify=False)
    for begin, end in spans:  # inside the values, behind the headers
        place = (begin + end) // 2 + 100
        damaged.write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with pytest.raises(ms.FileFormatError, match="damaged"):
            ms.load_trajectory(damaged)


def test_large_positions_are_verified_on_request(run, tmp_path, monkeypatch):
    data = bytearray(ms.save_trajectory(run, tmp_path / "run.npz").read_bytes())
    data[data.rindex(b"positions.npy", 0, len(data) - 500) + 2000] ^= 1
    (tmp_path / "run.npz").write_bytes(data)
    monkeypatch.setattr("modalshell.export.archive._VERIFIED", 100)
    assert len(ms.load_trajectory(tmp_path / "run.npz").times) == len(run.times)
    with pytest.raises(ms.FileFormatError, match="CRC"):
        ms.load_trajectory(tmp_path / "run.npz", verify=True)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"positions": np.zeros((3, 2))}, r"\(F, n, 3\)"),
        ({"positions": np.zeros((11, 45, 3), dtype=int)}, "float64 or float32"),
        ({"times": np.zeros(3)}, "times must be finite numbers"),
        ({"modalshell_trajectory": np.array(7)}, "format 7"),
        ({"status": np.array([{"a": 1}])}, "Python objects"),
        ({"status": np.array("never heard of")}, "'never heard of' is not a valid Outcome"),
    ],
)
def test_other_archives_are_refused(run, tmp_path, change, match):
    with np.load(ms.save_trajectory(run, tmp_path / "run.npz")) as stored:
        arrays = {name: stored[name] for name in stored.files} | change
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(ms.FileFormatError, match=match):
        ms.load_trajectory(tmp_path / "other.npz")


def test_missing_parts_and_compressed_archives_are_refused(tmp_path, run):
    with pytest.raises(ms.FileFormatError, match="nothing"):
        ms.load_trajectory(tmp_path / "nothing.npz")
    np.savez(tmp_path / "other.npz", a=np.eye(3))
    with pytest.raises(ms.FileFormatError, match="not a saved trajectory but other arrays"):
        ms.load_trajectory(tmp_path / "other.npz")
    with np.load(ms.save_trajectory(run, tmp_path / "run.npz")) as stored:
        np.savez_compressed(tmp_path / "other.npz", **stored)
    with pytest.raises(ms.FileFormatError, match="compressed"):
        ms.load_trajectory(tmp_path / "other.npz")


@pytest.mark.by_default("float32")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_vtkhdf_is_read_back(run, tmp_path, dtype):
    saved = replace(run, positions=run.positions.astype(dtype))
    done = []
    path = ms.save_trajectory(saved, tmp_path / "run.vtkhdf", on_frame=lambda *counts: done.append(counts))
    assert done[-1] == (len(run.times), len(run.times))
    reader = pyvista.get_reader(path)
    assert reader.reader.GetNumberOfSteps() == len(run.times)
    for index in (0, 4, len(run.times) - 1):
        reader.reader.SetStep(index)
        surface = reader.read()
        assert reader.reader.GetTimeValue() == np.float32(run.times[index])
        assert surface.points.dtype == dtype
        np.testing.assert_array_equal(surface.points, saved.positions[index])
        np.testing.assert_array_equal(surface.regular_faces, run.faces)
    assert [file.name for file in tmp_path.iterdir()] == ["run.vtkhdf"]
    assert path.stat().st_size < 400_000  # of small runs, too


def test_pvd_is_read_back(run, tmp_path):
    path = ms.save_trajectory(run, tmp_path / "run.pvd")
    reader = pyvista.get_reader(path)
    np.testing.assert_array_equal(reader.time_values, run.times)
    for index in (0, 7):
        reader.set_active_time_value(run.times[index])
        surface = reader.read()[0]
        np.testing.assert_array_equal(surface.points, run.positions[index])
        np.testing.assert_array_equal(surface.regular_faces, run.faces)


@pytest.fixture(scope="module")
def fielded():
    mesh = ms.flat_beam(cells=(6, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.3, 0.01, 1000.0), mesh.vertices[:, 0] < 1e-6)
    return ms.simulate(
        ms.LinearModal(ms.solve_modes(shell, 4)), duration=0.2, dt=0.05, gravity=(0, 0, -1), fields=list(FIELDS)
    )


def test_archives_keep_fields(fielded, tmp_path):
    loaded = ms.load_trajectory(ms.save_trajectory(fielded, tmp_path / "run.npz"))
    assert list(loaded.fields) == list(FIELDS)
    for name, values in fielded.fields.items():
        np.testing.assert_array_equal(loaded.fields[name], values)
    broken = replace(fielded, fields={"curvature": fielded.fields["curvature"][1:]})
    with pytest.raises(ms.FileFormatError, match="field_curvature must be finite numbers"):
        ms.load_trajectory(ms.save_trajectory(broken, tmp_path / "broken.npz"))


def frame_of(path, run, index):
    """A frame as VTK reads it."""
    reader = pyvista.get_reader(path)
    if path.suffix == ".vtkhdf":
        reader.reader.SetStep(index)
        return reader.read()
    reader.set_active_time_value(run.times[index])
    return reader.read()[0]


@pytest.mark.parametrize("suffix", ["vtkhdf", "pvd"])
def test_vtk_reads_every_array_with_its_name_and_unit(fielded, tmp_path, suffix):
    path = ms.save_trajectory(fielded, tmp_path / f"run.{suffix}")
    for index in (0, 3):
        surface = frame_of(path, fielded, index)
        assert "contact_force" not in surface.point_data
        moved = fielded.positions[index] - fielded.rest_positions
        np.testing.assert_array_equal(surface.point_data["displacement"], moved)
        assert surface.field_data["displacement_unit"] == ["m"]
        for name, unit in FIELDS.items():
            np.testing.assert_array_equal(surface.cell_data[name], fielded.fields[name][index])
            assert surface.field_data[f"{name}_unit"] == [unit or "1"]
            if suffix == "pvd":
                array = surface.GetCellData().GetArray(name)
                assert array.GetInformation().Get(array.UNITS_LABEL()) == unit


@pytest.mark.parametrize("suffix", ["vtkhdf", "pvd"])
def test_vtk_reads_what_touches(fielded, tmp_path, suffix):
    frames, vertices = fielded.positions.shape[:2]
    forces = np.random.default_rng(1).normal(size=(frames, vertices, 3))
    touching = replace(
        fielded, contact_forces=forces, in_contact=forces[:, :, 2] > 0.0, deepest=np.zeros(frames), fields={}
    )
    touching = touching.in_units(ms.UnitSystem(length="mm", mass="t", time="s"))
    path = ms.save_trajectory(touching, tmp_path / f"run.{suffix}")
    for index in (0, 3):
        surface = frame_of(path, touching, index)
        np.testing.assert_array_equal(surface.point_data["contact_force"], forces[index])
        np.testing.assert_array_equal(surface.point_data["in_contact"], touching.in_contact[index])
        assert surface.field_data["contact_force_unit"] == ["N"]


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_tables_give_every_number_back_with_its_unit(fielded, tmp_path, dtype):
    forces = np.random.default_rng(1).normal(size=fielded.positions.shape)
    kept = replace(fielded, positions=fielded.positions.astype(dtype), reactions=forces)
    kept = kept.in_units(ms.UnitSystem(length="mm", mass="t", time="s"))
    path = ms.save_trajectory(kept, tmp_path / "run.csv")
    vertices, triangles = (
        np.genfromtxt(tmp_path / name, delimiter=",", names=True, deletechars="", replace_space=" ")
        for name in ("run.csv", "run_triangles.csv")
    )
    frames, count = kept.positions.shape[:2]
    assert path.read_text().count("\n") == 1 + frames * count
    vertices, triangles = vertices.reshape(frames, -1), triangles.reshape(frames, -1)
    np.testing.assert_array_equal(vertices["time [s]"][:, 0], kept.times)
    np.testing.assert_array_equal(vertices["vertex"][2], np.arange(count))
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(vertices[f"rest {name} [mm]"][1], kept.rest_positions[:, axis])
        moved = kept.positions - kept.rest_positions.astype(dtype)
        np.testing.assert_array_equal(vertices[f"displacement {name} [mm]"].astype(dtype), moved[:, :, axis])
        np.testing.assert_array_equal(vertices[f"reaction {name} [N]"], forces[:, :, axis])
        np.testing.assert_array_equal(triangles[f"vertex {axis}"][3], kept.faces[:, axis])
    np.testing.assert_array_equal(triangles["von_mises [MPa]"], kept.fields["von_mises"])
    np.testing.assert_array_equal(triangles["von_mises_faces bottom [MPa]"], kept.fields["von_mises_faces"][..., 1])
    np.testing.assert_array_equal(triangles["membrane_strain 12"], kept.fields["membrane_strain"][..., 2])


def test_a_table_of_triangles_is_of_the_run_that_it_is_named_after(fielded, tmp_path):
    ms.save_trajectory(fielded, tmp_path / "run.csv")
    ms.save_trajectory(replace(fielded, fields={}), tmp_path / "run.csv")
    assert [file.name for file in tmp_path.iterdir()] == ["run.csv"]
    (tmp_path / "run_triangles.csv").write_text("my,own\n")
    ms.save_trajectory(replace(fielded, fields={}), tmp_path / "run.csv")
    with pytest.raises(ms.OptionError, match="was not written by modalshell"):
        ms.save_trajectory(fielded, tmp_path / "run.csv")
    assert (tmp_path / "run_triangles.csv").read_text() == "my,own\n"


def test_runs_whose_tables_would_have_one_name_leave_each_other_alone(fielded, tmp_path):
    """Writing ``a`` removed the table of the vertices of ``a_triangles``."""
    plain = replace(fielded, fields={})
    other = ms.save_trajectory(plain, tmp_path / "a_triangles.csv")
    whole = other.read_bytes()
    ms.save_trajectory(plain, tmp_path / "a.csv")
    with pytest.raises(ms.OptionError, match="of another run, one vertex a row, where one triangle a row"):
        ms.save_trajectory(fielded, tmp_path / "a.csv")
    assert other.read_bytes() == whole
    other.unlink()
    ms.save_trajectory(fielded, tmp_path / "a.csv")
    with pytest.raises(ms.OptionError, match="one triangle a row, where one vertex a row is expected"):
        ms.save_trajectory(plain, other)


def page_of(file):
    with pytest.raises(SystemExit, match="0"):
        main(["export", str(file), "--to", "page"])
    return file.with_suffix(".html").read_text()


@pytest.mark.slow
def test_a_page_of_a_run_says_that_its_colliders_are_not_shown(run, tmp_path):
    forces = np.ones(run.positions.shape)
    touching = replace(run, contact_forces=forces, in_contact=forces[:, :, 0] > 0.0, deepest=np.zeros(len(run.times)))
    for name, one, told in (("alone", run, 0), ("touching", touching, 1)):
        ms.save_trajectory(one, tmp_path / f"{name}.npz")
        assert page_of(tmp_path / f"{name}.npz").count("Colliders are not shown") == told


def test_a_page_of_a_run_shows_the_colliders_that_its_scene_still_has(tmp_path):
    """They were left out of every page of a run."""
    scene = tmp_path / "table.toml"
    scene.write_text("""
        mesh = {shape = "sheet", cells = [2, 2]}
        material = {young = 1e7, poisson = 0.3, thickness = 0.01, density = 100.0}
        supports = [{kind = "clamp", sel = "x < 0.01"}]
        contacts = [{kind = "box", center = [0.9, 0.0, -0.2], half = [0.1, 0.1, 0.1]}]
        loads = {gravity = [0.0, 0.0, -9.81]}
        model = {name = "lma", modes = 2}
        output = {formats = ["npz"]}
    """)
    archive = ms.run_scene(ms.load_scene(scene), out=tmp_path / "out").files[0]
    clip = ms.save_trajectory(ms.load_trajectory(archive), archive.with_suffix(".clip"))
    for file in (archive, clip):
        page = page_of(file)
        assert '"bodies"' in page
        assert "Colliders are not shown" not in page
        file.with_suffix(".html").unlink()
    scene.write_text(scene.read_text().replace("0.9", "0.8"))
    page = page_of(archive)
    assert '"bodies"' not in page
    assert "Colliders are not shown" in page


def test_tables_too_long_for_spreadsheets_are_named(fielded, tmp_path, monkeypatch):
    monkeypatch.setattr("modalshell.export.csv_tables._MOST_ROWS", 100)
    with pytest.warns(ms.ModalShellWarning, match="120 rows, and spreadsheets show 100 at most"):
        ms.save_trajectory(fielded, tmp_path / "run.csv")


def test_a_shorter_collection_replaces_a_longer_one(run, tmp_path):
    ms.save_trajectory(run, tmp_path / "run.pvd")
    ms.save_trajectory(replace(run, times=run.times[:3], positions=run.positions[:3]), tmp_path / "run.pvd")
    assert len(list((tmp_path / "run_frames").iterdir())) == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.pvd", "run_frames"]


@pytest.mark.parametrize("suffix", [".vtkhdf", ".pvd"])
def test_a_failed_export_leaves_nothing(run, tmp_path, suffix):
    def stop(done, _total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ms.save_trajectory(run, tmp_path / f"run{suffix}", on_frame=stop)
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_saved_is_refused(run, tmp_path):
    with pytest.raises(ms.OptionError, match=r"run\.xyz"):
        ms.save_trajectory(run, tmp_path / "run.xyz")
    with pytest.raises(ms.OptionError, match="faces"):
        ms.save_trajectory(replace(run, faces=run.faces[:0]), tmp_path / "run.pvd")


def test_without_vtk_its_formats_are_refused_before_the_run(monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "vtkmodules" else find_spec(name))
    with pytest.raises(ms.OptionError, match=r"pvd files need VTK.*modalshell\[vtk\]"):
        check_formats(["npz", "pvd"])
    check_formats(["npz", "mp4", "png"])
