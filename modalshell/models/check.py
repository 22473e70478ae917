"""The check that a modal model must pass: its hooks are those of one shape, derivatives against differences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from modalshell.core.checks import checked_count, checked_kind, checked_number
from modalshell.core.errors import OptionError
from modalshell.core.typing import Array
from modalshell.models.base.modal import ModalModel

_CLOSE = 1e-6
"""Difference, as a share of the larger of both, up to which a derivative counts as right."""
_TANGENT = 1e-4
"""The same of the modes at rest, which may be as coarse as the modal rotations are."""
_PATCH = 3
"""Vertices of the patches that are looked at."""
_SLANTED = np.array([[0.6, 0.0, 0.8]])
"""Direction along which rows for contacts are looked at, along no axis."""


def check_model(model: ModalModel, *, turn: float = 0.3, states: int = 3, seed: int = 0) -> None:
    """Check a modal model: its shape, its derivatives, its force, its rows for contacts, and its options.

    At random coordinates the derivatives are compared with central differences of fourth order, to 1e-6. A model of
    another package calls this in a test of its own.

    Parameters
    ----------
    model : ModalModel
        The model, with options that differ from their defaults.
    turn : float
        Largest modal rotation [rad] of the states.
    states : int
        Number of states, rest not counted.
    seed : int
        Of the random numbers.

    Raises
    ------
    OptionError
        Names every method that is wrong, by how much, and what it should be.
    """
    checked_kind("model", model, ModalModel)  # type: ignore[type-abstract]
    rng = np.random.default_rng(checked_count("seed", seed, at_least=0))
    size = checked_number("turn", turn, above=0.0)
    faults = list(_at_rest(model))
    for _ in range(checked_count("states", states)):
        q = rng.standard_normal(model.basis.count)
        q[: model.basis.rigid_modes] = 0.0
        q *= size / max(float(np.abs(model.basis.rotations @ q).max()), 1e-300)
        faults += _at(model, q, rng)
    if faults:
        listed = "\n".join(f"- {fault}" for fault in dict.fromkeys(faults))
        raise OptionError(f"{model.name} is not the model of one shape:\n{listed}")


def _at_rest(model: ModalModel) -> Iterator[str]:
    """What is wrong at rest."""
    rest, count = model.shell.rest_positions, model.basis.count
    shape = model.warped(np.zeros(count))
    if np.shape(shape) != rest.shape:
        yield f"warped(0) has shape {np.shape(shape)}, expected {rest.shape}: one displacement per vertex"
        return
    if np.any(shape):
        yield f"warped(0) is not zero (got up to {np.abs(shape).max():.2g} m): coordinates count from the rest shape"
    slope = model.by_differences(model.warped, np.zeros(count)).reshape(-1, count)
    yield from _fault("warped to first order about rest", slope, "Phi q", model.basis.modes, _TANGENT)


def _at(model: ModalModel, q: Array, rng: np.random.Generator) -> Iterator[str]:
    """What is wrong at some coordinates."""
    rest = model.shell.rest_positions
    shape = model.warped(q)
    if np.shape(shape) != rest.shape or not np.isfinite(shape).all():
        return  # of the wrong shape, which is reported at rest, or outside the range of the model
    yield from _fault("warped_positions", model.warped_positions(q) - rest, "rest + warped(q)", shape)
    largest, bound = float(np.linalg.norm(shape, axis=1).max()), model.farthest(q)
    if not bound >= (1.0 - _CLOSE) * largest:
        yield f"farthest is {bound:.3g} m, less than the {largest:.3g} m by which warped(q) moves a vertex"
    load = model.shell.mass[:, None] * rng.standard_normal(rest.shape)
    vertices = np.sort(rng.choice(np.flatnonzero(model.shell.free), _PATCH, replace=False))
    by_work = model.by_differences(lambda q: np.vdot(load, model.warped(q)), q)
    yield from _fault("warped_gradient", model.warped_gradient(q, load), "d(g . warped)/dq", by_work)
    force = model.warped_force(q, load)
    # What a turn of the force makes: next to it a derivative of zero is one.
    turned = float(np.abs(force).max() * np.abs(model.basis.rotations).max())
    if model.conservative:
        work, push = model.warped_work(q, load)
        yield from _fault("warped_work", np.array([work]), "f . warped(q)", np.array([np.vdot(load, shape)]))
        yield from _fault("the gradient of warped_work", push, "d(f . warped)/dq", by_work)
        yield from _fault("warped_force", force, "d(f . warped)/dq", by_work)
        bent = model.by_differences(lambda q: model.warped_work(q, load)[1], q)
        yield from _fault("warped_curvature", model.warped_curvature(q, load), "d2(f . warped)/dq2", bent, floor=turned)
    slope = model.by_differences(lambda q: model.warped_force(q, load), q)
    yield from _fault("warped_jacobian", model.warped_jacobian(q, load), "d(warped_force)/dq", slope, floor=turned)
    rows = model.by_differences(lambda q: model.warped(q)[vertices], q)
    if model.frames is None:
        yield from _fault("contact_rows", model.contact_rows(q, vertices), "d(warped)/dq", rows)
        points, along = model.contact_frame(q, vertices, _SLANTED)
        yield from _fault("contact_frame", points - rest[vertices], "warped(q)", shape[vertices])
        yield from _fault("the derivatives of contact_frame", np.asarray(along), "d(warped)/dq", _SLANTED @ rows)
    mean, by_q = model.warped_patch(q, vertices)
    moved = shape[vertices].mean(axis=0)
    yield from _fault("warped_patch", mean - rest[vertices].mean(axis=0), "mean of warped(q)", moved)
    yield from _fault("the Jacobian of warped_patch", by_q, "d(mean of warped)/dq", rows.mean(axis=0))
    yield from _of_options(model, q, shape)


def _of_options(model: ModalModel, q: Array, shape: Array) -> Iterator[str]:
    """Whether the same model on another basis, or with another rule of time, has the same shape."""
    basis = model.basis
    twice = replace(
        basis,
        eigenvalues=np.tile(4.0 * basis.eigenvalues, 2),
        modes=np.hstack([basis.modes, basis.modes]),
        rotations=np.hstack([basis.rotations, basis.rotations]),
    )
    lost = "that of the model: is an option lost?"
    yield from _fault("warped of stepped_by", model.stepped_by(model.integrator).warped(q), lost, shape)
    try:
        same, other = model.on_basis(basis), model.on_basis(twice)
    except OptionError:  # its training is that of one basis
        return
    yield from _fault("warped of on_basis", same.warped(q), lost, shape)
    shared = np.concatenate([0.3 * q, 0.7 * q])  # the same Phi q
    same_span = "that of the model: is it a function of Phi q and Psi q alone?"
    yield from _fault("warped of on_basis with twice the modes", other.warped(shared), same_span, shape)


def _fault(
    name: str, got: Array, expected_as: str, expected: Array, close: float = _CLOSE, *, floor: float = 1e-300
) -> Iterator[str]:
    """That an array is not what it should be, by how much of its size, or of ``floor`` if that is more."""
    if np.shape(got) != np.shape(expected):
        yield f"{name} has shape {np.shape(got)}, expected {np.shape(expected)}, {expected_as}"
        return
    scale = max(float(np.abs(expected).max(initial=0.0)), float(np.abs(got).max(initial=0.0)), floor)
    off = float(np.abs(np.asarray(got) - expected).max(initial=0.0)) / scale
    if not off <= close:
        yield f"{name} is off by {off:.2g} of its size from {expected_as}"
