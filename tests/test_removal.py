"""A feature is one folder: without it the package imports and works, but for the lines that name it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import modalshell

PACKAGE = Path(modalshell.__file__).parent
NAMED_BY = {"crowd": {"__init__.py"}, "springs": {"__init__.py"}}
"""Folder -> the files outside it that import it: those that hand its names on."""
USE = """
import pkgutil, importlib
import modalshell as ms
for module in pkgutil.walk_packages(ms.__path__, "modalshell."):
    if not any(part in module.name for part in ("__main__", "blender", "symbolic", "device", "adapters")):
        importlib.import_module(module.name)
mesh = ms.flat_beam(cells=(4, 2))
shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.3)
model = ms.LinearModal(ms.solve_modes(shell, 2))
assert ms.simulate(model, duration=0.2, dt=0.1, gravity=(0, 0, -0.1)).outcome == "completed"
print(*ms.models())
"""


def without(folder, copy):
    """A copy of the package without a folder and without the lines that name it; the files that had such lines."""
    shutil.copytree(PACKAGE, copy / "modalshell", ignore=shutil.ignore_patterns(folder))
    changed = {}
    for path in (copy / "modalshell").rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        names = re.findall(
            rf"^ *from modalshell\.{folder}[\w.]* import \(?([\w, \n]+?)\)?$", source, flags=re.MULTILINE
        )
        if names:
            changed[path.relative_to(copy / "modalshell").as_posix()] = names
            source = re.sub(rf"^( *)from modalshell\.{folder}\b.*$", r"\1pass", source, flags=re.MULTILINE)
            for name in re.findall(r"\w+", " ".join(names)):
                source = source.replace(f'    "{name}",\n', "")
            path.write_text(source, encoding="utf-8")
    return changed


@pytest.mark.parametrize("folder", NAMED_BY)
def test_a_feature_is_named_by_few_files(folder, tmp_path):
    assert set(without(folder, tmp_path)) == NAMED_BY[folder]


@pytest.mark.slow
@pytest.mark.parametrize("folder", NAMED_BY)
def test_the_package_works_without_a_feature(folder, tmp_path):
    without(folder, tmp_path)
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1"}  # nothing to compile anew
    answer = subprocess.run(
        [sys.executable, "-c", USE], env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=600
    )
    assert answer.returncode == 0, answer.stderr
    assert ("springs" in answer.stdout) == (folder != "springs")
    assert "ds" in answer.stdout.split()
