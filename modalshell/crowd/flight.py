"""Flight: a flock of boids whose shells bend with their motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from modalshell.core.checks import checked_count, checked_kind, checked_number, checked_vectors
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.core.units import SI, UnitSystem
from modalshell.crowd.flap import Flap
from modalshell.crowd.flock import Flock
from modalshell.crowd.shell_crowd import ShellCrowd
from modalshell.integrators.modal.flow import turning_flow
from modalshell.page import Page
from modalshell.page.html import encoded, filled_page, modal_data

_FLOCK = ("positions", "directions", "velocities", "accelerations")
_SAMPLE = 1.0 / 30.0
"""Time [s] between the samples of a moving target on a page."""
_CROWD = ("coordinates", "rates", "forces", "levels")
_MOST_BIRDS = 20_000
"""Birds of a page: each looks at all the others."""


@final
class Flight:
    """A flock whose boids each carry an instance of a crowd, banked, accelerated and flapping as they fly.

    Parameters
    ----------
    flock : Flock
        The boids.
    crowd : Crowd or DeviceCrowd
        One instance per boid; each moves in the frame of its boid.
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

    def count_from(self, time: float) -> None:
        """Let a ``time`` [s] of the flight be 0: its noise and wing beats continue, and its target begins."""
        self.flock.noise_offsets = self.flock.noise_offsets + self.flock.noise_frequency * time
        self.phases = self.phases + 2.0 * np.pi * self.flap.frequency * time
        self.flock.time = 0.0

    def page(
        self,
        *,
        camera: tuple[ArrayLike, ArrayLike],
        dt: float = 1.0 / 60.0,
        duration: float = 10.0,
        title: str = "flock",
        units: UnitSystem = SI,
    ) -> Page:
        """A self-contained web page that continues the flight from here on the browser's GPU, in single precision.

        Modal forces are those of LMA, ``Phi^T f`` in each bird's frame; positions are those of MWTS.

        Parameters
        ----------
        camera : (array_like, array_like)
            Its position and what it looks at, (3,) each [m].
        dt : float
            Time step [s].
        duration : float
            Time [s] after which a moving target starts again.
        title : str
            Headline of the page.
        units : UnitSystem
            Units of the flock's numbers, ``dt`` and ``duration`` with them; the page plays at real speed.

        Raises
        ------
        OptionError
            For more birds or modes than a browser takes, or a camera in its target.
        """
        flock, crowd, flap = self.flock, self.crowd, self.flap
        dt, duration = checked_number("dt", dt, above=0.0), checked_number("duration", duration, above=0.0)
        eye, target = (checked_vectors("camera", part, (3,), OptionError) for part in camera)
        back = eye - target
        distance = float(np.linalg.norm(back))
        if not distance > 0.0:
            raise OptionError("the camera must be away from what it looks at")
        if crowd.count > _MOST_BIRDS:
            raise OptionError(f"a page takes at most {_MOST_BIRDS:,} birds (got {crowd.count:,})")
        sample = _SAMPLE / units.seconds
        basis = crowd.basis
        rest, faces = basis.shell.rest_positions, basis.shell.mesh.faces
        data = {
            "birds": crowd.count,
            **modal_data(rest, faces, basis.modes, basis.rotations),
            "positions": encoded(flock.positions.astype(np.float32)),
            "directions": encoded(flock.directions.astype(np.float32)),
            "own": encoded(np.column_stack([flock.noise_offsets, self.phases]).astype(np.float32)),
            "size": distance,
            "distance": distance,
            "centre": target.tolist(),
            "azimuth": float(np.arctan2(back[1], back[0])),
            "elevation": float(np.arcsin(back[2] / distance)),
            "dt": dt,
            "reach": flock.neighbour_distance,
            "cosine": math.cos(0.5 * flock.field_of_view),
            "turning": flock.rotation_speed,
            "speed": flock.speed,
            "variation": flock.speed_variation,
            "frequency": flock.noise_frequency,
            "weights": flock.weights.tolist(),
            "targetWeight": flock.target_weight,
            "home": flock.flock_position.tolist(),
            "target": self._targets(duration, sample),
            "sample": sample,
            "second": 1.0 / units.seconds,
            "unit": units.time,
            "repeat": None if self.target is None else duration,
            "bounds": None if flock.bounds is None else flock.bounds.tolist(),
            "knots": flock.knots.tolist(),
            "gravity": self.gravity.tolist(),
            "modalWeights": crowd.modal_weights.T.tolist(),
            "flow": np.array(turning_flow(basis.eigenvalues, crowd.damping, dt)).T.tolist(),
            "flapForce": flap.force.tolist(),
            "beats": flap.frequency,
            "largest": flap.largest_load_factor,
        }
        return filled_page("flock", title, data, rest, faces, __package__)

    def _targets(self, duration: float, sample: float) -> list[list[float]] | None:
        """The target's places at every ``sample`` of a duration, one where it stays; None without."""
        if self.target is not None:
            return [np.asarray(self.target(t)).tolist() for t in np.arange(0.0, duration + 0.5 * sample, sample)]
        return None if self.flock.target is None else [self.flock.target.tolist()]

    def snapshot(self) -> dict[str, NDArray[np.generic]]:
        """Checkpoint from which :meth:`restore` resumes bit for bit."""
        found = {name: getattr(self.flock, name).copy() for name in _FLOCK}
        found |= {name: getattr(self.crowd, name).copy() for name in _CROWD}
        return found | {"time": np.array(self.flock.time)}

    def restore(self, snapshot: dict[str, NDArray[np.generic]]) -> None:
        """Go back to a snapshot."""
        for owner, names in ((self.flock, _FLOCK), (self.crowd, _CROWD)):
            for name in names:
                setattr(owner, name, np.array(snapshot[name]))
        self.flock.time = float(np.asarray(snapshot["time"]))
