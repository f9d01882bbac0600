"""What the tests run: the installation, compiled where there is a C compiler, or the sources."""

import json
import os
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path

from native_build import compiled_files, no_compiler
from tests.structure import PACKAGES
from tests.support.paths import ROOT

AGAIN = ".venv/bin/pip install '.[dev]'"


def place() -> Path:
    """Return the folder in which Python finds the packages."""
    found = find_spec("cordon")
    assert found is not None
    assert found.origin is not None
    return Path(found.origin).resolve().parent.parent


def compiled(at: Path) -> bool:
    """Return whether the packages in a folder are compiled."""
    return any(at.glob("agents/core.*.so"))


def description() -> str:
    """Return in a line what is tested."""
    at = place()
    return f"tested: {'the sources' if at == ROOT else 'the installation'} in {at}, " + (
        "compiled" if compiled(at) else "as Python"
    )


def fault(at: Path, sources: Path = ROOT) -> str:
    """Return why tests of the packages in a folder would not be of these sources; empty if they are.

    An installation has to hold the same files, and all compiled modules where there is a C compiler, unless
    CORDON_COMPILE is 0. Sources run where they are installed as such, or by PYTHONPATH.
    """
    if at == sources:
        return "" if runs_sources() else f"Python finds the sources in {at} before the installation"
    if different := sorted(_different(at, sources)):
        return f"{at} does not hold these sources: {', '.join(different[:5])} differ: {AGAIN}"
    if os.environ.get("CORDON_COMPILE") == "0" or no_compiler():
        return ""
    missing = [name for name in compiled_files(sources) if not any(at.glob(f"{name.removesuffix('.py')}.*.so"))]
    return f"{at} lacks compiled modules, as of {missing[0]}: CORDON_COMPILE=1 {AGAIN}" if missing else ""


def runs_sources() -> bool:
    """Return whether the sources are to run: by PYTHONPATH, by an editable installation, or as there is no other."""
    if str(ROOT) in os.environ.get("PYTHONPATH", "").split(os.pathsep):
        return True
    try:
        text = distribution("cordon-gcs").read_text("direct_url.json")
    except PackageNotFoundError:
        return True
    return bool(json.loads(text or "{}").get("dir_info", {}).get("editable"))


def _different(at: Path, sources: Path) -> Iterator[str]:
    for package in PACKAGES:
        for path in (sources / package).rglob("*"):
            name = path.relative_to(sources)
            if path.is_file() and path.suffix not in (".pyc", ".so"):
                installed = at / name
                if not installed.is_file() or installed.read_bytes() != path.read_bytes():
                    yield name.as_posix()
