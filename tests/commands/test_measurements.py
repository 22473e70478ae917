"""The command that recovers constants of a scene's material from measurements."""

import json
import re

import numpy as np
import pytest

import modalshell as ms
from modalshell.commands.cli import main

SCENE = """
[mesh]
shape = "flat_beam"
length = 1.0
width = 0.1
cells = [24, 2]

[material]
young = 2e6
poisson = 0.3
thickness = 4e-3
density = 60.0

[supports]
clamped = "x < 0.01"

[loads]
gravity = [0.0, 0.0, -1.0]

[model]
name = "ds"
"""
FACTORS = np.array([0.5, 1.0, 2.0])


@pytest.fixture(scope="module")
def curve():
    """Tip of the strip of half the scene's modulus, and its frequencies."""
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(24, 2))
    sheet = ms.Isotropic(young=1e6, poisson=0.3, thickness=4e-3, density=60.0)
    shell = ms.Shell(mesh, sheet, mesh.vertices[:, 0] < 0.01)
    answers = [ms.DiscreteShell(shell).equilibrium(gravity=(0.0, 0.0, -factor)) for factor in FACTORS]
    tip = mesh.vertices[:, 0] > 0.999
    return np.array([answer.positions[tip].mean(axis=0) for answer in answers]), ms.solve_modes(shell, 4).frequencies


def command(capsys, folder, *options):
    scene = folder / "strip.toml"
    scene.write_text(SCENE)
    status = 0
    try:
        main(["fit", str(scene), *options])
    except SystemExit as exit_:
        status = exit_.code
    captured = capsys.readouterr()
    return status or 0, captured.out, captured.err


def told(out):
    return float(re.search(r"young = (\S+),", out).group(1))


@pytest.mark.by_default("npz")
@pytest.mark.parametrize("kind", ["csv", "json", "npz"])
def test_young_is_found_from_a_tip_curve(capsys, tmp_path, curve, kind):
    positions, file = curve[0], tmp_path / f"tip.{kind}"
    if kind == "csv":
        rows = [f"{factor},{z}" for factor, z in zip(FACTORS, positions[:, 2], strict=True)]
        file.write_text("\n".join(["factor , z ", *rows]))  # of a column "factor " all numbers were left out
    elif kind == "json":
        told_as = [[None, None, z] for z in positions[:, 2].tolist()]
        file.write_text(json.dumps({"factors": FACTORS.tolist(), "positions": told_as}))
    else:
        np.savez(file, factors=FACTORS, positions=positions)
    record = tmp_path / "fit.json"
    options = ["--data", str(file), "--wrt", "young", "--where", "x > 0.999", "--out", str(record)]
    status, out, err = command(capsys, tmp_path, *options)
    assert status == 0, err
    assert told(out) == pytest.approx(1e6, rel=1e-4)
    found = json.loads(record.read_text())
    assert found["converged"]
    assert found["intervals"]["young"][0] <= found["values"]["young"] <= found["intervals"]["young"][1]


def test_a_fit_has_the_units_of_its_scene(capsys, tmp_path, curve, monkeypatch):
    millimetres = {"length = 1.0": "length = 1000.0", "width = 0.1": "width = 100.0", "young = 2e6": "young = 2.0"}
    millimetres |= {"thickness = 4e-3": "thickness = 4.0", "density = 60.0": "density = 60e-12", "0.01": "10.0"}
    millimetres |= {"-1.0]": "-1000.0]", "[mesh]": '[units]\nlength = "mm"\nmass = "t"\n[mesh]'}
    text = SCENE
    for old, new in millimetres.items():
        text = text.replace(old, new)
    monkeypatch.setitem(globals(), "SCENE", text)
    file = tmp_path / "tip.csv"
    rows = [f"{factor},{1000.0 * z}" for factor, z in zip(FACTORS, curve[0][:, 2], strict=True)]
    file.write_text("\n".join(["factor, z", *rows]))
    status, out, err = command(capsys, tmp_path, "--data", str(file), "--wrt", "young", "--where", "x > 999.0")
    assert status == 0, err
    assert told(out) == pytest.approx(1.0, rel=1e-4)
    assert re.search(r"residual: \S+ mm \(root mean square\)", out)
    assert re.search(r"young = \S+, within \S+ to \S+ MPa at 95 %", out)
    monkeypatch.setitem(globals(), "SCENE", text + "[rest]\nrest_curvature = 1e-4\n")
    file.write_text("frequency\n1.0\n")
    status, _, err = command(capsys, tmp_path, "--data", str(file), "--wrt", "young")
    assert status == 2
    assert re.search(r"Newton's first step is \S+ mm\)", err)


@pytest.mark.slow
def test_young_is_found_from_frequencies(capsys, tmp_path, curve):
    file = tmp_path / "modes.csv"
    file.write_text("\n".join(["frequency", *(f"{value}" if n != 2 else " " for n, value in enumerate(curve[1]))]))
    status, out, err = command(capsys, tmp_path, "--data", str(file), "--wrt", "young")
    assert status == 0, err
    assert told(out) == pytest.approx(1e6, rel=1e-5)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("tip.txt", "z\n1", "its name must end in"),
        ("tip.csv", "z", "no rows"),
        ("tip.csv", "height\n1", "column 'height' is none of"),
        ("tip.csv", "factor\n1", "none of the columns"),
        ("tip.csv", "x,z\n1,2\n1,2", "need the column factor"),
        ("tip.csv", "frequency,z\n1,2", "frequencies stand alone"),
        ("tip.csv", "z\nfar", "could not convert"),
        ("tip.csv", "factor,z\n0,5,-0,1", "more cells than the heading"),
        ("tip.csv", "z,z\n1,2", "a column is there twice"),
        ("tip.json", "[1]", "must be one object"),
        ("tip.json", '{"height": 1}', "'height' is none of"),
        ("tip.json", "{}", "neither positions nor frequencies"),
        ("none.json", None, "cannot read measurements"),
        ("tip.csv", "frequency\n-1", "frequencies must be positive"),
        ("tip.csv", "z\n1", "need --where"),
    ],
)
def test_bad_measurements_end_with_status_2(capsys, tmp_path, name, text, message):
    if text is not None:
        (tmp_path / name).write_text(text)
    status, _, err = command(capsys, tmp_path, "--data", str(tmp_path / name), "--wrt", "young")
    assert status == 2
    assert message in " ".join(err.split())


def test_cards_are_listed_with_their_sources(capsys):
    from modalshell.shell.cards import CARDS

    listed, one = "", ""
    for name in ((), ("steel-0.1mm",)):
        with pytest.raises(SystemExit) as done:
            main(["cards", *name])
        assert not done.value.code
        listed, one = one, capsys.readouterr().out
    assert all(key in listed for key in CARDS)
    assert "young = 2.1e+11 Pa" in one
    assert "speed of sound along a thin bar: 5200 m/s within 2 %" in one
    with pytest.raises(SystemExit) as stopped:
        main(["cards", "steal-0.1mm"])
    assert stopped.value.code == 2
    assert "did you mean 'steel-0.1mm'" in capsys.readouterr().err
