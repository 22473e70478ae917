"""Calls with valid arguments: every public constructor and function, with what may be replaced in each."""

from __future__ import annotations

import functools
import importlib.util
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

import modalshell as ms
from fuzzing.harness import LongWork, few_steps
from fuzzing.world import Later, model, model_names, part, resolved, world
from modalshell import springs as masses
from modalshell.crowd import Flap, Flight
from modalshell.sweep import load_sweep

Build = Callable[..., Any]


RECORDS = {"Advice", "Basis", "Buckling", "Damping", "Equilibrium", "EquilibriumPath", "FlightResult"}
RECORDS |= {"LoadedModes", "Model", "Outcome", "ModelSpec", "PathEvent", "Scene", "SceneResult"}
RECORDS |= {
    "BasisSensitivity",
    "ErrorBar",
    "Fit",
    "QuantityBar",
    "QuickAdvice",
    "RepairReport",
    "ShellFields",
    "SweepResult",
    "Tradeoff",
    "Trajectory",
    "UnitSystem",
}
"""Plain records that the package fills itself; they hold what they are given."""
NO_INPUT = {"models"}
"""They take nothing."""
FILES = {"load_clip", "load_mesh", "save_mesh", "load_scene"}
FILES |= {"load_trajectory", "save_trajectory", "run_scene", "RunFollower"}
"""Their input is files: see the other surfaces."""
SLOW = {"tradeoff", "advise", "quick_advice"}
"""Minutes of work where they accept what they get: junk in every parameter that has a check."""


class Target:
    """A call with valid arguments: numbers and arrays, choices among words, and objects of the package.

    The call, its numbers and its objects may be Later; the properties of these names make them.
    """

    def __init__(
        self,
        name: str,
        call: Build | Later,
        values: dict[str, Any],
        words: dict[str, tuple[Any, ...]] | None = None,
        objects: dict[str, Any] | None = None,
        always: tuple[str, ...] = (),
    ) -> None:
        self.name, self.words, self.always = name, words or {}, always
        """Of the arguments in ``always`` one is always junk."""
        self._call, self._values, self._objects = call, values, objects or {}

    @functools.cached_property
    def call(self) -> Build:
        return resolved(self._call)

    @functools.cached_property
    def values(self) -> dict[str, Any]:
        return {name: resolved(value) for name, value in self._values.items()}

    @functools.cached_property
    def objects(self) -> dict[str, Any]:
        return {name: resolved(value) for name, value in self._objects.items()}

    def numeric(self) -> list[str]:
        """Names of the values that are numbers or arrays of them, as all are that are made later."""
        return [
            name
            for name, value in self._values.items()
            if isinstance(value, Later) or np.asarray(value).dtype.kind in "biuf"
        ]


def targets() -> list[Target]:
    """Every public call, those that this file does not know with junk alone."""
    made = [*_meshes(), *_shells(), *_models(), *_springs(), *_motions(), *_crowds(), *_measures(), *_ladder()]
    made += _sweeps()
    known = {target.name.split(".")[0].split(",")[0] for target in made} | RECORDS | FILES | NO_INPUT | {"measure"}
    for name in ms.__all__:
        value = getattr(ms, name)
        error = isinstance(value, type) and issubclass(value, BaseException)
        if name not in known and callable(value) and not error:
            required = [
                parameter.name
                for parameter in inspect.signature(value).parameters.values()
                if parameter.default is parameter.empty and parameter.kind is not parameter.VAR_KEYWORD
            ]
            made.append(Target(name, value, {key: np.eye(3) for key in required}, always=tuple(required)))
    return made


def _meshes() -> list[Target]:
    mesh = part("mesh")
    soup = {name: part("mesh", name).then(np.array) for name in ("vertices", "faces")}
    size = {"length": 1.0, "width": 0.2, "cells": (2, 2)}
    panel = {"length": 1.0, "radius": 0.6, "angle": 90.0, "cells": (2, 2)}
    family = {"family": ("alternating", "equilateral", "union-jack", "lloyd", "delaunay", "right")}
    anew = [Target("remesh", ms.remesh, {"triangles": 20, "crease": 25.0, "keep": [[0, 1]]}, objects={"mesh": mesh})]
    return [
        Target("TriangleMesh", _meshed(ms.TriangleMesh), soup),
        Target("TriangleMesh.from_soup", _meshed(ms.TriangleMesh.from_soup), soup),
        *(anew if importlib.util.find_spec("pymeshlab") else []),
        Target("repair", _meshed(lambda **given: ms.repair(**given)[0]), soup | {"tolerance": 1e-6}),
        Target("TriangleMesh.weld", part("mesh", "weld"), {"tolerance": 1e-6}),
        Target("flat_beam", ms.flat_beam, size, family),
        Target("sheet", ms.sheet, size, family),
        Target("v_beam", ms.v_beam, size | {"fold": 150.0}, family),
        Target("cylinder_panel", ms.cylinder_panel, panel, family),
        Target("leaf", ms.leaf, size | {"cells": (5, 2), "fold": 160.0, "camber": 0.1, "curl": 20.0}, family),
        Target(
            "paper_bird",
            ms.paper_bird,
            {"length": 0.2, "wing": 0.18, "body": 0.04, "opening": 40.0, "dihedral": 15.0, "cells": (2, 3)},
        ),
    ]


