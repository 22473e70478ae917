"""Other engines in processes of their own: what counts, what does not, and what is missing."""

import json

import numpy as np
import pytest
from scenes import PLAIN

import modalshell as ms
from modalshell.compare.engines import ENGINES, answered
from modalshell.compare.engines import answer as answer_of
from modalshell.compare.engines import engine as engines
from modalshell.compare.engines.adapters import calculix, in_time
from modalshell.compare.engines.answer import CONSTANTS, MASS, SMALL, check, strip
from modalshell.compare.engines.case import STEPS, engine_case, with_images
from modalshell.compare.engines.engine import Engine, ask

SHEET = ms.Isotropic(young=1e7, poisson=0.3, thickness=3e-3, density=1000.0)
DOWN = np.array([0.0, 0.0, -1.0])
# What every adapter below begins with: the case, and a strip bent as small deflection has it, times a factor.
ANSWER = """
import json, sys
case = json.load(sys.stdin)
def bent(factor):
    reach = max(p[0] for p in case["vertices"])
    drop = 1.5 * case["density"] * -case["loads"][0]["gravity"][2] / case["young"] / case["thickness"] ** 2
    return [[p[0], p[1], -factor * drop * reach ** 4 * (p[0] / reach) ** 2] for p in case["vertices"]]
moving = [m for v, m in enumerate(case["masses"]) if v not in case["held"]]
steps = [case["duration"] / case["steps"][0]]
found = {"version": "Fake 1", "positions": [bent(1.0)] * len(case["loads"]), "seconds": 1.0, "mass": sum(moving),
         "taken": steps * len(case["loads"]), "step": case["steps"][0]}
"""


@pytest.fixture
def adapter(monkeypatch, tmp_path):
    """Writes an adapter, and gives its engine."""
    monkeypatch.delenv("MODALSHELL_ENGINES", raising=False)
    monkeypatch.setattr(engines, "ADAPTERS", tmp_path)

    def write(text, **options):
        (tmp_path / "fake.py").write_text(text)
        return Engine("fake", "Fake", "pip install fake", options={"limit": 9.0}, **options)

    return write


def cantilever(cells=(6, 2)):
    mesh = ms.flat_beam(length=0.3, width=0.03, cells=cells)
    return ms.Shell(mesh, SHEET, mesh.vertices[:, 0] < 1e-9)


def test_processes_that_fail_are_rows(adapter, monkeypatch, tmp_path):
    assert ask(adapter("import no_such_engine"), {}) == {"outcome": "not installed: pip install fake"}
    assert ask(adapter("import os; os._exit(7)"), {})["outcome"] == "ended with status 7: no message"
    noisy = adapter("import json, os; print('noise'); print(json.dumps({'threads': os.environ['OMP_NUM_THREADS']}))")
    assert ask(noisy, {}) == {"threads": "1"}
    for last in ("bye", "5"):
        assert ask(adapter(f"print('{last}')"), {}) == {"outcome": f"answered no table: {last}"}
    monkeypatch.setattr(engines, "SECONDS", 0.5)
    assert ask(adapter("import time; time.sleep(60)"), {})["outcome"] == "stopped after 0.5 s"
    monkeypatch.setenv("MODALSHELL_ENGINES", str(tmp_path / "no_python"))
    assert ask(adapter(""), {})["outcome"].startswith("did not start")


def test_an_engine_that_meets_the_closed_forms_counts(adapter):
    engine = adapter(ANSWER + "print(json.dumps(found))")
    shell = cantilever()
    found = answered(engine, shell, [(DOWN, None), (2.0 * DOWN, None)])
    assert found.counts
    assert found.positions.shape == (2, len(shell.mesh.vertices), 3)
    assert abs(found.drop) < 1e-9
    assert found.version == "Fake 1"
    assert found.frame_ms == pytest.approx(1e3 / (2.0 * 4.0 * STEPS[0]))


@pytest.mark.by_default("found['taken'] = [1]-not at rest after 9 s a load", "del found['positions']-no step stayed")
@pytest.mark.parametrize(
    ("change", "outcome"),
    [
        ("found['positions'] = [bent(1.2)]", "conversion check failed: small drop +20 %"),
        (f"found['mass'] *= {1.0 + 2.0 * MASS}", "conversion check failed: mass +2.0 %"),
        ("found['taken'] = [1]", "not at rest after 9 s a load"),
        ("del found['positions']", "no step stayed"),
        ("found = {'outcome': 'told so'}", "told so"),
    ],
)
def test_what_fails_its_check_has_no_answer(adapter, change, outcome):
    found = answered(adapter(ANSWER + change + "\nprint(json.dumps(found))"), cantilever(), [(DOWN, None)])
    assert found.outcome.startswith(outcome)
    assert found.positions is None
    assert not found.counts


