"""Damping by measured ratios: the factors that they give, and decay of single modes."""

import numpy as np
import pytest

from modalshell import (
    Damping,
    DiscreteShell,
    Isotropic,
    LinearModal,
    ModalDerivatives,
    OptionError,
    SceneError,
    Shell,
    flat_beam,
    load_scene,
    simulate,
    solve_modes,
)


@pytest.mark.parametrize("pairs", [((1.0, 0.02), (10.0, 0.02)), ((8.0, 0.05), (2.0, 0.03)), ((1.0, 0.04), (4.0, 0.01))])
def test_two_ratios_give_rayleigh_factors(pairs):
    damping = Damping.from_ratios(*pairs)
    omega = 2.0 * np.pi * np.array([frequency for frequency, _ in pairs])
    assert damping.of_modes(omega**2) / (2.0 * omega) == pytest.approx([ratio for _, ratio in pairs])


def test_factors_of_any_kind_of_number_are_floats():
    """Half precision stayed, and what it was multiplied by lost its digits, too."""
    damping = Damping(np.float16(0.1), np.int64(1))
    assert [type(damping.mass_factor), type(damping.stiffness_factor)] == [float, float]


def test_ratios_that_no_factors_give_are_refused():
    with pytest.raises(OptionError, match=r"between 0\.005 and 0\.08 \(got 0\.2\)"):
        Damping.from_ratios((1.0, 0.02), (4.0, 0.2))
    with pytest.raises(OptionError, match="two frequencies"):
        Damping.from_ratios((1.0, 0.02), (1.0, 0.02))
    for first in ((0.0, 0.1), (1.0, -0.1), (1.0,), "ab", (np.nan, 0.1)):
        with pytest.raises(OptionError):
            Damping.from_ratios(first, (2.0, 0.1))
    for wrong in ((-1.0,), (np.nan,), 0.1, "x"):
        with pytest.raises(OptionError):
            Damping(ratios=wrong)


@pytest.mark.slow
def test_each_mode_decays_by_its_own_ratio():
    mesh = flat_beam(length=1.0, width=0.2, cells=(10, 2))
    shell = Shell(mesh, Isotropic(young=1e6, poisson=0.3, thickness=0.01, density=1000.0), mesh.vertices[:, 0] < 1e-9)
    basis = solve_modes(shell, 3)
    model = LinearModal(basis, integrator="implicit_midpoint")
    ratios = (0.02, 0.05, 0.1)
    for mode in range(3):
        period = 1.0 / basis.frequencies[mode]
        shape = basis.modes[:, mode].reshape(-1, 3)
        start = shell.rest_positions + 1e-3 * shape / np.abs(shape).max()
        run = simulate(model, duration=3 * period, dt=period / 200, start=start, damping=Damping(ratios=ratios))
        left = (run.energies[-1, :2].sum() / run.energies[0, :2].sum()) ** 0.5
        expected = np.exp(-2.0 * np.pi * 3.0 * ratios[mode] / np.sqrt(1.0 - ratios[mode] ** 2))
        assert left == pytest.approx(expected, rel=0.02)
    for wrong, told in (
        (model, "one number or 3"),
        (DiscreteShell(shell), "no modes"),
        (ModalDerivatives(shell, 2), "no modes"),
    ):
        with pytest.raises(OptionError, match=told):
            simulate(wrong, duration=0.1, damping=Damping(ratios=(0.1, 0.2)))


def test_scenes_declare_measured_damping(scene_file):
    def damping(keys):
        return load_scene(scene_file(("duration = 1", f"duration = 1\n{keys}"))).build().start_motion().setup.damping

    assert damping("damping_ratios = [[1, 0.02], [10, 0.02]]") == Damping.from_ratios((1.0, 0.02), (10.0, 0.02))
    assert damping("modal_damping = [0.05]") == Damping(ratios=(0.05,))
    for keys, told in (
        ("damping = [1, 0]\nmodal_damping = [0.1]", r"motion\.modal_damping: takes the place"),
        ("damping_ratios = [[1, 0.02]]", r"motion\.damping_ratios"),
        ("damping_ratios = [[1, 0.02], [2, 5.0]]", r"motion: no Rayleigh factors"),
        ("modal_damping = [0.1, 0.2]", r"motion\.modal_damping: must be one number or"),
        ("modal_damping = []", r"motion\.modal_damping"),
    ):
        with pytest.raises(SceneError, match=told):
            damping(keys)
    full = load_scene(scene_file(("duration = 1", "duration = 1\nmodal_damping = [0.1]"), ('"mwts"', '"ds"')))
    with pytest.raises(SceneError, match=r"motion\.modal_damping: must be left out: DS has no modes"):
        full.build().start_motion()
