"""Check everything: format, lint, types, import contracts, tests. Further arguments go to pytest."""

import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parent.parent
SCRIPTS = Path(sysconfig.get_path("scripts"))
CHECKS = (
    ("ruff", "format", "--check", "."),
    ("ruff", "check", "."),
    ("mypy",),
    ("lint-imports", "--no-logo"),
)


def main() -> int:
    """Run every check, the tests last, and return 0 if all of them pass."""
    failed = [check for check in CHECKS if _run(*check) != 0]
    # In two processes: all tests over sockets in the one, where they mostly wait, and the computing in the other.
    tests = _run("pytest", "--numprocesses=2", "--dist=loadgroup", *sys.argv[1:])
    for check in failed:
        print(f"failed: {' '.join(check)}", file=sys.stderr)
    return 1 if failed else tests


def _run(tool: str, *arguments: str) -> int:
    print(f"--- {tool} {' '.join(arguments)}", flush=True)
    return subprocess.run([SCRIPTS / tool, *arguments], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
