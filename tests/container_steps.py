"""Carry out the steps of Containerfile without a container engine, then its default command: as root on Linux.

`python -m tests.container_steps` gives each stage a view of this computer's file system in which all that is written
goes to memory (an overlay in a mount namespace of its own), and runs the steps in it. No image is fetched: Debian's
python3 takes the place of the image's `python`, and apt-get that of this computer. Arguments take the place of the
default command's.
"""

import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from json import loads
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.paths import ROOT

INSIDE = "CORDON_CONTAINER_STEPS"
"""Is set in the mount namespace, which ends with its last process, and all mounts with it."""

PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
"""As images have it."""


@dataclass
class Stage:
    """A stage of the file: its view of the file system, and what its commands run with."""

    root: Path
    user: str = "root"
    folder: str = "/"
    environment: dict[str, str] = field(default_factory=dict)
    entrypoint: tuple[str, ...] = ()
    command: tuple[str, ...] = ()

    def run(self, command: Sequence[str]) -> int:
        """Run a command as the stage's user, and return its exit code."""
        home = next(line.split(":")[5] for line in self._users() if line.startswith(f"{self.user}:"))
        outside = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PYENV"))}
        environment = {**outside, "PATH": PATH, "HOME": home, **self.environment}
        inside = ["env", "-C", self.folder, *command]
        chroot = ["chroot", f"--userspec={self.user}", "--groups=", str(self.root), *inside]
        return subprocess.run(chroot, env=environment, check=False).returncode

    def within(self, path: str) -> Path:
        """Return where a path of the stage is outside of it."""
        return self.root / path.lstrip("/")

    def _users(self) -> list[str]:
        return self.within("/etc/passwd").read_text(encoding="utf-8").splitlines()


def steps(text: str) -> Iterator[tuple[str, str]]:
    """Yield the instructions of a Containerfile with their arguments."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        if line.strip():
            instruction, _, arguments = line.strip().partition(" ")
            yield instruction.upper(), arguments.strip()


def mounted(directory: Path) -> Path:
    """Return a new view of this computer's file system, which keeps in a directory what is written."""
    root, upper, work = (directory / name for name in ("root", "upper", "work"))
    for each in (root, upper, work):
        each.mkdir(parents=True)
    options = f"lowerdir=/,upperdir={upper},workdir={work}"
    subprocess.run(["mount", "-t", "overlay", "-o", options, "overlay", str(root)], check=True)
    for name in ("dev", "proc"):
        subprocess.run(["mount", "--rbind", f"/{name}", str(root / name)], check=True)
    (python := root / "usr/local/bin/python").unlink(missing_ok=True)
    python.symlink_to("/usr/bin/python3")
    return root


def take(stage: Stage, instruction: str, arguments: str, stages: dict[str, Stage]) -> None:
    """Carry out an instruction; raises ValueError for one that this program does not know, or that fails."""
    match instruction:
        case "RUN":
            if code := stage.run(["/bin/sh", "-c", arguments]):
                raise ValueError(f"RUN {arguments}: exit code {code}")
        case "COPY":
            *options, source, target = shlex.split(arguments)
            origin = stages[options[0].removeprefix("--from=")].within(source) if options else ROOT / source
            ignored = () if options else (ROOT / ".containerignore").read_text(encoding="utf-8").split()
            ignore = shutil.ignore_patterns(*(pattern.removeprefix("**/") for pattern in ignored))
            shutil.copytree(origin, stage.within(target), symlinks=True, ignore=ignore, dirs_exist_ok=True)
        case "ENV":
            stage.environment |= dict(each.split("=", 1) for each in shlex.split(arguments))
        case "USER":
            stage.user = arguments
        case "WORKDIR":
            stage.folder = arguments
        case "ENTRYPOINT":
            stage.entrypoint = tuple(loads(arguments))
        case "CMD":
            stage.command = tuple(loads(arguments))
        case "VOLUME" | "STOPSIGNAL":
            pass  # what an engine does when it runs the image
        case _:
            raise ValueError(f"{instruction}: not known to {Path(__file__).name}")


def main(arguments: Sequence[str]) -> int:
    """Carry out all stages, then the default command; return its exit code."""
    stages: dict[str, Stage] = {}
    with TemporaryDirectory(ignore_cleanup_errors=True) as name:
        subprocess.run(["mount", "-t", "tmpfs", "-o", "mode=755", "tmpfs", name], check=True)
        for number, (instruction, words) in enumerate(steps((ROOT / "Containerfile").read_text(encoding="utf-8"))):
            print(f"--- {instruction} {words}", flush=True)
            if instruction == "FROM":
                alias = words.rpartition(" AS ")[2]
                stages[alias] = stage = Stage(mounted(Path(name, str(number))))
            else:
                take(stage, instruction, words, stages)
        command = [*stage.entrypoint, *(arguments or stage.command)]
        print(f"--- {shlex.join(command)}, as {stage.user} in {stage.folder}", flush=True)
        code = stage.run(command)
        for path in sorted(path for path in stage.within(stage.folder).rglob("*") if path.is_file()):
            owner = path.stat().st_uid
            print(f"written: {path.relative_to(stage.root)}, {path.stat().st_size} bytes, by user {owner}")
    return code


if __name__ == "__main__":
    if INSIDE not in os.environ:
        command = ["unshare", "--mount", sys.executable, "-m", "tests.container_steps", *sys.argv[1:]]
        os.execvpe(command[0], command, {**os.environ, INSIDE: "1", "PYTHONSAFEPATH": ""})
    sys.exit(main(sys.argv[1:]))
