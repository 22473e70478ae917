"""The viewer's pages, served by processes of their own, in a headless browser."""

import socket
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from io import BytesIO

import numpy as np
import pytest
from matplotlib.image import imread

import modalshell as ms


class Stopped(Exception):
    pass


@pytest.fixture(scope="module")
def serve(opengl):  # noqa: ARG001 (skips)
    """Starts servers in processes of their own; each call returns the address that its server prints."""
    pytest.importorskip("trame.app", reason="trame is not installed (pip install 'modalshell[web]')")
    pytest.importorskip("trame_vtk", reason="trame-vtk is not installed (pip install 'modalshell[web]')")
    servers = []

    def start(*arguments):
        command = [sys.executable, "-m", "modalshell", "view", *map(str, arguments), "--web", "--port", "0"]
        servers.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        line = servers[-1].stdout.readline()
        assert line.startswith("http://127.0.0.1:"), line
        return line.split()[0]

    yield start
    for server in servers:
        server.terminate()
        server.communicate()


@pytest.fixture(scope="module")
def page_address(serve, scene_text, tmp_path_factory):
    file = tmp_path_factory.mktemp("served") / "scene.toml"
    file.write_text(scene_text(), encoding="utf-8")
    return serve(file)


@pytest.mark.slow
def test_page_is_served_on_loopback_alone(page_address):
    with urllib.request.urlopen(page_address, timeout=20) as answer:
        assert b"<html" in answer.read()
    port = urllib.parse.urlsplit(page_address).port
    if sys.platform.startswith("linux"):  # where all of 127.0.0.0/8 is this machine
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.2", port), timeout=5)


@pytest.fixture
def open_page(browser):
    """Opens an address in a headless browser."""
    pages = []

    def opened(address):
        page = browser.new_page(viewport={"width": 1000, "height": 700})
        pages.append(page)
        page.set_default_timeout(60_000)
        page.goto(address)
        page.wait_for_selector("#picture")
        return page

    yield opened
    for page in pages:
        page.close()


@pytest.fixture
def page(open_page, page_address):
    return open_page(page_address)


def picture(page):
    return imread(BytesIO(page.locator("#picture").screenshot()))[..., :3]


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "nothing happened on the page"
        time.sleep(0.2)


def changed(page, before):
    return (np.abs(picture(page) - before).max(axis=2) > 0.1).mean() > 0.005


def settled_picture(page):
    """The picture once the shell is on it and the page has stopped laying itself out."""
    seen, calm = picture(page), 0

    def settled():
        nonlocal seen, calm
        before, seen = seen, picture(page)
        coloured = (np.ptp(seen, axis=2) > 0.1).mean() > 0.01
        same = coloured and before.shape == seen.shape and np.abs(seen - before).max() < 0.1
        calm = calm + 1 if same else 0
        return calm == 6

    wait_for(settled)
    return seen


@pytest.mark.slow
def test_page_plays_and_takes_gravity_model_and_modes(page):
    status = page.locator("#status")
    wait_for(lambda: "playing" in status.inner_text())  # from the start
    page.click("#play")
    wait_for(lambda: "paused" in status.inner_text())
    page.click("#reset")
    wait_for(lambda: "t = 0.00 s" in status.inner_text())
    still = settled_picture(page)

    page.click("#play")
    wait_for(lambda: changed(page, still))
    assert "playing" in status.inner_text()
    page.click("#play")
    wait_for(lambda: "paused" in status.inner_text())

    page.click("#reset")
    wait_for(lambda: "t = 0.00 s" in status.inner_text())
    wait_for(lambda: not changed(page, still))

    thumb = page.locator(".v-slider-thumb")
    modes, gravity_x = thumb.nth(0), thumb.nth(1)
    gravity_x.focus()
    page.keyboard.press("End")
    wait_for(lambda: "19.6" in page.get_by_text("Gravity x").inner_text())
    modes.focus()
    page.keyboard.press("ArrowRight")
    wait_for(lambda: "MWTS, 9 modes" in status.inner_text())

    page.locator("div[role=combobox]").click()
    page.get_by_role("option", name="DS", exact=True).click()
    wait_for(lambda: status.inner_text().startswith("DS;"))
    page.click("#play")
    wait_for(lambda: changed(page, still))
    page.click("#play")  # the tests that follow share the server: a motion that plays on would slow them


@pytest.mark.slow
def test_page_follows_a_run(serve, open_page, scene_file, tmp_path):
    out = tmp_path / "out"
    scene = scene_file(("duration = 1", "duration = 4.0"))

    def run_to(steps, each=lambda: None):
        def on_step(done, _total):
            if done == steps:
                each()
                raise Stopped

        with pytest.raises(Stopped):
            ms.run_scene(scene, out=out, on_step=on_step)

    run_to(1)
    page = open_page(serve("--attach", out))
    status = page.locator("#status")
    wait_for(lambda: status.inner_text() == "scene; frame 1; t = 0.0333333 s; stopped")
    still = settled_picture(page)

    def running():
        wait_for(lambda: "frame 13; t = 0.433333 s; running" in status.inner_text())
        wait_for(lambda: changed(page, still))

    run_to(13, running)
    wait_for(lambda: status.inner_text().endswith("stopped"))
    ms.run_scene(scene, out=out)
    wait_for(lambda: status.inner_text().endswith("frame 120; t = 4 s; finished: completed"))
