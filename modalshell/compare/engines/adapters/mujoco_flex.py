"""Shells by MuJoCo's flex: ``python mujoco_flex.py < case.json``, in any environment that has MuJoCo.

A flex takes Young's modulus [Pa], Poisson's ratio and the thickness [m]; it spreads its mass evenly over the vertices,
so that each body gets the lumped mass of the case instead. The integrator is 'discrete', the one that takes flex
elasticity implicitly. Motion is damped by the mass until it rests.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import mujoco  # type: ignore[import-not-found]
from in_time import Settled, by_longest_step, settled  # type: ignore[import-not-found]  # beside this script


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


def answer(case: dict[str, Any], load: dict[str, Any], step: float) -> Settled:
    """Where a load comes to rest."""
    model = flex(case, load["gravity"], step)
    data = mujoco.MjData(model)
    for vertex, body in enumerate(model.flex_vertbodyid):
        if body > 0 and load.get("force"):
            data.xfrc_applied[body, :3] = load["force"][vertex]
    return settled(case, step, lambda: mujoco.mj_step(model, data), lambda: data.flexvert_xpos)


def main() -> None:
    """Answer every load of the case."""
    case = json.load(sys.stdin)
    mass = float(flex(case, [0.0, 0.0, 0.0], case["steps"][0]).body_mass.sum())
    print(json.dumps({"version": f"MuJoCo {mujoco.__version__}", "mass": mass, **by_longest_step(case, answer)}))


if __name__ == "__main__":
    main()
