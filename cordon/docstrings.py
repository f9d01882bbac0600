"""The docstrings of public classes that are compiled: mypyc drops them, and the sources stand beside what it makes."""

import ast
import sys
from pathlib import Path


def documented(value: object) -> object:
    """Return a value; a class without a docstring gets that of its source, if there is one."""
    if isinstance(value, type) and not value.__doc__:
        text = _docstring(value)
        if text:
            value.__doc__ = text
    return value


def _docstring(of: type) -> str | None:
    file = sys.modules[of.__module__].__file__
    if file is None:
        return None
    source = Path(file).with_name(f"{of.__module__.rpartition('.')[2]}.py")
    try:
        tree = ast.parse(source.read_text(encoding="utf-8"))
    except OSError:
        return None
    found = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == of.__name__]
    return ast.get_docstring(found[0]) if found else None
