"""Abstract base of crowds: modal coordinates, their steps, and levels of detail."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from modalshell.core.checks import (
    as_array,
    checked_count,
    checked_kind,
    checked_number,
    checked_output,
    checked_precision,
    checked_vectors,
    shown,
)
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.crowd.flock import MOST
from modalshell.crowd.free_instances import FreeInstances
from modalshell.crowd.kernels import instances as kernels
from modalshell.integrators.modal.exponential import VIOLENT
from modalshell.integrators.modal.flow import Flow, hardly_followed, turning_flow
from modalshell.models import LinearModal, ModalWarping, RigidShell, RotationStrain
from modalshell.models.base.free_frames import FreeFrames
from modalshell.modes import Basis
from modalshell.shell.damping import Damping

LEVELS = tuple(model.name for model in (RigidShell, LinearModal, ModalWarping))
"""Levels of detail, by their numbers in ``levels`` of a crowd."""
_NO_ROTATION = 1e-4
"""Largest entry of ``R R^T - 1`` of a rotation, in single precision and after some products."""
_BATCH = 256
"""Number of instances per batch in the computation of errors."""


class ShellCrowd(ABC):
    """B instances of one shell in motion; the parameters are those of :class:`modalshell.Crowd`."""

    def __init__(self, basis: Basis, count: int, damping: tuple[float, float], dtype: DTypeLike) -> None:
        self.basis = checked_kind("basis", basis, Basis)
        self.count = checked_count("count", count, at_most=MOST)
        factors = checked_vectors("damping", damping, (2,), OptionError)
        if factors.min() < 0.0:
            raise OptionError(f"damping must be two factors at least 0 (got {shown(damping)})")
        self.damping = Damping(*factors.tolist()).of_modes(basis.eigenvalues)
        self.dtype = checked_precision(dtype)
        self.vertices = len(basis.shell.rest_positions)
        # Modal force of LMA for a unit acceleration along each axis, and the largest motion and turn of each mode.
        modes, turns = (a.reshape(-1, 3, basis.count) for a in (basis.modes, basis.rotations))
        self.modal_weights = np.einsum("n,nik->ik", basis.shell.mass, modes)
        self._reach, self._turn = (np.linalg.norm(a, axis=1).max(axis=0) for a in (modes, turns))
        size = basis.shell.mesh.extent
        self._violent = (VIOLENT * size) ** 2 * float(basis.shell.mass.sum())
        self.coordinates = np.zeros((self.count, basis.count))
        self.rates = np.zeros_like(self.coordinates)
        self.forces = np.full_like(self.coordinates, np.nan)
        frames = FreeFrames.of(basis.shell, basis.modes[:, : basis.rigid_modes])
        self.free = None if frames is None else FreeInstances(frames, float(factors[0]))
        self.turn_back = np.zeros((self.count, 0 if frames is None else len(frames.parts), 3))
        self._kept_flow: tuple[float, Flow] | None = None
        self.levels = np.full(self.count, kernels.WARPED, np.int8)

    def step(self, dt: float, *, felt: ArrayLike = (0.0, 0.0, 0.0), forcing: ArrayLike | None = None) -> None:
        """One step of :class:`modalshell.integrators.modal.Exponential` for every mode of every instance.

        It is that of forces that turn at every level of detail, so that changes of level do not show. Parts without
        supports fly in their frames, see :class:`modalshell.models.base.free_frames.FreeFrames`.

        Parameters
        ----------
        dt : float
            Step [s].
        felt : array_like, shape (3,) or (B, 3)
            Gravity less the acceleration of the instance's frame at the step's end, in that frame, the same for all its
            vertices [m/s^2]. What a turning frame adds (Euler, centrifugal and Coriolis forces) is left out: for a boid
            it is smaller than this by the shell's size over the radius of the turn.
        forcing : array_like, shape (B, m), optional
            Further modal forces at the step's end, such as those of :class:`modalshell.crowd.Flap`.
        """
        dt = checked_number("dt", dt, above=0.0, unit="s")
        self._check_state()
        felt, further = self._per_instance("felt", felt, (3,)), np.zeros_like(self.coordinates)
        if forcing is not None:
            further = checked_vectors("forcing", forcing, self.coordinates.shape, OptionError)

        def force(coordinates: Array, rates: Array, time: float = dt) -> Array:
            return self._forces(coordinates, rates, felt, (time, dt)) + further

        q, v, kept, c = self.coordinates, self.rates, self.forces, self._flow(dt)
        if (unknown := np.isnan(kept)).any():
            kept = np.where(unknown, force(q, v, 0.0), kept)
        ahead, rates = c.e11 * q + c.e12 * v + c.a1 * kept, c.e21 * q + c.e22 * v + c.b1 * kept
        pushed = force(ahead, rates)
        change = pushed - kept
        missed = c.a2 * change
        self.coordinates, self.rates = ahead + missed, rates + c.b2 * change
        violent = np.einsum("bm,bm->b", missed, missed) > self._violent
        if (stiff := hardly_followed(self.basis.eigenvalues, dt)) is not None:
            elastic = pushed[:, self.basis.eigenvalues > 0.0]
            violent |= np.einsum("bm,bm->b", elastic, elastic) > self._violent * stiff**2
        if violent.any():
            pushed = np.where(violent[:, None], force(self.coordinates, self.rates), pushed)
        if self.free is not None:
            for chosen in self._batches():
                before, after = (q[chosen], v[chosen]), (self.coordinates[chosen], self.rates[chosen])
                ends, shapes = (kept[chosen], pushed[chosen]), partial(self._shapes, self._stepped(chosen))
                flown = self.free.flown(before, after, ends, dt, shapes)
                self.coordinates[chosen], self.rates[chosen], self.turn_back[chosen] = flown
        self.forces = pushed

    def _forces(self, coordinates: Array, rates: Array, felt: Array, times: tuple[float, float]) -> Array:
        """Modal forces (B, m) of accelerations (B, 3), a time after the step's begin; both times [s] are given."""
        if self.free is None:
            return self._modal_forces(coordinates, felt, self.levels)
        ahead, found = self.free.frames.predicted(coordinates, self.turn_back, times[0]), np.empty_like(coordinates)
        for chosen in self._batches():
            levels = self._stepped(chosen)
            shapes, push = partial(self._shapes, levels), partial(self._modal_forces, levels=levels)
            found[chosen] = self.free.push(ahead[chosen], rates[chosen], felt[chosen], times[1], shapes, push)
        return found

    def _batches(self) -> list[slice]:
        """Instances whose shapes are looked at together."""
        return [slice(first, first + _BATCH) for first in range(0, self.count, _BATCH)]

    def _stepped(self, chosen: slice) -> NDArray[np.int8]:
        """Levels of detail of some instances' motion: rigid ones are stepped as those of LMA."""
        return np.maximum(self.levels[chosen], np.int8(kernels.LINEAR))

    def _shapes(self, levels: NDArray[np.int8], coordinates: Array) -> Array:
        """Positions (b, n, 3) [m] at coordinates (b, m) in double precision, without frames."""
        out = np.empty((len(levels), self.vertices, 3))
        self._reconstruct(coordinates, levels, None, out)
        return out

    def _flow(self, dt: float) -> Flow:
        """The rule's coefficients, kept from step to step."""
        if self._kept_flow is None or self._kept_flow[0] != dt:
            self._kept_flow = dt, turning_flow(self.basis.eigenvalues, self.damping, dt)
        return self._kept_flow[1]

    def positions(
        self, rotations: ArrayLike | None = None, translations: ArrayLike | None = None, out: NDArray[Any] | None = None
    ) -> NDArray[Any]:
        """Vertex positions (B, n, 3) [m] in the world, each instance at its level of detail.

        Parameters
        ----------
        rotations : array_like, shape (3, 3) or (B, 3, 3), optional
            From the instance's frame to the world's, R R^T = 1 and det R = 1; identity by default.
        translations : array_like, shape (3,) or (B, 3), optional
            Translation of the frame's origin [m]; zero by default.
        out : ndarray, shape (B, n, 3), optional
            C-ordered array of the crowd's precision to write into.
        """
        self._check_state()
        out = checked_output(out, (self.count, self.vertices, 3), self.dtype)
        moved = rotations is not None or translations is not None
        poses = self._poses(rotations, translations) if moved else None
        if self.free is None:
            self._reconstruct(self.coordinates, self.levels, poses, out)
        else:
            self._fly(self.free, poses, out)
        return out

    def _fly(self, free: FreeInstances, poses: tuple[Array, Array] | None, out: NDArray[Any]) -> None:
        """Write positions of instances whose parts are in their frames into ``out``."""
        turns, moves = free.placed(self.coordinates, poses)
        for chosen in self._batches():
            self._reconstruct(free.frames.elastic(self.coordinates[chosen]), self.levels[chosen], None, out[chosen])
            free.place(out[chosen], turns[chosen], moves[chosen])

    def blend_strains(
        self,
        model: RotationStrain,
        shares: ArrayLike,
        out: NDArray[Any],
        rotations: ArrayLike | None = None,
        translations: ArrayLike | None = None,
    ) -> Array:
        """Move positions towards those of RSW, as much as each instance's share says.

        Shares that change smoothly with the distance from the viewer show no jump. Forces stay those of the levels.

        Parameters
        ----------
        model : RotationStrain
            RSW on the crowd's basis.
        shares : array_like, shape (B,)
            From 0, as it is, to 1, RSW.
        out : ndarray, shape (B, n, 3)
            What :meth:`positions` gave with the same ``rotations`` and ``translations``; changed in place [m].

        Returns
        -------
        ndarray, shape (B,)
            Largest distance [m] of a vertex by RSW from where it was; zero without a share.
        """
        if model.basis is not self.basis:
            raise OptionError("the model must have the crowd's own basis")
        self._check_state()
        checked_output(out, (self.count, self.vertices, 3), self.dtype)
        share = checked_vectors("shares", shares, (self.count,), OptionError)
        turns, moves = self._poses(rotations, translations)
        gaps = np.zeros(self.count)
        for b in np.flatnonzero(share):
            shape = self.basis.shell.rest_positions + model.raw_displacement(self.coordinates[b])
            gap = shape @ turns[b].reshape(3, 3).T + moves[b] - out[b]
            gaps[b] = np.linalg.norm(gap, axis=1).max()
            out[b] += share[b] * gap
        return gaps

    def choose_levels(self, distances: ArrayLike, angle: float) -> None:
        """Give every instance the cheapest level that is not seen to be one.

        No vertex is farther from its position by MWTS than ``angle`` in view, so none jumps by more at a switch. With
        ``|u|`` and ``|w|`` at most ``sum_k |q_k|`` times the largest motion and turn of mode k, rigid is off by at most
        ``|u|`` and LMA by at most ``|w| |u| / 2``; as much again where a part's mean is taken away.

        Parameters
        ----------
        distances : array_like, shape (B,)
            From the viewer to the nearest vertex of each instance [m], at least 0.
        angle : float
            Largest angle allowed [rad]; a pixel is one over the focal length in pixels.
        """
        angle = checked_number("angle", angle, above=0.0, unit="rad")
        self._check_state()
        far = checked_vectors("distances", distances, (self.count,), OptionError)
        if far.min() < 0.0:
            raise OptionError(f"distances must be at least 0 [m] (got {far.min():g} of instance {int(far.argmin())})")
        seen = angle * far
        amounts = np.abs(self.coordinates if self.free is None else self.free.frames.elastic(self.coordinates))
        length, turn = amounts @ self._reach, amounts @ self._turn
        linear = 0.5 * turn * length
        if self.free is not None:  # the linear modes' own means are zero
            length, linear = length + linear, 2.0 * linear
        levels = np.where(linear <= seen, kernels.LINEAR, kernels.WARPED)
        self.levels = np.where(length <= seen, kernels.RIGID, levels).astype(np.int8)

    def level_errors(self) -> Array:
        """Largest distance (B,) [m] of a vertex from its position by MWTS, at present coordinates and levels.

        This is the jump of a switch between that level and MWTS.
        """
        self._check_state()
        errors = np.zeros(self.count)
        less = np.flatnonzero(self.levels != kernels.WARPED)
        for part in np.array_split(less, -(-less.size // _BATCH)) if less.size else ():
            shapes = np.empty((2, part.size, self.vertices, 3), self.dtype)
            warped, coordinates = np.full(part.size, kernels.WARPED, np.int8), self.coordinates[part]
            coordinates = coordinates if self.free is None else self.free.frames.elastic(coordinates)
            for shape, levels in zip(shapes, (self.levels[part], warped), strict=True):
                self._reconstruct(coordinates, levels, None, shape)
                if self.free is not None:
                    self.free.centred(shape)
            errors[part] = np.linalg.norm(shapes[1] - shapes[0], axis=2).max(axis=1)
        return errors

    @abstractmethod
    def _modal_forces(self, coordinates: Array, felt: Array, levels: NDArray[np.int8]) -> Array:
        """Modal forces (b, m) of some instances, of accelerations (b, 3), or (b, n, 3) of the vertices one by one."""

    @abstractmethod
    def _reconstruct(
        self, coordinates: Array, levels: NDArray[np.int8], poses: tuple[Array, Array] | None, out: NDArray[Any]
    ) -> None:
        """Write the positions of some instances into ``out``, where they are or at the poses of :meth:`_poses`.

        They are computed in the precision of ``out``, and without frames.
        """

    def _check_state(self) -> None:
        """OptionError where coordinates, rates or levels were replaced by what the kernels would read beyond."""
        shape = self.count, self.basis.count
        for name in ("coordinates", "rates", "forces"):
            values = as_array(name, getattr(self, name), f"numbers of shape {shape}", OptionError)
            if values.shape != shape:
                raise OptionError(f"{name} must have shape {shape} (got {values.shape})")
            setattr(self, name, np.ascontiguousarray(values, dtype=np.float64))
        levels = np.asarray(self.levels)
        if levels.shape != (self.count,) or not np.isin(levels, range(len(LEVELS))).all():
            raise OptionError(f"levels must be {self.count} of 0 to {len(LEVELS) - 1} (got {shown(levels)})")
        self.levels = levels.astype(np.int8, copy=False)

    def _poses(self, rotations: ArrayLike | None, translations: ArrayLike | None) -> tuple[Array, Array]:
        """Rotations (B, 9) and translations (B, 3) of all instances."""
        turns = self._per_instance("rotations", np.eye(3) if rotations is None else rotations, (3, 3))
        if rotations is not None:
            _refuse_others(turns)
        moves = self._per_instance("translations", np.zeros(3) if translations is None else translations, (3,))
        return turns.reshape(-1, 9), moves

    def _per_instance(self, name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
        """``values`` for every instance, (B, *shape), from that or from one for all."""
        if np.shape(values) == shape:
            return np.tile(checked_vectors(name, values, shape, OptionError), (self.count, *(1 for _ in shape)))
        return checked_vectors(name, values, (self.count, *shape), OptionError)


def _refuse_others(turns: Array) -> None:
    """OptionError where one of the matrices (B, 3, 3) is no rotation."""
    first, second, third = np.ascontiguousarray(turns.reshape(-1, 9).T).reshape(3, 3, -1)  # in every frame: quickly
    # The third row is the cross product of unit vectors at right angles.
    ahead, behind = [1, 2, 0], [2, 0, 1]
    cross = first[ahead] * second[behind] - first[behind] * second[ahead]
    products = [(first * first).sum(axis=0) - 1.0, (second * second).sum(axis=0) - 1.0, (first * second).sum(axis=0)]
    off = np.abs(np.concatenate([cross - third, products])).max(axis=0)
    if not off.max(initial=0.0) <= _NO_ROTATION:
        worst = int(off.argmax())
        raise OptionError(
            f"rotations must be rotation matrices, with R R^T = 1 and det R = 1 (got {shown(turns[worst].tolist())} of "
            f"instance {worst}): scale or mirror the mesh instead"
        )
