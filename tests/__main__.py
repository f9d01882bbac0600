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
from pathlib import Path
from tempfile import TemporaryFile
from typing import Self

ROOT = Path(__file__).parent.parent
SCRIPTS = Path(sysconfig.get_path("scripts"))
CHECKS = (("ruff", "format", "--check", "."), ("ruff", "check", "."), ("mypy",), ("lint-imports", "--no-logo"))

WORKERS = 2 * (os.cpu_count() or 1)
SOCKETS = ("-m", "wire", "--dist", "load", "--maxschedchunk", "1", "-n", str(WORKERS))
"""Tests on real sockets mostly wait: twice as many as there are cores run side by side. More lack the processor."""
BROWSER = ("-m", "browser", "-n", "2", "--dist", "loadfile")
"""Tests that drive a browser wait as well, but draw pages on the processor: two at a time, once others have ended."""
COMPUTING = ("-m", "not wire and not browser", "-n", "auto", "--dist", "loadfile")
"""Tests that compute run beside the others, and a file's tests share what its fixtures have flown."""
QUICK = ("-m", "not wire and not browser and not slow", *COMPUTING[2:])
"""What a change is tested with while it is written: below the wire, without what computes for long."""
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
"""Matrices here are small: more threads only spin, in the way of the other processes."""
HANGS_AFTER_S = 900.0
"""A test that hangs is ended by pytest's own bound; a process in which none has ended for this time hangs outside."""


def main() -> int:
    """Run every check and all tests, and return 0 if all of them pass."""
    arguments = sys.argv[1:]
    if arguments == ["--quick"]:
        with Tests(*QUICK) as quick:
            checks = _failing_checks()
            tests_fail = not quick.all_pass()
    elif arguments:
        checks = _failing_checks()
        tests_fail = _run("pytest", *arguments) != 0
    else:
        with Tests(*COMPUTING) as computing:
            checks = _failing_checks()  # meanwhile, two processes compile what the many after them only load
            with Tests(*SOCKETS) as sockets:
                while computing.go_on and sockets.go_on:
                    time.sleep(0.2)
                with Tests(*BROWSER) as browser:
                    passed = [each.all_pass() for each in (sockets, browser, computing)]
        tests_fail = not all(passed)
    for check in checks:
        print(f"failed: {check}", file=sys.stderr)
    return int(tests_fail or bool(checks))


def _failing_checks() -> list[str]:
    return [" ".join(check) for check in CHECKS if _run(*check) != 0]


class Tests:
    """Some of the tests, which run in a process of their own from the beginning of the context."""

    def __init__(self, *arguments: str) -> None:
        self._arguments = arguments
        self._output = TemporaryFile()  # noqa: SIM115 - closed at the end of the context
        self._size, self._wrote_s = 0, time.monotonic()
        command = [str(SCRIPTS / "pytest"), *arguments]
        self._process = subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, stdout=self._output, stderr=self._output)

    @property
    def go_on(self) -> bool:
        """Whether they still run."""
        size = os.fstat(self._output.fileno()).st_size
        if size != self._size:  # a busy computer only takes longer
            self._size, self._wrote_s = size, time.monotonic()
        return self._process.poll() is None and time.monotonic() - self._wrote_s < HANGS_AFTER_S

    def all_pass(self) -> bool:
        """Wait for their end, show the output and return whether all pass."""
        print(f"--- pytest {shlex.join(self._arguments)}", flush=True)
        while self.go_on:
            time.sleep(0.2)
        if self._process.poll() is None:
            print(f"hangs: aborted, no test has ended for {HANGS_AFTER_S:g} s", flush=True)
            self._process.send_signal(signal.SIGABRT)  # pytest's fault handler tells where each of its threads stands
            self._process.wait()
        self._output.seek(0)
        sys.stdout.buffer.write(self._output.read())
        sys.stdout.buffer.flush()
        return self._process.returncode == 0

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End them."""
        self._process.kill()
        self._output.close()


def _run(tool: str, *arguments: str) -> int:
    print(f"--- {tool} {shlex.join(arguments)}", flush=True)
    return subprocess.run([SCRIPTS / tool, *arguments], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
