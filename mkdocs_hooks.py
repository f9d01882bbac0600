"""What `mkdocs build` does beside mkdocs.yml: notes enter the navigation, links into the sources become text."""

import re
from pathlib import Path
from posixpath import dirname, join, normpath

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.pages import Page

_LINK = re.compile(r"\[([^\]]*)\]\((\.\./[^)#\s]+)(#[^)\s]*)?\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the pages in docs/notes to the navigation."""
    notes = sorted(Path(config.docs_dir).glob("notes/*.md"))
    if notes and config.nav is not None:
        config.nav.append({"Engineering notes": [f"notes/{path.name}" for path in notes]})
    return config


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Turn links that leave docs/ into their text, for only docs/ is in the site; README.md is the entrance's."""
    folder = dirname(page.file.src_uri)

    def inside(link: re.Match[str]) -> str:
        target = normpath(join(folder, link[2]))
        if target == "../README.md":
            return f"[{link[1]}]({'../' * bool(folder)}index.md)"
        return link[1] if target.startswith("../") else link[0]

    return _LINK.sub(inside, markdown)