@pytest.mark.slow
def test_shorter_steps_are_tried_until_the_conversion_holds(adapter):
    soft = "\nif case['steps'][0] * 100 > case['duration'] / 2.0: found['positions'] = [bent(3.0)]"
    engine = adapter(ANSWER + soft + "\nprint(json.dumps(found))")
    row = check(engine, tuple(getattr(SHEET, name) for name in CONSTANTS), "this")
    assert (row["first"], row["outcome"]) == (1, "counts")
    found = answered(engine, cantilever(), [(DOWN, None)])
    period = 1.0 / ms.solve_modes(cantilever(), 1).frequencies[0]
    assert found.step == pytest.approx(period / STEPS[1])


@pytest.mark.slow
def test_a_calibrated_modulus_is_checked_on_another_strip(adapter):
    text = "\nfound['positions'] = [bent(1.3 / case['calibration'])]\nprint(json.dumps(found))"
    found = answered(adapter(ANSWER + text, calibrated=True), cantilever(), [(DOWN, None)])
    assert found.counts
    assert abs(found.drop) < 1e-9


def test_what_no_engine_can_express_is_an_outcome():
    mesh = cantilever().mesh
    low = mesh.vertices[:, 0] < 0.051
    cases = [
        (ms.Shell(mesh, PLAIN, low), "use ms.Isotropic"),
        (ms.Shell(mesh, SHEET, supports=[ms.Clamp(low), ms.Fix([20], axes="z")]), "all clamps, or all pins"),
        (ms.Shell(mesh, SHEET, supports=[ms.Pin([0, 1])]), "that their supports hold"),
        (ms.Shell(mesh, ms.Isotropic(1e7, np.full(len(mesh.faces), 0.3), 3e-3, 1e3), low), "one Young's modulus"),
        (ms.Shell(ms.TriangleMesh(np.eye(3), [[0, 1, 2]]), SHEET, [0, 1]), "cannot bend (got 0 hinges)"),
    ]
    for shell, told in cases:
        found = answered(ENGINES[0], shell, [(DOWN, None)])
        assert found.outcome.startswith("cannot express: ")
        assert told in found.outcome


def test_a_clamped_edge_gets_held_mirror_images():
    mesh = ms.v_beam(length=1.0, width=0.2, fold=140.0, cells=(6, 4))
    held = mesh.vertices[:, 0] < 1e-9
    further, all_held = with_images(mesh, held)
    images = further.vertices[len(mesh.vertices) :]
    assert (images[:, 0] < -1e-3).all()
    assert all_held[len(mesh.vertices) :].all()
    np.testing.assert_array_equal(further.vertices[: len(mesh.vertices)], mesh.vertices)
    near = images * (-1.0, 1.0, 1.0)
    away = np.linalg.norm(near[:, None] - mesh.vertices, axis=2).min(axis=1)
    np.testing.assert_allclose(away, 0.0, atol=1e-12)


def test_a_clamp_inside_the_sheet_needs_two_rows_where_vertices_have_no_turns():
    mesh = ms.flat_beam(length=0.3, width=0.03, cells=(9, 2), family="right")
    x = mesh.vertices[:, 0]
    row, rows = np.abs(x - 0.1) < 1e-6, np.abs(x - 0.1) < 0.034
    turning, plain = ENGINES[0], ENGINES[1]
    assert engine_case(turning, ms.Shell(mesh, SHEET, row), [])["clamped"]
    with pytest.raises(ms.OptionError, match=r"got 2 clamped edges inside the sheet.*: clamp two rows"):
        engine_case(plain, ms.Shell(mesh, SHEET, row), [])
    assert engine_case(plain, ms.Shell(mesh, SHEET, rows), [])["held"] == np.flatnonzero(rows).tolist()


