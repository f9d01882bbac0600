"""Run every command of the command line once, with --json where it has it, and print a table of exit codes.

The run fails where a command ends with another code than it should, or prints other keys than docs/json.md lists.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.experiments.arguments import parser
from tests.support.installation import description
from tests.support.verb_runs import commands, run_all


def main() -> int:
    """Print a row for each command, and return 1 if one is at fault or missing."""
    parser("verbs", __doc__).parse_args()
    print(f"{description()}\n\n| command | `--json` | exit code | seconds | |\n|---|---|---|---|---|")
    has_json, faults = commands(), 0
    missing = set(has_json)
    with TemporaryDirectory() as folder:
        for ran in run_all(Path(folder)):
            name = ran.run.command
            missing -= {name}
            faults += bool(ran.fault)
            print(
                f"| {name} | {'yes' if has_json[name] else ''} | {ran.code} | {ran.took_s:.1f} | {ran.fault} |",
                flush=True,
            )
            if ran.fault:
                print(ran.err, file=sys.stderr)
    for name in sorted(missing):
        print(f"| {name} | | not run | | |")
    return int(bool(faults or missing))


if __name__ == "__main__":
    sys.exit(main())
