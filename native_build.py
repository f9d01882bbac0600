"""Compile the floors of the tick with mypyc: the same sources, at installation.

`python native_build.py DIRECTORY` puts a compiled copy of `agents` and `estimation` into a directory; `hatch_build.py`
puts the compiled modules into a wheel. A source tree never holds compiled modules, so none is older than its source.

mypyc compiles classes of its own, whose attributes are machine numbers, but not the structs of msgspec. So the copy has
plain classes in place of the structs of the modules below. These have the same attributes, methods and defaults, and
compare and show as structs do. `msgspec.structs` and encoders do not take them.
"""

import ast
import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

PACKAGES = ("agents", "estimation")
COMPILED = (
    "agents/broadcast.py",
    "agents/control",
    "agents/core.py",
    "agents/ring",
    "agents/safety",
    "agents/setpoint",
    "agents/situation",
    "agents/team/clock_watch.py",
    "agents/team/credibility.py",
    "agents/team/ring_members.py",
    "agents/team/send_rate.py",
    "agents/team/team.py",
    "estimation/filters",
    "estimation/polar.py",
    "estimation/vectors.py",
)
"""What is compiled: whole folders, and single files. Nothing that is encoded."""
STAY_STRUCTS = frozenset({"_Track"})
"""Structs that `msgspec.structs.replace` takes."""
SUBCLASSED = frozenset({"VehicleCore"})
"""Classes with subclasses that are not compiled."""
OPEN = (
    "if TYPE_CHECKING: from mypy_extensions import mypyc_attr",
    "@mypyc_attr(allow_interpreted_subclasses=True)",
)
FLAGS = "-ffp-contract=off -fno-builtin -Wno-all"
"""No arithmetic that Python does not do: a compiled flight is bit for bit the same. No warnings about generated code:
without optimisation, looking for them takes three quarters of the compiler's time.
"""
SETUP = """
from mypyc.build import mypycify
from setuptools import setup
options = ["--ignore-missing-imports", "--follow-imports=silent"]
libraries = [(files, f"cordon_{{number}}") for number, files in enumerate({halves!r})]
modules = mypycify([*{files!r}, *options], opt_level="{level}", debug_level="0", separate=libraries)
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


def compiled_copy(root: Path, directory: Path, level: int = 2) -> list[Path]:
    """Copy the packages of a source tree into a directory, compile the copy there, and return its compiled modules.

    `level` is the C compiler's level of optimisation. Raises RuntimeError with the compiler's words when it fails.
    """
    if missing := no_compiler():
        raise RuntimeError(missing)
    for package in PACKAGES:
        shutil.copytree(root / package, directory / package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    files = [str(path.relative_to(directory)) for path in _sources(directory)]
    for file in files:
        path = directory / file
        path.write_text(native_source(path.read_text()))
    flags = "" if os.name == "nt" else f"{FLAGS} {os.environ.get('CFLAGS', '')}"
    program = SETUP.format(files=files, halves=_halves(directory, files), level=level)
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


def _sources(directory: Path) -> Iterator[Path]:
    for name in COMPILED:
        path = directory / name
        yield from [path] if path.is_file() else sorted(p for p in path.glob("*.py") if p.name != "__init__.py")


def native_source(source: str) -> str:
    """Return a module's source with plain classes in place of its structs, and all else on the line where it was."""
    lines, tree = source.splitlines(), ast.parse(source)
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and node.name not in STAY_STRUCTS and _is_struct(node):
            fields = [each for each in node.body if isinstance(each, ast.AnnAssign)]
            first, last = node.body[0].lineno, fields[-1].end_lineno or 0  # from the docstring to the last field
            members = _members(node, fields)
            assert len(members) <= last - first + 1, f"{node.name} needs a docstring"
            lines[first - 1 : last] = [*members, *[""] * (last - first + 1 - len(members))]
            lines[node.lineno - 1] = f"class {node.name}:"
        elif isinstance(node, ast.ClassDef) and node.name in SUBCLASSED:
            lines[node.lineno - 3 : node.lineno - 1] = OPEN  # in place of the two blank lines before the class
            lines[(tree.body[0].end_lineno or 1) - 1] += "; from typing import TYPE_CHECKING"
    return "\n".join(lines) + "\n"


def _is_struct(node: ast.ClassDef) -> bool:
    return any(ast.unparse(base) == "msgspec.Struct" for base in node.bases)


def _members(node: ast.ClassDef, fields: list[ast.AnnAssign]) -> list[str]:
    names = [ast.unparse(field.target) for field in fields]
    arguments = [
        f"{ast.unparse(field.target)}: {ast.unparse(field.annotation)}"
        + ("" if field.value is None else f" = {ast.unparse(field.value)}")
        for field in fields
    ]
    equal = " and ".join(f"self.{name} == other.{name}" for name in names)
    shown = ", ".join(f"{name}={{self.{name}!r}}" for name in names)
    return [
        f"    def __init__(self, {', '.join(arguments)}) -> None: " + "; ".join(f"self.{n} = {n}" for n in names),
        f"    def __eq__(self, other: object) -> bool: return isinstance(other, {node.name}) and {equal}",
        f'    def __repr__(self) -> str: return f"{node.name}({shown})"',
    ]


if __name__ == "__main__":
    compiled_copy(Path(__file__).parent, Path(sys.argv[1]))
