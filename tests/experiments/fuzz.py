"""Fuzzing of external inputs: mutated bus messages, sightings, profiles, missions and logs.

Fails if an input causes an undeclared error, exceeds its time limit, or the memory exceeds its limit. A finding states
target, seed and number; --target and --input reproduce it.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

from tests.experiments.arguments import parser
from tests.support.fuzzing import MEMORY_MAX_BYTES, Findings, Target, fault_of, mutated, run, targets

PROGRESS_S = 60.0


def main() -> int:
    """Run, print the findings, and return 0 if there are none."""
    reader = parser("fuzz", __doc__ or "")
    reader.add_argument("--count", type=int, default=1_000_000, help="number of inputs in all (default: %(default)s)")
    reader.add_argument("--seed", type=int, default=0, help="seed (default: %(default)s)")
    reader.add_argument("--target", help="read inputs of this target only")
    reader.add_argument("--input", type=int, help="read the input of this number again")
    options = reader.parse_args()
    with TemporaryDirectory() as folder:
        chosen = [each for each in targets(Path(folder)) if options.target in (None, each.name)]
        if options.input is not None:
            return _once(chosen[0], options.seed, options.input)
        findings = run(chosen, options.count, options.seed, _Progress())
    _show(findings)
    return 1 if findings.faults or findings.memory_bytes > MEMORY_MAX_BYTES else 0


def _once(target: Target, seed: int, number: int) -> int:
    data = mutated(target, seed, number)
    print(data)
    print(fault := fault_of(target, data))
    return int(bool(fault))


def _show(findings: Findings) -> None:
    for fault in findings.faults:
        print(fault)
    for name, count in findings.counts.items():
        print(f"{name:24} {count:8} inputs, the slowest took {findings.slowest_s.get(name, 0.0) * 1000:.0f} ms")
    total = sum(findings.counts.values())
    print(f"{total} inputs, {len(findings.faults)} findings, memory grew by {findings.memory_bytes / 1e6:.0f} MB")


class _Progress:
    """Prints the progress of a run."""

    def __init__(self) -> None:
        self._told_s = monotonic()

    def __call__(self, name: str, number: int) -> None:
        if monotonic() - self._told_s > PROGRESS_S:
            self._told_s = monotonic()
            print(f"{name}: input {number}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
