"""The command line: one file for each verb, its options, and what is printed.

It may import every folder of gcs; nothing imports it.
"""

import sys
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec

from cyclopts import App, CycloptsError

from gcs.cli.options import with_stubs
from gcs.errors import Exit, InputError

OF_A_TEAM = ("command", "router", "start", "station", "target", "watch")
"""The verbs for a team whose agents run already, and for their bus."""
OF_A_FLIGHT = ("check", "drill", "excite", "fly", "relay", "sim", "sitl")
VERBS = tuple(sorted((*OF_A_FLIGHT, *OF_A_TEAM, "identify", "keys", "log", "replay", "report")))

app = App(
    name="cordon",
    help="Fly a team of quadrotors line abreast, and let each decide for itself to encircle a target.",
    help_epilogue="Start with: cordon fly case2 --sitl --speed 10",
    version=lambda: f"{version('cordon-gcs')} ({_runs()})",
)
for _verb in VERBS:
    _module = f"gcs.cli.team.{_verb}" if _verb in OF_A_TEAM else f"gcs.cli.{_verb}"
    app.command(f"{_module}:{_verb}", name=_verb)


def main() -> None:
    """Run the command line and exit with its code."""
    tokens = with_stubs(sys.argv[1:])
    _load_summaries(tokens)
    try:
        command, bound, _ = app.parse_args(tokens, exit_on_error=False)
    except CycloptsError:
        sys.exit(Exit.BAD_INPUT)
    try:
        sys.exit(command(*bound.args, **bound.kwargs))
    except InputError as error:
        print(*error.faults, sep="\n", file=sys.stderr)
        sys.exit(Exit.BAD_INPUT)
    except KeyboardInterrupt:  # a flight handles Ctrl-C itself: here nothing has moved yet
        sys.exit(Exit.REFUSED)


def _runs() -> str:
    """Return how the tick's arithmetic runs: it is compiled at installation where there is a C compiler."""
    core = find_spec("agents.core")
    return "compiled" if core and core.origin and not core.origin.endswith(".py") else "pure Python"


def _load_summaries(tokens: Sequence[str]) -> None:
    """Import all verbs where their list is about to be shown: it holds the first line of each docstring."""
    if not tokens or tokens[0] not in VERBS:
        app.resolved_commands()
