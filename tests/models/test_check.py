"""The check of models: it passes those of the package, and finds what is wrong with others."""

import numpy as np
import pytest

import modalshell as ms
from modalshell.models.base.modal import ModalModel
from modalshell.models.base.unstretched import UnstretchedModel
from modalshell.models.check import check_model
from modalshell.models.linear import LinearModal
from modalshell.models.registry import MODELS


def strip(*, held=True):
    mesh = ms.flat_beam(length=1.0, width=0.2, cells=(10, 2))
    return ms.Shell(mesh, ms.Isotropic(1e8, 0.3, 5e-3, 100.0), clamped=(mesh.vertices[:, 0] < 1e-6) if held else None)


@pytest.fixture(scope="module")
def basis():
    return ms.solve_modes(strip(), count=4)


class Bounded(ModalModel):
    """Linear modes, their root mean square below a limit [m]: one hook, all else by differences."""

    name = "bounded"

    def __init__(self, basis, *, integrator="exponential", limit=1.0):
        super().__init__(basis, integrator=integrator)
        self.limit = limit

    def scale(self, q):
        linear = self.basis.modes @ q
        return 1.0 / np.sqrt(1.0 + linear @ linear / (self.limit**2 * len(self.shell.mass)))

    def warped(self, q):
        return self.scale(q) * (self.basis.modes @ q).reshape(-1, 3)


@pytest.mark.by_default("True-lma", "True-rsw", "False-mwts-consistent")
@pytest.mark.parametrize("key", [key for key, spec in MODELS.items() if spec.needs == "basis"])
@pytest.mark.parametrize("held", [True, False])
def test_the_models_of_the_package_pass(key, held):
    check_model(MODELS[key].builder(ms.solve_modes(strip(held=held), count=4 if held else 9)))


def test_a_reduced_model_passes(basis):
    load = basis.shell.gravity_force((0, 0, -2.0))
    check_model(MODELS["reduced-rsw"].builder(basis, np.array([0.5 * load, load]), rank=8), turn=0.05)


@pytest.mark.by_default("True")
@pytest.mark.parametrize("held", [True, False])
def test_one_hook_is_enough(held):
    check_model(Bounded(ms.solve_modes(strip(held=held), count=4 if held else 9), limit=0.2))


def overridden(**methods):
    """A bounded model with some methods of its own."""
    return type("Wrong", (Bounded,), methods)


WRONG = {
    "warped_gradient": lambda self, q, weights: self.scale(q) * (self.basis.modes.T @ weights.ravel()),
    "warped_positions": lambda self, q: self.shell.rest_positions + (self.basis.modes @ q).reshape(-1, 3),
    "warped_curvature": lambda _, q, __: np.zeros((q.size, q.size)),
    "warped_jacobian": lambda _, q, __: np.zeros((q.size, q.size)),
    "contact_rows": lambda self, _, vertices: self.basis.modes.reshape(-1, 3, self.basis.count)[vertices],
    "warped_patch": lambda self, q, vertices: (
        self.warped_positions(q)[vertices].mean(axis=0),
        self.basis.modes.reshape(-1, 3, self.basis.count)[vertices].mean(axis=0),
    ),
    "on_basis": lambda self, basis: type(self)(basis),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(basis, name):
    with pytest.raises(ms.OptionError, match=rf"{name}.* off by [\d.e-]+ of its size from"):
        check_model(overridden(**{name: WRONG[name]})(basis, limit=0.2))


@pytest.mark.parametrize(
    ("warped", "message"),
    [
        (lambda self, q: 0.5 * (self.basis.modes @ q).reshape(-1, 3), "to first order about rest is off by 0.5"),
        (lambda self, q: self.basis.modes @ q, r"shape \(99,\), expected \(33, 3\)"),
        (lambda self, q: 0.1 + (self.basis.modes @ q).reshape(-1, 3), r"warped\(0\) is not zero"),
    ],
)
def test_a_shape_that_is_not_that_of_the_modes_at_rest_is_named(basis, warped, message):
    with pytest.raises(ms.OptionError, match=message):
        check_model(type("Wrong", (ModalModel,), {"name": "wrong", "warped": warped})(basis))


def test_a_shape_by_the_coordinates_themselves_is_named(basis):
    """On a basis that is no orthonormal one, as sensitivities take it, q . q is no measure of the displacement."""
    shape = {"scale": lambda self, q: 1.0 / np.sqrt(1.0 + q @ q / (self.limit**2 * self.shell.mass.sum()))}
    with pytest.raises(ms.OptionError, match="a function of Phi q and Psi q alone"):
        check_model(overridden(**shape)(basis, limit=0.2))


@pytest.mark.parametrize("name", ["raw_displacement", "displacement_gradient", "modal_force", "work"])
def test_methods_that_are_no_hooks_cannot_be_overridden(name):
    with pytest.raises(ms.OptionError, match=f"Wrong overrides {name}, which the base derives from warped"):
        overridden(**{name: lambda *_: None})


def test_a_shape_does_not_inherit_the_derivatives_of_another():
    scaled = {"warped": lambda self, q: 0.5 * LinearModal.warped(self, q)}
    with pytest.raises(ms.OptionError, match=r"belongs to another shape: .*warped_gradient.* of LinearModal"):
        type("Wrong", (LinearModal,), scaled)
    mixin = type("Mixin", (), scaled)
    with pytest.raises(ms.OptionError, match=r"belongs to another shape: .*warped_gradient.* of LinearModal"):
        type("Wrong", (mixin, LinearModal), {})
    type("Right", (UnstretchedModel,), scaled)


def test_a_force_without_its_work_is_refused_unless_it_has_none():
    force = {"warped_force": lambda self, _, load: self.basis.modes.T @ load.ravel()}
    with pytest.raises(ms.OptionError, match="warped_force, but not the work"):
        overridden(**force)
    overridden(**force, conservative=False)


def test_models_without_a_potential_have_statics_by_balance(basis):
    force = {"warped_force": lambda self, _, load: self.basis.modes.T @ load.ravel(), "conservative": False}
    model, linear = overridden(**force)(basis, limit=0.2), LinearModal(basis)
    check_model(model)
    answers = [one.equilibrium(gravity=(0, 0, -1)) for one in (model, linear)]
    assert answers[0].converged
    np.testing.assert_allclose(answers[0].coordinates, answers[1].coordinates, rtol=1e-6, atol=1e-12)


def test_options_survive_another_basis(basis):
    rsw = ms.RotationStrain(basis, integrator="implicit_euler", backend="superlu")
    assert rsw.on_basis(basis).backend == rsw.backend
    other = Bounded(basis, limit=0.2).stepped_by("implicit_midpoint").on_basis(basis)
    assert (other.limit, other.integrator.key) == (0.2, "implicit_midpoint")
    assert Bounded(basis=basis, limit=0.3).on_basis(basis).limit == 0.3
    assert ms.ModalWarping(basis, consistent_force=True).on_basis(basis).conservative
