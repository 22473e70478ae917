"""Scenes in motion with a known answer or a fine one: a plate, a snap, a held strip, and supports that move."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import eigh

import modalshell as ms
from modalshell.core.typing import Progress
from studies.motion_rungs import FULL_RULES, LENGTH, REFERENCE, first_frequency, moved, rungs, strip
from studies.pages import counted
from studies.shell_theory import Sheet, flat_shell

PLATE: Sheet = {"young": 1e9, "poisson": 0.3, "thickness": 2e-3, "density": 1000.0}
PLATE_CELLS, PLATE_PERIODS = 8, 3
PLATE_STEPS = (20, 50, 100, 200)
SNAP_MATERIAL = ms.Material(2000.0, 2000.0, 0.05, 0.2)
SNAP_CELLS, SNAP_GRAVITY, SNAP_DAMPING, SNAP_STEP = (16, 4), 50.0, (4.0, 0.0), 1.0 / 30.0
SNAP_DIVISIONS, SNAP_FINE = (1, 2, 4, 8), 64
HELD_STRIP: Sheet = {"young": 1e8, "poisson": 0.0, "thickness": 0.01, "density": 1000.0}
RATIOS_BY_AMPLITUDE = {1.0: 1.0892, 3.0: 1.6257}
"""Frequency over that of small motion, by the amplitude over the radius of gyration [woinowsky1950]."""
SWING_STEPS, SWING_FINE = (60, 120, 240), 32
LED_STEP, LED_FINE, LED_TIMES = 1.0 / 30.0, 32, (5.0, 6.0)
"""Step of motions of supports, what it is divided by for the reference, and how long the two motions last [s]."""
LED_LONG = (ms.ModalDerivatives.name,)
"""Rungs that take long, which a quick study does not lead."""


def supported_plate(energy: str) -> ms.Shell:
    """A square plate, simply supported."""
    mesh = ms.sheet(length=1.0, width=1.0, cells=(PLATE_CELLS, PLATE_CELLS), family="union-jack")
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    edge = (np.isclose(mesh.vertices, low) | np.isclose(mesh.vertices, high))[:, :2].any(axis=1)
    return flat_shell(energy, mesh, PLATE, supports=[ms.Pin(edge)])


def plate_series(times: np.ndarray, pressure: float, terms: int = 61) -> np.ndarray:
    """Deflection (t,) [m] of the centre under a pressure [Pa] from time 0 on, by Navier's series."""
    stiffness = PLATE["young"] * PLATE["thickness"] ** 3 / (12.0 * (1.0 - PLATE["poisson"] ** 2))
    mass = PLATE["density"] * PLATE["thickness"]
    odd = np.arange(1, terms, 2)
    along, across = (part.ravel() for part in np.meshgrid(odd, odd))
    squares = (np.pi**2 * (along**2 + across**2)) ** 2 * stiffness / mass
    sign = np.sin(0.5 * np.pi * along) * np.sin(0.5 * np.pi * across)
    static = 16.0 * pressure / (np.pi**2 * along * across * mass * squares) * sign
    return (1.0 - np.cos(np.outer(times, np.sqrt(squares)))) @ static