def _meshed(make: Build) -> Build:
    """A mesh, and what lazily follows from it."""

    def call(**arguments: Any) -> list[Any]:
        mesh = make(**arguments)
        return [mesh, mesh.hinges, mesh.face_areas, mesh.face_normals, mesh.components, mesh.area, mesh.edge_lengths]

    return call


def _shells() -> list[Target]:
    mesh, shell = part("mesh"), part("shell")
    stiffness = {"stretch": 20.0, "shear": 20.0, "flexure": 0.05, "density": 0.2}
    by_element = {
        "stretch": _one_each("faces", 20.0),
        "shear": _one_each("edges", 20.0),
        "flexure": _one_each("hinges", 0.05),
        "density": _one_each("faces", 0.2),
    }

    def used(mesh: Any, clamped: Any = None, **material: Any) -> list[Any]:
        made = ms.Shell(mesh, ms.Material(**material), clamped)
        basis = ms.solve_modes(made, 2)
        return [made, basis, ms.LinearModal(basis).equilibrium(gravity=(0.0, 0.0, -9.81))]

    def calibrated(mesh: Any, **physical: Any) -> list[Any]:
        material = ms.Material.from_physical(mesh=mesh, **physical)
        return [material, ms.solve_modes(ms.Shell(mesh, material, world()["shell"].clamped), 2)]

    def isotropic(mesh: Any, clamped: Any = None, **physical: Any) -> list[Any]:
        made = ms.Shell(mesh, ms.Isotropic(**physical), clamped)
        basis = ms.solve_modes(made, 2)
        load = 1e-3 * made.gravity_force((0.0, 0.0, -9.81))
        return [made, basis, made.force(moved.make()), ms.DiscreteShell(made).equilibrium(force=load)]

    def on_mesh(make: Build) -> Later:
        return mesh.then(lambda found: functools.partial(make, mesh=found))

    physical = {"young": 1e6, "poisson": 0.3, "thickness": 0.01, "density": 1e3}
    start = part("shell", "rest_positions").then(np.array)
    held, moved = part("shell", "clamped").then(np.array), start.then(lambda positions: positions * 1.01)
    switch = {"correct_clamp": (False, True, None, 2)}
    positions = {"positions": moved}
    return [
        Target("Material", used, stiffness | {"clamped": held}, switch, {"mesh": mesh}),
        Target("Material, by element", on_mesh(used), by_element | {"clamped": held.then(np.flatnonzero)}, switch),
        Target("Material.from_physical", calibrated, physical | {"direction": np.array([1.0, 0.0, 0.0])},
               {"narrow": (None, True, False)}, {"mesh": mesh}),
        Target("Isotropic", isotropic, physical | {"clamped": held}, {}, {"mesh": mesh}),
        Target("Isotropic, by triangle", on_mesh(isotropic),
               {name: _one_each("faces", value) for name, value in physical.items()} | {"clamped": held}),
        Target("Shell", lambda clamped, **given: ms.Shell(clamped=clamped, **given), {"clamped": held}, {},
               {"mesh": mesh, "material": part("material")}),
        Target("Shell.holding", part("shell", "holding"), {"vertices": np.array([8, 9])}),
        Target("Shell.energy", part("shell", "energy"), positions),
        Target("Shell.force", part("shell", "force"), positions),
        Target("Shell.stiffness", part("shell", "stiffness"), positions),
        Target("Shell.gravity_force", part("shell", "gravity_force"), {"gravity": np.array([0.0, 0.0, -9.81])}),
        *(
            Target(load.__name__, lambda sel, force, load=load: load(sel, force).force(world()["mesh"]),
                   {"sel": held, "force": np.array([0.0, 0.0, -1.0])})
            for load in (ms.PointForce, ms.LineForce, ms.FollowerForce)
        ),
        Target("EdgeMoment", lambda sel, m: ms.EdgeMoment(sel, m).force(world()["mesh"]), {"sel": held, "m": 0.1}),
        Target("Pressure", lambda p, sel, follower=True: ms.Pressure(p, follower, sel).force(world()["mesh"]),
               {"p": 2.0, "sel": held}, {"follower": (False, True)}),
        Target("Wind", lambda sel, **given: ms.Wind(sel=sel, **given).force(world()["mesh"]),
               {"velocity": np.array([1.0, 0.0, 2.0]), "density": 1.2, "normal": 1.0, "tangential": 0.01,
                "sel": held}),
        Target("SelfWeight", lambda gravity: world()["shell"].total_load(loads=[ms.SelfWeight(gravity)]),
               {"gravity": np.array([0.0, 0.0, -9.81])}),
        Target("FrameInertia", lambda **given: world()["shell"].total_load(loads=[ms.FrameInertia(**given)]),
               {name: np.array([0.0, 1.0, 0.5])
                for name in ("acceleration", "angular_velocity", "angular_acceleration", "origin")}),
        Target("Scaled", lambda times, factors: ms.Scaled(ms.Pressure(1.0), (times, factors)).force(world()["mesh"]),
               {"times": np.array([0.0, 1.0]), "factors": np.array([1.0, 2.0])}),
        Target("WarpFrame", lambda **given: ms.WarpFrame(**given).positions(np.zeros(3)), {"threads": 1},
               {"dtype": ("float64", "float32", "int")}, {"basis": part("basis")}),
        Target("solve_modes", ms.solve_modes, {"count": 3}, {"backend": (None, "superlu", "x", 3)}, {"shell": shell}),
        Target("solve_modes, about", ms.solve_modes, {"count": 3, "about": start}, {},
               {"shell": shell}, ("about",)),
        Target("solve_modes, attached", lambda force, **given: ms.solve_modes(attachments=[force], **given),
               {"count": 3, "force": start}, {}, {"shell": shell}, ("force",)),
        Target("buckling_factors", ms.buckling_factors, {"count": 1, "gravity": np.array([0.0, 0.0, -1.0]),
               "force": start}, {}, {"shell": shell}),
        Target("Damping.from_ratios", ms.Damping.from_ratios, {"first": (1.0, 0.02), "second": (5.0, 0.03)}),
    ]  # fmt: skip


