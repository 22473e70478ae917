"""A strip under gravity by MuJoCo's flex: ``python mujoco_flex.py < case.json``, in any environment that has MuJoCo.

A flex takes Young's modulus [Pa], Poisson's ratio and the thickness [m]; it spreads its mass evenly over the vertices,
so that each body gets the lumped mass of the case instead. The integrator is 'discrete', the one that takes flex
elasticity implicitly. Motion is damped by the mass until it rests.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import mujoco  # type: ignore[import-not-found]
import numpy as np


def flex(case: dict[str, Any], gravity: float) -> Any:
    """The model of a case under a gravity [m/s^2] along -z."""
    points = " ".join(f"{value:.12g}" for point in case["vertices"] for value in point)
    faces = " ".join(str(corner) for face in case["faces"] for corner in face)
    held = " ".join(str(vertex) for vertex in case["held"])
    scale = case.get("calibration", 1.0)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{case["step"]}" gravity="0 0 {-gravity}" integrator="discrete">
        <flag contact="disable"/></option><size memory="100M"/><worldbody>
        <flexcomp name="strip" type="direct" dim="2" mass="1" radius="1e-5" point="{points}" element="{faces}">
        <edge equality="false"/><contact selfcollide="none" contype="0" conaffinity="0"/>
        <elasticity young="{scale * case["young"]}" poisson="{case["poisson"]}" thickness="{case["thickness"]}"
        elastic2d="both"/><pin id="{held}"/></flexcomp></worldbody></mujoco>"""
    )
    for vertex, body in enumerate(model.flex_vertbodyid):
        if body > 0:
            model.body_mass[body] = case["masses"][vertex]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    for body in range(model.nbody):
        first, count = model.body_dofadr[body], model.body_dofnum[body]
        if count > 0:
            model.dof_damping[first : first + count] = case["damping"] * model.body_mass[body]
    return model


def main() -> None:
    """Answer every load of the case."""
    case = json.load(sys.stdin)
    found: dict[str, Any] = {"version": f"MuJoCo {mujoco.__version__}", "tips": [], "seconds": [], "steps": []}
    for gravity in case["gravities"]:
        model = flex(case, gravity)
        found["mass"] = float(model.body_mass.sum())
        data, begin, steps = mujoco.MjData(model), time.perf_counter(), 0
        while data.time < case["duration"] and time.perf_counter() - begin < case["limit"]:
            mujoco.mj_step(model, data)
            steps += 1
        found["tips"].append(np.asarray(data.flexvert_xpos)[case["tip"]].mean(axis=0).tolist())
        found["seconds"].append(time.perf_counter() - begin)
        found["steps"].append(steps)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
