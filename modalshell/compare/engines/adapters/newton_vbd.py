"""Shells by Newton's vertex block descent: ``python newton_vbd.py < case.json``.

Its membrane takes ``mu = E h / (2 (1 + nu))`` and ``lambda = E h nu / (1 - nu^2)`` [N/m]; its bending is
``k l (theta - theta_0)^2 / 2`` over every interior edge of length l, k [N] from the hinges of the case. Velocities are
damped by the mass until the shell rests.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import newton  # type: ignore[import-not-found]
import numpy as np
import warp as wp
from in_time import Settled, by_longest_step, settled  # type: ignore[import-not-found]  # beside this script


def cloth(case: dict[str, Any], gravity: list[float]) -> Any:
    """The model of a case under a gravity [m/s^2]."""
    stiffness = case["young"] * case["thickness"]
    builder = newton.ModelBuilder(gravity=tuple(gravity))
    builder.add_cloth_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=[wp.vec3(*point) for point in case["vertices"]],
        indices=[corner for face in case["faces"] for corner in face],
        density=case["density"] * case["thickness"],
        tri_ke=stiffness / (2.0 * (1.0 + case["poisson"])),
        tri_ka=stiffness * case["poisson"] / (1.0 - case["poisson"] ** 2),
        tri_kd=0.0,
        edge_ke=1.0,
        edge_kd=0.0,
        particle_radius=1e-4,
    )
    builder.color(include_bending=True)
    model = builder.finalize(device="cpu")
    by_ends = {tuple(sorted((int(first), int(second)))): weight for first, second, weight in case["hinges"]}
    edges, properties = model.edge_indices.numpy(), model.edge_bending_properties.numpy()
    for row, edge in enumerate(edges):
        properties[row, 0] = by_ends.get(tuple(sorted((int(edge[2]), int(edge[3])))), 0.0)
    model.edge_bending_properties.assign(properties)
    masses, inverse = model.particle_mass.numpy(), model.particle_inv_mass.numpy()
    masses[case["held"]] = inverse[case["held"]] = 0.0
    model.particle_mass.assign(masses)
    model.particle_inv_mass.assign(inverse)
    return model


def answer(case: dict[str, Any], load: dict[str, Any], step: float) -> Settled:
    """Where a load comes to rest."""
    model = cloth(case, load["gravity"])
    solver = newton.solvers.SolverVBD(model, iterations=case["iterations"])
    before, after, control = model.state(), model.state(), model.control()
    solver.step(before, after, control, None, step)  # compiles
    before, after = model.state(), model.state()
    if load.get("force"):
        for state in (before, after):
            state.particle_f.assign(np.array(load["force"], dtype=np.float32))
    keep = float(np.exp(-case["damping"] * step))

    def advance() -> None:
        nonlocal before, after
        solver.step(before, after, control, None, step)
        before, after = after, before
        before.particle_qd.assign(keep * before.particle_qd.numpy())

    return settled(case, step, advance, lambda: before.particle_q.numpy())


def main() -> None:
    """Answer every load of the case."""
    wp.config.quiet = True
    case = json.load(sys.stdin)
    mass = float(cloth(case, [0.0, 0.0, 0.0]).particle_mass.numpy().sum())
    print(json.dumps({"version": f"Newton {newton.__version__}", "mass": mass, **by_longest_step(case, answer)}))


if __name__ == "__main__":
    main()