def _one_each(elements: str, value: float) -> Later:
    """The value for each of the mesh's faces, edges or hinges."""
    return part("mesh", elements).then(lambda found: np.full(len(found), value))


def _followed_well(**given: Any) -> ms.EquilibriumPath:
    """The path of a double well, through both of its limit points."""

    def energy(x: Any) -> tuple[Any, Any, Any]:
        slope = x * (x**2 - 1.0)
        return 0.25 * np.sum((x**2 - 1.0) ** 2), slope, np.diag(3.0 * x**2 - 1.0)

    system = ms.EnergyFunction(energy, **given)
    return ms.equilibrium_path(system, force=np.ones_like(system.rest), points=60)


def _models() -> list[Target]:
    basis, shell, mesh, rsw = part("basis"), part("shell"), part("mesh"), model("rsw")
    integrators = {"integrator": ("exponential", "implicit_euler", "implicit_midpoint", "euler", None, 1)}
    gravity, start = np.array([0.0, 0.0, -2.0]), part("shell", "rest_positions").then(np.array)
    force = start.then(lambda positions: np.full(positions.shape, 0.01))
    hung = shell.then(
        lambda found: np.array(ms.DiscreteShell(found).equilibrium(gravity=gravity, force=force.make()).positions)
    )

    def answered(make: Build) -> Build:
        def call(**arguments: Any) -> list[Any]:
            made = make(**arguments)
            return [made, made.equilibrium(gravity=gravity)]

        return call

    coordinates = np.random.default_rng(0).standard_normal((6, 3)) * 0.01
    coarse = shell.then(lambda found: ms.CoarseDiscreteShell(found, found))
    made = [
        Target("LinearModal", answered(ms.LinearModal), {}, integrators, {"basis": basis}),
        Target("ModalWarping", answered(ms.ModalWarping), {}, integrators, {"basis": basis}),
        Target("RotationStrain", answered(ms.RotationStrain), {}, integrators, {"basis": basis}),
        Target("ReducedRotationStrain", answered(ms.ReducedRotationStrain), {"coordinates": coordinates, "rank": 4}, {},
               {"model": rsw}),
        Target("ReducedRotationStrain.trained", ms.ReducedRotationStrain.trained,
               {"gravities": np.array([[0.0, 0.0, -2.0]]), "mixtures": 4, "rank": 3, "seed": 0}, {},
               {"model": rsw}, ("gravities", "mixtures", "rank", "seed")),
        Target("ModalDerivatives", answered(ms.ModalDerivatives), {"count": 2},
               {"cubature": (False, True, 5, 0, -1, 1.5, "x", None)}, {"shell": shell}),
        Target("DiscreteShell", answered(ms.DiscreteShell), {"step_tolerance": 1e-6},
               {"integrator": ("implicit", "linear_implicit", "explicit", "verlet", "x", None)}, {"shell": shell}),
        Target("SpringSheet", answered(ms.SpringSheet), {"step_tolerance": 1e-6, "iterations": 1000},
               {"integrator": ("linear_implicit", "verlet", "x", None), "solver": ("factor", "cg", "x", None)},
               {"shell": shell, "springs": shell.then(masses.shell_springs)}),
        Target("RigidShell", answered(ms.RigidShell), {}, {}, {"shell": shell}),
        Target("coarse_shell", ms.coarse_shell, {}, {}, {"shell": shell, "mesh": mesh, "material": part("material")}),
        Target("CoarseDiscreteShell.prolong", coarse.then(lambda body: body.prolong), {"positions": start}),
        Target("CoarseDiscreteShell.restrict", coarse.then(lambda body: body.restrict), {"load": force}),
        Target("CoarseDiscreteShell", answered(ms.CoarseDiscreteShell), {}, {}, {"shell": shell, "coarse": shell}),
        Target("EnergyFunction", _followed_well, {"rest": np.array([-1.0]), "size": 1.0}),
        Target("equilibrium_path", ms.equilibrium_path,
               {"gravity": gravity, "force": force, "until": 1.5, "begin": 0.0, "start": start, "steps": 3,
                "points": 20, "branches": 1},
               {"control": ("arc", "load", "displacement", "time", None, 1), "watch": (None, ([9], (0, 0, 1)), 3)},
               {"model": shell}),
        Target("fit", ms.fit, {"observed": hung, "gravity": gravity, "force": force, "confidence": 0.9},
               {"wrt": ("flexure", "young", ["flexure", "shear"], None, 1), "where": (None, "x > 0.5", 3)},
               {"shell": shell, "wrt": "flexure"}),
        Target("fit, curves", ms.fit,
               {"observed": hung.then(lambda seen: seen[None]), "factors": np.array([1.0]), "gravity": gravity,
                "force": force},
               {"wrt": ("flexure", "young"), "average": (False, True, 1)}, {"shell": shell, "wrt": "flexure"}),
        Target("fit, frequencies", ms.fit,
               {"frequencies": shell.then(lambda one: 1.02 * ms.solve_modes(one, 3).frequencies), "confidence": 0.9},
               {"wrt": ("flexure", "young", "density")}, {"shell": shell, "wrt": "flexure"}),
        Target("PositionConstraint", _constraint(ms.PositionConstraint),
               {"vertices": np.array([8, 9]), "target": np.array([1.0, 0.0, -0.1])}),
        Target("OrientationConstraint", _constraint(ms.OrientationConstraint),
               {"vertices": np.array([8, 9]), "target": np.array([0.1, 0.0, 0.0])}),
    ]  # fmt: skip
    asked = {"gravity": gravity, "force": force, "start": start}
    made += [Target(f"{name}.equilibrium", model(name, "equilibrium"), asked) for name in model_names()]
    return made


