"""Texts for people use the field's terms: a list of former phrases that they no longer hold."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.structure import PACKAGES
from tests.support.paths import DOCS, ROOT

FORMER = ()
"""Phrases in lower case, matched as whole words. The terms to use are in docs/glossary.md, or in the text's neighbours."""
NAMES = ("nobody hears anybody", "nobody-hears-anybody")
"""Names of injected faults, which users write."""
PAGES = {".html", ".j2", ".js", ".toml"}


def test_former_phrases_do_not_come_back(subtests: pytest.Subtests) -> None:
    for phrase in FORMER:
        with subtests.test(phrase=phrase):
            assert [place for place, text in TEXTS if re.search(rf"\b{re.escape(phrase)}\b", text)] == []


def test_the_search_reads_all_texts_for_people() -> None:
    for shown in (
        "every vehicle is separate",
        "fly a mission over mavlink and zenoh",
        ):
        assert any(shown in text for _, text in TEXTS)


def _texts() -> Iterator[tuple[str, str]]:
    """Yield every text for people, in lower case and on one line, with its place."""
    for path in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md"))):
        yield path.name, _plain(path.read_text(encoding="utf-8"))
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            place = str(path.relative_to(ROOT))
            if path.suffix == ".py":
                yield from ((f"{place}:{line}", text) for line, text in _strings(path))
            elif path.suffix in PAGES and "vendor" not in path.parts:
                yield place, _plain(path.read_text(encoding="utf-8"))


def _strings(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines and the texts of string literals and docstrings; values inside a text are left out."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            yield node.lineno, _plain("".join(map(_literal, node.values)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, _plain(node.value)


def _literal(part: ast.expr) -> str:
    return str(part.value) if isinstance(part, ast.Constant) else "{}"


def _plain(text: str) -> str:
    text = " ".join(text.lower().split())
    for name in NAMES:
        text = text.replace(name, "")
    return text


TEXTS = tuple(_texts())
