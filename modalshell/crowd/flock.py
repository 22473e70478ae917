"""Boids: separation, alignment and cohesion, a target, bounds, and smooth noise in their speed."""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Self, final

import numpy as np
from numpy.typing import ArrayLike

from modalshell.core.checks import checked_choice, checked_count, checked_number, checked_vectors, shown, vector_count
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.crowd.neighbours import Neighbourhood, NeighbourSearch, Search, gather

MOST, MOST_THREADS = 10_000_000, 4096
"""Of boids and instances, more of which do not fit the memory of a common machine, and of threads."""
_NOISE_PERIOD = 256
"""Knots of the periodic noise."""
_PARALLEL = 1e-9
"""Sine below which two directions count as parallel."""


class Rules(NamedTuple):
    """Weighted steering vectors of each rule, (N, 3) each; a boid turns towards their sum."""

    separation: Array
    """Away from the neighbours: sum of ``offset (1 / distance - 1 / neighbour distance)``, zero at that distance."""
    alignment: Array
    """Mean of the neighbours' directions; zero without neighbours."""
    cohesion: Array
    """Unit vector to the mean position of the neighbours and of the flock position, which counts as one more."""
    target: Array
    """Unit vector to the target."""
    bounds: Array
    """Back into the box: the distance outside it along each axis over the neighbour distance."""

    @property
    def direction(self) -> Array:
        """Sum of all rules (N, 3)."""
        return np.sum(self, axis=0)