def _springs() -> list[Target]:
    sizes = {"spacing": 0.1, "particle_mass": 0.01, "structural": 20.0, "shear": 10.0, "flexion": 5.0, "drag": 0.1}
    pinned = np.zeros((3, 4), dtype=bool)
    pinned[0] = True
    sheet = masses.SheetGrid(shape=(3, 4), pinned=pinned, **sizes)
    gravity, springs = np.array([0.0, 0.0, -9.81]), sheet.springs()
    start = sheet.rest_positions()

    def declared(**given: Any) -> list[Any]:
        grid = masses.SheetGrid(**given)
        return [grid, grid.springs(), grid.rest_positions()]

    def stepped(count: Any, dt: Any, **given: Any) -> list[Any]:
        verlet = masses.GridVerlet(**given)
        verlet.step(count, dt)
        return [verlet.positions, verlet.velocities]

    def solved(positions: Any, velocities: Any, mass: Any, held: Any, **given: Any) -> list[Any]:
        stepper = masses.ImplicitSprings(springs, mass, held, threads=1)
        stepper.place(positions, velocities)
        found = stepper.step(**given)
        return [found if found.converged else found.converged, stepper.positions, stepper.velocities]

    arrays = {"pairs": np.array(springs.pairs), "rest_lengths": np.array(springs.rest_lengths)}
    arrays |= {"stiffness": np.array(springs.stiffness), "damping": np.zeros(len(springs))}
    steps = {"dt": 1e-3, "load": gravity, "drag": 0.1, "stiffness_damping": 0.01, "iterations": 10, "tolerance": 1e-6}
    return [
        Target("SheetGrid", declared, sizes | {"shape": np.array([3, 4]), "spring_damping": 0.1, "gravity": gravity,
                                               "pinned": pinned}),
        Target("GridVerlet", stepped, {"count": 3, "dt": 1e-3, "start": start, "velocity": np.zeros_like(start),
               "threads": 1}, {"dtype": (np.float64, "float32", "f2", "x", int), "allow_unstable_step": (False, True)},
               {"grid": sheet}),
        Target("Springs", masses.Springs, arrays),
        Target("mesh_springs", masses.mesh_springs, {"structural": _one_each("edges", 20.0), "damping": 0.1,
               "flexion": _one_each("hinges", 2.0)}, {}, {"mesh": part("mesh")}),
        Target("shell_springs", masses.shell_springs, {"reference_fold": 0.2}, {}, {"shell": part("shell")}),
        Target("ImplicitSprings", solved, steps | {"positions": start, "velocities": np.zeros_like(start),
               "mass": np.full(len(start), 0.01), "held": np.array([0, 1])}),
    ]  # fmt: skip


