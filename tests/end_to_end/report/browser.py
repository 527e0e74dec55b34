"""A real browser for the pages: Chromium under playwright.

A test module takes the fixture: `from tests.end_to_end.report import browser as chromium`,
then `browser = chromium.browser`.
Its scope is the module, not the session: while playwright's loop runs, no other test could run one.
"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from tests.patience import PATIENCE

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
Scheme = Literal["light", "dark"]


@dataclass(frozen=True, slots=True)
class Watched:
    """An open page with its errors and requests."""

    page: Page
    errors: list[str] = field(default_factory=list)
    """Messages of console.error and uncaught exceptions."""
    requests: list[str] = field(default_factory=list)
    """URLs, the page itself included."""

    def shown(self) -> None:
        """Wait until the page has drawn report data."""
        self.page.wait_for_selector("html[data-drawn]")

    def drawn(self) -> int:
        """Return how often the page has drawn report data."""
        return int(self.page.evaluate("Number(document.documentElement.dataset.drawn || 0)"))

    def overflow(self) -> int:
        """Return by how many pixels the page is wider than its window."""
        return int(self.page.evaluate("document.documentElement.scrollWidth - window.innerWidth"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Return a Chromium without a window; the tests are skipped where none is installed."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("there is no Chromium here: apt-get install chromium")
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        try:
            yield found
        finally:
            found.close()


@contextmanager
def watched(
    browser: Browser, *, width: int = 1280, scheme: Scheme = "light", any_certificate: bool = False
) -> Iterator[Watched]:
    """Open an empty page whose errors and requests are kept."""
    context = browser.new_context(
        viewport={"width": width, "height": 900},
        color_scheme=scheme,
        has_touch=width < 500,
        device_scale_factor=1,
        ignore_https_errors=any_certificate,
    )
    context.set_default_timeout(1000 * PATIENCE)
    try:
        page = context.new_page()
        watch = Watched(page)
        page.on("console", lambda message: watch.errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: watch.errors.append(str(error)))
        page.on("request", lambda request: watch.requests.append(request.url))
        yield watch
    finally:
        context.close()
