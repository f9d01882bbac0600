"""The structure of the packages in figures: `python -m tests.structure`.

A circle is a set of siblings - files or folders of one folder - that import one another, directly or through others.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("cordon", "gcs", "agents", "sitl", "estimation")
FUNCTION_LINES_MAX = 40
FILE_LINES_MAX = 400
"""More is reported: a length is a reason to look, not a fault."""
_TEXT = re.compile(
    "advice|alert|because|cause|clause|condition|detail|did|ended|ending|fault|finding|found|headline|how|lacks|mode|"
    "note|problem|reason|refusal|sentence|subject|tactic|text|title|why"
)
"""Attributes and variables that hold text for people, or the name of a member of an enumeration."""
_LABEL = re.compile("get_(label|text|title|xlabel|ylabel)")
_TAKES_APART = re.compile("(starts|ends)with|r?partition|r?split|splitlines|remove(pre|suf)fix|r?find|r?index|count")
_SEARCHES = re.compile("match|search|fullmatch|findall|finditer")
_UNCHANGED = re.compile("lower|upper|[lr]?strip|casefold")


def sources() -> list[Path]:
    """Return the Python files of the packages, relative to the project's folder."""
    return sorted(path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def files_per_folder(files: list[Path]) -> dict[str, int]:
    """Return how many Python files stand at the top level of each folder."""
    folders = [path.parent.as_posix() for path in files]
    return {folder: folders.count(folder) for folder in sorted(set(folders))}


def long_functions(files: list[Path]) -> list[str]:
    """Return the functions of more than `FUNCTION_LINES_MAX` lines, each with its place and length."""
    rows = []
    for path in files:
        for node in ast.walk(_tree(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if length > FUNCTION_LINES_MAX:
                    rows.append(f"{path.as_posix()}:{node.lineno} {node.name}: {length} lines")
    return rows


def long_files(files: list[Path]) -> list[str]:
    """Return the files of more than `FILE_LINES_MAX` lines, each with its length."""
    rows = [(path.as_posix(), len(_text(path).splitlines())) for path in files]
    return [f"{name}: {count} lines" for name, count in rows if count > FILE_LINES_MAX]


def unseeded_generators(files: list[Path]) -> list[str]:
    """Return the places that make a random generator without a seed, which the linter has no rule for."""
    calls = ((path, node) for path in files for node in ast.walk(_tree(path)) if isinstance(node, ast.Call))
    return [
        f"{path.as_posix()}:{node.lineno} {ast.unparse(node)}"
        for path, node in calls
        if not node.args and not node.keywords and ast.unparse(node.func).endswith("default_rng")
    ]


def repeated_classes(files: list[Path]) -> list[str]:
    """Return the names of classes that several files define, each with its places: one name means one thing."""
    places: dict[str, dict[str, int]] = {}
    for path in files:
        for node in ast.walk(_tree(path)):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, {}).setdefault(path.as_posix(), node.lineno)
    return [
        f"{name}: {', '.join(f'{path}:{line}' for path, line in found.items())}"
        for name, found in sorted(places.items())
        if len(found) > 1
    ]


def parsed_texts(files: list[Path]) -> list[str]:
    """Return the places that take text apart which other code wrote: text is for people, values carry its content.

    What comes from outside is parsed once, in a function that takes it as its argument `text`.
    """
    return [
        f"{path.as_posix()}:{node.lineno} {ast.unparse(node)}"
        for path in files
        for node, arguments in _nodes(_tree(path))
        if isinstance(node, ast.Call | ast.Compare)
        and _parses(node, partial(_is_text, from_outside="text" in arguments))
    ]


def file_circles(files: list[Path]) -> list[str]:
    """Return one circle of files that import one another, empty if there is none."""
    return _circle(_imports(files))


def folder_circles(files: list[Path]) -> list[str]:
    """Return, for each folder whose files and folders import one another in a circle, one such circle."""
    found: list[str] = []
    imports = _imports(files)
    for parent in sorted({module.rpartition(".")[0] for module in imports} | {""}):
        siblings: dict[str, set[str]] = {}
        for module, imported in imports.items():
            own = _child(parent, module)
            others = {_child(parent, each) for each in imported} - {own, ""}
            if own:
                siblings.setdefault(own, set()).update(others)
        found += _circle(siblings)
    return found


def _imports(files: list[Path]) -> dict[str, set[str]]:
    """Return the modules of the packages that each module imports, wherever in its file but for type checking alone."""
    modules = {_module(path): path for path in files}
    return {module: set(_imported(_tree(path), modules)) - {module} for module, path in modules.items()}


def _imported(tree: ast.Module, modules: Mapping[str, Path]) -> Iterator[str]:
    typing_only = {id(node) for block in ast.walk(tree) if _is_type_checking(block) for node in ast.walk(block)}
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                yield from (name for name in (submodule, node.module) if name in modules and name not in PACKAGES)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)


def _is_type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def _module(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _child(parent: str, module: str) -> str:
    """Return the child of `parent` that is, or holds, a module; empty if none does."""
    prefix = f"{parent}." if parent else ""
    if not module.startswith(prefix):
        return ""
    return prefix + module.removeprefix(prefix).partition(".")[0]


def _circle(graph: Mapping[str, set[str]]) -> list[str]:
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return [" -> ".join(reversed(error.args[1]))]
    return []


def _nodes(node: ast.AST, arguments: frozenset[str] = frozenset()) -> Iterator[tuple[ast.AST, frozenset[str]]]:
    """Return all nodes below one, each with the names of the arguments of the functions around it."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
        arguments |= {each.arg for each in ast.walk(node.args) if isinstance(each, ast.arg)}
    yield node, arguments
    for child in ast.iter_child_nodes(node):
        yield from _nodes(child, arguments)


def _is_text(node: ast.expr, from_outside: bool) -> bool:
    """Return whether an expression is text for people; the variable `text` is not if it is `from_outside`."""
    match node:
        case ast.Name(id="text"):
            return not from_outside
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return _TEXT.fullmatch(name) is not None
        case ast.Call(func=ast.Attribute(value=value, attr=name)):
            unchanged = _UNCHANGED.fullmatch(name) and _is_text(value, from_outside)
            return bool(_LABEL.fullmatch(name) or unchanged)
    return False


def _parses(node: ast.AST, is_text: Callable[[ast.expr], bool]) -> bool:
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr=name), args=arguments):
            parsed = [value] if _TAKES_APART.fullmatch(name) else arguments if _SEARCHES.fullmatch(name) else []
            return any(map(is_text, parsed))
        case ast.Compare(left=left, comparators=others):
            return any(map(is_text, (left, *others))) and any(_is_literal(each) for each in (left, *others))
    return False


def _is_literal(node: ast.expr) -> bool:
    """Return whether an expression is text written out, or a sequence with such; the empty text stands for none."""
    match node:
        case ast.Constant(value=value):
            return isinstance(value, str) and bool(value)
        case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Set(elts=parts):
            return any(map(_is_literal, parts))
    return isinstance(node, ast.JoinedStr)


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(_text(path))


def _text(path: Path) -> str:
    return (ROOT / path).read_text(encoding="utf-8")


def main() -> int:
    """Print the figures, and return 1 if the structure breaches a rule."""
    files = sources()
    for folder, count in files_per_folder(files).items():
        print(f"{count:4d} files  {folder}")
    for package in PACKAGES:
        lines = [len(_text(path).splitlines()) for path in files if path.parts[0] == package]
        print(f"{sum(lines):6d} lines  {package} ({len(lines)} files, the longest {max(lines)})")
    faults = {
        "circles of files": file_circles(files),
        "circles of folders": folder_circles(files),
        "class names that several files define": repeated_classes(files),
        "random generators without a seed": unseeded_generators(files),
        "texts taken apart": parsed_texts(files),
    }
    lengths = {
        f"functions over {FUNCTION_LINES_MAX} lines": long_functions(files),
        f"files over {FILE_LINES_MAX} lines": long_files(files),
    }
    for title, rows in (faults | lengths).items():
        print(f"{title}: {len(rows)}", *rows, sep="\n  ")
    return int(any(faults.values()))


if __name__ == "__main__":
    sys.exit(main())