def plate_rows(energy: str, steps: tuple[int, ...], rules: tuple[str, ...] = FULL_RULES) -> list[dict[str, Any]]:
    """DS under a sudden pressure against the exact modal answer of its mesh, and the series [largest deflection]."""
    shell = supported_plate(energy)
    stiffness = PLATE["young"] * PLATE["thickness"] ** 3 / (12.0 * (1.0 - PLATE["poisson"] ** 2))
    first = 2.0 * np.pi**2 * np.sqrt(stiffness / (PLATE["density"] * PLATE["thickness"]))
    # So weak that the plate moves by a ten-thousandth of its thickness: the answers are linear.
    pressure = 1e-4 * PLATE["thickness"] * stiffness / 0.00406
    rest = shell.rest_positions
    force = np.zeros_like(rest)
    force[:, 2] = pressure / (PLATE["density"] * PLATE["thickness"]) * shell.mass
    centre = int(np.linalg.norm(rest - 0.5 * (rest.min(axis=0) + rest.max(axis=0)), axis=1).argmin())
    free = np.asarray(shell.free_unknowns)
    square, shapes = eigh(shell.stiffness().toarray()[np.ix_(free, free)], np.diag(np.repeat(shell.mass, 3)[free]))
    seen = shapes[np.searchsorted(free, 3 * centre + 2)] * (shapes.T @ force.ravel()[free]) / square
    rows = []
    for rule in rules:
        for count in steps:
            dt = 2.0 * np.pi / (first * count)
            run, took = moved(ms.DiscreteShell(shell, integrator=rule), PLATE_PERIODS * count, dt, force=force)
            found = run.positions[:, centre, 2] - rest[centre, 2]
            exact, series = (
                (1.0 - np.cos(np.outer(run.times, np.sqrt(square)))) @ seen,
                plate_series(run.times, pressure),
            )
            errors = [float(np.abs(found - other).max() / np.abs(other).max()) for other in (exact, series)]
            rows.append({"rule": rule, "steps": count, "error": errors[0], "against_series": errors[1]} | took)
    return rows


def snapping_shell() -> ms.Shell:
    """The V-beam of stiff membrane whose fold flattens."""
    mesh = ms.v_beam(length=LENGTH, width=0.2, fold=150.0, cells=SNAP_CELLS)
    return ms.Shell(mesh, SNAP_MATERIAL, mesh.vertices[:, 0] < 1.5 * LENGTH / SNAP_CELLS[0])


def snap_models() -> dict[str, Callable[[str], ms.Model]]:
    """DS and coarse DS on the same mesh, so that the errors of steps alone are seen."""
    shell = snapping_shell()
    return {
        ms.DiscreteShell.name: lambda rule: ms.DiscreteShell(shell, integrator=rule),
        ms.CoarseDiscreteShell.name: lambda rule: ms.CoarseDiscreteShell(shell, shell, integrator=rule),
    }


def snap_tip(model: ms.Model, divisions: int) -> tuple[np.ndarray, dict[str, Any]]:
    """Positions (31, 3) [m] of the tip in the first second, and what they took."""
    gravity = (0.0, 0.0, -SNAP_GRAVITY)
    count = round(1.0 / SNAP_STEP) * divisions
    run, took = moved(model, count, SNAP_STEP / divisions, divisions, gravity=gravity, damping=SNAP_DAMPING)
    tip = model.shell.rest_positions[:, 0] > LENGTH - 1e-9
    return run.positions[:, tip].mean(axis=1), took


def snap_rows(
    divisions: tuple[int, ...] = SNAP_DIVISIONS, rules: tuple[str, ...] = FULL_RULES, fine: int = SNAP_FINE
) -> list[dict[str, Any]]:
    """Errors of the tip [L] through the snap against a fine motion of another rule."""
    rows = []
    for name, make in snap_models().items():
        reference = snap_tip(make("bdf2"), fine)[0]
        for rule in rules:
            for count in divisions:
                tip, took = snap_tip(make(rule), count)
                error = float(np.linalg.norm(tip - reference, axis=1).max() / LENGTH)
                rows.append({"rung": name, "rule": rule, "divisions": count, "error": error} | took)
    return rows


def held_strip(energy: str, cells: int = 40) -> ms.Shell:
    """A narrow strip whose ends are held, but may turn."""
    mesh = ms.flat_beam(length=LENGTH, width=0.05, cells=(cells, 2), family="union-jack")
    x = mesh.vertices[:, 0]
    return flat_shell(energy, mesh, HELD_STRIP, supports=[ms.Pin((x < 1e-9) | (x > LENGTH - 1e-9))])


