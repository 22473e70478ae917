"""A strip under gravity by Newton's vertex block descent: ``python newton_vbd.py < case.json``.

Its membrane takes ``mu = E h / (2 (1 + nu))`` and ``lambda = E h nu / (1 - nu^2)`` [N/m]; its bending is
``k l (theta - theta_0)^2 / 2`` over every interior edge of length l, k [N] from the hinges of the case. Velocities are
damped by the mass until the strip rests.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import newton  # type: ignore[import-not-found]
import numpy as np
import warp as wp


def cloth(case: dict[str, Any], gravity: float) -> Any:
    """The model of a case under a gravity [m/s^2] along -z."""
    stiffness = case["young"] * case["thickness"]
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -gravity))
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
    return model


def main() -> None:
    """Answer every load of the case."""
    wp.config.quiet = True
    case = json.load(sys.stdin)
    found: dict[str, Any] = {"version": f"Newton {newton.__version__}", "tips": [], "seconds": [], "steps": []}
    for gravity in case["gravities"]:
        model = cloth(case, gravity)
        masses, inverse = model.particle_mass.numpy(), model.particle_inv_mass.numpy()
        masses[case["held"]] = inverse[case["held"]] = 0.0
        found["mass"] = float(masses.sum())
        model.particle_mass.assign(masses)
        model.particle_inv_mass.assign(inverse)
        solver = newton.solvers.SolverVBD(model, iterations=case["iterations"])
        before, after, control = model.state(), model.state(), model.control()
        solver.step(before, after, control, None, case["step"])  # compiles
        before, after = model.state(), model.state()
        keep, begin, steps = float(np.exp(-case["damping"] * case["step"])), time.perf_counter(), 0
        while steps * case["step"] < case["duration"] and time.perf_counter() - begin < case["limit"]:
            solver.step(before, after, control, None, case["step"])
            before, after = after, before
            before.particle_qd.assign(keep * before.particle_qd.numpy())
            steps += 1
        found["tips"].append(before.particle_q.numpy()[case["tip"]].mean(axis=0).tolist())
        found["seconds"].append(time.perf_counter() - begin)
        found["steps"].append(steps)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
