"""The error bar of a motion that is shown while it runs."""

from __future__ import annotations

from typing import final

import numpy as np

from modalshell.core.typing import Array
from modalshell.models.base.bars import led_vertices
from modalshell.models.coarse.profile_step import quick_estimator
from modalshell.models.motion_check import MotionCheck, damped_basis, touching_frames
from modalshell.motion import Motion
from modalshell.motion.bars import check_text
from modalshell.scene.scene import BARS_EVERY


@final
class LiveBar:
    """The last bar of a motion, found from its start on every 15 steps as in runs of scenes.

    OptionError for a shell that its supports do not hold.

    Attributes
    ----------
    text : str
        What the last check says; "" before the first one.
    """

    def __init__(self, motion: Motion) -> None:
        setup = motion.setup
        model, supports = motion.model, setup.supports
        shell, origin = model.true_shell, motion.stepper.origin
        if origin.any():  # the model is one about the origin, its frames are in the world
            shell = shell.shifted(-origin)
        led = led_vertices(shell, setup.constraints, supports)
        touching = touching_frames(model, setup.contacts, setup.dt, supports, shell, led)
        estimator = None if led is None or touching is not None else quick_estimator(shell, led)
        self._check = MotionCheck(shell, setup.loading, setup.damping, supports, touching=touching, estimator=estimator)
        self._check.basis = damped_basis(model)
        self._follows = motion.model.follows_snaps
        self._frames: list[tuple[int, Array, Array | None]] = []
        self._largest, self._held, self.text = 0.0, True, ""

    def see(self, motion: Motion) -> None:
        """Take the motion after a step; its dead loads are those of now."""
        x, touched = motion.positions().copy(), motion.touched()
        self._frames = [*self._frames[-2:], (motion.count, x, None if touched is None else touched.forces)]
        counts = [count for count, _, _ in self._frames]
        middle = motion.count - 1
        if middle % BARS_EVERY == 0 and counts == [middle - 1, middle, middle + 1]:
            times = motion.setup.dt * np.array(counts, dtype=np.float64)
            frames = np.stack([frame for _, frame, _ in self._frames])
            forces = None if touched is None else np.stack([force for _, _, force in self._frames if force is not None])
            bar = self._check.bar_under(times, frames, motion.load.copy(), forces=forces)[0]
            off = self._check.off(bar, self._check.own(times[1], self._frames[1][1]))
            valid = bar.valid and (self._held or self._follows)
            unjudged = self._check.unjudged
            self._held = self._held and (bar.valid or bool(unjudged))
            self.text = check_text(off / self._largest if self._largest > 0.0 else float(off > 0.0), valid, unjudged)
        self._largest = max(self._largest, self._check.moved(self._check.own(motion.time, x)))
