"""The commands of the command line with usage, arguments and options, from the application that runs them."""

import re
from collections.abc import Iterator, Sequence
from inspect import cleandoc
from pathlib import Path
from typing import Any, get_args, get_origin

from cyclopts import App
from cyclopts.argument import Argument

from gcs.cli import GROUPS, app

_VALUES = {bool: "", int: "INTEGER", float: "NUMBER", Path: "PATH", str: "TEXT"}
"""What stands for a value, by its type."""
_EXAMPLE = re.compile(r"^Example: (.+)$", re.MULTILINE)


def command_list() -> str:
    """Return the verbs with what each does, as Markdown, in the groups of the help."""
    app.resolved_commands()
    rows = ["| | command | does |", "|---|---|---|"]
    for group, verbs in GROUPS.items():
        for at, verb in enumerate(verbs):
            link = f"[`cordon {verb}`](#cordon-{verb})"
            rows.append(f"| {'' if at else group} | {link} | {_summary(app[verb])} |")
    return "\n".join(rows)


def command_sections() -> str:
    """Return a section for each command: usage, arguments and options with their defaults, as Markdown."""
    app.resolved_commands()
    verbs = (verb for verbs in GROUPS.values() for verb in verbs)
    return "\n\n".join(section for verb in verbs for section in _sections(app[verb], f"cordon {verb}"))


def _sections(command: App, name: str) -> Iterator[str]:
    yield _section(command, name)
    for inner, each in command.resolved_commands().items():
        if not inner.startswith("-"):
            yield from _sections(each, f"{name} {inner}")


def _section(command: App, name: str) -> str:
    heading = f"{'#' * len(name.split())} {name}"
    examples = _EXAMPLE.findall(cleandoc(command.help))
    parts = [heading, _paragraphs(_EXAMPLE.sub("", cleandoc(command.help)))]
    if command.default_command is not None:
        arguments = list(command.assemble_argument_collection().filter_by(show=True))
        arguments.sort(key=lambda each: each.index is None)
        parts += [_usage(name, arguments), _table(arguments)]
    if examples:
        parts.append("\n".join(["```sh", *examples, "```"]))
    return "\n\n".join(filter(None, parts))


def _usage(name: str, arguments: Sequence[Argument]) -> str:
    """Return how a command is called: optional options are not listed."""
    words = [name]
    for each in arguments:
        if each.index is not None:
            words.append(_place(each) if each.required else f"[{_place(each)}]")
        elif each.required:
            words.append(f"{each.names[0]} {_value(each)}")
    if any(each.index is None and not each.required for each in arguments):
        words.append("[OPTIONS]")
    return f"Usage: `{' '.join(words)}`"


def _table(arguments: Sequence[Argument]) -> str:
    rows = [f"| {_names(each)} | {_default(each)} | {_help(each)} |" for each in arguments]
    return "\n".join(["| argument | default | meaning |", "|---|---|---|", *rows]) if rows else ""


def _summary(command: App) -> str:
    return _paragraphs(cleandoc(command.help)).partition("\n\n")[0]


def _paragraphs(text: str) -> str:
    """Return a docstring with a line for each paragraph."""
    return "\n\n".join(" ".join(each.split()) for each in text.split("\n\n") if each.strip())


def _place(argument: Argument) -> str:
    """Return a positional argument as the usage names it."""
    name = argument.names[0].lstrip("-").upper()
    return f"{name}..." if get_origin(argument.hint) in (tuple, list) else name


def _names(argument: Argument) -> str:
    choices = argument.get_choices()
    if argument.index is not None:
        return f"`{_place(argument)}`" + (f": {', '.join(f'`{each}`' for each in choices)}" if choices else "")
    value = ", ".join(choices) if choices else _value(argument)
    return ", ".join(f"`{name}`" for name in argument.names) + (f" {value}" if value else "")


def _value(argument: Argument) -> str:
    return next((_VALUES[kind] for kind in _kinds(argument.hint) if kind in _VALUES), "")


def _kinds(hint: Any) -> Iterator[Any]:
    """Return the plain types that a hint is made of."""
    for each in get_args(hint):
        yield from _kinds(each)
    if not get_args(hint):
        yield hint


def _default(argument: Argument) -> str:
    if argument.required:
        return "required"
    default = argument.field_info.default
    hidden = argument.parameter.show_default is False or default is None or default is False or default == ()
    return "" if hidden else f"`{default}`"


def _help(argument: Argument) -> str:
    return " ".join((argument.parameter.help or "").split()).replace("|", "\\|")
