"""Fields that are stored with a motion."""

import numpy as np
import pytest
from scenes import cantilever

import modalshell as ms


def model(material=None):
    if material is None:
        return ms.LinearModal(ms.solve_modes(cantilever((4, 2)), 4))
    mesh = ms.flat_beam(cells=(4, 2))
    return ms.LinearModal(ms.solve_modes(ms.Shell(mesh, material, mesh.vertices[:, 0] < 1e-6), 4))


def test_motions_store_the_fields_that_are_named():
    sheet = model(ms.Isotropic(1e7, 0.3, 0.01, 1000.0))
    names = ["curvature", "von_mises", "von_mises_faces", "energy_density", "curvature"]
    run = ms.simulate(sheet, duration=0.1, gravity=(0, 0, -1), fields=names)
    assert list(run.fields) == names[:4]
    last = sheet.shell.fields(run.positions[-1])
    for name, values in run.fields.items():
        np.testing.assert_array_equal(values[-1], last.values(name))
    assert ms.simulate(sheet, duration=0.1).fields == {}


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (["stress"], "each of fields must be one of"),
        ("curvature", "fields must be a list of names"),
        (["von_mises"], "needs a sheet with a thickness"),
    ],
)
def test_other_fields_are_refused_before_the_motion(fields, message):
    with pytest.raises(ms.OptionError, match=message):
        ms.simulate(model(), duration=1e9, fields=fields)
