"""What self-contact costs: steps of a strip that turns over and strikes itself, with it and without from each state.

By the processor's clock, the two in turn.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import modalshell as ms
from modalshell.core.typing import Array
from modalshell.motion.stepping import Motion
from studies.benchmarks.timing import one_blas_thread

STEP = 1.0 / 60.0
GRAVITY = (0.0, 0.0, -9.81)
PULL = (-0.45, 0.0, 0.54)
"""Force [N] on the strip's end, until it is let go between 0.5 and 0.6 s."""
HARD = 5
"""Steps in a row that are looked at where they cost most."""


def folded_strip(cells: tuple[int, int] = (154, 12), steps: int = 90) -> list[dict[str, Any]]:
    """Seconds of a step with self-contact, and over one without: of all, of those that touch, of the hardest in a row.

    The strip is that of the scene ``folded_strip``. Each step is taken once, as in a motion.
    """
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=cells)
    along = mesh.vertices[:, 0]
    shell = ms.Shell(mesh, ms.Isotropic(5e6, 0.3, 1e-3, 500.0), clamped=along < 0.45)
    model, loading, end = ms.DiscreteShell(shell), shell.loading(GRAVITY, None, None), along > 0.99
    pull = end[:, None] * np.array(PULL) / end.sum()
    dead = loading.dead.copy()

    def motion(contacts: list[Any]) -> Motion:
        return Motion(model, loading, dt=STEP, damping=(2.0, 0.0), contacts=contacts)

    touching, plain = motion([ms.SelfContact(gap=2e-3, friction=0.3)]), motion([])
    start, seconds, touched = touching.snapshot(), np.empty((steps, 2)), np.empty(steps, bool)
    with one_blas_thread():
        for timed in (False, True):  # the first time kernels are loaded
            touching.restore(start)
            for step in range(steps):
                load = dead + np.interp((step + 0.5) * STEP, [0.5, 0.6], [1.0, 0.0]) * pull
                touching.load = plain.load = load
                plain.restore(touching.snapshot())
                for turn, moving in enumerate((touching, plain)):
                    begin = time.process_time()
                    moving.advance()
                    seconds[step, turn] = time.process_time() - begin
                frame = touching.touched()
                touched[step] = frame is not None and bool(frame.forces.any())
                if not timed and touched[: step + 1].sum() == HARD:
                    break
    first = max(range(steps - HARD + 1), key=lambda i: ratio(seconds[i : i + HARD]))
    parts = {"all": seconds, "touching": seconds[touched], f"hardest {HARD}": seconds[first : first + HARD]}
    return [
        {
            "vertices": len(mesh.vertices),
            "steps": name,
            "number": len(own),
            "milliseconds_step": 1e3 * float(own[:, 0].mean()),
            "milliseconds_without": 1e3 * float(own[:, 1].mean()),
            "ratio": ratio(own),
            "unsolved": touching.unconverged,
        }
        for name, own in parts.items()
    ]


def ratio(seconds: Array) -> float:
    """Of seconds (steps, 2), the sum of the first ones over that of the others."""
    return float(seconds[:, 0].sum() / seconds[:, 1].sum())
