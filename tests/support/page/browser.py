"""The system's Chromium, as tests and experiments of the operator's page start it."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, sync_playwright

# WebGL without a graphics card, as in CI.
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
DRAWN_BY_CPU = ("--disable-gpu-compositing", "--disable-gpu-rasterization")
"""Only the map is drawn by the emulated graphics card: the rest of a page would take twice the processor there."""
MISSING = "no chromium, chromium-browser or google-chrome is installed: apt-get install chromium"


def program() -> str | None:
    """Return the browser's path, None where none is installed."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def launched() -> Iterator[Browser]:
    """Yield a browser; without one the test is skipped."""
    path = program()
    if path is None:
        pytest.skip(MISSING)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*ARGUMENTS, *DRAWN_BY_CPU])
        yield browser
        browser.close()
