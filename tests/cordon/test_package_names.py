"""Other distributions that have a name of cordon's packages: installed beside it, or found in its place."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from cordon.package_names import PACKAGES
from tests.support.paths import ROOT


def install(site: Path, distribution: str, files: dict[str, str]) -> None:
    """Put files where pip would put them, with the metadata that it writes."""
    info = f"{distribution.replace('-', '_')}-1.0.dist-info"
    files = {**files, f"{info}/METADATA": f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.0\n"}
    for name, text in files.items():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_text(text)
    record = "".join(f"{name},sha256=unread,{len(text)}\n" for name, text in files.items())
    (site / info / "RECORD").write_text(f"{record}{info}/RECORD,,\n")


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """An installation of what looks for other distributions: cordon, and of the other packages the top level."""
    own = [*(ROOT / "cordon").glob("*.py"), *(path for name in PACKAGES for path in (ROOT / name).glob("*.py"))]
    files = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="ascii", errors="replace") for path in own}
    install(
        tmp_path / "site",
        "cordon-gcs",
        {name: text.encode("ascii", "replace").decode() for name, text in files.items()},
    )
    return tmp_path / "site"


def said(*command: str, path: list[Path]) -> tuple[int, str]:
    """Run Python with these folders before all others; return its exit code and what it says on standard error."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path)), "PYTHONSAFEPATH": "1"}
    done = subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def test_nothing_is_said_of_an_installation_alone(site: Path) -> None:
    subprocess.run([sys.executable, "-m", "compileall", "-q", site], check=True)
    program = "import sys, cordon; assert 'importlib.metadata' not in sys.modules, 'it read the metadata of all'"
    assert said("-c", program, path=[site]) == (0, "")


@pytest.mark.parametrize(
    "others", [{"agents/toolbox.py": ""}, {"agents/__init__.py": "kit = 1\n"}, {"agents/kit/a.py": ""}]
)
def test_another_distribution_in_one_of_its_folders_is_named(site: Path, others: dict[str, str]) -> None:
    install(site, "agents-kit", others)
    code, words = said("-c", "import cordon", path=[site])
    assert code == 0
    for fact in ("agents-kit", "'agents'", str(site), "pipx", "uv tool", "venv"):
        assert fact in words
    assert not any(f"'{name}'" in words for name in PACKAGES if name != "agents")


def test_a_package_found_in_the_place_of_cordons_ends_the_command_line(site: Path, tmp_path: Path) -> None:
    install(tmp_path / "elsewhere", "ground", {"gcs/__init__.py": "raise RuntimeError('run')\n"})
    before = [tmp_path / "elsewhere", site]
    code, words = said("-m", "cordon", "--version", path=before)
    assert code == 2
    for fact in ("'gcs'", str(tmp_path / "elsewhere" / "gcs"), str(site), "pipx", "uv tool", "venv"):
        assert fact in words
    assert "Traceback" not in words


def test_a_package_that_is_missing_is_named(site: Path, tmp_path: Path) -> None:
    shutil.rmtree(site / "sitl")
    environment = {"PYTHONPATH": str(site)}
    done = subprocess.run(  # without this environment's own packages, which hold another sitl
        [sys.executable, "-S", "-P", "-c", "import cordon"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "'sitl'" in done.stderr
    assert "nowhere" in done.stderr
