"""The command line: one file for each verb, its options, and what is printed.

It may import every folder of gcs, and none imports it.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from errno import EDQUOT, EIO, ENOSPC
from importlib.metadata import version
from importlib.util import find_spec

from cyclopts import App, CycloptsError, CycloptsPanel, Group

from gcs.cli.options import with_stubs
from gcs.errors import Exit, InputError

GROUPS = {
    "Plan": ("missions", "new", "zones", "tiles", "schema", "sim", "sweep", "check"),
    "Fly": ("fly", "start", "sitl", "recover", "drill", "excite", "relay", "router"),
    "Operate": ("watch", "station", "command", "rejoin", "target", "ros2", "cot", "keys"),
    "Analyse": ("report", "replay", "identify", "log", "flights"),
}
"""The verbs in the order of the help."""
VERBS = tuple(verb for verbs in GROUPS.values() for verb in verbs)

app = App(
    name="cordon",
    help="Fly a team of quadrotors line abreast. Each vehicle decides for itself when to encircle a target.\n\n"
    "Start with: cordon fly case2 --sitl --speed 10",
    group_commands=Group("This program", sort_key=len(GROUPS)),
    version=lambda: f"{version('cordon-gcs')} ({_runs()})",
)
for _order, (_title, _verbs) in enumerate(GROUPS.items()):
    _group = Group(_title, sort_key=_order)
    for _place, _verb in enumerate(_verbs):
        app.command(f"gcs.cli.{_verb}:{_verb}", name=_verb, group=_group, sort_key=_place)
app.register_install_completion_command(help="Install completion of commands and options in your shell.")


def main() -> None:
    """Run the command line and exit with its code."""
    _ignore_unusable_sizes()
    tokens = with_stubs(sys.argv[1:])
    _load_summaries(tokens)
    try:
        command, bound, _ = app.parse_args(tokens, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        sys.exit(_bad_usage(error, tokens))
    try:
        sys.exit(command(*bound.args, **bound.kwargs))
    except InputError as error:
        sys.exit(_bad_input(error.faults))
    except OSError as error:
        if error.errno not in _FULL:  # of standard output, by a help text: verbs report their own files
            raise
        with suppress(OSError):  # nothing is left to be written at exit
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(_bad_input([f"standard output: {error.strerror}"]))
    except KeyboardInterrupt:  # a flight handles Ctrl-C itself: here no vehicle has moved yet
        sys.exit(Exit.REFUSED)


_FULL = (ENOSPC, EDQUOT, EIO)
_COLUMNS_MAX = 10_000


def _ignore_unusable_sizes() -> None:
    """Remove sizes of the terminal from the environment that are none, such as COLUMNS=0."""
    for name in ("COLUMNS", "LINES"):
        size = os.environ.get(name, "")
        if not (size.isascii() and size.isdecimal() and 0 < int(size[:9]) <= _COLUMNS_MAX):
            os.environ.pop(name, None)


def _bad_usage(error: CycloptsError, tokens: Sequence[str]) -> Exit:
    """Print what is wrong with the arguments; `cordon command` has verbs, some others are commands of their own."""
    if tokens[:1] == ["command"] and len(tokens) > 1 and tokens[1] in VERBS:
        return _bad_input([f"command: {tokens[1]} is a command of its own; next: cordon {tokens[1]} --help"])
    from gcs.console.terminal import STDERR

    STDERR.print(CycloptsPanel(error))
    print("next:", *("cordon", *(error.command_chain or ()), "--help"), file=sys.stderr)
    return Exit.BAD_INPUT


def _bad_input(faults: Sequence[str]) -> Exit:
    from gcs.console.terminal import print_line

    for fault in faults:
        print_line(fault)
    return Exit.BAD_INPUT


def _runs() -> str:
    """Return how the control loop's code runs: the installation compiles it if there is a C compiler."""
    core = find_spec("agents.core")
    return "compiled" if core and core.origin and not core.origin.endswith(".py") else "pure Python"


def _load_summaries(tokens: Sequence[str]) -> None:
    """Import all verbs before their list is shown: it holds the first line of each docstring."""
    if not tokens or tokens[0] not in VERBS:
        app.resolved_commands()
