"""Check everything: format, lint, types, import contracts, tests. Further arguments go to pytest."""

import subprocess
import sys
import sysconfig
from pathlib import Path
from tempfile import TemporaryFile

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
    arguments = sys.argv[1:]
    tests = _run("pytest", *arguments) if arguments else _run_all_tests()
    for check in failed:
        print(f"failed: {' '.join(check)}", file=sys.stderr)
    return 1 if failed else tests


def _run_all_tests() -> int:
    """Run the tests that open sockets, which mostly wait, and all others beside them, which compute.

    No two tests with sockets run at once: they would keep each other from the processor.
    """
    with TemporaryFile() as output:
        others = subprocess.Popen([SCRIPTS / "pytest", "-m", "not wire"], cwd=ROOT, stdout=output, stderr=output)
        wire = _run("pytest", "-m", "wire")
        print("--- pytest -m not wire", flush=True)
        other = others.wait()
        output.seek(0)
        sys.stdout.buffer.write(output.read())
    return wire or other


def _run(tool: str, *arguments: str) -> int:
    print(f"--- {tool} {' '.join(arguments)}", flush=True)
    return subprocess.run([SCRIPTS / tool, *arguments], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
