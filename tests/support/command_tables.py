"""The commands of the command line with usage, arguments and options, from the application that runs them."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
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
    """Return the verbs in the groups of the help, with links, as Markdown."""
    rows = [
        f"- {group}: {', '.join(f'[`{verb}`](#cordon-{verb})' for verb in verbs)}" for group, verbs in GROUPS.items()
    ]
    return "\n".join(rows)


def common_arguments() -> str:
    """Return the arguments that several commands have, each once, as Markdown."""
    return _list(list(_common().values()))


def command_sections() -> str:
    """Return a section for each command: usage, arguments and options with their defaults, as Markdown."""
    common = _common()
    return "\n\n".join(_section(command, name, common) for command, name in _commands())


def _commands() -> Iterator[tuple[App, str]]:
    """Yield all commands with their names, those of a verb behind it."""
    app.resolved_commands()
    for verb in (verb for verbs in GROUPS.values() for verb in verbs):
        yield from _with_inner(app[verb], f"cordon {verb}")


def _with_inner(command: App, name: str) -> Iterator[tuple[App, str]]:
    yield command, name
    for inner, each in command.resolved_commands().items():
        if not inner.startswith("-"):
            yield from _with_inner(each, f"{name} {inner}")


def _common() -> dict[str, Argument]:
    """Return the arguments that several commands have with one meaning and default, by their rows."""
    found = {_row(each): each for command, _ in _commands() for each in reversed(_arguments(command))}
    times = Counter(_row(each) for command, _ in _commands() for each in _arguments(command))
    return {row: found[row] for row in times if times[row] > 1}


def _arguments(command: App) -> list[Argument]:
    """Return the arguments of a command, those without a name of an option first."""
    if command.default_command is None:
        return []
    arguments = list(command.assemble_argument_collection().filter_by(show=True))
    return sorted(arguments, key=lambda each: each.index is None)


def _section(command: App, name: str, common: Collection[str]) -> str:
    heading = f"{'#' * len(name.split())} {name}"
    examples = _EXAMPLE.findall(cleandoc(command.help))
    parts = [heading, _paragraphs(_EXAMPLE.sub("", cleandoc(command.help)))]
    if command.default_command is not None:
        arguments = _arguments(command)
        shared = [f"`{_short(each)}`" for each in arguments if _row(each) in common]
        also = f"[Common](#common-arguments): {', '.join(shared)}." if shared else ""
        parts += [_usage(name, arguments), _list([each for each in arguments if _row(each) not in common]), also]
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
    return f"`{' '.join(words)}`"


def _list(arguments: Sequence[Argument]) -> str:
    return "\n".join(_row(each) for each in arguments)


def _row(argument: Argument) -> str:
    meaning = " ".join(
        filter(None, (_help(argument), f"Default: {default}." if (default := _default(argument)) else ""))
    )
    return f"- {_names(argument)}: {meaning}" if meaning else f"- {_names(argument)}"


def _short(argument: Argument) -> str:
    """Return the name of an argument alone."""
    return _place(argument) if argument.index is not None else argument.names[0]


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
        return f"`{_place(argument)}`" + (f" {', '.join(f'`{each}`' for each in choices)}" if choices else "")
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
    """Return the default, empty where there is none; the usage shows required arguments."""
    if argument.required:
        return ""
    default = argument.field_info.default
    absent = default is None or default is False or default == () or default is argument.field_info.empty
    hidden = absent or argument.parameter.show_default is False
    return "" if hidden else f"`{default}`"


def _help(argument: Argument) -> str:
    return " ".join((argument.parameter.help or "").split())
