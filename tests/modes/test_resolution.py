"""Remarks on meshes too coarse or too thin: frequencies tell which of them are off."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.modes.resolution import FEWEST_EDGES, edges_per_half_wave
from modalshell.scene.load import parse_scene
from modalshell.scene.remarks import sliver_remark

SHEET = ms.Isotropic(1e9, 0.3, 1e-3, 1000.0)


def lowest(cells, count=1):
    return ms.solve_modes(ms.Shell(ms.sheet(cells=cells), SHEET, clamped="boundary"), count)


@pytest.mark.parametrize(("waves", "cells"), [(1, 8), (2, 8), (3, 12)])
def test_edges_of_a_sine_are_counted_along_it(waves, cells):
    mesh = ms.sheet(cells=(cells, 5 * cells))  # the finer cells across the wave do not count
    shape = np.zeros((len(mesh.vertices), 3))
    shape[:, 2] = np.sin(np.pi * waves * mesh.vertices[:, 0])
    assert edges_per_half_wave(mesh, shape.ravel()) == pytest.approx(cells / waves, rel=0.05)
    assert edges_per_half_wave(mesh, np.tile([0.0, 0.0, 1.0], len(mesh.vertices))) == np.inf


def test_frequencies_of_few_edges_are_off_and_others_are_not():
    fine, coarse = lowest((32, 32), 4), lowest((8, 8), 4)
    edges = np.array([edges_per_half_wave(coarse.shell.mesh, coarse.modes[:, k]) for k in range(4)])
    off = np.abs(coarse.frequencies / fine.frequencies - 1.0)
    assert edges[0] > FEWEST_EDGES
    assert off[0] < 0.035
    assert (edges[1:] < FEWEST_EDGES).all()
    assert edges[3] < 3.0
    assert off[3] > 0.05


@pytest.mark.slow
def test_slivers_that_bend_too_softly_are_remarked_on_and_no_others():
    truth = lowest((32, 32)).eigenvalues[0]
    for cells, soft in (((8, 32), False), ((8, 160), True)):
        off = lowest(cells).eigenvalues[0] / truth - 1.0
        assert (off < -0.08) == soft
        assert ("slivers" in sliver_remark(ms.sheet(cells=cells))) == soft


def test_scenes_of_slivers_warn(tmp_path):
    raw = {
        "mesh": {"shape": "sheet", "cells": (4, 60)},
        "material": {"young": 1e9, "poisson": 0.3, "thickness": 1e-3, "density": 1000.0},
        "model": {"name": "ds"},
        "supports": {"clamped": "boundary"},
    }
    with pytest.warns(ms.ModalShellWarning, match="100 % of the area is in slivers"):
        parse_scene(tmp_path / "scene.toml", raw).build_shell()


FEW = "fewer than 4 edges a half wave"


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_modes_that_the_mesh_does_not_resolve_are_named():
    with pytest.warns(ms.ModalShellWarning, match=f"modes 2, 3, 4 have {FEW}"):
        lowest((8, 8), 4)
    lowest((32, 32), 4)
    free = ms.Shell(ms.sheet(cells=(4, 4)), SHEET)
    with pytest.warns(ms.ModalShellWarning, match=f"modes 7, 8 have {FEW}"):
        ms.solve_modes(free, 8)
    with pytest.warns(ms.ModalShellWarning, match=f"modes 2, 3, 4 have {FEW}"):
        shell = lowest((8, 8), 4).shell
    with pytest.warns(ms.ModalShellWarning, match=f"mode 2 has {FEW}|modes 2, 3 have {FEW}"):
        ms.solve_modes(shell, 3, about=shell.rest_positions)
    ms.ModalDerivatives(shell, count=3)  # a model's basis may hold short waves


@pytest.mark.filterwarnings("error")
def test_buckling_shapes_that_the_mesh_does_not_resolve_are_named():
    """A strip pressed from its end buckles in ever shorter waves."""
    for cells, named in (((8, 2), True), ((64, 4), False)):
        mesh = ms.flat_beam(length=1.0, width=0.1, cells=cells)
        shell = ms.Shell(mesh, SHEET, supports=[ms.Clamp("x < 0.13"), ms.Fix("x > 0.99", axes="yz")])
        force = np.zeros((len(mesh.vertices), 3))
        force[mesh.vertices[:, 0] > 0.99, 0] = -0.01
        if named:
            with pytest.warns(ms.ModalShellWarning, match=rf"buckling modes? .*{FEW} .* load factors are"):
                ms.buckling_factors(shell, 3, force=force)
        else:
            ms.buckling_factors(shell, 2, force=force)


@pytest.mark.slow
@pytest.mark.filterwarnings("always")
def test_the_modes_command_names_the_modes_that_the_mesh_does_not_resolve(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    file = tmp_path / "sheet.obj"
    for cells, named in ((6, True), (16, False)):
        ms.save_mesh(ms.sheet(cells=(cells, cells)), file)
        with pytest.raises(SystemExit) as stop:
            main(["modes", str(file), "--clamp", "boundary", "--count", "3", "--out", str(tmp_path)])
        assert stop.value.code == 0
        assert ("modes 1, 2, 3 have fewer than 4 edges a half wave" in capsys.readouterr().err) == named
