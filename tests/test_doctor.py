import importlib.util

import pytest

from modalshell.cli import main
from modalshell.doctor import examine
from modalshell.modes.factorisation import available_backends


def test_doctor_tells_what_is_here_and_how_to_get_the_rest(monkeypatch, capsys):
    monkeypatch.setenv("MODALSHELL_RENDERER", "matplotlib")
    readings = {reading.name: reading for reading in examine()}
    assert readings["factorisation"].value.split(", ") == available_backends()
    assert "apt-get install" in readings["drawing"].hint
    for name, module in (("cholmod", "sksparse"), ("pardiso", "pypardiso"), ("web", "trame")):
        here = importlib.util.find_spec(module) is not None
        assert readings[f"extra {name}"].value == ("installed" if here else "not installed")
        assert (f"modalshell[{name}]" in readings[f"extra {name}"].hint) is not here
    with pytest.raises(SystemExit) as end:
        main(["doctor"])
    assert end.value.code == 0
    assert "factorisation" in capsys.readouterr().out
