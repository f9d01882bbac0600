"""The system's Chromium, as tests and experiments of the operator's page start it."""

import shutil

# WebGL without a graphics card, as in CI.
ARGUMENTS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
MISSING = "no chromium, chromium-browser or google-chrome is installed: apt-get install chromium"


def program() -> str | None:
    """Return the browser's path, None where none is installed."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
