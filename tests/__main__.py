"""Check everything: format, lint, types, import contracts, tests. Further arguments go to pytest."""

import os
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Sequence
from contextlib import ExitStack
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

STAGES = (
    ("not wire", "wire and not team", "team and not (operator or processes or alone)"),
    ("operator", "processes"),
    ("alone",),
)
"""What runs side by side: those with sockets mostly wait, but for too long where too many compute beside them."""
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
"""Matrices here are small: more threads only spin, in the way of the other processes."""
STAGE_MAX_S = 900.0
"""A test that hangs is ended by pytest's own bound; this one is for a process that hangs outside of its tests."""


def main() -> int:
    """Run every check, the tests last, and return 0 if all of them pass."""
    failed = [check for check in CHECKS if _run(*check) != 0]
    arguments = sys.argv[1:]
    tests = _run("pytest", *arguments) if arguments else _run_all_tests()
    for check in failed:
        print(f"failed: {' '.join(check)}", file=sys.stderr)
    return 1 if failed else tests


def _run_all_tests() -> int:
    return max([_run_side_by_side(parts) for parts in STAGES])


def _run_side_by_side(parts: Sequence[str]) -> int:
    with ExitStack() as stack:
        outputs = [stack.enter_context(TemporaryFile()) for _ in parts]
        runs = [
            subprocess.Popen([SCRIPTS / "pytest", "-m", part], cwd=ROOT, env=ENVIRONMENT, stdout=output, stderr=output)
            for part, output in zip(parts, outputs, strict=True)
        ]
        end_s = time.monotonic() + STAGE_MAX_S
        for part, output, run in zip(parts, outputs, runs, strict=True):
            print(f"--- pytest -m '{part}'", flush=True)
            _wait(run, end_s)
            output.seek(0)
            sys.stdout.buffer.write(output.read())
    return int(any(run.wait() for run in runs))


def _wait(run: subprocess.Popen[bytes], end_s: float) -> None:
    try:
        run.wait(max(0.0, end_s - time.monotonic()))
    except subprocess.TimeoutExpired:
        print(f"hangs: aborted after {STAGE_MAX_S:g} s", flush=True)
        run.send_signal(signal.SIGABRT)  # pytest's fault handler tells where each of its threads stands
        run.wait()


def _run(tool: str, *arguments: str) -> int:
    print(f"--- {tool} {' '.join(arguments)}", flush=True)
    return subprocess.run([SCRIPTS / tool, *arguments], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
