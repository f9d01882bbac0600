"""The public names of `import cordon` with their signatures and docstrings, as they stand in the sources.

Types are plain ones: names of other types of the project, such as `Pair`, are replaced by what they stand for.
"""

import ast
import re
from collections.abc import Iterator
from copy import deepcopy
from functools import cache
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
    module = cordon._HOMES[name]
    body = _body(module)
    for at, node in enumerate(body):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return _Plainly(module).visit(deepcopy(node)), ast.get_docstring(node) or ""
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            plain = ast.Assign(node.targets, _Plain(module).visit(deepcopy(node.value)), lineno=0)
            return plain, cleandoc(ast.literal_eval(body[at + 1].value))  # type: ignore[attr-defined]
    raise LookupError(name)


@cache
def _body(module: str) -> list[ast.stmt]:
    """Return the statements of a module of the project, none for others."""
    path = ROOT / f"{module.replace('.', '/')}.py"
    return ast.parse(path.read_text(encoding="utf-8")).body if path.exists() else []


def _stands_for(module: str, name: str) -> tuple[str, ast.expr] | None:
    """Return the type that a name of a module stands for, with the module that defines it; None for a class."""
    for node in _body(module):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return module, node.value
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for each in node.names:
                if (each.asname or each.name) == name:
                    return _stands_for(node.module, each.name)
    return None


class _Plain(ast.NodeTransformer):
    """Makes a type of a module plain: without quotes, without annotations, and without names for other types."""

    def __init__(self, module: str) -> None:
        self._module = module

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return self._plain(ast.parse(node.value, mode="eval").body) if isinstance(node.value, str) else node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        name, parts = ast.unparse(node.value), node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if name == "Annotated":
            return self._plain(parts[0])
        if name == "Literal":
            named = [self._plain(each) if isinstance(each, ast.Name) else ast.Tuple([each]) for each in parts]
            slices = [each.slice if isinstance(each, ast.Subscript) else each for each in named]
            return ast.Subscript(node.value, ast.Tuple([each for words in slices for each in words.elts]))  # type: ignore[attr-defined]
        self.generic_visit(node)
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        stands_for = None if node.id in dir(cordon) else _stands_for(self._module, node.id)
        if stands_for is None:
            return node
        module, value = stands_for
        return _Plain(module)._plain(deepcopy(value))

    def _plain(self, node: ast.expr) -> ast.expr:
        plain: ast.expr = self.visit(node)
        return plain


class _Plainly(ast.NodeTransformer):
    """Makes the types of fields, arguments and results of a definition plain."""

    def __init__(self, module: str) -> None:
        self._plain = _Plain(module)

    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        for field in ("annotation", "returns"):
            if (given := getattr(node, field, None)) is not None:
                setattr(node, field, self._plain.visit(given))
        return node


def _section(name: str, node: ast.stmt, text: str) -> str:
    lines = [line if line.lstrip().startswith("#") else line.replace("'", '"') for line in _signature(node)]
    parts = [f"### {name}", "\n".join(["```py", *lines, "```"]), _DOCTEST.sub("", text)]
    return "\n\n".join(parts)


def _signature(node: ast.stmt) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef):
        yield from _call(node, "")
    elif isinstance(node, ast.ClassDef):
        yield f"class {node.name}{'(Enum)' if _is_enumeration(node) else ''}:"
        yield from (f"    {each}" for each in _attributes(node) if not each.startswith("_"))
        for method in _methods(node):
            yield f"    # {_summary(method)}"
            yield from _call(method, "    ")
    elif len(ast.unparse(node)) > _LINE_MAX and isinstance(node, ast.Assign) and isinstance(node.value, ast.Subscript):
        yield f"{ast.unparse(node.targets[0])} = {ast.unparse(node.value.value)}["
        yield from (f"    {ast.unparse(each)}," for each in node.value.slice.elts)  # type: ignore[attr-defined]
        yield "]"
    else:
        yield ast.unparse(node)


def _attributes(node: ast.ClassDef) -> Iterator[str]:
    """Return the fields of a class, the members of an enumeration, and what the class gives each instance."""
    for each in node.body:
        if isinstance(each, ast.AnnAssign):
            yield _field(each)
        elif isinstance(each, ast.Assign) and _is_enumeration(node):
            yield ast.unparse(each)
        elif isinstance(each, ast.FunctionDef) and each.name == "__init__":
            yield from _given(each)


def _is_enumeration(node: ast.ClassDef) -> bool:
    return any(ast.unparse(base) == "Enum" for base in node.bases)


def _given(node: ast.FunctionDef) -> Iterator[str]:
    """Return the attributes that a class gives each instance, of which the type is stated, or an argument's."""
    of_arguments = {each.arg: each.annotation for each in (*node.args.args, *node.args.kwonlyargs)}
    for each in node.body:
        if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Attribute):
            stated = each.annotation
            if isinstance(stated, ast.Subscript) and ast.unparse(stated.value) == "Final":
                stated = stated.slice
            if ast.unparse(stated) == "Final" and each.value:
                stated = of_arguments[ast.unparse(each.value)] or stated
            yield f"{each.target.attr}: {ast.unparse(stated)}"


def _field(node: ast.AnnAssign) -> str:
    """Return a field with its type and default; of `field(...)` what it makes the default."""
    default = "" if node.value is None else f" = {ast.unparse(node.value)}"
    if isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "field":
        given = {each.arg: ast.unparse(each.value) for each in node.value.keywords}
        made = given.get("default") or (f"{given['default_factory']}()" if "default_factory" in given else "")
        default = f" = {made}" if made else ""
    return f"{ast.unparse(node.target)}: {ast.unparse(node.annotation)}{default}"


def _methods(node: ast.ClassDef) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for each in node.body:
        if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) and not each.name.startswith("_"):
            yield each


def _call(node: ast.FunctionDef | ast.AsyncFunctionDef, indent: str) -> Iterator[str]:
    """Return a function's signature, an argument to a line where it is long; a property's without arguments."""
    returns = f" -> {ast.unparse(node.returns)}" if node.returns else ""
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
