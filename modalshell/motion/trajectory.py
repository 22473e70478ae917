"""Trajectories: the stored frames of a motion, with outcome and solver statistics."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from modalshell.core.checks import checked_callback
from modalshell.core.drawn import Drawn
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.typing import Array, Mask, Progress
from modalshell.core.units import SI, UnitSystem
from modalshell.loads import Loading
from modalshell.models import Equilibrium
from modalshell.motion.bars import Bars
from modalshell.shell import CreaseState, Shell

WRITERS: dict[str, Callable[[Any, Path, Progress], Path]] = {}
"""What writes a trajectory, by the suffix of the file; the package ``export`` fills it."""


@final
@short_repr
@dataclass(frozen=True, kw_only=True)
class Trajectory(Drawn):
    """A simulated motion; made by keywords only.

    Attributes
    ----------
    times : ndarray, shape (F,)
        Times of the stored frames [s], the start at 0 included.
    positions : ndarray of float64 or float32, shape (F, n, 3)
        Vertex positions [m]; every one finite.
    outcome : Outcome
        How the motion ended, the gravest outcome where several hold; an equilibrium's own for a static answer. A motion
        that diverges keeps the frames up to there; any other one is kept whole.
    message : str
        A message that names all that went wrong, with numbers and times, and the range that a trained model states;
        empty if there is nothing to say.
    unconverged_steps : int
        Steps whose own solver did not converge.
    seconds : float
        Wall time.
    step_error : float or None
        Largest error of a vertex that the length of the steps has made, as a share of ``mesh.moment_length``, by the
        steps' own estimates added up: right within a factor of about two; None where the integrator knows none, as the
        exponential one under constraints. It does not know how a motion enlarges small differences: where a sheet
        slides over a moving collider without friction it was up to ten times too low. There compare with a run of half
        the step. Nor does it include kinks and jumps of a load's table within a step: a free shell ends ``dt^2 / 6``
        times the change of its acceleration away, by BDF2 ``dt^2 / 2``; where the table's times are ends of steps it
        does not.
    damping_error : float or None
        Error of the damping ratio that steps give to motion of its main frequency, over the one asked for; None where
        no damping was asked for, or the integrator does not know.
    energies : ndarray, shape (F, 3)
        Kinetic and elastic energy, with that stored by creases' hardening, and potential of the load [J] of each
        stored frame, in the model's own frame; the load's potential is zero at rest, and that of loads that have none,
        as wind or pressure on a sheet with free edges, too.
    constraint_residuals : ndarray, shape (F, k)
        How far each constraint is from its target: [m] for positions, [rad] for orientations.
    faces : ndarray of int, shape (T, 3)
        Triangles of the mesh.
    rest_positions : ndarray, shape (n, 3)
        Vertex positions at rest [m].
    fields : dict of ndarray
        Fields of the triangles by name, as of :class:`modalshell.ShellFields`: tensors (F, T, 3), scalars (F, T).
    levels : tuple of str
        The model of each frame, of a model that switches itself; else empty.
    crease_angles : ndarray, shape (F, C)
        Plastic fold [rad] of every crease in each frame, of shells with creases; else no columns.
    crease_heat : ndarray, shape (F,)
        Heat [J] that creases have made by then; empty without creases.
    contact_forces : ndarray, shape (F, n, 3)
        Force of the colliders on every vertex [N] along their normals, its mean over the step that ends there, rebounds
        with it; empty without contacts, as the next two. Of explicit rules and linear
        implicit Euler it is what the vertices' change of speed there needs, friction with it; of the latter it is too
        small by what the sheet's own stiffness takes in a step: some per cent of a flap at rest, more if squeezed.
    in_contact : ndarray of bool, shape (F, n)
        Vertices that are pushed.
    deepest : ndarray, shape (F,)
        Depth of the deepest vertex in a collider [m].
    reactions : ndarray, shape (F, n, 3)
        Forces of the supports on their vertices [N], of equilibria by DS of scenes in which nothing else holds the
        shell; else empty. See :meth:`modalshell.Shell.reactions`.
    self_contact : ndarray, shape (F,)
        Smallest distance [m] of parts in self-contact, its gap where none are nearer; empty without it.
    bars : Bars or None
        Error bars of some frames, where these were asked for.
    contacts : tuple of Contact
        The contacts, which pictures show; files of trajectories do not keep them.
    units : UnitSystem
        Units of all numbers but ``seconds``: SI unless the scene names others.
    """

    times: Array
    positions: NDArray[np.floating]
    outcome: Outcome
    message: str
    unconverged_steps: int
    seconds: float
    step_error: float | None = None
    damping_error: float | None = None
    energies: Array = field(default_factory=lambda: np.empty((0, 3)))
    constraint_residuals: Array = field(default_factory=lambda: np.empty((0, 0)))
    faces: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 3), dtype=np.int64))
    rest_positions: Array = field(default_factory=lambda: np.empty((0, 3)))
    fields: dict[str, Array] = field(default_factory=dict)
    levels: tuple[str, ...] = ()
    crease_angles: Array = field(default_factory=lambda: np.empty((0, 0)))
    crease_heat: Array = field(default_factory=lambda: np.empty(0))
    contact_forces: Array = field(default_factory=lambda: np.empty((0, 0, 3)))
    in_contact: Mask = field(default_factory=lambda: np.empty((0, 0), dtype=bool))
    deepest: Array = field(default_factory=lambda: np.empty(0))
    reactions: Array = field(default_factory=lambda: np.empty((0, 0, 3)))
    self_contact: Array = field(default_factory=lambda: np.empty(0))
    bars: Bars | None = None
    contacts: tuple[Any, ...] = field(default=(), repr=False, compare=False)
    units: UnitSystem = SI

    @property
    def status(self) -> str:
        """The outcome as a word or two."""
        return str(self.outcome)

    @property
    def error(self) -> Array | None:
        """Estimated distance from DS at the checked frames (B,), those at ``bars.times``; None without bars."""
        return None if self.bars is None else self.bars.displacement

    @property
    def margin(self) -> Array | None:
        """Stability margin at the checked frames (B,); None without bars."""
        return None if self.bars is None else self.bars.margin

    def in_units(self, units: UnitSystem) -> Trajectory:
        """The same numbers, which are in these units; the message says so, too."""
        return replace(self, units=units, message=units.restated(self.message))

    def with_remark(self, remark: str) -> Trajectory:
        """The same trajectory, its message with a further sentence."""
        return replace(self, message=f"{self.message}; {remark}" if self.message else remark)

    @classmethod
    def still(cls, answer: Equilibrium, shell: Shell, loading: Loading, dtype: DTypeLike = np.float64) -> Trajectory:
        """One frame at time 0: a static answer under the loads, its outcome the solver's."""
        shell = shell if answer.creases is None else shell.creased(answer.creases)
        kept: dict[str, Any] = {} if answer.creases is None else _kept(answer.creases)
        if answer.in_contact.size:
            forces, touches = answer.contact_forces[None], answer.in_contact[None]
            kept |= {"contact_forces": forces, "in_contact": touches, "deepest": np.array([answer.deepest])}
        if answer.self_contact is not None:
            kept["self_contact"] = np.array([answer.self_contact])
        energies = [0.0, shell.stored_energy(answer.positions), loading.energy(answer.positions)]
        return cls(
            times=np.zeros(1),
            positions=answer.positions[None].astype(dtype),
            outcome=answer.outcome,
            message=answer.message,
            unconverged_steps=int(not answer.converged),
            seconds=answer.seconds,
            energies=np.array([energies]),
            constraint_residuals=answer.constraint_residuals[None],
            faces=np.asarray(shell.mesh.faces),
            rest_positions=shell.rest_positions,
            bars=None if answer.bar is None else Bars.still(answer.bar),
            contacts=answer.contacts,
            **kept,
        )

    def save(self, path: str | os.PathLike[str], *, on_frame: Progress | None = None) -> Path:
        """Write the trajectory; the suffix of the file names the format, see :func:`modalshell.save_trajectory`."""
        target = Path(path)
        on_frame = checked_callback("on_frame", on_frame)
        if target.suffix not in WRITERS:
            raise OptionError(f"a trajectory is saved as {', '.join(WRITERS)} (got {target.name!r})")
        return WRITERS[target.suffix](self, target, on_frame)


def _kept(state: CreaseState) -> dict[str, Any]:
    """What creases have kept, as of one frame."""
    return {"crease_angles": state.angles[None], "crease_heat": np.array([state.dissipated])}
