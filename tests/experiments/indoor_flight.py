"""Fly one PX4 simulator (CORDON_PX4) around a target indoors: without GPS, its positions sent as vision.

The simulator's truth serves as the camera system, at 30 Hz and 50 ms late, on the team's bus. The ring is evaluated
with the same truth.
"""

import asyncio
import json
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import atan2, cos, hypot, radians
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from pymavlink import mavutil

from agents.ports import VehicleRefusedError
from agents.team.external_positions import TOPIC, ExternalPose, ExternalPoses
from estimation.frames import Triple
from gcs.console.team_bus import guest_bus
from gcs.errors import InputError
from gcs.keys.team_keys import team_keys
from gcs.mission.file import load_mission
from gcs.mission.mission import Mission
from tests.experiments.arguments import parser, positive
from tests.support.px4 import Px4Simulator
from tests.support.wire import cordon

RATE_HZ, DELAY_S = 30.0, 0.05
TRUTH_HZ, HIL_STATE_QUATERNION, SET_MESSAGE_INTERVAL = 100.0, 115, 511
STATION_PORT = 14550
EARTH_M = 6_371_000.0
READY_S = 12.0
RADIUS_M, CENTRE_M = 2.0, (4.0, 0.0)
RADIUS_ERROR_MAX_M = 0.1
INDOORS = {
    "EKF2_GPS_CTRL": 0.0,
    "EKF2_EV_CTRL": 11.0,
    "EKF2_HGT_REF": 3.0,
    "EKF2_EV_DELAY": 1e3 * DELAY_S,
    "EKF2_EVP_NOISE": 0.01,
    "EKF2_TAU_POS": 0.1,
    "EKF2_TAU_VEL": 0.1,
    "COM_OBL_RC_ACT": 4.0,
}
"""As in docs/indoor.md."""
MISSION = f"""
[mission]
name = "indoors"
duration_s = 600.0
rate_hz = 20.0

[frame]
local = true
external_positions = true

[formation]
spacing_m = 2.0
speed_m_s = 0.1
leader = 1

[encirclement]
radius_m = {RADIUS_M}
angular_rate_rad_s = 0.3
speed_max_m_s = 1.5

[decision]
importance_min = 0.6
threat_max = 0.5
distance_max_m = 10.0

[safety]
separation_m = 1.0
fence_m = [[-5.0, -8.0], [12.0, -8.0], [12.0, 8.0], [-5.0, 8.0]]

[choreography]
landing = "in_place"

[target]
start_m = [{CENTRE_M[0]}, {CENTRE_M[1]}]
velocity_m_s = [0.0, 0.0]
importance = 0.8
threat = 0.2

[target.sensor]
range_m = 25.0
rate_hz = 5.0
noise_m = 0.0

[[vehicles]]
id = 1
url = "udpin://127.0.0.1:14540"
endpoint = "tcp/127.0.0.1:7461"
start_m = [0.0, 0.0]
origin_m = [0.0, 0.0, 0.0]
altitude_m = 2.5
profile = "px4"
"""


class Pose(NamedTuple):
    """The simulator's position north, west and up from its start [m], and its yaw counter-clockwise from north."""

    time_s: float
    position_m: Triple
    yaw_rad: float


class Cameras:
    """Reads and stores the simulator's truth."""

    def __init__(self, place: Triple) -> None:
        self._place = place
        self.track: list[Pose] = []
        self._recent: deque[Pose] = deque(maxlen=round(TRUTH_HZ))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read)

    def seen(self, at_s: float) -> Pose | None:
        """Return the newest truth not after a time."""
        return next((each for each in reversed(tuple(self._recent)) if each.time_s <= at_s), None)

    def start(self) -> None:
        """Read from now on."""
        self._thread.start()

    def close(self) -> None:
        """End."""
        self._ended.set()
        self._thread.join()

    def _read(self) -> None:
        link, asked_s = mavutil.mavlink_connection(f"udpin:127.0.0.1:{STATION_PORT}"), 0.0
        latitude, longitude, altitude = self._place
        while not self._ended.is_set():
            message = link.recv_match(blocking=True, timeout=0.2)
            if message is None:
                continue
            if time.monotonic() > asked_s:
                asked_s = time.monotonic() + 5.0
                link.mav.command_long_send(
                    1, 1, SET_MESSAGE_INTERVAL, 0, HIL_STATE_QUATERNION, 1e6 / TRUTH_HZ, 0, 0, 0, 0, 0
                )
            if message.get_type() == "HIL_STATE_QUATERNION":
                north_m = radians(message.lat * 1e-7 - latitude) * EARTH_M
                west_m = -radians(message.lon * 1e-7 - longitude) * EARTH_M * cos(radians(latitude))
                w, x, y, z = message.attitude_quaternion
                heading_rad = atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y**2 + z**2))
                place = (north_m, west_m, message.alt * 1e-3 - altitude)
                self._recent.append(Pose(time.time(), place, -heading_rad))
                self.track.append(self._recent[-1])
        link.close()


