"""Equilibrium paths of models: limit points, bifurcations, stability, and secondary branches."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple, cast, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import (
    LARGEST,
    checked_callback,
    checked_choice,
    checked_count,
    checked_kind,
    checked_number,
    checked_vectors,
    shown,
)
from modalshell.core.errors import LoadError, OptionError, SolverError
from modalshell.core.outcome import Outcome
from modalshell.core.short_repr import short_repr
from modalshell.core.timings import Stopwatch
from modalshell.core.typing import Array, Mask, Progress, Vector
from modalshell.loads import Load
from modalshell.mesh import TriangleMesh
from modalshell.mesh.selection import Selection, selected
from modalshell.models.base.model import RIGID_LOAD, Model
from modalshell.models.base.setup import given_contacts
from modalshell.models.discrete_shell import DiscreteShell
from modalshell.modes.rigid import rigid_motions
from modalshell.shell import Shell
from modalshell.statics.bifurcation import BIFURCATION, PathEvent, Range, Trace, follow, switched
from modalshell.statics.continuation import equilibrium
from modalshell.statics.dense import EnergyFunction
from modalshell.statics.path import CONTROLS, Control, Followable, PathPoint, Tracer
from modalshell.statics.potential import Potential

if TYPE_CHECKING:
    from modalshell.contact import Contact  # paths without contacts do not import it

_BEYOND = 2.0
"""Multiples of the requested range of load factors within which a path is followed."""
_LITTLE = 1.0, 1e-2, 1e-4
"""Shares of the first step's load under which a shell that its own stresses buckle is let go."""


@final
@short_repr
@dataclass(frozen=True)
class EquilibriumPath:
    """Equilibria under a load that grows in proportion, in order along their path.

    Attributes
    ----------
    factors : ndarray, shape (k,)
        Shares of the load.
    positions : ndarray, shape (k, n, 3)
        Vertex positions [m]; unknowns (k, N) of an :class:`~modalshell.EnergyFunction`.
    stable : ndarray of bool, shape (k,)
        Whether the Hessian of the potential is positive definite.
    unstable_directions : ndarray of int, shape (k,)
        Number of its negative eigenvalues.
    displacements : ndarray, shape (k,)
        The watched displacement [m].
    events : list of PathEvent
        ``(kind, index, factor)`` of limit points and bifurcations; they are points of the path.
    residuals : ndarray, shape (k,)
        Out-of-balance forces over the largest load so far.
    outcome : Outcome
        ``Outcome.CONVERGED`` if the path reached the requested load factor.
    message : str
        Why it did not, a sentence.
    branches : list of EquilibriumPath
        Paths from bifurcations of this one, two for each requested one that crosses.
    parent : int or None
        Of a branch: the point of the first path that it leaves.
    iterations : int
        Factorisations.
    seconds : float
        Wall time, without that of the branches.
    mesh : TriangleMesh or None
        Of the shell.
    contact_forces : ndarray, shape (k, n, 3)
        Force of the contacts on every vertex [N]; empty without contacts, as the next one.
    in_contact : ndarray of bool, shape (k, n)
        Vertices that touch a collider.
    """

    factors: Array
    positions: Array = field(repr=False)
    stable: Mask = field(repr=False)
    unstable_directions: NDArray[np.int64] = field(repr=False)
    displacements: Array = field(repr=False)
    events: list[PathEvent]
    residuals: Array = field(repr=False)
    outcome: Outcome
    message: str
    branches: list[EquilibriumPath] = field(default_factory=list)
    parent: int | None = None
    iterations: int = 0
    seconds: float = 0.0
    mesh: TriangleMesh | None = field(default=None, repr=False)
    contact_forces: Array = field(default_factory=lambda: np.empty((0, 0, 3)), repr=False)
    in_contact: Mask = field(default_factory=lambda: np.empty((0, 0), dtype=bool), repr=False)

    @classmethod
    def _of(
        cls, trace: Trace, followed: _Followed, iterations: int, seconds: float, parent: int | None = None
    ) -> EquilibriumPath:
        """The path of a trace."""
        positions = np.array([followed.model.positions(point.x) for point in trace.points])
        moves = positions - followed.model.positions(followed.model.problem.origin)
        negative = np.array([point.negative for point in trace.points])
        return cls(
            factors=np.array([point.factor for point in trace.points]),
            positions=positions,
            stable=negative == 0,
            unstable_directions=negative,
            displacements=np.tensordot(moves, followed.weights, followed.weights.ndim),
            events=trace.events,
            residuals=np.array([point.residual for point in trace.points]),
            outcome=Outcome.CONVERGED if trace.complete else Outcome.NOT_CONVERGED,
            message=trace.message,
            parent=parent,
            iterations=iterations,
            seconds=seconds,
            mesh=followed.mesh,
        )

    @property
    def converged(self) -> bool:
        """Whether the path reached the requested load factor."""
        return self.outcome is Outcome.CONVERGED

    def crossings(self, factor: float) -> Array:
        """Watched displacements [m] of all equilibria of this path at a load factor, in order, linear in between."""
        off = self.factors - checked_number("factor", factor)
        after = np.flatnonzero((off[:-1] * off[1:] < 0.0) | (off[1:] == 0.0)) + 1
        weight = off[after - 1] / (off[after - 1] - off[after])
        between = self.displacements[after - 1] + weight * (self.displacements[after] - self.displacements[after - 1])
        return np.concatenate([self.displacements[:1][off[:1] == 0.0], between])


