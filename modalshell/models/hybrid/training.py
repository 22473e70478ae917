"""Training of the hybrid model: random loads, motions of the coarse shell, POD, and errors on held-out loads."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np

from modalshell.core.checks import checked_count, checked_number
from modalshell.core.errors import ModalShellWarning, OptionError, SolverError
from modalshell.core.typing import Array, Index, Progress, unheard
from modalshell.integrators.free_parts import FittedFrames, FreeParts
from modalshell.integrators.full import BDF2
from modalshell.integrators.full.implicit_rule import EulerStart, EulerSteps
from modalshell.integrators.state import MotionState
from modalshell.kernels.rotations import largest_turn
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.hybrid.assumed_stress import (
    ReducedStress,
    measures_of,
    position_modes,
    reduce_energy,
    stress_modes,
)
from modalshell.models.hybrid.assumed_stress_step import STEP_GOAL, implicit_step, reduced_start
from modalshell.models.hybrid.measures import NONE_TURNED, Measures
from modalshell.modes import lowest_modes
from modalshell.modes.modal_rotation import largest_at_vertices
from modalshell.shell import Shell
from modalshell.shell.damping import Damping

LOADED, RELEASED = 30, 15
"""Frames under the load and after it."""
IN_A_PERIOD = 8.0
"""Frames in a period of the lowest mode."""
_SIZES = (0.5, 1.2)
_AROUND = np.radians(30.0)
"""Sizes of the loads over the given one, and largest angle between half of them and it."""
_POINT = 0.1
"""Size of the additional point force of a third of the loads, relative to the load."""
_DRAG, _VISCOSITY = (0.0, 0.1), (9e-3, 0.18)
"""Damping by the mass over a frame, and by the stiffness in half of the motions, in frames."""
_HELD_OUT = 10
"""Motions on loads that are not in training, at least."""
_MOST_FAILED = 0.1
"""Motions that may fail, and be drawn again, over those wanted."""
_ENOUGH = 0.03
"""Error up to which a basis is not made larger where none is wanted: estimates from few motions scatter by a third."""
_NEARLY = 1.25
"""Mean error over the least one up to which a smaller basis is taken, where no error is wanted: the geometric mean, as
two motions of ten that any basis snaps otherwise are the 90th percentile of all."""
_WRONG = 0.1
"""Error from which a motion is wrong, and a warning is given where no error is wanted."""
GROWING = (16, 24, 32, 44, 64)
"""Sizes of the basis that are tried where an error is wanted, up to the largest that is allowed."""
_LINEAR, _STRESSED = 4, 6
"""Linear modes in the basis, and those whose stresses are assumed."""
_UNSTRETCHED = 1e-12
"""Share of a linear mode's energy that is in the membrane, below which it is rounding."""
_MOST_FRAMES = 900
"""Snapshots at most."""
_EVEN, _LEAST = 0.5, 1e-3
"""Power of its size by which a snapshot is divided, so that states before a snap count, and the least size for it."""
SMALL = 0.02
"""Share of the largest energy in training that counts as small."""


RULE = BDF2()
"""Steps of motions in training, those of the models."""
_FALLING = 0.05
"""Turn [rad] to train on where loads bend free parts less: what bends them in flight follows from their motion."""


@final
class TrainingLoads:
    """What parts without supports are trained on: loads that leave their frames at rest.

    A dead load in the frame, balanced by inertia, and loads of the lowest elastic modes; these turn a vertex as the
    balanced load does, or by a twentieth of a radian where that is less.
    """

    def __init__(self, coarse: Shell, load: Array, count: int) -> None:
        self.frames = FittedFrames(coarse.rest_positions, FreeParts.of(coarse))
        self.rigid = 6 * len(self.frames.parts)
        modes = lowest_modes(coarse, min(self.rigid + count, coarse.free_unknowns.size))[0]
        self.lowest, self.eigenvalues = modes.modes[:, self.rigid :], modes.eigenvalues[self.rigid :]
        self._turns, self._mass = largest_at_vertices(modes.rotations[:, self.rigid :]), np.repeat(coarse.mass, 3)
        balanced = self.frames.load_in_frames(coarse.rest_positions, load).ravel() @ self.lowest / self.eigenvalues
        self.size = max(_FALLING, float(np.abs(balanced * self._turns).max(initial=0.0)))
        """Turn [rad] of a vertex."""

    def drawn(self, load: Array, rng: np.random.Generator) -> Array:
        """A load (k, 3) [N] about one that was drawn; that itself where all parts are held."""
        if not self.frames.parts:
            return load
        softer = self.eigenvalues[0] / self.eigenvalues  # forces of all modes are alike: stiff ones bend less
        q = self.size * softer / self._turns * rng.standard_normal(self._turns.size)
        further = self._mass * (self.lowest @ (self.eigenvalues * q))
        return self.frames.load_in_frames(self.frames.rest, load) + further.reshape(-1, 3)


