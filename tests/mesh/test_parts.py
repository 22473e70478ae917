"""Meshes in several parts: what nothing holds is refused with a repair that works, or said."""

import re

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.mesh.parts import chosen_part, refuse_loose_parts


def parts(*offsets, shape=None):
    """Sheets side by side, each smaller than the one before."""
    vertices, faces, count = [], [], 0
    for number, offset in enumerate(offsets):
        mesh = shape or ms.sheet(length=1.0 - 0.1 * number, width=1.0, cells=(3, 3))
        vertices.append(mesh.vertices + offset)
        faces.append(mesh.faces + count)
        count += len(mesh.vertices)
    return ms.TriangleMesh(np.vstack(vertices), np.vstack(faces))


def test_a_part_is_chosen_by_area():
    mesh = parts([0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 4.0, 0.0])
    assert chosen_part(mesh) is mesh
    assert chosen_part(mesh, "all") is mesh
    for number, component in enumerate(("largest", 1, 2)):
        part = chosen_part(mesh, component)
        assert part.components.max() == 0
        assert part.area == pytest.approx(1.0 - 0.1 * number)
    single = ms.sheet(cells=(2, 2))
    assert chosen_part(single, "largest") is single
    with pytest.raises(ms.MeshError, match=r"a number from 0 to 2 \(got 3\)"):
        chosen_part(mesh, 3)
    for wrong in (-1, 1.5, "smallest"):
        with pytest.raises(ms.OptionError):
            chosen_part(mesh, wrong)
    with pytest.raises(ms.OptionError, match="join"):
        chosen_part(mesh, join=float("nan"))


def test_the_repairs_that_a_refusal_names_work():
    gap = 2e-5
    mesh = parts([0.0, 0.0, 0.0], [1.0 + gap, 0.0, 0.0], shape=ms.sheet(length=1.0, width=1.0, cells=(3, 3)))
    held = mesh.vertices[:, 0] < 0.1
    with pytest.raises(ms.SupportError, match=r"1 of 2 parts of the mesh are not held") as caught:
        refuse_loose_parts(mesh, held)
    distance = float(re.search(r"join (\S+) \[m\]", str(caught.value))[1])
    joined = chosen_part(mesh, join=distance)
    refuse_loose_parts(joined, joined.vertices[:, 0] < 0.1)
    largest = chosen_part(mesh, "largest")
    refuse_loose_parts(largest, np.zeros(len(largest.vertices), bool))
    far = parts([0.0, 0.0, 0.0], [0.0, 2.0, 0.0])
    with pytest.raises(ms.SupportError) as caught:
        refuse_loose_parts(far, np.zeros(len(far.vertices), bool))
    assert "2 of 2 parts" in str(caught.value)
    assert "join" not in str(caught.value)
    refuse_loose_parts(far, far.vertices[:, 0] < 0.1)


def test_modes_of_loose_parts_are_refused_unless_asked_for():
    mesh = parts([0.0, 0.0, 0.0], [0.0, 2.0, 0.0])
    shell = ms.Shell(
        mesh, ms.Material(20.0, 20.0, 0.05, 0.2), (mesh.vertices[:, 0] < 0.4) & (mesh.vertices[:, 1] < 1.5)
    )
    with pytest.raises(ms.SupportError, match=r"1 of 2 parts .* in Python loose_parts=True"):
        ms.solve_modes(shell, 8)
    asked = ms.Shell(mesh, shell.material, shell.clamped, loose_parts=True)
    with pytest.warns(ms.ModalShellWarning, match=r"motion: 1 of 2 parts .*: each takes six modes; ask for"):
        assert ms.solve_modes(asked, 8).rigid_modes == 6
    with pytest.raises(ms.OptionError, match="loose_parts"):
        ms.Shell(mesh, shell.material, loose_parts=1)
    # A support of single components holds a part, too.
    rolling = ms.Shell(mesh, shell.material, shell.clamped, [ms.Fix("y > 1.5", axes="z")])
    assert ms.solve_modes(rolling, 4).rigid_modes == 3


@pytest.fixture
def file(tmp_path):
    ms.save_mesh(parts([0.0, 0.0, 0.0], [0.0, 2.0, 0.0]), tmp_path / "parts.obj")
    return tmp_path / "parts.obj"


def run(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([*map(str, arguments)])
    return stop.value.code


@pytest.mark.slow
def test_commands_take_the_part(file, capsys):
    command = ["modes", file, "--clamp", "y < 0.1", "--count", 2, "--out", file.parent]
    assert run(*command) == 2
    error = capsys.readouterr().err
    assert "1 of 2 parts of the mesh are not held" in error
    assert error.count("\n") == 1
    assert run(*command, "--component", "largest") == 0
    assert run(*command, "--component", "0") == 0
    assert run(*command, "--component", "5") == 2


@pytest.mark.usefixtures("file")
def test_scenes_take_the_part(scene_file):
    def scene(more):
        path = scene_file(
            ('shape = "v_beam"\ncells = [12, 4]', f'file = "parts.obj"{more}'), ('"x < 0.1"', '"y < 0.1"')
        )
        return ms.load_scene(path)

    with pytest.raises(ms.SceneError, match="supports: 1 of 2 parts of the mesh are not held"):
        scene("").build_shell()
    assert scene('\ncomponent = "largest"').build_shell().mesh.components.max() == 0
    assert len(scene("\ncomponent = 1").build_mesh().vertices) == 16
    assert scene('\ncomponent = "all"').build_shell().mesh.components.max() == 1
    assert len(scene("\njoin = 1e-9").build_mesh().vertices) == 32
    with pytest.raises(ms.SceneError, match=r"mesh\.component"):
        scene('\ncomponent = "smallest"')
