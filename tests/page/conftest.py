"""Pages opened from the file system."""

import pytest

SELDOM = "{ const often = requestAnimationFrame; requestAnimationFrame = f => setTimeout(() => often(f), 100); }"
"""A page that draws ten times a second: software draws on every core for as long as a page is open."""


@pytest.fixture
def open_page(browser):
    """Opens a file, with the network off, in a window of a size; returns the page with a list of its errors."""
    contexts = []

    def opened(file, size=(800, 512), **options):
        context = browser.new_context(offline=True, viewport={"width": size[0], "height": size[1]}, **options)
        context.set_default_timeout(120_000)  # software rendering on a busy machine
        context.add_init_script(SELDOM)
        contexts.append(context)
        shown, errors = context.new_page(), []
        shown.on("pageerror", lambda error: errors.append(str(error)))
        shown.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        shown.goto(file.as_uri())
        shown.wait_for_selector("canvas")
        return shown, errors

    yield opened
    for context in contexts:  # else it goes on drawing
        context.close()


@pytest.fixture
def open_file(open_page, tmp_path):
    """Opens a page as a file."""
    return lambda page: open_page(page.save(tmp_path / "page.html"))


@pytest.fixture(scope="session")
def wait_until():
    """Waits for an expression of a page to be true; Playwright's own waiting needs eval, which the pages forbid."""

    def wait(page, expression):
        for _ in range(300):
            if page.evaluate(f"() => {expression}"):
                return
            page.wait_for_timeout(100)
        raise AssertionError(f"never true: {expression}")

    return wait