@final
@dataclass(frozen=True)
class Trained:
    """Result of the training."""

    basis: Array
    """V, mass-orthonormal, of the coarse shell's displacements; shape (3k, m)."""
    stresses: Array
    """Modes of stresses; shape (e, K)."""
    held_out_error: float
    """90th percentile of the motions' errors against the coarse shell on loads that were not in training."""
    strain_limit: float
    """Largest share of unseen membrane energy that counts as seen."""
    energy: float
    """Largest elastic energy in training [J]."""
    description: str
    """The loads."""
    coarse_errors: Array = field(default_factory=lambda: np.empty((0, 2)))
    """Shares of the load, and under each the error of the coarse shell itself against DS at rest; none if unknown.
    Shape (c, 2)."""
    turned: Index = field(default_factory=lambda: NONE_TURNED)
    """Folds, flat at rest, that are evaluated as bent ones: training turns them far. Shape (t,)."""

    def unseen(self, measures: Measures, x: Array, energy: float, seen: float) -> float:
        """Membrane energy at ``x`` (k, 3) that the stresses do not see, over ``energy`` [J] and a small one.

        ``seen`` [J] is that of the assumed stresses.
        """
        return abs(measures.energy(x) - seen) / (energy + SMALL * self.energy)


@final
@dataclass(frozen=True)
class Training:
    """Options of a training; see :meth:`modalshell.HybridStress.trained`."""

    modes: int | None = None
    """Vectors of the basis; with an ``error`` the most."""
    motions: int = 40
    """Motions to train on."""
    seed: int = 0
    """Of the random loads."""
    error: float | None = None
    """Wanted error on the held-out motions."""

    def __post_init__(self) -> None:
        if self.modes is not None:
            checked_count("modes", self.modes, at_least=2)
        if self.error is not None:
            checked_number("error", self.error, above=0.0)
        checked_count("motions", self.motions, at_least=4)

    @property
    def drawn(self) -> int:
        """Motions on the coarse shell, held-out ones included."""
        return self.motions + max(_HELD_OUT, self.motions // 6)

    @property
    def frames(self) -> int:
        """Their frames."""
        return self.drawn * (LOADED + RELEASED)

    def sizes(self, most: int, usual: Sequence[int]) -> list[int]:
        """Numbers of vectors to try, ascending, each at most ``most``; the ``usual`` ones where none is wanted."""
        if self.error is None:
            tries = [*usual] if self.modes is None else [self.modes]
        else:
            tries = [*GROWING] if self.modes is None else [*(n for n in GROWING if n < self.modes), self.modes]
        return sorted({min(size, most) for size in tries})


def train(coarse: Shell, load: Array, training: Training, on_step: Progress = unheard) -> Trained:
    """Train on motions of ``coarse`` under random loads about ``load`` (k, 3) [N].

    The basis is the first of :meth:`Training.sizes` that meets the ``error`` on the held-out motions, or else the best,
    with a ModalShellWarning; where no error is wanted, the first of 0.03 or nearly the best on average, with one from
    an error of 0.1 on.
    """
    loads = TrainingLoads(coarse, load, _STRESSED)
    if not (load.any() or loads.rigid):
        raise OptionError("the hybrid rung is trained about a load: give one that is not zero")
    at_rest = measures_of(coarse)
    sizes = training.sizes(coarse.free_unknowns.size, at_rest.vectors)
    runs, failed = _random_motions(coarse, load, loads, training, on_step)
    frames, held_out = [frames for _, _, frames in runs[: training.motions]], runs[training.motions :]
    resultant = float(np.linalg.norm(load.sum(axis=0)))
    sizes_of_loads = f"loads of {_SIZES[0]} to {_SIZES[1]} times {resultant:.3g} N"
    if loads.rigid:
        sizes_of_loads = f"loads in flight that turn a vertex by about {loads.size:.2g} rad"
    description = f"{training.motions} motions under {sizes_of_loads}"
    if failed:
        description += f", {failed} more left out, as steps of the coarse shell failed"
    tried: list[Trained] = []
    means: list[float] = []
    turned = at_rest.far_turned(np.concatenate(frames))
    measures = measures_of(coarse, turned) if turned.size else at_rest
    for size in sizes:
        found, reduced = _reduce(measures, loads, frames, size)
        errors, unseen = zip(*(_held_out(found, reduced, measures, loads, *run) for run in held_out), strict=True)
        right = [part for error, part in zip(errors, unseen, strict=True) if error <= _WRONG]
        limit = max(1.0, 2.0 * max(right, default=0.0))
        missed = float(np.quantile(errors, 0.9))
        found = replace(found, turned=turned, held_out_error=missed, strain_limit=limit, description=description)
        tried.append(found)
        means.append(float(np.exp(np.mean(np.log(np.maximum(errors, _LEAST))))))
        if missed <= (training.error or _ENOUGH):
            return tried[-1]
    best, wanted = min(tried, key=lambda one: one.held_out_error), training.error or _WRONG
    if not training.error:
        best = next(one for one, mean in zip(tried, means, strict=True) if mean <= _NEARLY * min(means))
    if best.held_out_error > wanted:
        warnings.warn(
            f"no basis of up to {sizes[-1]} vectors meets an error of {wanted:g}: the best is "
            f"{best.held_out_error:.3g} off; allow more modes, train on more motions, or about a smaller load",
            ModalShellWarning,
            stacklevel=3,
        )
    return best


def _random_motions(
    coarse: Shell, load: Array, loads: TrainingLoads, training: Training, on_step: Progress
) -> tuple[list[tuple[Array, Damping, Array]], int]:
    """Load, damping and frames of the motions to train on, and of those held out after them; and how many failed.

    Others are drawn in place of those few; SolverError where they are more than a tenth.
    """
    rng, model = np.random.default_rng(training.seed), CoarseDiscreteShell(coarse, coarse, integrator=RULE)
    model = model.of_any_minimum()
    runs: list[tuple[Array, Damping, Array]] = []
    failed, total, dt = 0, training.drawn, frame_length(loads.eigenvalues[0])
    while len(runs) < total:
        drawn = loads.drawn(random_load(coarse, load, rng), rng)
        try:
            runs.append(motion_under(model, drawn, random_damping(rng, dt), loads.frames, dt))
        except SolverError:
            failed += 1
            if failed > _MOST_FAILED * total:
                raise
            continue
        on_step(len(runs), total)
    return runs, failed


def _reduce(
    measures: Measures, loads: TrainingLoads, motions: list[Array], modes: int
) -> tuple[Trained, ReducedStress]:
    """Basis, and as many stress modes, of motions (f, k, 3)."""
    coarse, rest = measures.shell, measures.shell.rest_positions
    every = -(-sum(len(frames) for frames in motions) // _MOST_FRAMES)
    frames = np.concatenate(motions)[::every]
    lowest, none = loads.lowest, np.zeros_like(rest)
    leading = np.array([measures.state(rest, mode.reshape(-1, 3)) for mode in lowest.T]).T
    leading[:, np.sum(measures.scaled(leading) ** 2, axis=0) <= _UNSTRETCHED * loads.eigenvalues] = 0.0
    elastic = np.array([measures.state(frame, none) for frame in frames]).T
    moves = (frames - rest).reshape(len(frames), -1).T
    displacements = _evened(moves, np.sqrt(np.repeat(coarse.mass, 3))[:, None] * moves)
    basis = position_modes(coarse, lowest[:, :_LINEAR], displacements, modes, coarse.stiffness())
    stresses = stress_modes(measures, leading, _evened(elastic, measures.scaled(elastic)), modes)
    energy = max(coarse.elastic_energy.energy(frame) for frame in frames[::5])
    return Trained(basis, stresses, 0.0, 1.0, energy, ""), reduce_energy(measures, basis, stresses)


def _evened(snapshots: Array, scaled: Array) -> Array:
    """Snapshots (N, s) over a power of the sizes of their ``scaled`` form (r, s)."""
    sizes = np.linalg.norm(scaled, axis=0)
    return np.asarray(snapshots / np.maximum(sizes, _LEAST * sizes.max()) ** _EVEN)


def random_load(coarse: Shell, load: Array, rng: np.random.Generator) -> Array:
    """Random loads: rotated (half of them by at most 30 degrees), scaled, and a third of them with a point force.

    Directions are drawn along the mesh's own axes.
    """
    given = load.sum(axis=0)
    size = float(np.linalg.norm(given))
    random = rng.standard_normal(3) @ coarse.mesh.axes
    random /= np.linalg.norm(random)
    if size == 0.0:  # a load without a resultant keeps its pattern
        turned = load.copy()
    else:
        axis = given / size
        direction = random
        if rng.random() < 0.5:
            aside = np.cross(axis, random)
            aside /= np.linalg.norm(aside)
            angle = _AROUND * np.sqrt(rng.random())
            direction = np.cos(angle) * axis + np.sin(angle) * aside
        turned = np.linalg.norm(load, axis=1)[:, None] * direction
    total = float(np.linalg.norm(turned, axis=1).sum())
    if rng.random() < 1.0 / 3.0:
        turned[rng.choice(coarse.free)] += _POINT * total * random
    return turned * rng.uniform(*_SIZES)


def frame_length(eigenvalue: float) -> float:
    """Length of a frame [s] of a shell by its lowest eigenvalue [1/s^2]: the same part of its period for all shells."""
    period = 2.0 * np.pi / np.sqrt(max(eigenvalue, np.finfo(np.float64).tiny))
    return float(period / IN_A_PERIOD)


def random_damping(rng: np.random.Generator, dt: float) -> Damping:
    """Damping by the mass and, half of the time, by the stiffness, for frames of ``dt`` [s]."""
    drag, viscosity = rng.uniform(*_DRAG), np.exp(rng.uniform(*np.log(_VISCOSITY)))
    return Damping(drag / dt, viscosity * dt if rng.random() < 0.5 else 0.0)


def motion_under(
    model: CoarseDiscreteShell, load: Array, damping: Damping, parts: FittedFrames, dt: float
) -> tuple[Array, Damping, Array]:
    """The load, the damping and the frames (f, k, 3) of a motion under the load and after it, of free parts in theirs.

    The load turns with the frames of free parts, and leaves them at rest.
    """
    state, frames = model.start_motion(), [np.array(model.coarse.shell.rest_positions)]
    for frame in range(LOADED + RELEASED):
        push = parts.load_in_frames(state.coordinates, load) if frame < LOADED else np.zeros_like(load)
        state, solved = model.step(state, dt, push, damping)
        if not solved or not np.isfinite(state.coordinates).all():
            raise SolverError("a training motion of the coarse shell failed: train about a smaller load")
        frames.append(parts.local(state.coordinates))
    return load, damping, np.array(frames)


@final
class _ReducedSteps(EulerSteps):
    """Steps of implicit Euler of the reduced shell, under a force ``push`` (m,) on its coordinates."""

    def __init__(self, found: Trained, reduced: ReducedStress, coarse: Shell, damping: Damping) -> None:
        self._basis, self._reduced, self._coarse = found.basis, reduced, coarse
        self._factors = damping.mass_factor, damping.stiffness_factor
        self.push, self.energies = np.zeros(found.basis.shape[1]), (0.0, 0.0)
        self._kept = np.full(found.basis.shape[1] + reduced.membrane.modes, np.nan)

    def positions(self, z: Array) -> Array:
        return self._coarse.rest_positions + (self._basis @ z).reshape(-1, 3)

    def solve(self, start: EulerStart) -> tuple[MotionState, bool]:
        begin = reduced_start(self._reduced, start, self._factors[1], self._kept)
        z, solved, *energies, _ = implicit_step(
            self._reduced, begin, self.push, start.dt, *self._factors, STEP_GOAL, self._kept
        )
        self.energies = energies[0], energies[1]
        return start.after(z), bool(solved)

    def turn(self, coordinates: Array, move: Array) -> float:
        moved = (self._basis @ move).reshape(-1, 3)
        return float(largest_turn(self.positions(coordinates), moved, self._coarse.mesh.faces))


def _held_out(
    found: Trained,
    reduced: ReducedStress,
    measures: Measures,
    loads: TrainingLoads,
    load: Array,
    damping: Damping,
    truth: Array,
) -> tuple[float, float]:
    """Error of a motion over its size, 1 where it fails, and its largest share of unseen membrane energy."""
    coarse, parts, dt = measures.shell, loads.frames, frame_length(loads.eigenvalues[0])
    steps, state = _ReducedSteps(found, reduced, coarse, damping), RULE.at_rest(np.zeros(found.basis.shape[1]))
    frames, unseen = [], 0.0
    for frame in range(LOADED + RELEASED):
        felt = parts.load_in_frames(steps.positions(state.coordinates), load).ravel() @ found.basis
        steps.push = felt if frame < LOADED else np.zeros_like(felt)
        state, solved = RULE.march(steps, state, dt)
        if not solved:
            return 1.0, unseen
        frames.append(steps.positions(state.coordinates))
        unseen = max(unseen, found.unseen(measures, frames[-1], *steps.energies))
    mass, exact = coarse.mass[:, None], truth[1:]
    off = np.sum(mass * (np.array(frames) - exact) ** 2)
    return float(np.sqrt(off / np.sum(mass * (exact - coarse.rest_positions) ** 2))), unseen
