"""The registry is the one list of models: nothing outside it tells them apart by type, or lists their names."""

import ast
import gc
from pathlib import Path

import numpy as np
import pytest
from guide import CONTRIBUTING, blocks

import modalshell as ms
from modalshell.models import CoarseMesh, Model
from modalshell.models.factory import ModelFactory
from modalshell.models.registry import MODELS

REPOSITORY = Path(__file__).resolve().parents[2]
REGISTRY = "modalshell/models/registry.py"
KEYS = {text: spec.key for spec in MODELS.values() for text in (spec.key, spec.name)}
SAYS = ("status", "outcome", "message", "fault")
PARSES = ("startswith", "endswith", "partition", "rpartition", "split", "removeprefix", "removesuffix")
FOREIGN = {("modalshell/scene/read.py", "message.partition")}
"""Not ours: the place of a fault stands nowhere but in the message of the library that reads TOML."""


READ = (ast.ClassDef, ast.Call, ast.Compare, ast.MatchClass, ast.Dict, ast.Tuple, ast.List, ast.Set)
"""What the searches below look at."""


def read(source):
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, READ)]


@pytest.fixture(scope="module")
def trees():
    """Of every file the nodes that the searches look at."""
    gc.disable()  # the collector would walk through these trees again and again, which takes four times as long
    try:
        yield {
            str(path.relative_to(REPOSITORY)): read(path.read_text(encoding="utf-8"))
            for package in ("modalshell", "studies", "paper_figures", "meshes")
            for path in sorted((REPOSITORY / package).rglob("*.py"))
        }
    finally:
        gc.enable()


def last_names(node):
    """Names of a type, or of a tuple or union of types, without their modules."""
    return {
        part.attr if isinstance(part, ast.Attribute) else part.id
        for part in ast.walk(node)
        if isinstance(part, ast.Name | ast.Attribute)
    }


def model_classes(trees):
    """Every class that derives from Model, by the file that defines it."""
    classes = [(file, node) for file, tree in trees.items() for node in tree if isinstance(node, ast.ClassDef)]
    found, before = {Model.__name__: "modalshell/models/base/model.py"}, 0
    while len(found) != before:
        before = len(found)
        found |= {
            node.name: file for file, node in classes if any(last_names(base) & found.keys() for base in node.bases)
        }
    return found


def told_by_type(trees):
    """Places that ask for the type of a model outside the module of that type."""
    owners, found = model_classes(trees), []
    for file, tree in trees.items():
        for node in tree:
            asked = []
            if isinstance(node, ast.Call) and last_names(node.func) & {"isinstance", "issubclass"}:
                asked = node.args[1:]
            elif isinstance(node, ast.Compare):
                asked = [side for side in (node.left, *node.comparators) if isinstance(side, ast.Name | ast.Attribute)]
            elif isinstance(node, ast.MatchClass):
                asked = [node.cls]
            names = set().union(*map(last_names, asked)) if asked else set()
            found += [f"{file}:{node.lineno} {name}" for name in names if owners.get(name, file) != file]
    return found


def listed_names(trees):
    """Tuples, lists, sets and tables outside the registry that name two models or more."""
    found = []
    for file, tree in trees.items():
        for node in tree:
            entries = node.keys if isinstance(node, ast.Dict) else getattr(node, "elts", [])
            texts = {
                entry.value for entry in entries if isinstance(entry, ast.Constant) and isinstance(entry.value, str)
            }
            if file != REGISTRY and len({KEYS[text] for text in texts & KEYS.keys()}) > 1:
                found.append(f"{file}:{node.lineno} {sorted(texts & KEYS.keys())}")
    return found


def parsed_statuses(trees):
    """Places that take a status, an outcome or a message apart."""
    found = []
    for file, tree in trees.items():
        for node in tree:
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in PARSES:
                owner = ast.unparse(node.func.value)
                call = f"{owner}.{node.func.attr}"
                if any(word in owner for word in SAYS) and (file, call) not in FOREIGN:
                    found.append(f"{file}:{node.lineno} {call}")
    return found


@pytest.mark.slow
def test_nobody_asks_for_the_type_of_a_model(trees):
    assert {"ModalModel", "FullModel", "SummedWarp", "RigidShell"} <= model_classes(trees).keys()
    assert told_by_type(trees) == []


