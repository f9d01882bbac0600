"""Coverage-guided fuzzing of a reader of external inputs, or of all side by side, by atheris; or reading single inputs.

It ends at the first input that causes an error that the reader does not state, takes too long, or too much memory. That
input, and those that reach new code, are kept in `build/fuzz/TARGET`; the next run goes on from them. With `all` the
outputs are there, too.
"""

import multiprocessing
import os
import sys
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from random import Random
from shutil import rmtree
from tempfile import TemporaryDirectory

from tests.experiments.arguments import parser, positive
from tests.support.fuzzing import CORPUS, INPUT_MAX_BYTES, MEMORY_MAX_BYTES, changed, fault_of
from tests.support.paths import ROOT

FOUND = ROOT / "build" / "fuzz"
INSTRUMENTED = ["agents", "estimation", "gcs", "mcap", "pyulog"]
PROCESS_BYTES = 600_000_000
"""What the imported modules take, instrumented, before the first input."""
ENGINES_SHARE = 0.5
"""Share of the inputs that libFuzzer changes; the others are changed as in the tests, which know texts and messages."""


def main() -> int:
    """Fuzz, or read inputs, and return 0 if nothing is found."""
    reader = parser("fuzz", __doc__ or "")
    names = sorted(path.name for path in CORPUS.iterdir() if path.is_dir())
    reader.add_argument("target", choices=["all", *names])
    reader.add_argument("--minutes", type=positive, default=1.0, help="duration (default: %(default)s)")
    reader.add_argument("--input", type=Path, nargs="+", help="read these files only, without atheris")
    options = reader.parse_args()
    if options.input:
        return _read(options.target, options.input)
    return _fuzz(names if options.target == "all" else [options.target], options.minutes)


def _read(name: str, paths: list[Path]) -> int:
    from tests.support.fuzz_targets import target_named

    with TemporaryDirectory() as folder:
        target = target_named(name, Path(folder))
        faults = {path: fault for path in paths if (fault := fault_of(target, path.read_bytes()))}
    for path, fault in faults.items():
        print(f"{path}: {fault}")
    print(f"{len(paths)} inputs, {len(faults)} findings")
    return int(bool(faults))


def _fuzz(names: Sequence[str], minutes: float) -> int:
    try:
        import atheris
    except ImportError:
        print("atheris is not installed; next: .venv/bin/pip install '.[fuzz]' (Linux x86-64)", file=sys.stderr)
        return 2
    with atheris.instrument_imports(include=INSTRUMENTED):
        import tests.support.fuzz_targets  # noqa: F401 - instrumented once, for all
    if len(names) == 1:
        _fuzz_one(names[0], minutes)
    forks = multiprocessing.get_context("fork")
    processes = {name: forks.Process(target=_fuzz_aside, args=(name, minutes)) for name in names}
    for process in processes.values():
        process.start()
    failed = 0
    for name, process in processes.items():
        process.join()
        lines = (FOUND / name / "output").read_text(encoding="utf-8", errors="replace").splitlines()
        failed += process.exitcode != 0
        shown = lines if process.exitcode else [each for each in lines if "DONE" in each]
        print(f"--- {name}", *shown, sep="\n")
    print(f"{len(names)} targets, {failed} failed")
    return int(failed > 0)


def _fuzz_aside(name: str, minutes: float) -> None:
    """Fuzz with the output in a file."""
    (FOUND / name).mkdir(parents=True, exist_ok=True)
    with (FOUND / name / "output").open("wb") as output:
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
    _fuzz_one(name, minutes)


def _fuzz_one(name: str, minutes: float) -> None:
    """Fuzz, and end the process."""
    import atheris

    from tests.support.fuzz_targets import target_named

    folder = FOUND / name
    found, valid, scratch = (folder / each for each in ("inputs", "valid", "scratch"))
    rmtree(valid, ignore_errors=True)
    for each in (found, valid, scratch):
        each.mkdir(parents=True, exist_ok=True)
    target = target_named(name, scratch)
    for number, data in enumerate(target.valid):
        (valid / str(number)).write_bytes(data)

    def read(data: bytes) -> None:
        if fault := fault_of(target, data):
            finding = folder / f"found-{sha256(data).hexdigest()[:16]}"
            finding.write_bytes(data)
            print(f"{fault}\nwritten: {finding}", flush=True)
            os._exit(1)  # at once: the end of Python takes seconds with instrumented modules

    def mutated(data: bytes, size_max: int, seed: int) -> bytes:
        random = Random(seed)
        if random.random() < ENGINES_SHARE:
            return bytes(atheris.Mutate(data, size_max))
        return changed(data, random, target)[:size_max]

    memory_mb = (PROCESS_BYTES + MEMORY_MAX_BYTES) // 1_000_000
    # `fault_of` limits the time, of the processor: libFuzzer's limit is of the wall's.
    limits = ["-timeout=0", f"-rss_limit_mb={memory_mb}", f"-max_len={INPUT_MAX_BYTES}"]
    ways = [f"-max_total_time={60.0 * minutes:.0f}", f"-artifact_prefix={folder}/", "-print_final_stats=1"]
    folders = map(str, (found, CORPUS / target.name, valid))
    atheris.Setup([sys.argv[0], *limits, *ways, *folders], read, custom_mutator=mutated)
    atheris.Fuzz()


if __name__ == "__main__":
    sys.exit(main())
