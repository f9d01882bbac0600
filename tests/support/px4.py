"""PX4 simulators for tests: processes of the build directory in the environment variable CORDON_PX4.

CORDON_PX4 is the build directory of PX4's own SITL target with the built-in simulator SIH: it holds bin/px4 and etc/.
"""

import os
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

VARIABLE = "CORDON_PX4"
FIRST_PORT = 14540
STOP_WITHIN_S = 10.0
SIH_QUADROTOR = "sihsim_quadx"


class Px4Missing(Exception):  # noqa: N818 - it is a reason to skip, no error
    """No PX4 simulator is available; the reason states what to set."""


def px4_build() -> Path:
    """Return the build directory; raises Px4Missing with the reason when there is none."""
    named = os.environ.get(VARIABLE)
    if not named:
        raise Px4Missing(f"{VARIABLE} is not set: point it to a PX4 SITL build directory (with bin/px4 and etc/)")
    build = Path(named)
    missing = [part for part in ("bin/px4", "etc") if not (build / part).exists()]
    if missing:
        raise Px4Missing(f"{VARIABLE} = {named} holds no {' and no '.join(missing)}: it is no PX4 SITL build directory")
    return build


class Px4Simulator:
    """One PX4 process with its built-in simulator; instance i has system id i + 1 and sends to UDP 14540 + i."""

    def __init__(
        self,
        instance: int = 5,
        *,
        speed: float = 2.0,
        place: tuple[float, float, float] = (47.397742, 8.545594, 488.0),
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        """Prepare an instance from 0 to 9 at a place (degrees, degrees, metres); raises Px4Missing."""
        self._build = px4_build()
        self._instance = instance
        self.system_id = instance + 1
        self.url = f"udpin://127.0.0.1:{FIRST_PORT + instance}"
        self.speed = speed
        self.place = place
        self._parameters = dict(parameters or {})
        self._folder = tempfile.TemporaryDirectory(prefix=f"px4-{instance}-")
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def folder(self) -> Path:
        """Its working directory, with its parameters and its output in px4.log."""
        return Path(self._folder.name)

    def start(self) -> None:
        """Start the process; parameters of an earlier start are kept, as on a flight controller."""
        latitude, longitude, altitude = self.place
        parameters = {"SDLOG_MODE": -1.0, **self._parameters}
        environment = os.environ | {
            "PX4_SIM_MODEL": SIH_QUADROTOR,
            "PX4_HOME_LAT": str(latitude),
            "PX4_HOME_LON": str(longitude),
            "PX4_HOME_ALT": str(altitude),
            "PX4_SIM_SPEED_FACTOR": f"{self.speed:g}",
            "HEADLESS": "1",
            **{f"PX4_PARAM_{name}": f"{value:g}" for name, value in parameters.items()},
        }
        options = ["-i", str(self._instance), "-d", "-w", str(self.folder)]
        command = [str(self._build / "bin" / "px4"), *options, str(self._build / "etc")]
        with (self.folder / "px4.log").open("ab") as log:
            self._process = subprocess.Popen(
                command, cwd=self.folder, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )

    def run(self, command: str, *words: str) -> None:
        """Run a command of its shell; raises subprocess.CalledProcessError."""
        program = [str(self._build / "bin" / f"px4-{command}"), "--instance", str(self._instance), *words]
        subprocess.run(program, cwd=self.folder, check=True, capture_output=True)

    def stop(self) -> None:
        """Stop the process, if it runs."""
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            try:
                process.wait(STOP_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def close(self) -> None:
        """Stop, and delete its files."""
        self.stop()
        self._folder.cleanup()