def _sweeps() -> list[Target]:
    """Sweeps that stop where their cases would be computed."""
    declared = load_sweep(Path(__file__).with_name("sweep.toml"))

    def refused(**given: Any) -> Any:
        with mock.patch("modalshell.sweep.driver.CaseFolder", _not_computed):
            return ms.run_sweep(**given)

    return [Target("run_sweep", refused, {"workers": 1, "time_limit": 10.0, "out": "results"},
                   {"cluster": (None, 3, np.eye(2), "x", "tcp://127.0.0.1:1")}, {"sweep": declared},
                   ("workers", "time_limit", "out"))]  # fmt: skip


def _not_computed(*_: Any) -> Any:
    raise LongWork


def _constraint(make: Build) -> Build:
    def call(**arguments: Any) -> list[Any]:
        constraint = make(**arguments)
        mwts = world()["models"]["mwts"]
        return [constraint.at(0.5), mwts.equilibrium(gravity=(0.0, 0.0, -1.0), constraints=[constraint])]

    return call


def _motions() -> list[Target]:
    gravity, start = np.array([0.0, 0.0, -2.0]), part("shell", "rest_positions").then(np.array)
    force = start.then(lambda positions: np.full(positions.shape, 0.01))
    common = {"duration": 0.1, "dt": 1 / 30, "gravity": gravity, "force": force, "damping": np.array([0.1, 0.01])}
    common |= {"start": start, "store_every": 1}
    words = {"dtype": ("float64", "float32", "f2", "x", int, 3)}
    objects = {"supports": part("path"), "constraints": [ms.PositionConstraint([12], [1.0, 0.0, -0.1])]}
    made = [
        Target(f"simulate, {name}", functools.partial(ms.simulate, on_step=few_steps), common, words,
               {"model": model(name)} | ({} if "free" in name else objects if name in ("mwts", "ds") else {}))
        for name in model_names()
    ]  # fmt: skip
    keyframes = {
        "times": np.array([0.0, 0.5, 1.0]),
        "translations": np.arange(9.0).reshape(3, 3),
        "rotation_vectors": np.arange(9.0).reshape(3, 3),
        "pivot": np.zeros(3),
    }

    def along(time: Any, **given: Any) -> Any:
        return ms.SupportPath(**given).at(time)

    sampled = {"duration": 0.1, "step": 0.05, "pivot": np.zeros(3)}
    return [
        *made,
        Target("SupportPath", along, keyframes | {"time": 0.3}),
        Target(
            "SupportPath.from_function",
            lambda **given: ms.SupportPath.from_function(lambda _: (np.zeros(3), np.zeros(3)), **given).at(0.01),
            sampled,
        ),
    ]


