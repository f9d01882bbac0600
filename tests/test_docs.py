"""The documentation says what the code does."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import get_args

import pytest

import cordon
from agents.team.verbs import VERBS, CommandVerb
from gcs.errors import Exit
from tests.support.docs import GENERATED, renewed
from tests.support.equations import NUMBER, docstrings, implementations
from tests.support.paths import DOCS

ROOT = DOCS.parent
READS_A_LOG = {"logs"}
"""Documents whose first piece of Python reads `flight.mcap`."""


def test_generated_parts_are_up_to_date(subtests: pytest.Subtests) -> None:
    for name in GENERATED:
        with subtests.test(name=name):
            assert (DOCS / name).read_text(encoding="utf-8") == renewed(name), "run python -m tests.support.docs"


def test_every_equation_of_the_paper_is_implemented() -> None:
    assert sorted(implementations()) == list(range(1, 27))


def test_docstrings_cite_equations_that_the_paper_has() -> None:
    wrong = {
        name: number for name, text in docstrings() for number in re.findall(NUMBER, text) if not 1 <= int(number) <= 26
    }
    assert not wrong


def test_readme_holds_exactly_two_commands() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```sh\n(.*?)```", readme, flags=re.DOTALL)
    assert [len(block.strip().splitlines()) for block in blocks] == [1, 1]
    assert blocks[1].strip().endswith("python -m tests"), ".ci/run looks for this line"


def test_all_state_one_version() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    cited = re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    released = re.findall(
        r"^## (.+) - \d{4}-\d\d-\d\d$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert [cited, released[0]] == [[version], version]


def test_links_lead_somewhere(subtests: pytest.Subtests) -> None:
    for document in sorted(ROOT.glob("*.md")) + sorted(DOCS.rglob("*.md")) + sorted(DOCS.glob("*/*.ipynb")):
        with subtests.test(document=document):
            targets = re.findall(r"\]\((?!https?://)([^)#]+)\)", document.read_text(encoding="utf-8"))
            assert [target for target in targets if not (document.parent / target).exists()] == []


def test_python_in_documents_runs(
    subtests: pytest.Subtests, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A document's pieces run one after the other, as a reader would run them, in a folder with a log of a flight."""
    ran = set()
    for document in (ROOT / "README.md", *sorted(DOCS.glob("*.md"))):
        pieces = re.findall(r"^```python\n(.*?)^```", document.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        names: dict[str, object] = {}
        (folder := tmp_path / document.stem).mkdir()
        monkeypatch.chdir(folder)
        if document.stem in READS_A_LOG:
            cordon.simulate("case2", duration_s=5.0, log="flight.mcap")
        for number, piece in enumerate(pieces, start=1):
            with subtests.test(document=document.name, piece=number):
                exec(compile(piece, f"{document.name}, piece {number}", "exec"), names)
                ran.add(document.stem)
    assert ran >= {"python", "logs"}


def test_every_verb_and_its_key_are_documented(subtests: pytest.Subtests) -> None:
    rows = [
        line.split("|")[1:3] for line in (DOCS / "flying.md").read_text(encoding="utf-8").splitlines() if "|" in line
    ]
    for verb in get_args(CommandVerb):
        with subtests.test(verb=verb):
            assert [key.strip()[:1] for key, name in rows if name.strip().startswith(f"`{verb}")] == [VERBS[verb].key]


def test_every_exit_code_is_documented() -> None:
    page = (DOCS / "json.md").read_text(encoding="utf-8").partition("## Exit codes")[2]
    documented = {int(code) for code in re.findall(r"^\| (\d) \|", page, flags=re.MULTILINE)}
    assert documented == {code.value for code in Exit}


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd judges its units")
@pytest.mark.parametrize("unit", sorted(DOCS.glob("onboard/*.service")), ids=lambda unit: unit.name)
def test_services_have_few_rights(unit: Path) -> None:
    judged = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=30", f"./{unit.name}"],
        cwd=unit.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    if "unrecognized option" in judged.stderr:
        pytest.skip("this version of systemd judges running services only")
    assert judged.returncode == 0, judged.stdout + judged.stderr
    keys = dict(line.split("=", 1) for line in unit.read_text(encoding="utf-8").splitlines() if "=" in line)
    assert (keys["UMask"], keys["SystemCallErrorNumber"], keys["CapabilityBoundingSet"]) == ("0077", "EPERM", "")
    assert int(keys["LimitNOFILE"]) > 10_000
    assert keys["MemoryMax"]