def held_strip_ratio(energy: str, rule: str, amplitude: float, steps: int = 100, periods: int = 3) -> dict[str, Any]:
    """Frequency of the strip at an ``amplitude`` [radius of gyration], over that of a beam at small ones.

    It is let go from a sine with the displacements along it that leave the same tension everywhere.
    """
    shell = held_strip(energy)
    radius = HELD_STRIP["thickness"] / np.sqrt(12.0)
    first = np.pi**2 * radius * np.sqrt(HELD_STRIP["young"] / HELD_STRIP["density"]) / LENGTH**2
    s, start = shell.rest_positions[:, 0], np.array(shell.rest_positions)
    start[:, 2] = amplitude * radius * np.sin(np.pi * s)
    start[:, 0] = s - 0.125 * np.pi * (amplitude * radius) ** 2 * np.sin(2.0 * np.pi * s)
    guess = first * RATIOS_BY_AMPLITUDE.get(amplitude, 1.0)
    model = ms.DiscreteShell(shell, integrator=rule)
    run, took = moved(model, periods * steps, 2.0 * np.pi / (guess * steps), start=start)
    height = run.positions[:, np.abs(s - 0.5) < 1e-9, 2].mean(axis=1)
    before = np.flatnonzero(np.sign(height[:-1]) * np.sign(height[1:]) < 0.0)
    share = height[before] / (height[before] - height[before + 1])
    half = float(np.diff(run.times[before] + share * np.diff(run.times)[before]).mean())
    exact = RATIOS_BY_AMPLITUDE.get(amplitude, 1.0)
    found = {
        "energy": energy,
        "rule": rule,
        "steps": steps,
        "amplitude": amplitude,
        "ratio": float(np.pi / half / first),
    }
    return found | {"exact": exact, "error": float(np.pi / half / first / exact - 1.0)} | took


def swinging_panel() -> ms.Shell:
    """A stiff panel that swings about its supported edge."""
    mesh = ms.sheet(length=0.3, width=0.1, cells=(3, 1))
    material = ms.Isotropic(young=1e9, poisson=0.3, thickness=3e-3, density=400.0)
    return ms.Shell(mesh, material, supports=[ms.Pin(mesh.vertices[:, 0] < 1e-6)])


def swing_rows(steps: tuple[int, ...] = SWING_STEPS, rules: tuple[str, ...] = FULL_RULES) -> list[dict[str, Any]]:
    """DS of a stiff panel that falls from level about its supported edge for a second, by every rule."""
    shell = swinging_panel()

    def swing(rule: str, count: int, kept: int = 1) -> ms.Trajectory:
        model = ms.DiscreteShell(shell, integrator=rule)
        return ms.simulate(model, duration=1.0, dt=1.0 / count, gravity=(0.0, 0.0, -9.81), store_every=kept)

    rows = []
    for count in steps:
        fine = swing("bdf2", SWING_FINE * count, SWING_FINE).positions
        for rule in rules:
            run = swing(rule, count)
            energies, error = run.energies.sum(axis=1), np.linalg.norm(run.positions - fine, axis=2).max() / 0.3
            rows.append({"rule": rule, "steps": count, "error": float(error), "estimate": run.step_error})
            rows[-1]["lost"] = float((energies[0] - energies[-1]) / np.ptp(run.energies[:, 2]))
    return rows


def spin_up(turns_a_second: float = 0.25, time: float = 4.0) -> ms.SupportPath:
    """The clamp of a strip turns about an axis across it, ever faster, and at last steadily."""
    omega = 2.0 * np.pi * turns_a_second

    def angle(t: float) -> float:
        # The rate rises as t - sin(2 pi t) / (2 pi) from 0 to 1 [kane1987].
        s = min(t / time, 1.0)
        risen = 0.5 * s**2 + (np.cos(2.0 * np.pi * s) - 1.0) / (4.0 * np.pi**2)
        return omega * (time * risen + max(t - time, 0.0))

    return ms.SupportPath.from_function(lambda t: (np.zeros(3), np.array([0.0, angle(t), 0.0])), 2.0 * time)


