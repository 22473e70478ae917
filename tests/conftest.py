"""Scenes that several test files share; one BLAS thread, since two on a busy machine take many times as long."""

import contextlib
import gc
import json
import os
import pkgutil
import shutil
import subprocess
import sys
import time
import warnings
from collections import Counter

import collecting  # first, for nothing below may be built at import, either
import numpy as np
import pytest
from guide import ROOT
from hypothesis import settings
from scenes import beam_text, cantilever

from modalshell import ModalShellWarning, solve_modes
from modalshell.core.errors import OptionError
from modalshell.core.registry import load_plugins
from modalshell.files.lock import acquire_lock
from modalshell.render import choose_backend
from modalshell.render.backend import RENDERER_VARIABLE, WINDOW_VARIABLE
from studies.reproduce import reproduce, studies

with contextlib.suppress(ImportError):
    # Variables such as OPENBLAS_NUM_THREADS come too late here: pytest's warning filters have loaded NumPy already.
    from threadpoolctl import threadpool_limits

    _ONE_THREAD = threadpool_limits(1)

# Without a deadline: the first example of a kernel compiles it, and on a busy machine any may be slow.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")  # the same examples in every run; others by --hypothesis-profile=default

SLOW_STUDIES = {"held_out_advice", "large_mesh", "sheet_vs_shell", "stability_atlas", "strangers_meshes", "tradeoff"}
SLOW_STUDIES |= {"blind_bars", "blind_motions", "held_out_snaps", "motion_truth"}
SLOW_STUDIES |= {
    "cloth_scaling",
    "dancing_character",
    "energy_cost",
    "error_budget",
    "large_deflection_benchmarks",
    "mesh_bias",
    "obstacle_course",
    "snap",
}
SLOW_STUDIES |= {"plate_frequencies", "spring_sheet_speed", "v_beam_truth"}
SLOW_STUDIES |= {"contact_truth", "engines", "identification", "lateral_buckling", "validity_map"}
SLOW_STUDIES |= {"fabric_drape", "flock_scaling", "grown_leaf", "integrator_drift", "manipulation"}
"""Those that take long even if quick; so do the tests that name them."""

SHORTER = {
    "blind_motions": {"studies.blind_motions.QUICK": 2, "studies.blind_motions.FRAMES": 45},
    "cloth_scaling": {"studies.cloth_scaling.SIDES": (25, 50)},
    "engines": {"studies.engines._FRAMES": 2},
    "held_out_advice": {
        "modalshell.models.hybrid.measures:Measures.motions": 8,
        "modalshell.models.hybrid.split_fold_measures:SplitFoldMeasures.motions": 8,
    },
    "integrator_drift": {"studies.integrator_drift.CYCLES": 3},
    "motion_truth": {
        "studies.motion_limits.COST_FINE": 320,
        "studies.motion_limits.FREE_TIME": 0.1,
        "studies.motion_limits.SHEET_TIME": 0.1,
        "studies.motion_limits.STRIP_TIME": 2.0,
        "studies.motion_scenes.LED_TIMES": (2.5, 3.0),
        "studies.motion_scenes.SWING_FINE": 2,
    },
    "stability_atlas": {
        "studies.stability_atlas.FEWEST": 4,
        "studies.stability_atlas.MOST": 6,
        "studies.stability_atlas.PATIENCE": 1,
    },
    "tradeoff": {
        "studies.tradeoff.REPEATS": 1,
        "modalshell.models.hybrid.measures:Measures.motions": 4,
        "modalshell.models.hybrid.split_fold_measures:SplitFoldMeasures.motions": 4,
    },
    "validity_map": {"studies.validity_map.MOTIONS": 4},
}
"""What quick studies take less of in the tests: repeats for exact timings, and work for findings that none looks at."""

SCENE = (
    beam_text()
    + """[loads]
gravity = [0, 0, -9.81]
[model]
name = "mwts"
[motion]
duration = 1
"""
)