def equilibrium_path(
    model: Model | Shell | EnergyFunction,
    *,
    gravity: ArrayLike | None = None,
    force: ArrayLike | None = None,
    loads: Sequence[Load] | None = None,
    until: float = 1.0,
    begin: float = 0.0,
    start: ArrayLike | None = None,
    control: Control = "arc",
    watch: tuple[Selection, Vector] | ArrayLike | None = None,
    steps: int = 20,
    points: int = 400,
    branches: int = 0,
    contacts: Sequence[Contact] | None = None,
    on_step: Progress | None = None,
) -> EquilibriumPath:
    """Follow the equilibria of a shell under a load that grows in proportion, stable or not.

    Steps are predicted along the tangent and corrected by mixed Newton in a plane across it [keller1977; riks1979], so
    that the path goes on through limit points, where the shell would snap. At each point the Hessian's negative
    eigenvalues are counted: where the load factor turns back there is a limit point, where their number changes
    otherwise a bifurcation. Both are located, and stand in the path.

    Parameters
    ----------
    model : Model, Shell or EnergyFunction
        DS, of either energy, RSW, MD-ROM or another model with a potential; a shell stands for its DS.
    gravity, force, loads : optional
        The load at a factor of 1, as in :meth:`Model.equilibrium`; ``force`` (N,) of an EnergyFunction.
    until : float
        Load factor at which the path ends.
    begin : float
        Load factor at which it begins.
    start : array_like, shape (n, 3), optional
        Positions [m] near those at the beginning; by default those under a load that grows from zero, of a shell that
        its own stresses buckle those to which it has buckled, on the side to which the load pushes.
    control : {"arc", "load", "displacement"}
        What the steps are measured by. Load control ends at the first limit point, displacement control where the
        watched displacement turns back.
    watch : (selection, direction), optional
        The displacement to report: the mean of these vertices' along a direction. Without it the mean along the
        load, weighted by its forces. Weights (N,) of the unknowns of an EnergyFunction.
    steps : int
        Steps at least from ``begin`` to ``until``.
    points : int
        Points at most of a path.
    branches : int
        Number of the path's bifurcations, from its beginning, whose other branch is followed too, to both sides.
    contacts : sequence of Contact, optional
        Colliders without friction, as they are at time 0, for DS with ``control="load"``: from each point to the next
        what touches may change. Stability is that of the motions that keep the gaps; where it changes the point is a
        bifurcation. The path ends where no equilibrium is near under more load.
    on_step : callable, optional
        Called with the number of points so far and the most.

    Returns
    -------
    EquilibriumPath
        Does not raise for a path that ends early: see ``outcome`` and ``message``.

    Raises
    ------
    LoadError
        For loads or positions of the wrong shape or not finite, or a load that moves nothing.
    OptionError
        For a model without a potential, supports that leave the shell free, options out of range, or contacts of held
        vertices alone, or with another control than the load, branches, friction, or models not of all vertices.
    SolverError
        If there is no equilibrium to begin from.

    Examples
    --------
    >>> import modalshell as ms
    >>> mesh = ms.flat_beam(cells=(12, 2))
    >>> shell = ms.Shell(mesh, ms.Material(20.0, 20.0, 0.05, 0.2), mesh.vertices[:, 0] < 0.1)
    >>> path = ms.equilibrium_path(shell, gravity=(0, 0, -2), until=1.0)
    >>> path.converged, bool(path.stable.all()), path.events
    (True, True, [])
    """
    watch_time = Stopwatch()
    on_step = checked_callback("on_step", on_step)
    until, begin = checked_number("until", until), checked_number("begin", begin)
    if until == begin:
        raise OptionError(f"until must differ from begin (got {until:g} for both)")
    if abs(until - begin) < 1.0 / LARGEST:
        raise OptionError(
            f"until must differ from begin by at least {1.0 / LARGEST:g} (got {until:g} and {begin:g}): scale the load"
        )
    checked_choice("control", control, CONTROLS)
    steps, points = checked_count("steps", steps), checked_count("points", points, at_least=2)
    branches = checked_count("branches", branches, at_least=0)
    followed = _followed(model, gravity, force, loads, watch, start)
    problem = followed.model.problem
    if not problem.measure(problem.push_at(problem.origin)) > 0.0:
        raise LoadError("no load moves the shell, so there is no path to follow: give gravity, force or loads")
    if contacts:
        if control != "load" or branches:
            raise OptionError(
                f'with contacts a path is followed by load steps, without branches (got control="{control}" and '
                f'branches={branches}): give control="load"'
            )
        return _with_contacts(followed, contacts, (begin, until), (steps, points), on_step)
    reach, longest = _BEYOND * abs(until - begin), abs(until - begin) / steps
    span = Range(until, begin - reach, begin + abs(until - begin) + reach, points)

    def tracer() -> Tracer[object]:
        return Tracer(problem, longest, control, lambda x: followed.model.generalised_force(x, followed.weights))

    with np.errstate(over="ignore", invalid="ignore"):
        walker = tracer()
        trace = follow(walker, _first(walker, followed, begin, np.sign(until - begin)), span, on_point=on_step)
        path = EquilibriumPath._of(trace, followed, walker.iterations, watch_time())
        crossings = [event for event in trace.events if event.kind == BIFURCATION]
        ends = [trace.points[event.index] for event in crossings]
        for event, side in itertools.product(crossings[:branches], (1.0, -1.0)):
            walker = tracer()
            walker.shortened()
            begun = switched(walker, trace.points[event.index], side)
            if begun is not None:
                branch = follow(walker, begun, span, on_point=on_step, ends=ends)
                path.branches.append(
                    EquilibriumPath._of(branch, followed, walker.iterations, watch_time(), event.index)
                )
    return path


