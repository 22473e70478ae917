"""A taken key is refused for everything that has keys, and the refusal names both classes."""

import pytest

import modalshell as ms
from modalshell.core.registry import Registry
from modalshell.integrators.full import FullIntegrator
from modalshell.integrators.modal import ModalIntegrator
from modalshell.loads import Load
from modalshell.models.registry import MODELS, ModelSpec, register
from modalshell.scene.kinds import KINDS, SceneKind
from modalshell.shell.elements import ENERGIES, Energy
from modalshell.supports import Support


def _load():
    class Mine(Load, key="pressure"):
        pass


def _support():
    class Mine(Support, key="pin"):
        pass


def _energy():
    class Mine(Energy, key="taken"):
        pass


def _full_integrator():
    class Mine(FullIntegrator, key="verlet"):
        pass


def _modal_integrator():
    class Mine(ModalIntegrator, key="implicit_midpoint"):
        pass


def _model():
    def mine(shell):
        raise AssertionError(shell)

    register(ModelSpec("ds", "mine", mine, "shell", 5))


def _scene_kind():
    def mine(declared):
        raise AssertionError(declared)

    KINDS["flock"] = SceneKind(KINDS["flock"].table, mine)


@pytest.mark.parametrize(
    ("declare", "taken", "owner"),
    [
        (_load, "load 'pressure'", "loads.surface.Pressure"),
        (_support, "support 'pin'", "supports.kinds.Pin"),
        (_energy, "energy 'taken'", "Theirs"),
        (_full_integrator, "integrator 'verlet'", "integrators.full.verlet.Verlet"),
        (_modal_integrator, "integrator 'implicit_midpoint'", "integrators.modal.implicit_midpoint.ImplicitMidpoint"),
        (_model, "model 'ds'", "models.discrete_shell.DiscreteShell"),
        (_scene_kind, "kind of scene 'flock'", "crowd.scene.declared_flock"),
    ],
)
def test_a_taken_key_is_refused(declare, taken, owner):
    if declare is _energy:  # the package itself has no further energy

        class Theirs(Energy, key="taken"):
            pass

    before = dict(MODELS), dict(KINDS)
    try:
        with pytest.raises(ms.OptionError) as refused:
            declare()
    finally:
        ENERGIES.pop("taken", None)
    message = str(refused.value)
    assert message.startswith(f"{taken} exists already, as ")
    assert owner in message
    assert "test_registries." in message
    assert "give" in message
    assert (dict(MODELS), dict(KINDS)) == before


def test_a_class_that_is_defined_again_replaces_itself():
    found = Registry("thing")

    def cell():
        class Thing:
            pass

        found["thing"] = Thing
        return Thing

    first, second = cell(), cell()
    assert found["thing"] is second
    assert first is not second
