"""Shells by MuJoCo's flex: ``python mujoco_flex.py < case.json``, in any environment that has MuJoCo.

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


def flex(case: dict[str, Any], gravity: list[float], step: float) -> Any:
    """The model of a case under a gravity [m/s^2]."""
    points = " ".join(f"{value:.12g}" for point in case["vertices"] for value in point)
    faces = " ".join(str(corner) for face in case["faces"] for corner in face)
    held = " ".join(str(vertex) for vertex in case["held"])
    pull = " ".join(f"{value:.12g}" for value in gravity)
    scale = case.get("calibration", 1.0)
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{step}" gravity="{pull}" integrator="discrete">
        <flag contact="disable"/></option><size memory="100M"/><worldbody>
        <flexcomp name="sheet" type="direct" dim="2" mass="1" radius="1e-5" point="{points}" element="{faces}">
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


def settled(case: dict[str, Any], load: dict[str, Any], step: float) -> tuple[Any, int, float]:
    """Positions after the case's time or limit, None where they left its bounds; steps, and seconds."""
    model = flex(case, load["gravity"], step)
    data, steps = mujoco.MjData(model), 0
    for vertex, body in enumerate(model.flex_vertbodyid):
        if body > 0 and load.get("force"):
            data.xfrc_applied[body, :3] = load["force"][vertex]
    begin = time.process_time()
    while data.time < case["duration"] and time.process_time() - begin < case["limit"]:
        mujoco.mj_step(model, data)
        steps += 1
        if steps % 16 == 0 and not np.abs(data.flexvert_xpos).max() < case["bound"]:
            return None, steps, time.process_time() - begin
    places = np.array(data.flexvert_xpos)
    return (places if np.abs(places).max() < case["bound"] else None), steps, time.process_time() - begin


def main() -> None:
    """Answer every load of the case, by the longest step that stays within its bounds."""
    case = json.load(sys.stdin)
    found: dict[str, Any] = {"version": f"MuJoCo {mujoco.__version__}"}
    mass = flex(case, [0.0, 0.0, 0.0], case["steps"][0]).body_mass.sum()
    for step in case["steps"]:
        answers = []
        for load in case["loads"]:
            answers.append(settled(case, load, step))
            if answers[-1][0] is None:
                break
        else:
            found |= {
                "positions": [places.tolist() for places, _, _ in answers],
                "seconds": sum(seconds for _, _, seconds in answers),
                "taken": [steps for _, steps, _ in answers],
                "step": step,
            }
            break
    print(json.dumps(found | {"mass": float(mass)}))


if __name__ == "__main__":
    main()
