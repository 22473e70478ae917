"""Arrays and numbers: every public constructor and function with some of its arguments replaced by junk."""

from __future__ import annotations

import contextlib
import copy
import warnings
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

import modalshell as ms
from fuzzing.calls import Target, targets
from fuzzing.harness import Input, LongWork
from fuzzing.mutations import array_like, scalars
from fuzzing.world import world
from modalshell.core.checks import shown


def make(folder: Path) -> st.SearchStrategy[Input]:  # noqa: ARG001 (one signature for every surface)
    """Inputs: a call, one to three of its arguments replaced."""
    _warm_up()
    return st.one_of([_inputs(target) for target in targets()])


def measures(folder: Path) -> st.SearchStrategy[Input]:  # noqa: ARG001
    """The part of them that measures shapes."""
    _warm_up()
    return st.one_of([_inputs(target) for target in targets() if target.name.startswith("measure.")])


@cache
def _warm_up() -> None:
    """Compile and load what the calls need, which may take longer than an input may; their own arguments are sound."""
    for target in targets():
        with contextlib.suppress(LongWork), warnings.catch_warnings():
            warnings.simplefilter("ignore", ms.ModalShellWarning)  # as in each attempt
            if target.always and target.name not in ("run_sweep", "tradeoff", "advise"):
                continue  # valid arguments are not known, or slow
            for dtype in [{"dtype": "float64"}, {"dtype": "float32"}] if "dtype" in target.words else [{}]:
                target.call(**target.values | target.objects | dtype)


def _inputs(target: Target) -> st.SearchStrategy[Input]:
    strange = st.one_of(scalars, st.sampled_from(list(world().values())), st.just(world()["models"]["lma"]))
    junk: dict[str, st.SearchStrategy[Any]] = {
        name: scalars if np.ndim(value) == 0 else array_like(value) for name, value in target.values.items()
    }
    junk |= {name: st.sampled_from(choices) for name, choices in target.words.items()}
    rare, call = dict.fromkeys(target.objects, strange), target.call

    @st.composite
    def build(draw: st.DrawFn) -> Input:
        given = {name: copy.copy(value) for name, value in (target.values | target.objects).items()}
        names = [*junk, *rare] if draw(st.integers(0, 5)) == 0 else list(junk) or list(rare)
        chosen = draw(st.lists(st.sampled_from(names), max_size=3, unique=True)) if names else []
        if target.always and not set(chosen) & set(target.always):
            chosen.append(draw(st.sampled_from(target.always)))
        for name in chosen:
            given[name] = draw((junk | rare)[name])
        if "dtype" in target.words:
            given.setdefault("dtype", "float64")
        told = ", ".join(f"{name}={shown(given[name])}" for name in chosen)
        return Input(f"{target.name}({told})", lambda: call(**given))

    return build()