def _first(walker: Tracer[object], followed: _Followed, begin: float, sense: float) -> PathPoint:
    """The point at which a path begins."""
    problem = followed.model.problem
    if followed.first is not None:
        return walker.first(followed.first, begin, sense)
    if begin == 0.0:
        with contextlib.suppress(SolverError):  # a shell under much stress is far from its equilibrium at rest
            if (at_rest := walker.first(problem.origin, begin, sense)).negative == 0:
                return at_rest
            return _buckled(walker, at_rest, sense)
    return walker.first(equilibrium(problem.loaded(begin), None).point, begin, sense)


def _buckled(walker: Tracer[object], at_rest: PathPoint, sense: float) -> PathPoint:
    """The point without load to which a shell has buckled by its own stresses, on the side to which the load pushes.

    The point ``at_rest``, which is unstable, where no stable one is found.
    """
    problem, best, gone = walker.problem, at_rest, 0.0
    push = sense * problem.push_at(problem.origin)
    for share in _LITTLE:
        start = equilibrium(problem.loaded(sense * share * walker.longest), None).point
        for _ in range(2):
            with contextlib.suppress(SolverError):
                point = walker.first(start, 0.0, sense)
                work = float(push @ problem.difference(point.x, problem.origin))
                if point.negative < best.negative or (point.negative == best.negative and gone < 0.0 < work):
                    best, gone = point, work
            start = problem.moved(problem.origin, -problem.difference(start, problem.origin))[0]  # the other side
        if best.negative == 0:
            break
    return best