LISTED = (
    "the registry is the one list of models: take records, as in (ms.models()['mwts'], ms.models()['ds']), and keys, "
    "names and colors from them (tip_drop in .github/CONTRIBUTING.md does), so that a new model needs no change there"
)
"""What to do where names of models are listed."""


def test_nobody_lists_the_names_of_models(trees):
    assert listed_names(trees) == [], LISTED


def test_the_code_of_the_guide_keeps_these_rules(trees):
    of_models = {file: tree for file, tree in trees.items() if file.startswith("modalshell/models")}
    guide = {f"guide/{number}.py": read(text) for number, text in enumerate(blocks(CONTRIBUTING, "python"))}
    for search in (told_by_type, listed_names, parsed_statuses):
        assert [place for place in search(of_models | guide) if place.startswith("guide")] == [], LISTED


def test_nobody_parses_a_status(trees):
    assert parsed_statuses(trees) == []


PLANTED = "studies/planted.py"


@pytest.mark.parametrize(
    ("search", "source"),
    [
        (told_by_type, "isinstance(model, ms.RigidShell)"),
        (told_by_type, "isinstance(model, (int, FullModel | str))"),
        (told_by_type, "spec.builder is ms.RigidShell"),
        (told_by_type, "match model:\n    case LinearModal(): pass"),
        (listed_names, "LADDER = ('LMA', 'MWTS')"),
        (listed_names, "OPACITY = {'lma': 0.6, 'ds': 1.0}"),
        (parsed_statuses, "answer.status.startswith('not')"),
        (parsed_statuses, "row['outcome'].partition(':')"),
        (parsed_statuses, "str(run.message).split(',')"),
    ],
)
def test_the_searches_see_what_they_look_for(trees, search, source):
    of_models = {file: tree for file, tree in trees.items() if file.startswith("modalshell/models")}
    assert [place.split(":")[0] for place in search(of_models | {PLANTED: read(source)})] == [PLANTED]


@pytest.fixture(scope="module")
def models_of_a_strip():
    """Every registered model on one flat strip, clamped at one end."""

    def strip(cells):
        mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
        return ms.Shell(mesh, ms.Material(200.0, 200.0, 0.05, 0.2), mesh.vertices[:, 0] < 1.5 / 12)

    shell = strip((12, 2))
    vertices = np.array(shell.rest_positions)
    coarse = ms.TriangleMesh(vertices, shell.mesh.faces)
    load = shell.gravity_force((0.0, 0.0, -1.0))
    factory = ModelFactory(shell, lambda: load, lambda *_: CoarseMesh(coarse, "the same"))
    return {key: factory.build(spec, {}) for key, spec in MODELS.items()}


@pytest.mark.slow
@pytest.mark.parametrize("key", MODELS)
def test_records_say_how_models_answer_a_load(models_of_a_strip, key):
    """A linear model's displacement doubles with the load; a rigid one's is zero."""
    model, rest = models_of_a_strip[key], models_of_a_strip[key].shell.rest_positions
    once, twice = (model.equilibrium(gravity=(0.0, 0.0, -g)).positions - rest for g in (4.0, 8.0))
    if MODELS[key].response == "rigid":
        assert not once.any()
        assert not twice.any()
    else:
        off = np.linalg.norm(twice - 2.0 * once) / np.linalg.norm(twice)
        assert (off < 1e-12) if MODELS[key].response == "linear" else (off > 1e-3)


@pytest.mark.by_default("springs", "md-rom", "hybrid", "coarse-ds")
@pytest.mark.parametrize("key", [key for key, spec in MODELS.items() if spec.response != "rigid"])
def test_records_say_which_models_bend(models_of_a_strip, key):
    """Bending energy grows with the square of a small bend; that of stretched springs with its fourth power."""
    model = models_of_a_strip[key]
    basis = models_of_a_strip["lma"].basis
    bend = basis.modes[:, 0].reshape(-1, 3) / np.abs(basis.modes[:, 0]).max()
    rest = model.shell.rest_positions
    energies = [model.elastic_energy(model.start_motion(rest + size * bend)) for size in (1e-3, 2e-3)]
    power = np.log2(energies[1] / energies[0])
    assert power == pytest.approx(2.0 if MODELS[key].bends else 4.0, abs=0.05)
