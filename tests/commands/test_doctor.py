import importlib.util
import re

import pytest
import scipy.sparse as sps

from modalshell.commands.cli import main
from modalshell.commands.doctor import examine
from modalshell.modes import BACKENDS, Factoriser


def test_doctor_tells_what_is_here_and_how_to_get_the_rest(monkeypatch, capsys):
    monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
    readings = {reading.name: reading for reading in examine()}
    assert all(backend in readings["factorisation"].value for backend in BACKENDS)
    # What it tells of sizes is what is done.
    size = int(re.search(r"from ([\d,]+) unknowns on", readings["factorisation"].value)[1].replace(",", ""))
    for unknowns, backend in ((size - 1, "superlu"), (size, "cholesky")):
        assert Factoriser(use="solve").definite(sps.eye_array(unknowns, format="csc")).backend == backend
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
