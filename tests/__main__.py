"""Check everything: format, lint, types, import contracts, tests. Further arguments go to pytest."""

import os
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
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

COMPUTING = "not wire"
"""Runs beside checks and stages; these mostly wait for sockets, and it gives way to them when their time comes."""
STAGES = (("wire and not team", "team and not (operator or processes or alone)"), ("operator", "processes"))
"""What runs side by side, one pair after the other."""
ALONE = "alone"
ENVIRONMENT = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
"""Matrices here are small: more threads only spin, in the way of the other processes."""
HANGS_AFTER_S = 1500.0
"""A test that hangs is ended by pytest's own bound; this one is for a process that hangs outside of its tests."""


def main() -> int:
    """Run every check and all tests, and return 0 if all of them pass."""
    arguments = sys.argv[1:]
    if arguments:
        checks = _failing_checks()
        tests_fail = _run("pytest", *arguments) != 0
    else:
        with _started(COMPUTING, "nice", "-n", "19") as computing:
            checks = _failing_checks()
            failed = [_fail(parts) for parts in STAGES]
            failed.append(not computing())
        tests_fail = any([*failed, _fail([ALONE])])
    for check in checks:
        print(f"failed: {check}", file=sys.stderr)
    return int(tests_fail or bool(checks))


def _failing_checks() -> list[str]:
    return [" ".join(check) for check in CHECKS if _run(*check) != 0]


def _fail(parts: Sequence[str]) -> bool:
    """Run parts side by side, and return whether one of them fails."""
    with ExitStack() as stack:
        runs = [stack.enter_context(_started(part)) for part in parts]
        return not min([passes() for passes in runs])  # all of them are shown


@contextmanager
def _started(part: str, *prefix: str) -> Iterator[Callable[[], bool]]:
    """Start the tests of one part; what is yielded waits for their end, shows the output and says whether they pass."""
    command = [*prefix, str(SCRIPTS / "pytest"), "-m", part]
    end_s = time.monotonic() + HANGS_AFTER_S
    with TemporaryFile() as output:
        process = subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, stdout=output, stderr=output)

        def passes() -> bool:
            print(f"--- pytest -m '{part}'", flush=True)
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
    print(f"--- {tool} {' '.join(arguments)}", flush=True)
    return subprocess.run([SCRIPTS / tool, *arguments], cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
