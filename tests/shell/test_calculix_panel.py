"""A plate with a rib against CalculiX S8R: sag, frequencies and buckling; the program itself where it is installed."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import modalshell as ms
from studies import calculix_panel as panel

DATA = Path(__file__).resolve().parents[1] / "data" / "calculix_panel.json"
COARSE, FINE = json.loads(DATA.read_text(encoding="utf-8"))


def at_end(mesh):
    """Vertices of the end, and those at the corners, the middle and the rib's foot."""
    x, y, z = mesh.vertices.T
    end = x > panel.LENGTH - 1e-9
    half = panel.WIDTH / 2 - 1e-9
    places = (y < -half, (np.abs(y) < 1e-9) & (z > -1e-9), y > half, z < 1e-9 - panel.HEIGHT)
    return end, [int(np.flatnonzero(end & place)[0]) for place in places]


@pytest.mark.slow
@pytest.mark.parametrize("family", ["alternating", "one-way"])
def test_a_ribbed_plate_is_within_two_percent_of_finite_elements(family):
    mesh = panel.ribbed_plate((40, 24, 4), family)
    shell = ms.Shell(mesh, ms.Isotropic(**panel.STEEL), clamped="x < 1e-9")
    end, seen = at_end(mesh)
    state = ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -panel.GRAVITY))
    assert state.converged
    np.testing.assert_allclose((mesh.vertices - state.positions)[seen, 2], FINE["sag"], rtol=0.02)
    np.testing.assert_allclose(ms.solve_modes(shell, 6).frequencies, FINE["frequencies"], rtol=0.01)
    push = ms.LineForce(end, (-panel.PUSH, 0.0, 0.0))
    np.testing.assert_allclose(ms.buckling_factors(shell, 4, loads=[push]).factors, FINE["buckling"], rtol=0.01)


def test_the_reference_has_converged_and_its_input_is_kept():
    for name, bound in (("sag", 7e-3), ("frequencies", 7e-3), ("buckling", 8e-3)):
        np.testing.assert_allclose(COARSE[name], FINE[name], rtol=bound)
    assert DATA.with_suffix(".inp").read_text(encoding="utf-8") == panel.deck(panel.CELLS[0])
    assert [COARSE["cells"], FINE["cells"]] == [list(cells) for cells in panel.CELLS]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_calculix_still_finds_these_numbers():
    found = panel.answer(panel.CELLS[0])
    for name in ("sag", "frequencies", "buckling"):
        np.testing.assert_allclose(found[name], COARSE[name], rtol=1e-4)
