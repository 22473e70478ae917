"""Manners in a notebook: short reprs of everything public, pictures by ``plot()``, numbers and a picture as HTML."""

import dataclasses
import re
from io import BytesIO

import numpy as np
import pytest
from fuzzing.world import world

import modalshell as ms
from modalshell import springs
from modalshell.core.short_repr import short_repr

LONGEST = 300


@pytest.fixture(autouse=True)
def _without_opengl(monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")


@pytest.fixture(scope="module")
def objects(v_basis):
    """One object or more of every public class, of a few hundred triangles."""
    mesh, shell = v_basis.shell.mesh, v_basis.shell
    every = np.ones(len(mesh.faces))
    physical = ms.Isotropic(young=1e9 * every, poisson=0.3, thickness=1e-3 * every, density=1e3)
    chosen = np.arange(len(mesh.vertices))[::2]
    model = ms.ModalWarping(v_basis)
    answer = model.equilibrium(gravity=(0.0, 0.0, -1.0))
    run = ms.simulate(model, duration=0.1, dt=0.05, gravity=(0.0, 0.0, -1.0))
    turn = ms.FrameInertia((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    kinds = (ms.Clamp, ms.Pin)
    return [
        mesh, shell, v_basis, model, answer, run, physical, turn,
        ms.Material(every, 2.0 * every, 0.01 * every, 0.2 * every), ms.Shell(mesh, physical, chosen[:5]),
        shell.fields(answer.positions), shell.loading((0.0, 0.0, -1.0)),
        ms.solve_modes(shell, 2, about=shell.rest_positions),
        ms.equilibrium_path(ms.DiscreteShell(shell), gravity=(0.0, 0.0, -0.1), until=0.1),
        ms.buckling_factors(shell, gravity=(-1.0, 0.0, 0.0)), ms.WarpFrame(v_basis), v_basis.page(),
        *[kind(chosen) for kind in kinds], ms.PointForce(chosen, (0.0, 0.0, 1.0)), ms.Pressure(3.0),
        ms.SupportPath([0.0, 0.1], [[0, 0, 0], [0, 0, 0.1]], [[0, 0, 0], [0, 0.2, 0]]),
        ms.PositionConstraint(chosen, np.zeros(3)), springs.shell_springs(shell),
        springs.SheetGrid(shape=(50, 50), spacing=0.1, particle_mass=1.0, structural=1.0, shear=1.0, flexion=1.0),
        *world()["models"].values(), *ms.models().values(), ms.repair(mesh.vertices, mesh.faces)[1],
        ms.load_scene("studies/scenes/v_beam.toml"), ms.load_scene("studies/scenes/flock.toml"),
        mesh.plot(), ms.Damping(0.5, 0.001), answer.outcome,
    ]  # fmt: skip


@pytest.mark.slow
def test_reprs_are_one_short_line(objects):
    long = {type(one).__name__: repr(one) for one in objects if len(repr(one)) > LONGEST or "\n" in repr(one)}
    assert not long


@pytest.mark.slow
def test_dataclasses_of_arrays_are_told_by_their_shapes(objects):
    told = {type(one).__name__: repr(one) for one in objects}
    assert re.search(r"positions=<\d+ x 3, ", told["Equilibrium"])
    assert "outcome=converged" in told["Equilibrium"]
    assert told["Material"].startswith("Material(stretch=<")
    assert "factors=" in told["EquilibriumPath"]


@pytest.mark.parametrize("room", ["modalshell", "modalshell.springs"])
def test_every_public_dataclass_that_may_hold_arrays_has_a_short_repr(room):
    """Fields of any other type print in a few characters each; this finds a class that was forgotten."""
    public = vars(springs) if room.endswith("springs") else vars(ms)
    plain = re.compile(r"\b(NDArray|Array|ndarray|Shell|Basis|list|Trajectory|Equilibrium|Loading)\b")
    forgotten = [
        name
        for name, one in public.items()
        if dataclasses.is_dataclass(one)
        and one.__dataclass_params__.repr  # others say something shorter
        and any(field.repr and plain.search(str(field.type)) for field in dataclasses.fields(one))
        and one.__repr__.__module__ != short_repr.__module__
    ]
    assert forgotten == []


def picture_of(data):
    from matplotlib.image import imread

    return imread(BytesIO(data))


def test_pictures_are_drawn_shown_and_saved(v_basis, tmp_path):
    model = ms.ModalWarping(v_basis)
    answer = model.equilibrium(gravity=(0.0, 0.0, -2.0))
    run = ms.simulate(model, duration=0.1, dt=0.05, gravity=(0.0, 0.0, -2.0))
    mesh = v_basis.shell.mesh
    for one, size in ((mesh, (960, 600)), (v_basis, (1600, 900)), (answer, (960, 600)), (run, (1600, 450))):
        drawn = one.plot()
        image = picture_of(drawn._repr_png_())
        assert image.shape[1::-1] == size
        assert image[..., :3].std() > 0.02, "nothing is seen"
        assert drawn.save(tmp_path / "new" / f"{type(one).__name__}.png").read_bytes() == drawn.data
        shown = one._repr_html_()
        assert shown.count("data:image/png;base64,") == 1
        assert type(one).__name__ in shown
    assert ms.plot(mesh).data == mesh.plot().data
    assert "converged" in answer._repr_html_()
    assert f"{v_basis.frequencies[0]:.4g}" in v_basis._repr_html_()
    assert v_basis.plot(count=1).data != v_basis.plot().data
    with pytest.raises(ms.OptionError, match="count must be at most"):
        v_basis.plot(count=v_basis.count + 1)
    with pytest.raises(ms.OptionError, match="without its mesh"):
        dataclasses.replace(answer, mesh=None).plot()
    with pytest.raises(ms.OptionError, match="needs the triangles"):
        dataclasses.replace(run, faces=run.faces[:0]).plot()
    with pytest.raises(ms.OptionError, match=r"\.png"):
        drawn.save(tmp_path / "a.jpg")
    with pytest.raises(ms.OptionError, match=r"draw a shell by shell\.mesh"):
        ms.plot(v_basis.shell)
    with pytest.raises(ms.OptionError, match=r"Equilibrium has the options size \(got color\)"):
        answer.plot(color="von_mises")


def test_a_trajectory_saves_itself(v_basis, tmp_path):
    run = ms.simulate(ms.ModalWarping(v_basis), duration=0.1, dt=0.05)
    assert run.save(tmp_path / "run.npz") == tmp_path / "run.npz"
    np.testing.assert_array_equal(ms.load_trajectory(tmp_path / "run.npz").positions, run.positions)
    with pytest.raises(ms.OptionError, match=r"is saved as \.npz"):
        run.save(tmp_path / "run.txt")


@pytest.mark.slow
def test_a_tradeoff_and_an_advice_show_their_table_and_front():
    mesh = ms.flat_beam(cells=(8, 2))
    shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.2)
    found = ms.advise(shell, gravity=(0.0, 0.0, -0.1), modes=(2,), loads=(1.0,))
    for one in (found, found.measured):
        shown = one._repr_html_()
        assert shown.count("data:image/png;base64,") == 1
        assert "<td>worst error</td>" in shown
        assert len(repr(one)) < LONGEST
        assert picture_of(one.plot().data).std() > 0.02
    assert found.explanation.splitlines()[0][:20] in found._repr_html_()