def test_calculix_holds_turns_along_clamped_edges_alone():
    mesh = ms.flat_beam(length=0.3, width=0.03, cells=(6, 2), family="right")
    x, y = mesh.vertices[:, 0], mesh.vertices[:, 1]
    corner = (x > 0.299) & (y > 0.014)
    case = engine_case(ENGINES[0], ms.Shell(mesh, SHEET, (x < 1e-9) | corner), [])
    text = calculix.deck(case).split("*")
    sets = {part.split("\n")[0]: part.split("\n")[1:-1] for part in text if part.startswith("NSET")}
    held, turned = (set(sets[f"NSET,NSET={name}"]) for name in ("HELD", "TURNED"))
    assert held - turned == {f"{int(np.flatnonzero(corner)[0]) + 1},"}
    assert len(turned) == 5
    assert "BOUNDARY\nHELD,1,3\nTURNED,4,6\n" in text
    pinned = engine_case(ENGINES[0], ms.Shell(mesh, SHEET, supports=[ms.Pin((x < 1e-9) | corner)]), [])
    assert "BOUNDARY\nHELD,1,3\n" in calculix.deck(pinned).split("*")
    apart = (y < -0.014) & ((x < 1e-9) | (x > 0.299)) | (y > 0.014) & (np.abs(x - 0.15) < 1e-9)
    points = engine_case(ENGINES[0], ms.Shell(mesh, SHEET, apart), [])
    assert points["clamped"]
    assert "TURNED" not in calculix.deck(points)


def test_an_adapter_reads_si_units_of_the_shell():
    shell, gravity = strip((1e7, 0.3, 3e-3, 1000.0))
    force = np.ones_like(shell.rest_positions)
    case = engine_case(ENGINES[1], shell, [(gravity * DOWN, force)])
    assert json.loads(json.dumps(case)) == case
    assert (case["young"], case["thickness"], case["clamped"]) == (1e7, 3e-3, True)
    assert sum(case["masses"][: len(shell.mass)]) >= shell.mass.sum() - 1e-12
    assert np.shape(case["loads"][0]["force"]) == np.shape(case["vertices"])
    assert gravity == pytest.approx(SMALL * 1e7 * 3e-3**2 / (12.0 * 1000.0 * 0.3**3))
    pinned = engine_case(ENGINES[1], ms.Shell(shell.mesh, SHEET, supports=[ms.Pin([0, 1, 5])]), [])
    assert pinned["clamped"] is False
    assert len(pinned["vertices"]) == len(shell.mesh.vertices)


@pytest.mark.slow
def test_finite_elements_meet_this_package_where_they_are_installed():
    shell = cantilever((20, 3))
    found = answered(ENGINES[0], shell, [(DOWN, None), (None, shell.gravity_force(DOWN))])
    if "not installed" in found.outcome:
        pytest.skip(found.outcome)
    own = ms.DiscreteShell(shell).equilibrium(gravity=DOWN)
    for places in found.positions:
        assert ms.measure.displacement_error(places, own.positions, shell) < 0.03


def test_loops_of_adapters_take_the_longest_stable_step():
    case = {"duration": 10.0, "limit": 9.0, "bound": 10.0, "steps": [0.5, 0.1], "loads": [{"to": 1.0}, {"to": 2.0}]}

    def answer(case, load, step):
        x = np.array([0.0])

        def advance():  # explicit Euler of x' = 6 (to - x), unstable by steps over 1/3
            x[:] += step * 6.0 * (load["to"] - x)

        return in_time.settled(case, step, advance, lambda: x)

    found = in_time.by_longest_step(case, answer)
    assert (found["step"], found["taken"]) == (0.1, [100, 100])
    assert found["positions"] == [[pytest.approx(1.0)], [pytest.approx(2.0)]]
    assert in_time.by_longest_step(case | {"steps": [0.5]}, answer) == {}


def test_an_engine_is_asked_again_in_another_python(monkeypatch):
    asked = []
    monkeypatch.setattr(answer_of, "ask", lambda engine, _: asked.append(engine) or {"outcome": "not installed"})
    mesh = ms.flat_beam(cells=(6, 2))
    shell = ms.Shell(mesh, ms.Isotropic(1e7, 0.0, 7e-3, 1000.0), mesh.vertices[:, 0] < 0.2)
    for python in ("one", "one", "other"):
        monkeypatch.setenv("MODALSHELL_ENGINES", python)
        assert answered(ENGINES[0], shell, [(np.array([0.0, 0.0, -1.0]), None)]).outcome == "not installed"
    assert len(asked) == 2
