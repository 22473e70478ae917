"""The model that switches itself: a modal rung as long as its error bar allows, and full rungs elsewhere."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any, final

import numpy as np

from modalshell.core.checks import checked_count, checked_kind, checked_number
from modalshell.core.errors import OptionError
from modalshell.core.outcome import Outcome
from modalshell.core.thread_safety import PerThread
from modalshell.core.typing import Array
from modalshell.integrators.state import MotionState
from modalshell.loads import Loading
from modalshell.models.auto.account import level_note
from modalshell.models.auto.answered import LinearAnswers, solver_at_rest
from modalshell.models.auto.checks import Check, FlownCheck, HeldCheck, free_parts_of
from modalshell.models.auto.levels import CoarseLevel, FullLevel, Level, ModalLevel
from modalshell.models.auto.sampled import SampledCheck, linear_gaps, lowest_gap
from modalshell.models.auto.stepper import AutoStepper
from modalshell.models.base.bars import bar_on_shell
from modalshell.models.base.equilibrium import Equilibrium
from modalshell.models.base.model import Model
from modalshell.models.base.setup import MotionSetup
from modalshell.models.base.stepper import Stepper
from modalshell.models.coarse.coarse_shell import coarse_shell
from modalshell.models.coarse.profile_step import quick_check
from modalshell.models.coarse_discrete_shell import CoarseDiscreteShell
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.models.motion_check import touching_frames
from modalshell.models.rotation_strain import RotationStrain
from modalshell.models.warping import ModalWarping, consistent_warping
from modalshell.modes import model_basis
from modalshell.shell import Shell
from modalshell.shell.damping import Damping
from modalshell.shell.strain_range import ends_strained, strained_beyond
from modalshell.statics.error_bar import ErrorEstimator, QuickCheck
from modalshell.supports.constraints import Constraint


@final
class Auto(Model):
    """A model that switches itself by error bars, so as to stay within a given error of DS.

    It holds several models, its levels, cheapest first: MWTS with the consistent force, RSW, coarse DS where a coarse
    shell is given, and DS. One of them takes each step. Theory 14 gives the reasons for these rules:

    * A motion begins on MWTS. It begins on DS where the modes lack more than half of ``error`` of the linear answer to
      the load, or where MWTS at rest under that load would be wrong. Both are checked again when the load doubles.
    * A modal level is checked as it moves: an error bar of the frame under d'Alembert's load says how far it is from
      DS, and a stability margin whether DS may snap. New states are checked every five steps, and at once when the
      displacement has grown by half. A check that leaves room vouches for states like its own and somewhat larger
      ones; these are checked after 40 steps, 80, 160 and so on, with much room after 40, 160, 640.
    * Where a bar exceeds half of ``error`` the next level takes over, RSW only if it would do better; coarse DS is then
      not used again. Where a margin fails DS does, as cheaper levels may miss a snap or take it under another load.
    * A bar is of one instant. The drift by which small errors of stiffness add up in a vibration is estimated apart,
      and DS continues while that drift is above half of ``error``.
    * DS tries from time to time to return to MWTS. It does if twice in a row the nearest shape of MWTS is within 0.4
      ``error``, at the ends of the swing as well, has about the same energy and an equilibrium near by, and the margin
      exceeds 0.39. So a motion that has snapped stays with DS, although bars alone would accept MWTS there.
    * A level starts from the positions and velocities of the last one; DS first relaxes the stretch of the modes.
    * A start away from rest begins on the first level that comes within 0.4 ``error`` of it and would stay there.

    Checks of shells of up to about a thousand vertices are compiled. One of a larger shell takes as long as
    hundreds of steps of MWTS: with ``coarse`` or ``triangles`` most are made on the coarse shell, as long as one on the
    shell itself agrees within a tenth each thirteenth time. As a level the coarse shell is left out where its linear
    answer misses more than ``error`` of the lowest mode, and with contacts.

    With contacts bars take into account what touches, and modal levels are checked every five steps throughout.
    Impacts that take more than a tenth of the swing (at 5 %) are predicted and computed by DS, as are steps in which
    a collider with friction, restitution or ``push_out`` touches. Frames with an impact are not checked.

    On supports that move all levels step in their frame. A check is valid for accelerations and turns of the supports
    like those of the checked states. Under constraints DS takes all steps: RSW with static shapes took as long.

    Parts without supports fly by MWTS in frames of their own or by DS, and take no contacts; centres and momenta are
    handed on. Displacements are those left after the rigid motion that fits best; a check comes every three steps.

    ``error`` is what is added to the error that steps of ``dt`` cost: a stiff panel in a wind whose modes have few
    steps a period is off whatever the level, and so are the first frames under a load, in which high vibrations begin.

    Statics is that of MWTS corrected by the two steps of its bar where that is at most half of ``error``; else that of
    DS. With contacts MWTS is not corrected; with friction, ``push_out`` or constraints, as of free parts, DS answers.

    Parameters
    ----------
    shell : Shell
        A shell each of whose parts is held by its supports, or has none.
    count : int
        Number of modes, rigid ones not counted.
    error : float
        Share of the largest displacement so far by which positions may be off DS.
    check_every : int, optional
        Steps from one check of a modal rung to the next, in known states, too; by default five in new states alone.
        What happens between two checks is not undone: where loads come suddenly and steps are long, take 1 or 2.
    coarse : Shell, optional
        The same surface with fewer vertices, for a level between; see :func:`modalshell.coarse_shell`.
    triangles : int, optional
        Number of triangles of such a shell to make (extra ``remesh``), in place of ``coarse``.

    Attributes
    ----------
    levels : list of Level
        Cheapest first.
    basis : Basis
        Modes of those of modes, rigid ones with them.

    Raises
    ------
    OptionError
        For numbers out of range, a part that its supports hold in part, or a coarse shell of one with free parts.
    """

    name = "auto"
    follows_snaps = True

    def __init__(
        self,
        shell: Shell,
        count: int = 8,
        *,
        error: float = 0.05,
        check_every: int | None = None,
        coarse: Shell | None = None,
        triangles: int | None = None,
    ) -> None:
        self.shell = checked_kind("shell", shell, Shell)
        self._free = free_parts_of(shell)
        count = checked_count("count", count)
        self.error = checked_number("error", error, at_least=1e-4, at_most=0.3)
        self.check_every = None if check_every is None else checked_count("check_every", check_every)
        if self._free is not None and not (coarse is None and triangles is None):
            raise OptionError(
                f"{self.name} has no level of a coarse shell in free flight: leave out coarse and triangles"
            )
        if coarse is None and triangles is not None:
            coarse = coarse_shell(shell, checked_count("triangles", triangles, at_least=4))
        rigid = 0 if self._free is None else 6 * len(self._free.parts)
        self._at_rest = PerThread(partial(solver_at_rest, shell))
        self.basis = basis = model_basis(shell, min(rigid + count, shell.unknowns.count), at_rest=self._at_rest)
        self.levels: list[Level] = [ModalLevel(basis, consistent_warping, ModalWarping.name)]
        if self._free is None:
            self.levels.append(ModalLevel(basis, RotationStrain, RotationStrain.name))
        if coarse is not None:
            self.levels.append(CoarseLevel(CoarseDiscreteShell(shell, coarse)))
        self.levels.append(FullLevel(DiscreteShell(shell)))
        self.level_names = tuple(level.name for level in self.levels)
        self._about_origin: dict[int, Model] = {}
        self._unpacked: tuple[MotionState | None, tuple[int, MotionState] | None] = (None, None)

    def _solve(self, load: Array, start: Array | None) -> Equilibrium:
        return self._solve_live(Loading(self.shell.rest_positions, load), start)

    def _solve_live(self, loading: Loading, start: Array | None) -> Equilibrium:
        return self._solve_unled(loading, start)

    def _solve_unled(self, loading: Loading, start: Array | None, contacts: Sequence[Any] = ()) -> Equilibrium:
        """The modal answer where its bar is small, corrected where nothing touches; else that of DS, and why."""
        modal, full = self.levels[0].model, self.levels[-1].model
        rough = any(contact.friction or getattr(contact, "push_out", 0.0) for contact in contacts)
        if rough or self._free is not None:  # they have no bar: of free parts nothing says where these rest
            return full.solved(loading, start, contacts)
        found = modal.solved(loading, start, contacts)
        bar = bar_on_shell(self.shell, found.positions, loading, contacts)
        if bar.valid and found.converged and bar.displacement <= 0.5 * self.error:
            x, how = (found.positions, ": it is") if contacts else (bar.corrected, ", corrected: it was")
            told = replace(found, positions=x, outcome=Outcome.CONVERGED, message=f"{modal.name}{how} {bar}")
            return replace(told, stable=True, coordinates=None)
        exact = full.solved(loading, bar.corrected if bar.valid else start, contacts)
        reason = f"{full.name}, as {modal.name} was {bar}" if not bar.message else f"{full.name}: {bar}"
        return replace(exact, message="; ".join(part for part in (exact.message, reason) if part))

    def _solve_constrained(
        self, loading: Loading, start: Array | None, constraints: Sequence[Constraint]
    ) -> Equilibrium:
        """That of DS."""
        return self.levels[-1].model._solve_constrained(loading, start, constraints)

    def _solve_touching(
        self, loading: Loading, start: Array | None, contacts: Sequence[Any], constraints: Sequence[Constraint]
    ) -> Equilibrium:
        """As without contacts; under constraints that of DS."""
        if constraints:
            return self.levels[-1].model._solve_touching(loading, start, contacts, constraints)
        return self._solve_unled(loading, start, contacts)

    def rigid_load(self, load: Array) -> float:
        """That of DS: the share of a load (n, 3) along free translations; free turns can find a balance."""
        return self.levels[-1].model.rigid_load(load)

    def no_contacts(self) -> OptionError:
        """The error of motions of free parts, which take no contacts."""
        return OptionError(f"{self.name} in free flight takes no contacts: hold some vertices, or take MWTS or DS")

    def tangent_eigenvalue(self, answer: Equilibrium, load: Array) -> float | None:
        """That of DS at the answer."""
        return self.levels[-1].model.tangent_eigenvalue(answer, load)

    def check(self, setup: MotionSetup) -> Check:
        """What sees a motion: of free parts their shapes alone."""
        judged = () if setup.constraints else setup.contacts  # under constraints DS takes all steps
        touching, supports = touching_frames(self, judged, setup.dt, setup.supports), setup.supports
        if touching is not None:
            return HeldCheck(self.shell, setup.loading, setup.damping, None, touching=touching, supports=supports)
        if self._free is None:
            estimator, coarse = ErrorEstimator(self.shell, self._quick_check, early=True), self._checked_on
            sampled = None if coarse is None else SampledCheck(*coarse)
            return HeldCheck(self.shell, setup.loading, setup.damping, estimator, sampled, supports=supports)
        return FlownCheck(self.shell, self._free, setup.loading, setup.damping)

    def stepper(self, setup: MotionSetup) -> Stepper:
        """What takes the steps of one motion."""
        return AutoStepper(self, self.levels, setup)

    @property
    def full(self) -> Model:
        """The level that all others are measured by, DS."""
        return self.levels[-1].model

    @property
    def count(self) -> int:
        """Number of modes, rigid ones with them."""
        return self.basis.count

    @property
    def highest(self) -> float:
        """Largest angular frequency [rad/s] of the modes."""
        return float(np.sqrt(self.basis.eigenvalues[-1]))

    @cached_property
    def periods(self) -> Array:
        """Periods of the modes (m,) over 2 pi [s]."""
        return np.asarray(1.0 / np.sqrt(np.maximum(self.basis.eigenvalues, 1e-300)))

    def answered_by_modes(self, force: Array) -> Array:
        """Coordinates (m,) of the modes' linear answer to forces (n, 3) [N]."""
        return np.asarray(self.basis.modes.T @ force.ravel()) * self.periods**2

    @cached_property
    def answers(self) -> LinearAnswers:
        """Linear answers to loads, of the shell and of its modes."""
        return LinearAnswers(self.basis, self._at_rest)

    @cached_property
    def _quick_check(self) -> QuickCheck | None:
        return quick_check(self.shell, early=True)

    @cached_property
    def _gaps(self) -> tuple[CoarseDiscreteShell, Array] | None:
        """The model of a coarse shell, if there is one, and what its linear answers lack (k, 3, m)."""
        found = [level.model for level in self.levels if isinstance(level, CoarseLevel)]
        return (found[0], linear_gaps(found[0], self.basis)) if found else None

    @property
    def coarse_levels(self) -> tuple[int, ...]:
        """Numbers of the levels on a coarse shell."""
        return tuple(k for k, level in enumerate(self.levels) if isinstance(level, CoarseLevel))

    @cached_property
    def unfit(self) -> tuple[int, ...]:
        """Levels that miss more than ``error`` of the lowest mode where displacements are small."""
        if self._gaps is None or lowest_gap(*self._gaps, self.basis) <= self.error:
            return ()
        return self.coarse_levels

    @cached_property
    def _checked_on(self) -> tuple[CoarseDiscreteShell, Array, QuickCheck | None] | None:
        """The coarse shell of a large one that modal states are checked on, what it lacks, and its compiled check."""
        if self._gaps is None or self._quick_check is not None:
            return None
        return *self._gaps, quick_check(self._gaps[0].coarse.shell, early=True)

    @cached_property
    def _templates(self) -> list[MotionState]:
        modal = self.levels[0].model.start_motion()  # that of all levels of modes
        return [modal if level.quadratic else level.model.start_motion() for level in self.levels]

    @cached_property
    def room(self) -> int:
        """Numbers of the largest state of a level."""
        return max(sum(part.size for part in template.arrays().values()) for template in self._templates)

    def _centred(self, level: int) -> Model:
        """A level's model about the origin, where its stepper's states are."""
        if level not in self._about_origin:
            self._about_origin[level] = self.levels[level].model.centred()[0]
        return self._about_origin[level]

    def start_motion(self, positions: Array | None = None) -> MotionState:
        """State at rest: on the first level in the rest shape, at other positions on the most exact one."""
        level = 0 if positions is None else len(self.levels) - 1
        model = self.levels[level].model
        inner = self._templates[level] if positions is None else model.start_motion(positions)
        return self.on_level(level, inner, model.positions(inner))

    def packed(self, level: int, inner: MotionState) -> Array:
        """A level's own state in one array."""
        return self.levels[level].packed(self._templates[level], inner, self.room)

    def of_states(self, templates: Sequence[MotionState]) -> Auto:
        """The same model for motions in which the levels' own states are like ``templates``."""
        model = copy.copy(self)
        model._templates, model._unpacked = list(templates), (None, None)
        model.__dict__.pop("room", None)
        return model

    def on_level(self, level: int, inner: MotionState, x: Array) -> MotionState:
        """State at rest of a level's own one, at x (n, 3) [m] in the world."""
        memory = AutoStepper.memory(x, len(self.levels))
        memory["level"][0] = level
        memory["inner"] = self.packed(level, inner)
        return MotionState(x, np.zeros_like(x), memory)

    def inner(self, state: MotionState) -> tuple[int, MotionState]:
        """The level of a state, and that level's own state."""
        known, found = self._unpacked
        if known is not state or found is None:
            level = int(state.memory["level"][0])
            found = level, self.levels[level].unpacked(self._templates[level], state.arrays()["inner"])
            self._unpacked = state, found  # energies ask for it, too
        return found

    def keep(self, state: MotionState, level: int, inner: MotionState) -> None:
        """Remember what :meth:`inner` finds of a state."""
        self._unpacked = state, (level, inner)

    def step(
        self, state: MotionState, dt: float, load: Array, damping: Damping, held: Array | None = None
    ) -> tuple[MotionState, bool]:
        """One step under a load that stays."""
        setup = MotionSetup(dt, damping, Loading(self.shell.rest_positions, load))
        return self.stepper(setup).advance(0.0, dt, state, load)

    def positions(self, state: MotionState) -> Array:
        """Vertex positions (n, 3) [m]: the coordinates themselves, copied."""
        return state.coordinates.copy()

    def velocities(self, state: MotionState, own: Array, lead: float) -> Array:
        """Velocities (n, 3) [m/s]: the rates themselves."""
        return state.rates

    def elastic_energy(self, state: MotionState) -> float:
        """Elastic energy [J] of the level's own state."""
        level, inner = self.inner(state)
        return self._centred(level).elastic_energy(inner)

    def kinetic_energy(self, state: MotionState) -> float:
        """Kinetic energy [J] of the level's own state."""
        level, inner = self.inner(state)
        return self._centred(level).kinetic_energy(inner)

    def fault(self, state: MotionState, positions: Array) -> Outcome | None:
        """That of the level."""
        level, inner = self.inner(state)
        return self._centred(level).fault(inner, positions)

    def account(self, state: MotionState) -> str:
        """How many steps each level took, and why it was left; and where the motion ends with large strains."""
        strained = ends_strained(self.shell, self.positions(state))
        return "; ".join(filter(None, [level_note(state, self.level_names), strained]))

    def beyond_range(self, answer: Equilibrium, constraints: Sequence[Constraint]) -> str:
        """What is said of an answer with large membrane strains."""
        return strained_beyond(self.shell, answer.positions)

    def mean_growth(self, state: MotionState, stiffness: float, damp: float, dt: float) -> complex:
        """What steps multiply an oscillation by, the geometric mean of those of all levels so far."""
        taken = [(level.model, count) for level, count in zip(self.levels, state.memory["steps"], strict=True) if count]
        logs = [count * np.log(model.growth(stiffness, damp, dt)) for model, count in taken]
        return complex(np.exp(sum(logs) / sum(count for _, count in taken))) if taken else complex(np.nan)

    def check_step(self, dt: float, damping: Damping) -> None:
        """Refuse what any level refuses."""
        for level in self.levels:
            level.check_step(dt, damping)
