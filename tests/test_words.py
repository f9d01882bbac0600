"""Texts for people use the field's terms: the search for former phrases that they no longer hold."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.structure import PACKAGES
from tests.support.paths import DOCS, ROOT

FORMER = (
    "all chance",
    "anybody",
    "believe",
    "believes",
    "bring one fault after another",
    "by and by",
    "by its own words",
    "central brain",
    "chronicle",
    "counts as much as it is sure",
    "dead-man",
    "errs",
    "every decision has to be what it was",
    "failsafes spoke",
    "first prototype",
    "free view",
    "graver",
    "grow old",
    "hardly believes",
    "hold by keys",
    "hurry",
    "in mid-flight",
    "in place of all",
    "in the midst",
    "left by resume",
    "lest",
    "lifeline",
    "listened to",
    "lively",
    "looked into",
    "make way",
    "makes way",
    "middle half",
    "muster",
    "no longer count",
    "no longer counts",
    "noses",
    "not watched any more",
    "nothing speaks against",
    "of one's own",
    "rival's",
    "see to it",
    "spoke",
    "stand down",
    "stands down",
    "tempt",
    "the pilot wins",
    "there is to say",
    "told late",
    "victim",
    "was tried",
    "we measured",
    "were tried",
    "what is not ideal",
    "what it is worth",
    "what no mission has to choose",
    "wish",
    "without a remark",
    "without end",
)
"""In lower case. Each is matched as a whole word, also over the end of a line."""
NAMES = ("nobody hears anybody", "nobody-hears-anybody")
"""Names of injected faults, which users write: they may hold former words."""
TEMPLATES = {".html", ".j2", ".js", ".toml"}


@pytest.fixture(scope="module")
def texts() -> list[tuple[str, str]]:
    """Every text for people with its place."""
    documents = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.glob("*.md")))
    found = [(path.name, _plain(path.read_text(encoding="utf-8"))) for path in documents]
    for path in (path for package in PACKAGES for path in sorted((ROOT / package).rglob("*"))):
        place = str(path.relative_to(ROOT))
        if path.suffix == ".py":
            found += [(f"{place}:{line}", text) for line, text in _strings(path)]
        elif path.suffix in TEMPLATES and "vendor" not in path.parts:
            found.append((place, _plain(path.read_text(encoding="utf-8"))))
    return found


def test_former_phrases_do_not_come_back(texts: list[tuple[str, str]]) -> None:
    former = re.compile(rf"\b(?:{'|'.join(map(re.escape, FORMER))})\b")
    assert [(place, phrase) for place, text in texts for phrase in former.findall(text)] == []


def test_a_phrase_is_found_over_the_end_of_a_line_and_in_parts_of_a_literal(tmp_path: Path) -> None:
    path = tmp_path / "program.py"
    path.write_text(
        '"""A former\n    phrase."""\nnumber = 1\ntext = f"{number} Former " "phrase"\n# A former phrase.\n'
    )
    assert {line for line, text in _strings(path) if "former phrase" in text} == {1, 4}


def _strings(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines and the texts of all string literals of a file, docstrings among them."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.JoinedStr):
            yield node.lineno, _plain("".join(map(_literal, node.values)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, _plain(node.value)


def _literal(part: ast.expr) -> str:
    return str(part.value) if isinstance(part, ast.Constant) else "{}"


def _plain(text: str) -> str:
    """Return a text in lower case and on one line, without the names of faults."""
    text = " ".join(text.lower().split())
    for name in NAMES:
        text = text.replace(name, "")
    return text