def _crowds() -> list[Target]:
    places = np.random.default_rng(1).standard_normal((4, 3))
    numbers = {
        "speed": 1.0,
        "speed_variation": 0.5,
        "noise_frequency": 0.5,
        "rotation_speed": 1.0,
        "neighbour_distance": 1.0,
        "field_of_view": 300.0,
        "seed": 0,
        "target_weight": 1.0,
        "threads": 1,
    }
    vectors = {"flock_position": np.zeros(3), "target": np.ones(3), "bounds": np.array([[-9.0] * 3, [9.0] * 3])}

    def flown(dt: Any, gravity: Any, **given: Any) -> list[Any]:
        flock = ms.Flock(**given)
        flock.step(dt)
        return [flock, flock.frames(gravity)]

    def scattered(**given: Any) -> list[Any]:
        flock = ms.Flock.random(**given)
        flock.step(0.1)
        return [flock]

    def crowded(basis: Any, dtype: Any, **given: Any) -> Any:
        crowd = ms.Crowd(basis, given["count"], damping=given["damping"], dtype=dtype)
        crowd.step(given["dt"], felt=given["felt"], forcing=given["forcing"])
        crowd.choose_levels(given["distances"], given["angle"])
        positions = crowd.positions(given["rotations"], given["translations"])
        return [crowd.coordinates, crowd.rates, positions, crowd.level_errors()]

    crowd = {
        "count": 2,
        "damping": np.array([0.1, 0.01]),
        "dt": 0.03,
        "felt": np.array([0.0, 0.0, -2.0]),
        "forcing": np.zeros((2, 3)),
        "distances": np.array([1.0, 5.0]),
        "rotations": np.eye(3),
        "translations": np.zeros(3),
        "angle": 0.01,
    }
    step = {"dt": 0.1, "gravity": np.array([0.0, 0.0, -9.81])}
    wings = {"amplitude": 0.1, "frequency": 2.0, "largest_load_factor": 3.0, "seed": 0}

    def carried(dt: Any, gravity: Any, basis: Any, seed: Any, **flap: Any) -> list[Any]:
        flock, crowd = ms.Flock(places, places[::-1]), ms.Crowd(world()["basis"], 4)
        flight = Flight(flock, crowd, Flap(basis, **flap), gravity=gravity, seed=seed)
        flight.advance(dt)
        return [flight.frames, flight.crowd.coordinates, flight.crowd.positions(flight.frames)]

    search = {"search": ("grid", "all_pairs", "x", None)}
    dtypes = {"dtype": (np.float64, "float32", "f2", "x", int)}
    return [
        Target("Flock", flown, numbers | vectors | step | {"positions": places, "directions": places[::-1]}, search),
        Target("Flock.random", scattered, numbers | vectors | {"count": 4, "radius": 1.0}, search),
        Target("Crowd", crowded, crowd, dtypes, {"basis": part("basis")}),
        Target("Flap and Flight", carried, wings | step, {}, {"basis": part("basis")}),
    ]


def _measures() -> list[Target]:
    mesh, shell = part("mesh"), part("shell")
    moved = part("mesh", "vertices").then(lambda vertices: np.array(vertices) * 1.1)
    both = {"positions": moved, "reference": moved.then(lambda positions: positions + 0.01)}
    made = [
        Target("measure.displacement_error", ms.measure.displacement_error, both, {"weighted": (True, False)},
               {"shape": shape}) for shape in (mesh, shell)
    ]  # fmt: skip
    return [*made, Target("measure.area_change", ms.measure.area_change, {"positions": moved}, {}, {"mesh": mesh})]


def _ladder() -> list[Target]:
    shell = part("shell")
    load = {"gravity": np.array([0.0, 0.0, -1.0]), "loads": np.array([0.5, 1.0]), "modes": (2,)}
    asked = load | {"error": 0.1, "fps": 60.0}
    load["truth"] = part("shell", "rest_positions").then(lambda positions: np.array(positions) * 1.1)
    always = ("gravity", "loads", "modes")
    return [
        Target("tradeoff", _checks_only(ms.tradeoff), load, {}, {"scene": shell}, always),
        Target("advise", _checks_only(ms.advise), asked, {}, {"scene": shell}, always),
    ]


def _checks_only(call: Build) -> Build:
    def start(*_: int) -> None:
        raise LongWork

    return functools.partial(call, on_step=start)