@pytest.fixture(scope="session", autouse=True)
def _few_frames():
    """Comparisons time a sixth of their frames: costs are counted, and no test looks at seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("modalshell.compare.runs._FRAMES", 8)
        yield


@pytest.fixture(scope="session")
def scene_text():
    """Text of a scene: a clamped beam in motion, with pairs of (old, new) replaced in it."""

    def text(*changes):
        found = SCENE
        for old, new in changes:
            assert found.count(old) == 1, f"{old!r} is not there once"
            found = found.replace(old, new)
        return found

    return text


@pytest.fixture
def scene_file(scene_text, tmp_path):
    """Writes such a text to a file."""

    def write(*changes, more=""):
        path = tmp_path / "scene.toml"
        path.write_text(scene_text(*changes) + more, encoding="utf-8")
        return path

    return write


@pytest.fixture
def install_modules(tmp_path, monkeypatch):
    """Installs modules beside their metadata, found by an entry point as another package's are; forgets them after."""
    names = []

    def install(entry, **sources):
        site = tmp_path / "site"
        metadata = site / "toy-0.1.dist-info"
        metadata.mkdir(parents=True)
        for name, source in sources.items():
            (site / f"{name}.py").write_text(source)
        names.extend(sources)
        (metadata / "entry_points.txt").write_text(f"[modalshell]\n{entry}\n")
        (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 0.1\n")
        monkeypatch.syspath_prepend(str(site))
        monkeypatch.setenv("MODALSHELL_RENDERER", "built-in")
        load_plugins.cache_clear()

    yield install
    for name in names:
        sys.modules.pop(name, None)
    load_plugins.cache_clear()


@pytest.fixture(scope="module")
def opengl():
    """Skip where nothing renders; leave the environment as it was."""
    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore", ModalShellWarning)
        for name in (RENDERER_VARIABLE, WINDOW_VARIABLE):
            patch.setenv(name, "")  # so that what the probe sets is taken back
        if choose_backend() != "pyvista":
            pytest.skip("PyVista renders nothing on this machine: no OpenGL (apt-get install libegl1 libgl1-mesa-dri)")
        yield


def pytest_sessionstart(session):
    config = session.config
    if hasattr(config, "workerinput") and config.args_source is pytest.Config.ArgsSource.TESTPATHS:
        files = sorted(str(path) for path in (ROOT / "tests").rglob("test_*.py"))
        config.args = collecting.own_first(files, **config.workerinput)


def pytest_collection_modifyitems(config, items):
    for item in items:
        parameters = item.callspec.params if hasattr(item, "callspec") else {}
        named = {parameters.get("name"), *(c for c in item.function.__code__.co_consts if isinstance(c, str))}
        if "quick_study" in item.fixturenames and named & SLOW_STUDIES:
            item.add_marker(pytest.mark.slow)
    some = any("[" in argument for argument in config.args) or config.getoption("lf", default=False)
    collecting.leave_to_the_long_run(items, partial=some or config.getoption("stepwise", default=False))
    if hasattr(config, "workerinput"):  # studies take longest, then files of many or slow tests: first, to end together
        sizes: Counter[str] = Counter()
        for item in items:
            sizes[taken_together(item.nodeid)] += 20 if item.get_closest_marker("slow") else 1
        # then by name, for each process has met them in another order
        items.sort(key=lambda item: place_of(item.nodeid, sizes))


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Without looks for cyclic garbage: what is imported and collected stays, and grows by the hundred thousand."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_finish():
    collecting.allow()
    gc.freeze()  # the tests and the modules stay: no collection need look through them


def pytest_addoption(parser):
    text = "write the golden numbers of the studies that run (choose with -k) anew; their tolerances stay"
    parser.addoption("--accept-golden", action="store_true", help=text)


def taken_together(nodeid):
    """What one process of pytest-xdist does alone: a file's tests, or those of one study."""
    file, _, test = nodeid.partition("::")
    name = test.partition("[")[2].removesuffix("]")
    return name if name in studies() else file


def place_of(nodeid, sizes):
    """Where a test stands in the order of pytest-xdist, by how many tests are taken together."""
    name = taken_together(nodeid)
    return name not in studies(), -sizes[name], name, nodeid.partition("::")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Processes take whole files, so that each compiles other kernels, and a file's fixtures are made once."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return taken_together(nodeid)

    config.option.loadscopereorder = False  # they are in order, as below
    return ByFile(config, log)


@pytest.fixture(scope="session")
def quick_study(tmp_path_factory):
    """A function of a study's name that runs it, quick and without OpenGL, and returns the results' folder.

    Its figures are made, but not painted: tests/studies/test_pictures.py draws them. It runs once for all processes of
    pytest-xdist: one of them runs it, and the others wait.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "quick_studies"
    folder.mkdir(exist_ok=True)
    from matplotlib.figure import Figure
    from text_boxes import save_square

    def run(name):
        done = folder / f"{name}.done"
        while not done.exists():
            try:
                lock = acquire_lock(folder / f"{name}.lock")
            except OptionError:  # another process runs it
                time.sleep(0.1)
                continue
            try:
                if not done.exists():
                    with pytest.MonkeyPatch.context() as patch:
                        patch.setenv("MODALSHELL_RENDERER", "built-in")
                        patch.setattr(Figure, "savefig", save_square)
                        for place, value in SHORTER.get(name, {}).items():
                            owner, _, attribute = place.rpartition(".")
                            patch.setattr(pkgutil.resolve_name(owner), attribute, value)
                        reproduce(name, folder, folder / "figures", quick=True)
                    done.touch()
            finally:
                os.close(lock)
        return folder

    return run


IMPORTS = """
import json, sys
import modalshell
import modalshell.crowd.device, modalshell.render, modalshell.springs.device
print(json.dumps([name for name in sys.modules]))
"""


@pytest.fixture(scope="session")
def imported():
    """Modules that a process has which imports the package, its pictures and its device kernels, and does nothing."""
    child = subprocess.run([sys.executable, "-c", IMPORTS], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(json.loads(child.stdout))


@pytest.fixture(scope="session")
def v_shell():
    """The V-beam of the paper's figures: 150 degrees between the flanges, two rows clamped."""
    return cantilever((40, 8))


@pytest.fixture(scope="session")
def v_basis(v_shell):
    return solve_modes(v_shell, 8)


@pytest.fixture(scope="session")
def v_ridge_tip(v_shell):
    return int(np.argmin(np.linalg.norm(v_shell.rest_positions - (1.0, 0.0, 0.0), axis=1)))


@pytest.fixture(scope="module")
def browser():
    """A headless Chromium with WebGL2 in software; its event loop would be in the way of other modules' own."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        names = ("chromium", "chromium-browser", "google-chrome")
        found = [driver.chromium.executable_path, *(shutil.which(name) or "" for name in names)]
        browsers = [path for path in found if os.path.exists(path)]
        if not browsers:
            pytest.skip("there is no Chromium (apt-get install chromium, or playwright install chromium)")
        options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        started = driver.chromium.launch(executable_path=browsers[0], args=options)
        yield started
        started.close()
