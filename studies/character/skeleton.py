"""The dancer's skeleton: joints of a tree, turned by splines through the keyframes; legs reach for their feet."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from modalshell.core.typing import Array
from modalshell.files.provenance import repository_file

STRAIGHT = 0.9985
"""Share of a leg's length to which it stretches at most: its knee never locks."""


class JointPose(NamedTuple):
    """Where a joint is [m], and how what hangs on it is turned from rest."""

    position: Array
    rotation: Rotation


class Skeleton:
    """The skeleton and its dance.

    Attributes
    ----------
    rest : dict of str to ndarray
        Position of each joint at rest [m], parents first.
    parents : dict of str to str
        Parent of each joint; empty for the pelvis.
    duration : float
        Of the dance [s].
    """

    def __init__(self) -> None:
        with repository_file("studies/character/dance.toml").open("rb") as file:
            data = tomllib.load(file)
        self.parents = {name: parent for name, (parent, _) in data["joints"].items()}
        self.rest = {name: np.array(place, dtype=np.float64) for name, (_, place) in data["joints"].items()}
        self._root = _smooth(data["root"]["keys"])
        self._turns = {name: _smooth(keys) for name, keys in data["turns"].items()}
        # Monotone between keys: a planted foot stays where it is.
        self._feet = {side: PchipInterpolator(*_columns(keys)) for side, keys in data["feet"].items()}
        self.duration = float(data["root"]["keys"][-1][0])

    @cache  # noqa: B019 (one skeleton, whose poses every shell asks for)
    def pose(self, time: float) -> dict[str, JointPose]:
        """Every joint at ``time`` [s]."""
        poses = {"pelvis": JointPose(self.rest["pelvis"] + self._root(time), self._turn("pelvis", time))}
        for name, parent in self.parents.items():
            if name in poses or name.startswith(("knee", "ankle")):
                continue
            above = poses[parent]
            position = above.position + above.rotation.apply(self.rest[name] - self.rest[parent])
            if name.startswith("hip"):
                poses |= self._leg(name.removeprefix("hip_"), position, poses["pelvis"].rotation, time)
            else:
                poses[name] = JointPose(position, above.rotation * self._turn(name, time))
        return poses

    def _turn(self, name: str, time: float) -> Rotation:
        return Rotation.from_euler("xyz", self._turns[name](time), degrees=True)

    def _leg(self, side: str, hip: Array, pelvis: Rotation, time: float) -> dict[str, JointPose]:
        """Hip, knee and ankle of a leg that reaches for its foot, the knee pointing between foot and pelvis."""
        foot = self._feet[side](time)
        ankle, heading = foot[:3], Rotation.from_euler("z", foot[3], degrees=True)
        names = [f"{joint}_{side}" for joint in ("hip", "knee", "ankle")]
        places = [self.rest[name] for name in names]
        thigh, shin = (float(np.linalg.norm(places[k + 1] - places[k])) for k in (0, 1))
        reach = ankle - hip
        distance = float(np.linalg.norm(reach))
        along = reach / distance
        distance = float(np.clip(distance, 1.02 * abs(thigh - shin), STRAIGHT * (thigh + shin)))
        ahead = heading.apply([0.0, -1.0, 0.0]) + pelvis.apply([0.0, -1.0, 0.0])
        ahead -= along * (along @ ahead)
        ahead /= np.linalg.norm(ahead)
        inward = (thigh**2 - shin**2 + distance**2) / (2.0 * distance)
        knee = hip + inward * along + np.sqrt(max(thigh**2 - inward**2, 0.0)) * ahead
        ankle = hip + distance * along
        hinge = np.cross(ahead, along)
        pitched = heading * Rotation.from_euler("x", foot[4], degrees=True)
        turns = [_hanging(knee - hip, hinge), _hanging(ankle - knee, hinge), pitched]
        return {k: JointPose(x, turn) for k, x, turn in zip(names, (hip, knee, ankle), turns, strict=True)}


def _hanging(direction: Array, hinge: Array) -> Rotation:
    """Rotation that takes -z to ``direction`` and x to ``hinge``."""
    up = -direction / np.linalg.norm(direction)
    return Rotation.from_matrix(np.column_stack([hinge, np.cross(up, hinge), up]))


def _columns(keys: Sequence[Sequence[float]]) -> tuple[Array, Array]:
    rows = np.array(keys, dtype=np.float64)
    return rows[:, 0], rows[:, 1:]


def _smooth(keys: Sequence[Sequence[float]]) -> CubicSpline:
    """Curve through the keys that starts and stops at rest."""
    return CubicSpline(*_columns(keys), bc_type="clamped")
