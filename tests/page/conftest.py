"""Pages opened from the file system."""

import pytest


@pytest.fixture
def open_file(browser, tmp_path):
    """Opens a page from the file system, with the network off; returns it with a list of its errors."""
    contexts = []

    def opened(page):
        context = browser.new_context(offline=True, viewport={"width": 1000, "height": 640})
        context.set_default_timeout(120_000)  # software rendering on a busy machine
        contexts.append(context)
        shown, errors = context.new_page(), []
        shown.on("pageerror", lambda error: errors.append(str(error)))
        shown.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        shown.goto(page.save(tmp_path / "page.html").as_uri())
        shown.wait_for_selector("canvas")
        return shown, errors

    yield opened
    for context in contexts:  # else it goes on drawing
        context.close()


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