def _with_contacts(
    followed: _Followed,
    contacts: Sequence[Contact],
    ends: tuple[float, float],
    counts: tuple[int, int],
    on_step: Progress,
) -> EquilibriumPath:
    """The path between two load factors with contacts; ``counts`` are the steps at least, and the points at most."""
    from modalshell.contact.path import LoadSteps  # not without contacts
    from modalshell.contact.touching import Touching, checked_contacts, refuse_friction, touched_frame

    watch_time, (begin, until), model = Stopwatch(), ends, followed.model
    problem = model.problem
    if not isinstance(problem, Potential):
        raise OptionError("paths with contacts are followed by models of all vertices alone: take DS")
    given = checked_contacts(given_contacts(contacts, problem.shell))
    refuse_friction(given, "paths")
    touching = Touching(given, problem.shell, model.positions(problem.origin)[0] - problem.origin[0])
    walker = LoadSteps(problem, touching, abs(until - begin) / counts[0])
    with np.errstate(over="ignore", invalid="ignore"):
        first = walker.first(problem.origin if followed.first is None else followed.first, begin)
        trace, rests = walker.follow(first, until, counts[1], on_step)
    path = EquilibriumPath._of(trace, followed, walker.iterations, watch_time())
    touched = [touched_frame(touching, rest.point, rest.pushes) for rest in rests]
    forces, touches = np.array([one.forces for one in touched]), np.array([one.touches for one in touched])
    return replace(path, contact_forces=forces, in_contact=touches)


class _Followed(NamedTuple):
    """A model under its load, the weights of the watched displacement, the mesh, and the unknowns to begin near."""

    model: Followable
    weights: Array
    mesh: TriangleMesh | None
    first: Array | None


def _followed(
    model: Model | Shell | EnergyFunction,
    gravity: ArrayLike | None,
    force: ArrayLike | None,
    loads: Sequence[Load] | None,
    watch: tuple[Selection, Vector] | ArrayLike | None,
    start: ArrayLike | None,
) -> _Followed:
    """What is followed, checked."""
    if isinstance(model, EnergyFunction):
        if gravity is not None or loads is not None:
            raise OptionError("an EnergyFunction knows no mass and no surface: give its load by force=")
        shape = model.rest.shape
        load = np.zeros(shape) if force is None else checked_vectors("force", force, shape)
        weights = load / max(float(np.abs(load).sum()), 1e-300)
        if watch is not None:
            weights = checked_vectors("watch", watch, shape, OptionError)
        first = None if start is None else checked_vectors("start", start, shape)
        same = Followable(model.problem(load), lambda x: x, lambda x: x, lambda _, force: force)
        return _Followed(same, weights, None, first)
    chosen: Model = checked_kind(
        "model",
        DiscreteShell(model) if isinstance(model, Shell) else model,
        Model,  # type: ignore[type-abstract]
    )
    shell = chosen.shell
    loading = shell.loading(gravity, force, loads)
    if loading.live:
        raise OptionError(
            "a path is followed under dead loads that grow in proportion (got one that follows the shell or the time): "
            "take equilibrium at several sizes of the load, each from the one before, or Pressure(follower=False)"
        )
    load = loading.dead
    if chosen.rigid_load(load) > RIGID_LOAD or rigid_motions(shell).shape[1]:
        raise OptionError("a path needs a shell that its supports hold: clamp some vertices")
    begin = None if start is None else shell.checked_positions(start)
    followed = chosen.followable(load)
    weights = _watched(shell, load, watch)
    return _Followed(followed, weights, shell.mesh, None if begin is None else followed.unknowns(begin))


def _watched(shell: Shell, load: Array, watch: tuple[Selection, Vector] | ArrayLike | None) -> Array:
    """Weights (n, 3) of the watched displacement."""
    if watch is None:
        free = np.asarray(shell.unknowns.prolong(shell.unknowns.values(load.ravel())).reshape(-1, 3))
        return free / max(float(np.linalg.norm(free, axis=1).sum()), 1e-300)
    if not isinstance(watch, tuple | list) or len(watch) != 2:
        raise OptionError(f"watch must be a selection of vertices and a direction (got {shown(watch)})")
    chosen, direction = cast("tuple[Selection, Vector]", watch)
    along = checked_vectors("direction", direction, (3,), OptionError)
    if not along.any():
        raise OptionError("direction must not be zero (got that of watch)")
    mask = selected("watch", chosen, shell.mesh)
    return np.where(mask[:, None], along / np.linalg.norm(along), 0.0) / mask.sum()
