"""The drape meter: its bending stiffness, cards, drapes and how it is laid out, against the package's own."""

import json
import tomllib
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import modalshell as ms
from modalshell.commands.cli import main
from modalshell.page.drape import FAMILY, coefficient_between, drape_page
from modalshell.shell.cards import CARDS, GRAVITY
from modalshell.shell.fabric import Fabric
from studies.drape_family import again, annulus, coefficient, shown


@cache
def cubed_overhang():
    """(L / bending length)^3 where a strip's chord hangs to 41.5 degrees: B theta'' = -w (L - s) cos theta."""

    def angle(ratio):  # of the chord
        def slopes(s, y):
            return np.stack([y[1], ratio * (1.0 - s) * np.cos(y[0])])

        s = np.linspace(0.0, 1.0, 201)
        found = solve_bvp(slopes, lambda a, b: np.array([a[0], b[1]]), s, np.zeros((2, len(s))), tol=1e-8)
        assert found.success
        down, across = (np.trapezoid(f(found.sol(s)[0]), s) for f in (np.sin, np.cos))
        return np.degrees(np.arctan2(abs(down), across))

    low, high = 1.0, 30.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if angle(-middle) < 41.5 else (low, middle)
    return low


def overhang(stiffness, weight):
    """Length [m] of an inextensible strip whose chord hangs to 41.5 degrees."""
    return (cubed_overhang() * stiffness / (weight * GRAVITY)) ** (1.0 / 3.0)


@pytest.mark.slow
def test_the_family_is_small_and_in_order():
    family = json.loads(FAMILY.read_text())
    assert FAMILY.stat().st_size < 400_000
    assert len(drape_page().text.encode()) < 500_000
    assert (np.diff(family["lengths"]) < 0.0).all()
    assert (np.diff(family["coefficients"]) < 0.0).all()
    assert max(abs(points) for _, points in family["missed"]) < 0.03


def test_the_command_writes_it_and_refuses_a_scene_with_it(tmp_path, capsys):
    for arguments, status in ((["--drape"], 0), (["--drape", "a.toml"], 2), ([], 2)):
        with pytest.raises(SystemExit) as ended:
            main(["page", *arguments, "--out", str(tmp_path / "drape.html")])
        assert (ended.value.code or 0) == status
    assert "without one" in capsys.readouterr().err
    assert "Drape meter" in (tmp_path / "drape.html").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CARDS, key=lambda name: CARDS[name].bending_length)[3::6])
def test_a_run_of_a_card_from_the_shape_of_the_page_has_its_drape_coefficient(name):
    """At another unevenness than the family's; the page states apart how far folds from the flat cloth differ."""
    run, page = again(CARDS[name].bending_length)
    assert run == pytest.approx(page, abs=0.03)


def test_the_shape_of_the_page_is_between_those_of_its_family():
    family = json.loads(FAMILY.read_text())
    lengths = family["lengths"]
    first, told = shown(lengths[4])
    assert told == pytest.approx(family["coefficients"][4])
    assert coefficient(first, annulus().faces) == pytest.approx(told, abs=2e-3)
    middle, _ = shown((lengths[4] * lengths[5]) ** 0.5)
    np.testing.assert_allclose(middle, 0.5 * (first + shown(lengths[5])[0]), atol=1e-9)
    np.testing.assert_allclose(shown(lengths[-1])[1], family["coefficients"][-1])
    with pytest.raises(ms.OptionError, match="length must be from"):
        shown(0.2)


@pytest.mark.slow
class TestInTheBrowser:
    def test_the_overhang_of_every_card_gives_its_stiffness_and_the_card(self, open_file):
        page, errors = open_file(drape_page())
        for name, card in CARDS.items():
            measured = overhang(card.bending, card.weight)
            found = page.evaluate(
                "([o, w]) => { shell.state.overhang = o; shell.state.weight = w; shell.update();"
                "const length = shell.bendingLength();"
                "return [shell.bending(), shell.nearest(length, w)[0].name, shell.drape(length), shell.material()]; }",
                [measured, card.weight],
            )
            assert found[0] == pytest.approx(card.bending, rel=0.01)
            assert found[1] == name
            family = json.loads(FAMILY.read_text())
            expected = coefficient_between(card.bending_length, family["lengths"], family["coefficients"])
            assert found[2] == pytest.approx(expected, abs=0.01)
            table = tomllib.loads(found[3])["material"]
            assert table.pop("kind") == "fabric"
            sheet = Fabric(**{key: tuple(v) if isinstance(v, list) else v for key, v in table.items()})
            assert float(sheet.bending[0]) == pytest.approx(card.bending, rel=0.01)
            assert float(sheet.density) == pytest.approx(card.weight, rel=1e-3)
        assert errors == []

    @pytest.mark.parametrize(("width", "height"), [(1280, 800), (390, 844)])
    def test_it_moves_when_a_slider_moves_and_nothing_is_cut(self, open_file, width, height):
        page, errors = open_file(drape_page())
        page.set_viewport_size({"width": width, "height": height})
        page.reload()
        page.wait_for_selector("canvas")
        if page.evaluate("() => document.getElementById('rest').hidden"):
            page.click("#fold")
        page.wait_for_timeout(300)
        before = page.screenshot()
        page.fill("#overhang", "40")
        page.wait_for_timeout(300)
        assert page.screenshot() != before
        assert page.inner_text("#coefficient").endswith("%")
        assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
        cut = page.evaluate(
            "() => [...document.querySelectorAll('#panel *')].filter(one => one.clientWidth && one.scrollWidth > "
            "one.clientWidth + 1 && getComputedStyle(one).overflowX === 'visible').map(one => one.outerHTML)"
        )
        assert cut == []
        inside = page.evaluate(
            "() => { const box = document.getElementById('view').getBoundingClientRect(), x = shell.shape;"
            "for (let i = 0; i < x.length; i += 30) { const [across, down] = projected(x.subarray(i, i + 3));"
            "if (across < 0 || across > box.width || down < 0 || down > box.height) return false; } return true; }"
        )
        assert inside
        page.click("#cards button >> nth=1")
        assert errors == []
        assert ms.card(page.inner_text("#cards button >> nth=0").split(" (")[0])
