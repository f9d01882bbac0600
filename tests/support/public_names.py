"""The public names of `import cordon` with their signatures and docstrings, as they stand in the sources."""

import ast
import re
from collections.abc import Iterator
from inspect import cleandoc

import cordon
from tests.support.paths import ROOT

_DOCTEST = re.compile(r"\n*^>>> .*", re.DOTALL | re.MULTILINE)
_LINE_MAX = 100


def name_sections() -> str:
    """Return a section for each public name, functions first: what it is, and its fields and methods, as Markdown."""
    sections = {name: _section(name, *_defined(name)) for name in dir(cordon)}
    return "\n\n".join(sections[name] for name in sorted(sections, key=str.swapcase))


def _defined(name: str) -> tuple[ast.stmt, str]:
    """Return the statement that defines a public name, and its docstring."""
    path = ROOT / f"{cordon._HOMES[name].replace('.', '/')}.py"
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for at, node in enumerate(tree.body):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return node, ast.get_docstring(node) or ""
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return node, cleandoc(ast.literal_eval(tree.body[at + 1].value))  # type: ignore[attr-defined]
    raise LookupError(name)


def _section(name: str, node: ast.stmt, text: str) -> str:
    parts = [f"### {name}", "\n".join(["```py", *_signature(node), "```"]), _DOCTEST.sub("", text)]
    return "\n\n".join(parts)


def _signature(node: ast.stmt) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef):
        yield from _call(node, "")
    elif isinstance(node, ast.ClassDef):
        yield f"class {node.name}:"
        for each in node.body:
            if isinstance(each, ast.AnnAssign) and not ast.unparse(each.target).startswith("_"):
                yield f"    {_field(each)}"
        for method in _methods(node):
            yield f"    # {_summary(method)}"
            yield from _call(method, "    ")
    else:
        yield ast.unparse(node)


def _field(node: ast.AnnAssign) -> str:
    """Return a field with its type and default; of `field(...)` what it makes the default."""
    default = "" if node.value is None else f" = {ast.unparse(node.value)}"
    if isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "field":
        given = {each.arg: ast.unparse(each.value) for each in node.value.keywords}
        made = given.get("default") or (f"{given['default_factory']}()" if "default_factory" in given else "")
        default = f" = {made}" if made else ""
    return f"{ast.unparse(node.target)}: {_unquoted(node.annotation)}{default}"


def _unquoted(annotation: ast.expr) -> str:
    return ast.unparse(annotation).strip("'")


def _methods(node: ast.ClassDef) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for each in node.body:
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) and not each.name.startswith("_"):
            yield each


def _call(node: ast.FunctionDef | ast.AsyncFunctionDef, indent: str) -> Iterator[str]:
    """Return a function's signature, an argument to a line where it is long; a property's without arguments."""
    returns = f" -> {_unquoted(node.returns)}" if node.returns else ""
    if any("property" in ast.unparse(each) for each in node.decorator_list):
        yield f"{indent}{node.name}{returns}"
        return
    arguments = [each for each in _arguments(node.args) if each not in ("self", "cls")]
    name = f"{'async ' * isinstance(node, ast.AsyncFunctionDef)}{node.name}"
    line = f"{indent}{name}({', '.join(arguments)}){returns}"
    if len(line) <= _LINE_MAX:
        yield line
        return
    yield f"{indent}{name}("
    yield from (f"{indent}    {each}," for each in arguments)
    yield f"{indent}){returns}"


def _arguments(arguments: ast.arguments) -> Iterator[str]:
    missing = [None] * (len(arguments.args) - len(arguments.defaults))
    for each, default in zip(arguments.args, (*missing, *arguments.defaults), strict=True):
        yield _argument(each, default)
    if arguments.vararg or arguments.kwonlyargs:
        yield f"*{ast.unparse(arguments.vararg) if arguments.vararg else ''}"
    for each, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        yield _argument(each, default)
    if arguments.kwarg:
        yield f"**{ast.unparse(arguments.kwarg)}"


def _argument(argument: ast.arg, default: ast.expr | None) -> str:
    return ast.unparse(argument) + (f" = {ast.unparse(default)}" if default else "")


def _summary(node: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    return " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split()).replace("|", "\\|")