async def publish(mission: Mission, cameras: Cameras, ended: threading.Event) -> None:
    """Publish the vehicle's positions on the team's bus until the end."""
    while True:
        try:
            bus = guest_bus(mission, team_keys(mission).identity("positions"))
            break
        except (InputError, VehicleRefusedError):  # the flight has not begun
            await asyncio.sleep(0.2)
    await bus.open(lambda _: None, lambda *_: None, lambda *_: None)
    next_s = time.monotonic()
    while not ended.is_set():
        seen = cameras.seen(time.time() - DELAY_S)
        if seen is not None:
            poses = ExternalPoses((ExternalPose(1, seen.position_m, seen.yaw_rad),), seen.time_s)
            bus.publish(TOPIC, msgspec.json.encode(poses))
        next_s += 1.0 / RATE_HZ
        await asyncio.sleep(max(next_s - time.monotonic(), 0.0))
    await bus.close()


@contextmanager
def cameras_for(mission: Mission, place: Triple) -> Iterator[Cameras]:
    """Run the cameras, and publish their positions."""
    cameras, ended = Cameras(place), threading.Event()
    cameras.start()
    publishing = threading.Thread(target=lambda: asyncio.run(publish(mission, cameras, ended)), daemon=True)
    publishing.start()
    try:
        yield cameras
    finally:
        ended.set()
        publishing.join(2.0)
        cameras.close()


def main(arguments: Sequence[str] = sys.argv[1:]) -> int:
    """Fly, and print the figures."""
    reader = parser("indoor_flight", __doc__ or "")
    reader.add_argument("--duration", type=positive, default=120.0, help="seconds of the flight (default: %(default)s)")
    options = reader.parse_args(arguments)
    simulator = Px4Simulator(0, speed=1.0, parameters=INDOORS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "indoors.toml")
        path.write_text(MISSION)
        simulator.start()
        try:
            with cameras_for(load_mission(str(path)), simulator.place) as cameras:
                time.sleep(READY_S)
                with cordon("fly", str(path), "--duration", f"{options.duration:g}", "--json", "--no-log") as flight:
                    out, err = flight.communicate()
            print(err, file=sys.stderr)
            print((simulator.folder / "px4.log").read_text()[-2000:], file=sys.stderr)
        finally:
            simulator.close()
    result = json.loads(out)
    print(f"by its own estimates: {result['vehicles'][0]}, verdicts {result['verdicts']}")
    flown = [(pose.time_s, pose.position_m) for pose in cameras.track if pose.position_m[2] > 1.5]
    last_s = flown[-1][0]
    ring = [each for each in flown if last_s - 0.5 * options.duration < each[0] < last_s - 15.0]
    off = np.array([hypot(x - CENTRE_M[0], y - CENTRE_M[1]) - RADIUS_M for _, (x, y, _) in ring])
    bearings = np.unwrap([atan2(y - CENTRE_M[1], x - CENTRE_M[0]) for _, (x, y, _) in ring])
    error_m, rate_rad_s = float(np.sqrt(np.mean(off**2))), (bearings[-1] - bearings[0]) / (ring[-1][0] - ring[0][0])
    print(f"by truth, over {ring[-1][0] - ring[0][0]:.0f} s: radius error {error_m:.3f} m rms, ", end="")
    print(f"{np.abs(off).max():.3f} m max; mean rate {rate_rad_s:.4f} rad/s")
    return 0 if error_m <= RADIUS_ERROR_MAX_M else 1


if __name__ == "__main__":
    sys.exit(main())
