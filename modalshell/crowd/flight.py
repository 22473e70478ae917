"""Birds in flight: boids lead, the shells that they carry bend."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.checks import checked_count, checked_kind, checked_vectors
from modalshell.crowd.flap import Flap
from modalshell.crowd.flock import Flock
from modalshell.crowd.shell_crowd import ShellCrowd
from modalshell.errors import OptionError
from modalshell.typing import Array

_FLOCK = ("positions", "directions", "velocities", "accelerations")
_CROWD = ("coordinates", "rates", "levels")


@final
class Flight:
    """A flock whose boids each carry an instance of a crowd, banked, accelerated and flapping as they fly.

    Parameters
    ----------
    flock : Flock
        The boids.
    crowd : Crowd or DeviceCrowd
        As many instances; each moves in the frame of its boid.
    flap : Flap
        Their wing beats.
    gravity : array_like, shape (3,)
        Acceleration of gravity [m/s^2], not zero.
    target : callable, optional
        Where the flock is drawn (3,) [m] at a time [s].
    seed : int
        Of the phases of the wing beats.

    Raises
    ------
    OptionError
        If the crowd is of another size, or gravity is zero.
    """

    def __init__(
        self,
        flock: Flock,
        crowd: ShellCrowd,
        flap: Flap,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        target: Callable[[float], Array] | None = None,
        seed: int = 0,
    ) -> None:
        checked_kind("flock", flock, Flock)
        checked_kind("crowd", crowd, ShellCrowd)  # type: ignore[type-abstract]
        checked_kind("flap", flap, Flap)
        seed = checked_count("seed", seed, at_least=0)
        if crowd.count != len(flock.positions):
            raise OptionError(f"{len(flock.positions)} boids need as many instances (got {crowd.count})")
        self.gravity = checked_vectors("gravity", gravity, (3,), OptionError)
        if not self.gravity.any():
            raise OptionError("gravity must not be zero: it says where up is")
        self.flock, self.crowd, self.flap, self.target = flock, crowd, flap, target
        self.phases = np.random.default_rng([seed, 2]).uniform(0.0, 2.0 * np.pi, crowd.count)

    @property
    def frames(self) -> Array:
        """Rotations (B, 3, 3) of the birds' frames."""
        return self.flock.frames(self.gravity)

    def advance(self, dt: float) -> None:
        """One step of boids and shells over ``dt`` [s]."""
        if self.target is not None:
            self.flock.target = self.target(self.flock.time)
        self.flock.step(dt)
        felt = np.einsum("bij,bi->bj", self.frames, self.gravity - self.flock.accelerations)
        strength = float(np.linalg.norm(self.gravity))
        forcing = self.flap.forcing(self.flock.time, self.phases, felt, strength)
        self.crowd.step(dt, felt=felt, forcing=forcing)

    def snapshot(self) -> dict[str, NDArray[np.generic]]:
        """All that :meth:`restore` needs to go on from here to the last bit."""
        found = {name: getattr(self.flock, name).copy() for name in _FLOCK}
        found |= {name: getattr(self.crowd, name).copy() for name in _CROWD}
        return found | {"time": np.array(self.flock.time)}

    def restore(self, snapshot: dict[str, NDArray[np.generic]]) -> None:
        """Go back to a snapshot."""
        for owner, names in ((self.flock, _FLOCK), (self.crowd, _CROWD)):
            for name in names:
                setattr(owner, name, np.array(snapshot[name]))
        self.flock.time = float(np.asarray(snapshot["time"]))
