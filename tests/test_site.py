"""The docs site builds without a warning, loads nothing from a network, and shows what the plain pages show."""

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from playwright.sync_api import expect

from tests.support.page.browser import launched
from tests.support.paths import DOCS, ROOT

pytestmark = pytest.mark.slow

_BLOCKS = re.compile(r"<(h[1-6]|li|pre|table|td|th|tr)[ >]")
_LOADED = re.compile(r"<(?:img|link|script|source)\b[^>]*?\b(?:href|src)=[\"']?(https?:|//)[^>]*>")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the site, built strictly: a broken link, anchor or omitted page fails here."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment, check=False)
    assert built.returncode == 0, built.stderr
    return folder


def test_pages_load_nothing_from_a_network(site: Path, subtests: pytest.Subtests) -> None:
    pages = sorted(site.rglob("*.html"))
    assert site / "index.html" in pages
    for page in pages:
        with subtests.test(page=page.name):
            assert not _LOADED.search(page.read_text(encoding="utf-8"))


def test_pages_have_the_blocks_that_a_forge_shows(site: Path, subtests: pytest.Subtests) -> None:
    """MkDocs reads Markdown by other rules than CommonMark: a list right below a paragraph would be none."""
    forge = MarkdownIt("commonmark").enable("table")
    for document in sorted(DOCS.rglob("*.md")):
        with subtests.test(document=document.name):
            page = site / document.relative_to(DOCS).with_suffix(".html")
            article = page.read_text(encoding="utf-8").partition("<article")[2].partition("</article>")[0]
            plain = forge.render(document.read_text(encoding="utf-8"))
            assert Counter(_BLOCKS.findall(article)) == Counter(_BLOCKS.findall(plain))


@pytest.mark.browser
def test_diagrams_are_drawn_and_the_operators_sheet_prints_on_two_sides(site: Path) -> None:
    requests: list[str] = []
    with launched() as browser:
        page = browser.new_page()
        page.on("request", lambda request: requests.append(request.url))
        for document in ("design", "notes/design"):
            page.goto((site / f"{document}.html").as_uri())
            diagrams = (DOCS / f"{document}.md").read_text(encoding="utf-8").count("```mermaid")
            assert diagrams
            expect(page.locator("div.mermaid")).to_have_count(diagrams)  # what is not drawn stays a `pre`
        page.goto((site / "operator.html").as_uri())
        page.evaluate("document.fonts.ready.then(() => null)")
        printed = page.pdf(prefer_css_page_size=True)
    assert len(re.findall(rb"/Type /Page\b", printed)) == 2
    fonts = {font.rpartition(b"+")[2] for font in re.findall(rb"/BaseFont /(\S+)", printed)}
    assert fonts == {b"Lato-Regular", b"Lato-Bold"}, "another font is one of this computer"
    assert not [url for url in requests if not url.startswith(("file:", "data:"))]
