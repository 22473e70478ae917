"""A second process compiles the kernels of a common scene, from the end of a list, while the first one runs."""

import importlib
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

import modalshell as ms
from modalshell.kernels import ahead, callees, compiler
from modalshell.kernels.rotations import largest_angle
from modalshell.render.camera import look_at
from modalshell.render.content import ShadedSurface
from modalshell.render.rasteriser_painter import RasteriserPainter


def kernel_of(name):
    module, _, kernel = name.rpartition(".")
    return getattr(importlib.import_module(f"modalshell.{module}"), kernel)


def test_the_list_is_what_a_common_scene_compiles():
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(6, 2))
    material = ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0)
    shell = ms.Shell(mesh, material, clamped=mesh.vertices[:, 0] < 1e-6)
    basis = ms.solve_modes(shell, count=1)
    fast = ms.ModalWarping(basis).equilibrium(gravity=(0, 0, -9.81))
    ms.DiscreteShell(shell).equilibrium(gravity=(0, 0, -9.81), start=fast.positions)
    run = ms.simulate(ms.ModalWarping(basis), duration=0.1, dt=1 / 30, gravity=(0, 0, -9.81), damping=(0.1, 0.0))
    painter = RasteriserPainter((64, 36))
    painter.start(
        [ShadedSurface(run.positions[0], mesh.faces)], look_at((1.0, 1.0, 1.0), (0.5, 0.0, 0.0), 0.5, 1.8), None
    )
    painter.image()
    unused = [name for name, arguments in ahead.entries() if arguments not in kernel_of(name).signatures]
    assert unused == []


class Started:
    """Stands in for ``subprocess.Popen``."""

    def __init__(self, command, **_):
        self.command = command


@pytest.fixture
def started(monkeypatch):
    found = []
    monkeypatch.setattr(subprocess, "Popen", lambda *a, **k: found.append(Started(*a, **k)) or found[-1])
    monkeypatch.setattr(ahead, "_begun", False)
    monkeypatch.setattr(ahead, "usable_cores", lambda: 2)
    monkeypatch.setattr(ahead.atexit, "register", lambda *_: None)
    return found


LISTED = dict(ahead.entries())["kernels.rotations.largest_angle"]


def test_it_begins_once_with_a_kernel_of_the_list(started, tmp_path):
    ahead.begin(largest_angle, LISTED, tmp_path)
    ahead.begin(largest_angle, LISTED, tmp_path)
    assert len(started) == 1
    assert str(tmp_path) in started[0].command[-1]


def test_a_command_begins_it_before_a_kernel_is_asked_for_on_an_empty_cache(started, tmp_path, monkeypatch):
    command = ["python", "-m", "modalshell"]
    monkeypatch.chdir(tmp_path.parent)
    mesh = tmp_path.with_name(f"{tmp_path.name}.obj")
    mesh.touch()
    refused = [[*command, "keys"], ["python", "x.py", "simulate", mesh.name], [*command, "simulate", mesh.name, "-h"]]
    for given in (*refused, [*command, "simulate", "not_there.obj"]):
        monkeypatch.setattr(sys, "orig_argv", given)
        ahead.begin_with_command(tmp_path)
    monkeypatch.setattr(sys, "orig_argv", [*command, "simulate", mesh.name, "--static"])
    (tmp_path / "kernels").mkdir()
    ahead.begin_with_command(tmp_path)
    ahead.begin_with_command(None)
    assert started == []
    (tmp_path / "kernels").rmdir()
    ahead.begin_with_command(tmp_path)
    assert len(started) == 1


def test_it_does_not_begin_where_it_cannot_help(started, tmp_path, monkeypatch):
    other = SimpleNamespace(py_func=SimpleNamespace(__module__="modalshell.x", __name__="y"))
    ahead.begin(other, LISTED, tmp_path)
    ahead.begin(largest_angle, (), tmp_path)
    ahead.begin(largest_angle, LISTED, None)
    with monkeypatch.context() as inner:
        inner.setattr(ahead, "usable_cores", lambda: 1)
        ahead.begin(largest_angle, LISTED, tmp_path)
    with monkeypatch.context() as inner:
        inner.setattr(sys, "executable", "")
        ahead.begin(largest_angle, LISTED, tmp_path)
    with monkeypatch.context() as inner:
        inner.setattr(ahead.config, "DISABLE_JIT", 1)
        inner.setattr(sys, "orig_argv", ["python", "-m", "modalshell", "simulate", "leaf.obj"])
        ahead.begin_with_command(tmp_path)
    assert started == []


def test_one_process_fills_a_folder_and_the_lock_of_a_dead_one_is_taken_over(started, tmp_path, monkeypatch):
    lock = tmp_path / "ahead.lock"
    lock.touch()
    ahead.begin(largest_angle, LISTED, tmp_path)
    assert started == []
    monkeypatch.setattr(ahead, "_begun", False)
    os.utime(lock, (0, 0))
    ahead.begin(largest_angle, LISTED, tmp_path)
    assert len(started) == 1


@pytest.mark.slow
def test_the_process_imports_few_modules_and_takes_the_kernels_for_the_same(started, tmp_path, monkeypatch):
    ahead.begin(largest_angle, LISTED, tmp_path)
    monkeypatch.undo()
    modules = sorted({f"modalshell.{name.rpartition('.')[0]}" for name, _ in ahead.entries()})
    ask = "from modalshell.kernels.callees import source_digest as digest; last = 'modalshell.kernels.compiler'; "
    ask += f"names = {modules}; import importlib; [importlib.import_module(name) for name in names]; "
    ask += "print(*(digest(name, last) for name in names)); import sys; print('modalshell.models.auto' in sys.modules)"
    preamble = started[0].command[-1].rpartition("\nfrom modalshell.kernels.ahead")[0]
    *digests, whole = subprocess.check_output([sys.executable, "-c", f"{preamble}\n{ask}"], text=True).split()
    assert digests == [callees.source_digest(name, compiler.__name__) for name in modules]
    assert whole == "False"


def second_process(tmp_path, names):
    """A process that compiles the kernels that the expression ``names`` gives."""
    lock = tmp_path / "ahead.lock"
    lock.touch()
    program = f"import time; from modalshell.kernels import ahead; ahead.KERNELS = {names}; "
    program += f"ahead.compile_from_end({str(lock)!r})"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, env=environment), lock


@pytest.mark.slow
def test_the_process_fills_the_cache_and_removes_the_lock(tmp_path):
    process, lock = second_process(tmp_path, r"'\nkernels.rotations.largest_angle d2\n'")
    with process:
        assert process.wait(timeout=120) == 0
    assert not lock.exists()
    assert len(list(tmp_path.rglob("rotations.largest_angle*.nbc"))) == 1


@pytest.mark.slow
def test_the_process_leaves_with_the_one_that_began_it(tmp_path):
    process, lock = second_process(tmp_path, r"type('Slow', (), {'split': lambda self, by: time.sleep(100)})()")
    with process:
        process.stdin.close()
        assert process.wait(timeout=60) == 0
    assert not lock.exists()


def test_letters_stand_for_types():
    named = dict(ahead.entries())
    assert [str(kind) for kind in named["shell.kernels.split_folds.add_edge_curvatures"]] == [
        "readonly array(int64, 2d, C)", "array(float64, 1d, C)", "bool", "array(int32, 3d, C)", "array(int64, 1d, C)",
        "array(float64, 1d, C)",
    ]  # fmt: skip
    assert all(np.all([kind is not None for kind in arguments]) for arguments in named.values())
