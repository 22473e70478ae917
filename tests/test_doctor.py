import importlib.util

import pytest

from modalshell.cli import main
from modalshell.doctor import examine
from modalshell.modes import BACKENDS


def test_doctor_tells_what_is_here_and_how_to_get_the_rest(monkeypatch, capsys):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    readings = {reading.name: reading for reading in examine()}
    assert readings["factorisation"].value.split(", ") == list(BACKENDS)
    assert "apt-get install" in readings["drawing"].hint
    modules = {"web": "trame", "vtk": "pyvista", "gpu": "warp"}
    for name, module in modules.items():
        here = importlib.util.find_spec(module) is not None
        assert readings[f"extra {name}"].value == ("installed" if here else "not installed")
        assert (f"modalshell[{name}]" in readings[f"extra {name}"].hint) is not here
    with pytest.raises(SystemExit) as end:
        main(["doctor"])
    assert end.value.code == 0
    printed = capsys.readouterr().out
    assert "factorisation" in printed
    missing = [name for name, reading in readings.items() if name.startswith("extra") and reading.hint]
    assert not missing or "modalshell[" in printed  # brackets are no markup of the table