@final
class Flock:
    """Boids that head where their neighbours make them [reynolds1987; theory 17, eq. 4 and 5].

    A boid turns by ``d <- normalised(e + k (d - e))``, with e the sum of its :class:`Rules` and
    ``k = exp(-rotation_speed dt)``, and moves along d at ``speed (1 + speed_variation noise(t))``. Rules, turning and
    the default parameters, all one, are those of the GPU boids of Unity's teaching samples; noise, field of view and
    bounds are not. The alignment is the mean over the neighbours, not counting the boid itself.

    Parameters
    ----------
    positions : array_like, shape (N, 3)
        Where the boids start [m].
    directions : array_like, shape (N, 3)
        Where they head; normalised.
    seed : int
        Of the noise; the same seed gives the same flock, whatever the threads.
    speed : float
        Mean speed [m/s].
    speed_variation : float
        Largest relative deviation from it, in [0, 1].
    noise_frequency : float
        Knots of the noise per second [Hz]; it is twice differentiable, and repeats after 256 knots.
    rotation_speed : float
        Rate of turning [1/s].
    neighbour_distance : float
        Distance [m] below which boids are neighbours; those at one point do not see each other.
    field_of_view : float
        Full angle about its direction in which a boid sees others [degrees], in (0, 360].
    weights : (float, float, float)
        Weights of separation, alignment and cohesion, at least 0.
    flock_position : array_like, shape (3,)
        Where the flock belongs [m]: a boid without neighbours flies there.
    target : array_like, shape (3,), optional
        Point that attracts all boids [m].
    target_weight : float
        Weight of the target against the other rules; may be changed between steps, as may ``target``.
    bounds : array_like, shape (2, 3), optional
        Lower and upper corner of a box that boids outside are steered back to [m]. They may overshoot.
    search : {"grid", "all_pairs"} or NeighbourSearch
        How neighbours are found: all pairs is for checking, :class:`modalshell.crowd.device.DeviceSearch` for GPUs.
    threads : int
        Threads of the grid's search.

    Attributes
    ----------
    positions, directions, velocities, accelerations : ndarray, shape (N, 3)
        Present state [m, 1, m/s, m/s^2]; the acceleration is the velocity's change over the last step.
    time : float
        Time since the start [s].
    knots, noise_offsets : ndarray, shape (256,) and (N,)
        Periodic noise of the speed, and every boid's place in it.

    Raises
    ------
    OptionError
        If a parameter is out of range, an array of the wrong shape or not finite, or a direction zero.
    """

    def __init__(
        self,
        positions: ArrayLike,
        directions: ArrayLike,
        *,
        seed: int = 0,
        speed: float = 1.0,
        speed_variation: float = 1.0,
        noise_frequency: float = 0.5,
        rotation_speed: float = 1.0,
        neighbour_distance: float = 1.0,
        field_of_view: float = 360.0,
        weights: ArrayLike = (1.0, 1.0, 1.0),
        flock_position: ArrayLike = (0.0, 0.0, 0.0),
        target: ArrayLike | None = None,
        target_weight: float = 1.0,
        bounds: ArrayLike | None = None,
        search: Search | NeighbourSearch = "grid",
        threads: int = 1,
    ) -> None:
        count = vector_count(positions)
        self.positions = checked_vectors("positions", positions, (count, 3), OptionError).copy()
        given = checked_vectors("directions", directions, (count, 3), OptionError)
        if not np.linalg.norm(given, axis=1).all():
            first = int(np.argmin(np.linalg.norm(given, axis=1)))
            raise OptionError(f"directions must not be zero (got {given[first]} for boid {first}, counted from 0)")
        self.directions = unit(given)
        self.speed = checked_number("speed", speed, at_least=0.0, unit="m/s")
        self.speed_variation = checked_number("speed_variation", speed_variation, at_least=0.0, at_most=1.0)
        self.noise_frequency = checked_number("noise_frequency", noise_frequency, at_least=0.0, unit="Hz")
        self.rotation_speed = checked_number("rotation_speed", rotation_speed, at_least=0.0, unit="1/s")
        self.neighbour_distance = checked_number("neighbour_distance", neighbour_distance, above=0.0, unit="m")
        angle = checked_number("field_of_view", field_of_view, above=0.0, at_most=360.0, unit="degrees")
        self.field_of_view = math.radians(angle)
        self.weights = checked_vectors("weights", weights, (3,), OptionError).copy()
        if self.weights.min() < 0.0:
            raise OptionError(f"weights must be at least 0 (got {shown(weights)})")
        self.flock_position = checked_vectors("flock_position", flock_position, (3,), OptionError).copy()
        self.target = None if target is None else checked_vectors("target", target, (3,), OptionError).copy()
        self.target_weight = checked_number("target_weight", target_weight)
        self.bounds = None if bounds is None else checked_vectors("bounds", bounds, (2, 3), OptionError).copy()
        if self.bounds is not None and (self.bounds[0] > self.bounds[1]).any():
            raise OptionError(f"bounds must be a lower and an upper corner (got {shown(bounds)})")
        if not isinstance(search, NeighbourSearch):
            checked_choice("search", search, ("grid", "all_pairs"))
        self.search = search
        self.threads = checked_count("threads", threads, at_most=MOST_THREADS)
        random = np.random.default_rng(checked_count("seed", seed, at_least=0))
        self.knots = random.uniform(-1.0, 1.0, _NOISE_PERIOD)
        self.noise_offsets = random.uniform(0.0, _NOISE_PERIOD, count)
        self.time = 0.0
        self.velocities = self.directions * self.speeds()[:, None]
        self.accelerations = np.zeros_like(self.velocities)

    @classmethod
    def random(cls, count: int, *, radius: float, seed: int = 0, **parameters: Any) -> Self:
        """Flock of ``count`` boids spread evenly over a ball about the flock position, heading anywhere.

        ``radius`` is the ball's [m]; ``parameters`` are the flock's.
        """
        count = checked_count("count", count, at_most=MOST)
        radius = checked_number("radius", radius, above=0.0, unit="m")
        # Another stream than the noise's, which takes the seed itself.
        random = np.random.default_rng([checked_count("seed", seed, at_least=0), 1])
        outward = unit(random.standard_normal((count, 3)))
        positions = radius * np.cbrt(random.random(count))[:, None] * outward
        directions = random.standard_normal((count, 3))
        centre = checked_vectors("flock_position", parameters.get("flock_position", np.zeros(3)), (3,), OptionError)
        return cls(positions + centre, directions, seed=seed, **parameters)

    def speeds(self) -> Array:
        """Speeds (N,) [m/s] at the present time: smooth noise between random knots, every boid at its own place."""
        place = self.noise_frequency * self.time + self.noise_offsets
        knot = np.floor(place)
        part = place - knot
        fade = part**3 * (part * (6.0 * part - 15.0) + 10.0)  # [perlin2002]
        first = knot.astype(np.int64) % _NOISE_PERIOD
        begin, end = self.knots[first], self.knots[(first + 1) % _NOISE_PERIOD]
        return self.speed * (1.0 + self.speed_variation * (begin + fade * (end - begin)))

    def neighbourhood(self) -> Neighbourhood:
        """Sums over every boid's neighbours now."""
        boids = self.positions, self.directions, self.neighbour_distance, self.field_of_view
        if isinstance(self.search, NeighbourSearch):
            return self.search.gather(*boids)
        return gather(*boids, search=self.search, threads=self.threads)

    def rules(self) -> Rules:
        """The present weighted steering vectors of every boid."""
        near = self.neighbourhood()
        alignment = near.directions / np.maximum(near.counts, 1.0)[:, None]
        middle = (near.positions + self.flock_position) / (near.counts + 1.0)[:, None]
        target = bounds = np.zeros_like(self.positions)
        if self.target is not None:
            target = self.target_weight * unit(self.target - self.positions)
        if self.bounds is not None:
            inside = np.clip(self.positions, *self.bounds)
            bounds = (inside - self.positions) / self.neighbour_distance
        separate, align, cohere = self.weights
        cohesion = cohere * unit(middle - self.positions)
        return Rules(separate * near.separation, align * alignment, cohesion, target, bounds)

    def step(self, dt: float) -> None:
        """Turn and move every boid over ``dt`` [s]; a boid whose new direction would vanish keeps its own."""
        dt = checked_number("dt", dt, above=0.0, unit="s")
        goal = self.rules().direction
        turned = unit(goal + math.exp(-self.rotation_speed * dt) * (self.directions - goal))
        self.directions = np.where(turned.any(axis=1, keepdims=True), turned, self.directions)
        self.time += dt
        velocities = self.directions * self.speeds()[:, None]
        self.accelerations = (velocities - self.velocities) / dt
        self.velocities = velocities
        self.positions = self.positions + dt * velocities

    def frames(self, gravity: ArrayLike = (0.0, 0.0, -9.81)) -> Array:
        """Rotations (N, 3, 3) of bodies with x forward and z up, banked as in a coordinated turn.

        Up is along the acceleration less ``gravity`` (3,) [m/s^2], which the wings carry, so that a body feels no force
        to its side. Where that is along the direction of flight, up is as far from it as an axis can be.
        """
        lift = self.accelerations - checked_vectors("gravity", gravity, (3,), OptionError)
        forward = self.directions
        up = lift - np.sum(lift * forward, axis=1, keepdims=True) * forward
        lost = np.linalg.norm(up, axis=1) <= _PARALLEL * np.linalg.norm(lift, axis=1)
        axis = np.eye(3)[np.abs(forward).argmin(axis=1)]
        across = axis - np.sum(axis * forward, axis=1, keepdims=True) * forward
        up = unit(np.where(lost[:, None], across, up))
        return np.stack((forward, np.cross(up, forward), up), axis=2)


def unit(vectors: Array) -> Array:
    """Vectors (N, 3) over their lengths; zero stays zero."""
    lengths = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return vectors / np.where(lengths > 0.0, lengths, 1.0)[:, None]
