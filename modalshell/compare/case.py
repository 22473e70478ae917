"""Case of a comparison: a shell under a growing load, and coarser meshes of it."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import ArrayLike

from modalshell.core.checks import checked_kind
from modalshell.core.errors import OptionError
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.loads import Load, Scaled
from modalshell.mesh import TriangleMesh
from modalshell.models import CoarseMesh
from modalshell.models.coarse.coarse_mesh import drawn_to_supports
from modalshell.modes.rigid import rigid_motions
from modalshell.scene import Scene, ShellScene, load_scene
from modalshell.scene.coarse import scene_coarse_meshes
from modalshell.scene.parts import build_damping, build_path
from modalshell.shell import Sheet, Shell
from modalshell.shell.damping import Damping

_FRAME = 1.0 / 60.0
"""Time between frames [s] where the scene declares no motion."""


@short_repr
@dataclass(frozen=True)
class Case:
    """What the rungs are compared on."""

    name: str
    """For titles and files."""
    shell: Shell
    """The shell, held by its supports."""
    load: Array = field(repr=False)
    """The whole load [N]; the load range is from zero to this; shape (n, 3)."""
    dt: float = _FRAME
    """Time between frames [s]."""
    damping: Damping = field(default_factory=Damping)
    """Of the motion whose frames are timed."""
    coarse: Sequence[CoarseMesh] = ()
    """Coarser meshes to run discrete shells on."""
    note: str = ""
    """Note on the origin of the load, if needed, in sentences."""
    integrator: str | None = None
    """Key of the integrator of modal models; by default their own."""
    live: Sequence[Load] = ()
    """Those loads of ``load``, which holds them as they are at rest, that follow the shell, without their change in
    time."""
    units: UnitSystem = SI
    """Of its numbers, which texts name."""

    def __post_init__(self) -> None:
        if loose := rigid_motions(self.shell).shape[1]:
            raise OptionError(
                f"the supports leave {loose} rigid motions free, so that no equilibrium exists to compare rungs at: "
                "hold more vertices"
            )
        if not self.shell.unknowns.restrict(self.load.ravel()).any():
            raise OptionError(
                f"{self.name!r}: no load moves the shell, so there is nothing to compare: give gravity or forces"
            )

    def statics(self, share: float) -> dict[str, Any]:
        """What ``model.equilibrium`` takes for a share of the load, with loads that follow the shell as they do so."""
        if not self.live:
            return {"force": share * self.load}
        dead = self.load - self.shell.loading(loads=self.live).largest_force()
        return {"force": share * dead, "loads": [Scaled(load, lambda _: share) for load in self.live]}

    @property
    def notes(self) -> str:
        """Notes on the reference and the load, in sentences."""
        theory = isinstance(self.shell.material, Sheet)
        reference = "DS stands for shell theory, by split folds on the same mesh." if theory else ""
        return " ".join(filter(None, (reference, self.note)))


def make_case(
    scene: Scene | Shell | Case | str | os.PathLike[str],
    gravity: ArrayLike | None,
    force: ArrayLike | None,
    coarse: Sequence[TriangleMesh],
) -> Case:
    """The case of a scene or its file, or of a shell under ``gravity`` and ``force`` with ``coarse`` meshes."""
    if isinstance(scene, Case | Scene | str | os.PathLike):
        if gravity is not None or force is not None or len(coarse):
            raise OptionError("a scene brings its own load and meshes: gravity, force and coarse go with a Shell")
        if isinstance(scene, Case):
            return scene
        declared = scene if isinstance(scene, Scene) else load_scene(scene)
        return scene_case(declared.require_shell())
    checked_kind("scene", scene, Shell)
    meshes = [CoarseMesh(drawn_to_supports(scene, mesh), f"{len(mesh.faces)} triangles") for mesh in coarse]
    return Case("shell", scene, scene.total_load(gravity, force), coarse=meshes)


def scene_case(scene: ShellScene) -> Case:
    """The case of a scene; moving supports give the largest inertial load of their path."""
    if scene.contacts:
        raise OptionError(f"{scene.file}: contacts: rungs are not compared with contacts yet; leave them out")
    if scene.constraints:
        raise OptionError(
            f"{scene.file}: constraints: rungs are compared under loads, not under constraints; leave them out, or "
            "give a force in their place"
        )
    shell = scene.build_shell()
    load, note = scene.largest_load(shell)
    motion = scene.motion
    if motion is not None and motion.modal_damping:
        raise OptionError(f"{scene.file}: motion.modal_damping: rungs without modes cannot take it; give damping")
    rule = scene.model.given.get("integrator") if scene.model.spec.on_modes else None
    return Case(
        scene.name,
        shell,
        load,
        motion.dt if motion else _FRAME / scene.unit_system.seconds,
        build_damping(motion) if motion else Damping(),
        scene_coarse_meshes(scene.mesh, scene.material, shell),
        note,
        rule,
        _live_loads(scene, shell),
        scene.unit_system,
    )


def _live_loads(scene: ShellScene, shell: Shell) -> list[Load]:
    """The loads that change, as :meth:`~modalshell.scene.ShellScene.largest_load` takes them, but free to follow.

    None where supports move, whose load is an instant's, or where a load changes in time by more than a factor.
    """
    if build_path(scene.supports) is not None:
        return []
    held = list[Load]()
    for load in scene.build_forces(shell)[1]:
        for one in shell.loading(loads=[load]).live:
            if one.is_field:
                return []
            if not one.by_position:
                continue
            largest, kind = max((one.factor_at(time) for time in one.times), key=abs), load
            while isinstance(kind, Scaled):
                kind = kind.load
            held.append(Scaled(kind, lambda _, largest=largest: largest))  # type: ignore[misc]
    return held
