"""Compile the floors of the tick with mypyc: the same sources, at installation.

`python native_build.py DIRECTORY` puts a compiled copy of `agents`, `estimation` and `sitl` into a directory;
`hatch_build.py` puts the compiled modules into a wheel. A source tree never holds compiled modules, so none is older
than its source.

The copy is compiled as it is. mypyc makes native classes, whose attributes are machine numbers, from plain classes, not
from structs of msgspec. So what a tick makes and reads most is a plain class in the source, with attributes that are
`Final`. What is encoded, or changed by `msgspec.structs`, is a struct in both.
"""

import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

PACKAGES = ("agents", "estimation", "sitl")
COMPILED = (
    "agents/broadcast.py",
    "agents/control",
    "agents/core.py",
    "agents/gimbal.py",
    "agents/ring",
    "agents/safety",
    "agents/setpoint.py",
    "agents/situation",
    "agents/team/clock_watch.py",
    "agents/team/consistency_check.py",
    "agents/team/inbox.py",
    "agents/team/numbers.py",
    "agents/team/ring_members.py",
    "agents/team/send_rate.py",
    "agents/team/team.py",
    "estimation/filters",
    "estimation/plant/watch.py",
    "estimation/polar.py",
    "estimation/vectors.py",
    "sitl/simulation",
    "sitl/vehicle",
    "sitl/world.py",
)
"""What is compiled: whole folders, and single files."""
INTERPRETED = ("agents/control/plan.py", "agents/situation/task.py")
"""What is not, in these folders: the public interface. Compiled methods have no docstrings, which `help` shows."""
FLAGS = "-ffp-contract=off -fno-builtin -Wno-all"
"""No arithmetic that Python does not do: a compiled flight is bit for bit the same. No warnings about generated code.
"""
SETUP = """
from mypyc.build import mypycify
from setuptools import setup
options = ["--config-file=", "--ignore-missing-imports", "--follow-imports=silent"]
libraries = [(files, f"cordon_{{number}}") for number, files in enumerate({halves!r})]
modules = mypycify([*{files!r}, *options], opt_level="2", debug_level="0", separate=libraries)
setup(name="cordon-compiled", ext_modules=modules, script_args=["-q", "build_ext", "--inplace", "--parallel=2"])
"""
"""Two libraries, which are compiled side by side, with no debug information, which would take as long again."""


def no_compiler() -> str:
    """Return why nothing can be compiled here, or an empty string where the compiler of setuptools compiles."""
    command = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    with TemporaryDirectory() as directory:
        source = Path(directory, "probe.c")
        source.write_text("#include <Python.h>\n")
        arguments = ["-I", sysconfig.get_path("include"), "-c", str(source), "-o", str(source.with_suffix(".o"))]
        try:
            result = subprocess.run([*command, *arguments], check=False, capture_output=True, text=True)
        except OSError as error:
            return f"no C compiler: {error}"
        if result.returncode != 0 or not source.with_suffix(".o").exists():
            return f"the C compiler {shlex.join(command)} does not compile Python.h: {result.stderr.strip()}"
    return ""


def compiled_copy(root: Path, directory: Path) -> list[Path]:
    """Copy the packages of a source tree into a directory, compile the copy there, and return its compiled modules.

    Raises RuntimeError with the compiler's words when it fails.
    """
    if missing := no_compiler():
        raise RuntimeError(missing)
    for package in PACKAGES:
        shutil.copytree(root / package, directory / package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    files = compiled_files(directory)
    flags = "" if os.name == "nt" else f"{FLAGS} {os.environ.get('CFLAGS', '')}"
    program = SETUP.format(files=files, halves=_halves(directory, files))
    environment = {**os.environ, "CFLAGS": flags, "MYPYPATH": str(directory)}
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=directory, env=environment, check=False, capture_output=True, text=True)
    if result.returncode != 0:
        raise RuntimeError(f"mypyc or the C compiler failed:\n{result.stdout}{result.stderr}")
    shutil.rmtree(directory / "build")
    return sorted(path for path in directory.rglob("*") if path.suffix in (".so", ".pyd"))


def _halves(directory: Path, files: list[str]) -> tuple[list[str], list[str]]:
    """Return the files in two lists of about the same size in bytes, as compiling takes time by size."""
    sizes = {file: (directory / file).stat().st_size for file in files}
    halves: tuple[list[str], list[str]] = [], []
    for file in sorted(files, key=sizes.__getitem__, reverse=True):
        min(halves, key=lambda half: sum(map(sizes.__getitem__, half))).append(file)
    return halves


def compiled_files(root: Path) -> list[str]:
    """Return the files of a source tree that are compiled, relative to it."""
    found = [path for name in COMPILED for path in (_modules(root / name) if (root / name).is_dir() else [root / name])]
    return [name for path in found if (name := path.relative_to(root).as_posix()) not in INTERPRETED]


def _modules(folder: Path) -> Iterator[Path]:
    yield from sorted(path for path in folder.glob("*.py") if path.name != "__init__.py")


if __name__ == "__main__":
    compiled_copy(Path(__file__).parent, Path(sys.argv[1]))
