"""Numbers of theory 13: a cantilever that lies on a table, by DS and by modal models with exact contact."""

from __future__ import annotations

import functools

import numpy as np

import modalshell as ms

GRAVITY, DEPTH, MODES = (0.0, 0.0, -9.81), 0.1, 8
"""Gravity [m/s^2], and how far below the clamp the table is, over the length."""


@functools.cache
def shell() -> ms.Shell:
    """A strip of shell theory, clamped at one end."""
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(24, 4))
    sheet = ms.Isotropic(young=1e8, poisson=0.3, thickness=3e-3, density=100.0)
    return ms.Shell(mesh, sheet, clamped=mesh.vertices[:, 0] < 1e-6)


def answer(model: ms.Model) -> ms.Equilibrium:
    """On the table."""
    return model.equilibrium(gravity=GRAVITY, contacts=[ms.Contact(ms.Plane((0.0, 0.0, 1.0), -DEPTH))])


def lost(rate: int = 240, height: float = 0.05) -> float:
    """Share of its energy that a plate which keeps its speed has lost after one rebound, in ``rate`` steps a second."""
    mesh = ms.flat_beam(length=0.3, width=0.2, cells=(6, 4))
    free = ms.Shell(mesh, ms.Isotropic(young=1e8, poisson=0.3, thickness=5e-3, density=100.0))
    floor = ms.Contact(ms.Plane((0.0, 0.0, 1.0), -height), restitution=1.0)
    model = ms.DiscreteShell(free, integrator="bdf2")
    run = ms.simulate(model, duration=0.4, dt=1.0 / rate, gravity=GRAVITY, contacts=[floor])
    heights = run.positions[:, :, 2].mean(axis=1)
    return float(-heights[heights.argmin() :].max() / height)


def swung(strip: ms.Shell, model: ms.Model, seconds: float = 0.6, *, lies: bool = True) -> float:
    """Swing that a strip, which ``lies`` on a cylinder, has left in 120 steps a second, over its first."""
    contacts = [ms.Contact(ms.Cylinder((0.9, -1.0, -0.05), (0.9, 1.0, -0.05), 0.05))]
    lying = model.equilibrium(gravity=GRAVITY, contacts=contacts).positions if lies else None
    run = ms.simulate(model, duration=seconds, dt=1 / 120, gravity=(0.0, 0.0, -6.9), start=lying, contacts=contacts)
    heights = run.positions[:, abs(strip.rest_positions[:, 0] - 0.5) < 1e-6, 2].mean(axis=1)
    return float(np.ptp(heights[-24:]) / np.ptp(heights[:24]))


def statements() -> list[str]:
    """What the chapter states."""
    truth, basis = answer(ms.DiscreteShell(shell())), ms.solve_modes(shell(), MODES)
    forces = truth.contact_forces
    share = 100.0 * forces[:, 2].sum() / (9.81 * shell().mass.sum())
    found = []
    for kind in (ms.LinearModal, ms.ModalWarping, ms.RotationStrain):
        one = answer(kind(basis))
        error = ms.measure.displacement_error(one.positions, truth.positions, shell())
        force = one.contact_forces.sum(axis=0)[2] / forces.sum(axis=0)[2] - 1.0
        found.append(f"| {one_name(kind)} | {100 * error:.1f} | {100 * abs(force):.1f} |")
    touching = f"{int(truth.in_contact.sum())} of its vertices touch and bear {share:.0f} % of its weight"
    mesh = ms.flat_beam(length=1.0, width=0.1, cells=(12, 2))
    strip = ms.Shell(mesh, ms.Isotropic(2e9, 0.3, 5e-3, 1000.0), clamped="x < 1e-6")
    full = [swung(strip, ms.DiscreteShell(strip, integrator=rule)) for rule in ("composite", "implicit")]
    swings = f"{100 * full[0]:.0f} % of its swing after three periods, and {100 * full[1]:.0f} %"
    rules = [ms.ModalWarping(ms.solve_modes(strip, 4), integrator=rule) for rule in ("exponential", "implicit_euler")]
    kept, gone = (swung(strip, model, 0.9, lies=False) for model in rules)
    by_modes = f"has {kept:.2f} of its swing after 0.9 s, by implicit Euler {gone:.2f}"
    return [touching, *found, f"so it loses {100 * lost():.1f} % at the first", swings, by_modes]


def one_name(kind: type[ms.Model]) -> str:
    """Name of a model."""
    return str(getattr(kind, "name", kind.__name__))


if __name__ == "__main__":
    print(*statements(), sep="\n")