def shaking(shell: ms.Shell, size: float = 0.02, periods: float = 4.0) -> ms.SupportPath:
    """The clamp of a shell is shaken across it at 0.7 of its first frequency, from rest and to rest."""
    omega = 0.7 * first_frequency(shell)
    time = 2.0 * np.pi * periods / omega

    def place(t: float) -> np.ndarray:
        return np.array([0.0, 0.0, size * np.sin(omega * t) * np.sin(np.pi * min(t / time, 1.0)) ** 2])

    return ms.SupportPath.from_function(lambda t: (place(t), np.zeros(3)), 1.2 * time)


def led_rows(quick: bool) -> list[dict[str, Any]]:
    """Every rung led by its supports at 30 steps a second against DS at fine ones [largest displacement in the frame].

    ``own`` is the error against the same rung at fine steps: that of the steps alone. ``quick`` halves the step alone,
    leaves out rungs that take long, and leads every other one through one scene alone, by turns.
    """
    rows = []
    shell = strip("hinges")
    omega = first_frequency(shell)
    damping = ms.Damping(0.0, 0.06 / omega)  # that of the mass slows full models in the world, others in the frame
    scenes = {"spin-up of a cantilever": spin_up(), "shaken cantilever": shaking(shell)}
    fine = 2 if quick else LED_FINE
    for turn, (scene, path) in enumerate(scenes.items()):
        count = round(LED_TIMES[turn] / LED_STEP)

        def frames(model: ms.Model, divisions: int, *, path=path, count=count) -> np.ndarray:  # type: ignore[no-untyped-def]
            steps = count * divisions
            run, _ = moved(model, steps, LED_STEP / divisions, divisions, damping=damping, supports=path)
            poses = zip(run.times, run.positions, strict=True)
            return np.array([path.at(float(time)).to_shell(np.array(x)) for time, x in poses]) - shell.rest_positions

        truth = frames(ms.DiscreteShell(shell), fine)
        size = float(np.linalg.norm(truth, axis=2).max())
        chosen = [rung for rung in rungs(shell, 1.0, with_hybrid=False) if not (quick and rung.name in LED_LONG)]
        for number, rung in enumerate(chosen):
            if quick and rung.name != REFERENCE and number % len(scenes) != turn:
                continue
            model = rung.make(rung.default)
            found = frames(model, 1)
            exact = truth if rung.name == REFERENCE else frames(model, fine)
            errors = [float(np.linalg.norm(found - other, axis=2).max()) / size for other in (truth, exact)]
            rows.append({"scene": scene, "rung": rung.name, "rule": rung.default, "size": size})
            rows[-1] |= {"error": errors[0], "own": errors[1]}
    return rows


def scene_findings(quick: bool, on_step: Progress | None) -> dict[str, Any]:
    """Plate, snap, swing, held strip and moving supports."""
    tasks: list[tuple[str, Callable[[], Any]]] = [
        ("plate", lambda: plate_rows("Isotropic", PLATE_STEPS[:1] if quick else PLATE_STEPS)),
        ("snap", lambda: snap_rows(SNAP_DIVISIONS[:1], fine=4) if quick else snap_rows()),
        ("swing", lambda: swing_rows(SWING_STEPS[1:2]) if quick else swing_rows()),
        ("led", lambda: led_rows(quick)),
    ]
    found: dict[str, Any] = {"strip": []}
    for energy in ("Isotropic",) if quick else ("Isotropic", "hinges"):
        for rule in FULL_RULES[:1] if quick else FULL_RULES[:2]:
            for amplitude in RATIOS_BY_AMPLITUDE if quick else (0.05, *RATIOS_BY_AMPLITUDE):
                tasks.append(("strip", partial(held_strip_ratio, energy, rule, amplitude)))
    for name, task in counted(tasks, on_step):
        if name == "strip":
            found[name].append(task())
        else:
            found[name] = task()
    return found
