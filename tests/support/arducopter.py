"""An ArduCopter simulator for tests: a process of the program in the environment variable CORDON_ARDUCOPTER.

CORDON_ARDUCOPTER is the program `arducopter` of ArduPilot's own SITL build, with its file of default parameters beside
it (copter.parm) or in the folder Tools/autotest/default_params of the sources.
"""

import os
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from tests.support.wire import LOOPBACK

VARIABLE = "CORDON_ARDUCOPTER"
STOP_WITHIN_S = 5.0
DEFAULTS = "Tools/autotest/default_params/copter.parm"
OWN_DEFAULTS: Mapping[str, float] = MappingProxyType(
    {
        "FS_GCS_ENABLE": 5,
        "MAV_GCS_SYSID": 245,
        "SYSID_MYGCS": 245,
        "FLTMODE_CH": 0,
        "INITIAL_MODE": 5,
        "BATT_CAPACITY": 33000,
    }
)


class ArduCopterMissing(Exception):  # noqa: N818 - it is a reason to skip, no error
    """No ArduCopter simulator is available; the reason states what to set."""


class ArduCopterSimulator:
    """One ArduCopter process, which sends to `port` from its second serial port; instance i has system id i + 1.

    Its first port, the USB port, goes to `usb_port`; ArduPilot accepts unsigned messages there.
    """

    def __init__(
        self,
        port: int,
        usb_port: int,
        *,
        speed: float,
        place: tuple[float, float, float],
        instance: int = 0,
        parameters: Mapping[str, float] = OWN_DEFAULTS,
    ) -> None:
        """Prepare it at a place (degrees, degrees, metres) with its own defaults; raises ArduCopterMissing."""
        named = os.environ.get(VARIABLE)
        if not named:
            raise ArduCopterMissing(f"{VARIABLE} is not set: point it to the program arducopter of a SITL build")
        self._program = Path(named).resolve()
        folders = [self._program.parent, *self._program.parents]
        defaults = [folder / name for folder in folders for name in ("copter.parm", DEFAULTS)]
        self._defaults = next((path for path in defaults if path.is_file()), None)
        if not self._program.is_file() or self._defaults is None:
            raise ArduCopterMissing(f"{VARIABLE} = {named} is no program, or has no copter.parm")
        self._links = [f"udpclient:{LOOPBACK}:{usb_port}", f"udpclient:{LOOPBACK}:{port}"]
        self._speed, self._place, self._instance, self._parameters = speed, place, instance, parameters
        self._folder = tempfile.TemporaryDirectory(prefix="arducopter-")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start the process; its key and parameters are kept, as on a flight controller."""
        folder = Path(self._folder.name)
        (folder / "own.parm").write_text("".join(f"{name} {value:g}\n" for name, value in self._parameters.items()))
        home = ",".join(f"{number:.7f}" for number in (*self._place, 0.0))
        options = ["--model", "quad", "--instance", str(self._instance), "--sysid", str(self._instance + 1)]
        options += ["--home", home, "--speedup", f"{self._speed:g}"]
        options += ["--defaults", f"{self._defaults},{folder / 'own.parm'}"]
        options += ["--serial0", self._links[0], "--serial1", self._links[1]]
        with (folder / "arducopter.log").open("ab") as log:
            self._process = subprocess.Popen(
                [str(self._program), *options], cwd=folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def log(self) -> str:
        """Return its output."""
        return (Path(self._folder.name) / "arducopter.log").read_text(errors="replace")

    def stop(self) -> None:
        """Stop the process, if it runs."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait(STOP_WITHIN_S)

    def close(self) -> None:
        """Stop, and delete its files."""
        self.stop()
        self._folder.cleanup()
