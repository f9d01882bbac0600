"""The documentation says what the code does."""

import re

import pytest

from gcs.errors import Exit
from tests.support.docs import GENERATED, renewed
from tests.support.paths import DOCS

ROOT = DOCS.parent


def test_generated_parts_are_up_to_date(subtests: pytest.Subtests) -> None:
    for name in GENERATED:
        with subtests.test(name=name):
            assert (DOCS / name).read_text(encoding="utf-8") == renewed(name), "run python -m tests.support.docs"


def test_readme_holds_exactly_two_commands() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", readme, flags=re.DOTALL)
    assert [len(block.strip().splitlines()) for block in blocks] == [1, 1]
    assert blocks[1].strip().endswith("python -m tests"), ".ci/run looks for this line"


def test_links_lead_somewhere(subtests: pytest.Subtests) -> None:
    for document in sorted(ROOT.glob("*.md")) + sorted(DOCS.glob("*.md")):
        with subtests.test(document=document):
            targets = re.findall(r"\]\((?!https?://)([^)#]+)\)", document.read_text(encoding="utf-8"))
            assert [target for target in targets if not (document.parent / target).exists()] == []


def test_every_exit_code_is_documented() -> None:
    flying = (DOCS / "flying.md").read_text(encoding="utf-8")
    documented = {int(code) for code in re.findall(r"^\| (\d) \|", flying, flags=re.MULTILINE)}
    assert documented == {code.value for code in Exit}
