"""What `mkdocs build` does beside mkdocs.yml: notes enter the navigation, links into the sources become text.

The operator's sheet gets a font, so that it prints on two sides whichever fonts a computer has.
"""

import re
from pathlib import Path
from posixpath import dirname, join, normpath

import mkdocs
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_LINK = re.compile(r"\[([^\]]*)\]\((\.\./[^)#\s]+)(#[^)\s]*)?\)")

_FONTS = Path(mkdocs.__file__).parent / "themes/readthedocs/css/fonts"
"""Lato, under the SIL Open Font License, as MkDocs brings it for another theme."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the pages in docs/notes to the navigation."""
    notes = sorted(Path(config.docs_dir).glob("notes/*.md"))
    if notes and config.nav is not None:
        config.nav.append({"Engineering notes": [f"notes/{path.name}" for path in notes]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Put the font of the operator's sheet beside site.css, which names its files."""
    for name in ("lato-normal.woff2", "lato-bold.woff2"):
        files.append(File.generated(config, f"site/{name}", abs_src_path=str(_FONTS / name)))
    return files


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """Turn links that leave docs/ into their text, for only docs/ is in the site; README.md is the entrance's."""
    folder = dirname(page.file.src_uri)

    def inside(link: re.Match[str]) -> str:
        target = normpath(join(folder, link[2]))
        if target == "../README.md":
            return f"[{link[1]}]({'../' * bool(folder)}index.md)"
        return link[1] if target.startswith("../") else link[0]

    return _LINK.sub(inside, markdown)
