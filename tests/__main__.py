"""Check everything: format, lint, types, import contracts, tests. `--quick` runs no slow test and none on sockets.

Further arguments go to pytest.
"""

import os
import shlex
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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

WORKERS = 2 * (os.cpu_count() or 1)
SOCKETS = ("-m", "wire", "--dist", "load", "--maxschedchunk", "1", "-n", str(WORKERS))
"""Tests on real sockets mostly wait: twice as many as there are cores run side by side. More lack the processor."""
BROWSER = ("-m", "browser", "-n", "2", "--dist", "loadfile")
"""Tests that drive a browser wait as well, but draw pages on the processor: after those on sockets, two at a time."""
COMPUTING = ("-m", "not wire and not browser", "-n", "auto", "--dist", "loadfile")
"""Tests that compute run beside the others, and a file's tests share what its fixtures have flown."""
QUICK = ("-m", "not wire and not browser and not slow", *COMPUTING[2:])
"""What a change is tested with while it is written: below the wire, without what computes for long."""
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": ""}
"""Matrices here are small: more threads only spin, in the way of the other processes. These are hundreds, and would
each compile what they import.
"""
HANGS_AFTER_S = 1500.0
"""A test that hangs is ended by pytest's own bound; this one is for a process that hangs outside of its tests."""


def main() -> int:
    """Run every check and all tests, and return 0 if all of them pass."""
    arguments = sys.argv[1:]
    if arguments == ["--quick"]:
        with _pytest(*QUICK) as quick:
            checks = _failing_checks()
            tests_fail = not quick()
    elif arguments:
        checks = _failing_checks()
        tests_fail = _run("pytest", *arguments) != 0
    else:
        with _pytest(*COMPUTING) as computing:
            checks = _failing_checks()  # meanwhile, two processes compile what the many after them only load
            with _pytest(*SOCKETS) as sockets:
                passed = [sockets()]
            with _pytest(*BROWSER) as browser:
                passed += [browser(), computing()]
        tests_fail = not all(passed)
    for check in checks:
        print(f"failed: {check}", file=sys.stderr)
    return int(tests_fail or bool(checks))


def _failing_checks() -> list[str]:
    return [" ".join(check) for check in CHECKS if _run(*check) != 0]


@contextmanager
def _pytest(*arguments: str) -> Iterator[Callable[[], bool]]:
    """Start some of the tests; what is yielded waits for their end, shows the output and returns whether they pass."""
    command = [str(SCRIPTS / "pytest"), *arguments]
    end_s = time.monotonic() + HANGS_AFTER_S
    with TemporaryFile() as output:
        process = subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, stdout=output, stderr=output)

        def passes() -> bool:
            print(f"--- pytest {shlex.join(arguments)}", flush=True)
            _wait(process, end_s)
            output.seek(0)
            sys.stdout.buffer.write(output.read())
            sys.stdout.buffer.flush()
            return process.returncode == 0

        try:
            yield passes
        finally:
            process.kill()


def _wait(process: subprocess.Popen[bytes], end_s: float) -> None:
    try:
        process.wait(max(0.0, end_s - time.monotonic()))
    except subprocess.TimeoutExpired:
        print(f"hangs: aborted after {HANGS_AFTER_S:g} s", flush=True)
        process.send_signal(signal.SIGABRT)  # pytest's fault handler tells where each of its threads stands
        process.wait()


def _run(tool: str, *arguments: str) -> int:
    print(f"--- {tool} {shlex.join(arguments)}", flush=True)
    return subprocess.run([SCRIPTS / tool, *arguments], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
