"""The MAVLink client of the exercises: MAVSDK's plugins for one vehicle, its status texts, and the autopilot's clock.

Times are on the autopilot's clock, from its attitude messages, and so independent of the simulation speed.
"""

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, nan, radians
from typing import Any, Protocol

from mavsdk.exceptions import MavsdkError
from mavsdk.mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.geofence import FenceType, Geofence, GeofenceData, Point, Polygon
from mavsdk.plugins.info import Info
from mavsdk.plugins.mavlink_direct import MavlinkDirect, MavlinkMessage
from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

POLL_S = 0.005
TEXT_WITHIN_S = 0.5
FOUND_WITHIN_S = 30.0
STALLED_AFTER_S = 15.0
"""The wall time by which a wait may exceed its limit, in case the autopilot's clock stops."""
AUTOPILOT = 1
METRES_PER_DEGREE = 111_195.0


class Simulator(Protocol):
    """One simulated vehicle in a process that can be restarted."""

    url: str
    system_id: int
    speed: float
    place: tuple[float, float, float]

    def start(self) -> None:
        """Start, and return when its sockets are bound."""
        ...

    def stop(self) -> None:
        """Stop, and return when it has ended."""
        ...


class NeverHappenedError(AssertionError):
    """A condition of an exercise did not become true in time."""


@dataclass(frozen=True, slots=True)
class LocalCommand:
    """A status text, and its time on the autopilot's clock."""

    time_s: float
    text: str


class Client:
    """One vehicle over MAVSDK: its telemetry and status texts, and the commands of the exercises."""

    def __init__(self, simulator: Simulator) -> None:
        """Connect; raises NeverHappenedError if the vehicle is not received."""
        self.simulator = simulator
        start_s = time.monotonic()
        self._mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        self._mavsdk.add_any_connection(simulator.url)
        while not self._mavsdk.system_count():
            if time.monotonic() > start_s + FOUND_WITHIN_S:
                raise NeverHappenedError(f"no vehicle at {simulator.url} within {FOUND_WITHIN_S:g} s")
            time.sleep(POLL_S)
        self.system: Any = self._mavsdk.get_systems()[0]
        self.telemetry: Any = Telemetry(self.system)
        self.action: Any = Action(self.system)
        self.offboard: Any = Offboard(self.system)
        self.param: Any = Param(self.system)
        self.geofence: Any = Geofence(self.system)
        self.info: Any = Info(self.system)
        self._direct: Any = MavlinkDirect(self.system)
        self.now_s = 0.0
        self.said: list[LocalCommand] = []
        self.clock_resets = 0
        self.telemetry.subscribe_attitude_euler(self._take_time)
        self.telemetry.subscribe_status_text(self._take_text)

    def close(self) -> None:
        """Disconnect."""
        self._mavsdk.destroy()

    def _take_time(self, attitude: Any, _user_data: object) -> None:
        now_s = attitude.timestamp_us * 1e-6
        self.clock_resets += now_s < self.now_s - 1.0
        self.now_s = now_s

    def _take_text(self, text: Any, _user_data: object) -> None:
        self.said.append(LocalCommand(self.now_s, text.text.rstrip("\t ")))

    # State

    @property
    def mode(self) -> str:
        """The flight mode of the last heartbeat."""
        return str(self.telemetry.flight_mode().name)

    @property
    def armed(self) -> bool:
        """Whether it is armed by the last heartbeat."""
        return bool(self.telemetry.armed())

    @property
    def armable(self) -> bool:
        """Whether the preflight checks pass in the present mode."""
        return bool(self.telemetry.health().is_armable)

    @property
    def ned_m(self) -> tuple[float, float, float]:
        """The local position."""
        position = self.telemetry.position_velocity_ned().position
        return position.north_m, position.east_m, position.down_m

    @property
    def height_m(self) -> float:
        """The height above home, by the global position."""
        return float(self.telemetry.position().relative_altitude_m)

    def down_m(self, height_m: float) -> float:
        """The local position's down at a height above home."""
        return float(self.telemetry.home().local_down_m) - height_m

    @property
    def systems(self) -> int:
        """The number of vehicles received."""
        return int(self._mavsdk.system_count())

    def parameter(self, name: str, kind: type[int] | type[float]) -> int | float:
        """Read a parameter of a type; NaN if it does not exist or has another type."""
        read = self.param.get_param_int if kind is int else self.param.get_param_float
        try:
            return kind(read(name))
        except MavsdkError:
            return nan

    def fence_around_home(self, reach_m: float) -> Any:
        """Return an inclusion fence: a square about home with this distance to each side."""
        home = self.telemetry.home()
        north_deg = reach_m / METRES_PER_DEGREE
        east_deg = north_deg / cos(radians(home.latitude_deg))
        signs = ((1, 1), (1, -1), (-1, -1), (-1, 1))
        corners = [Point(home.latitude_deg + n * north_deg, home.longitude_deg + e * east_deg) for n, e in signs]
        return GeofenceData([Polygon(corners, FenceType.INCLUSION)], [])

    # Waiting

    def wait(self, seconds: float) -> None:
        """Wait for a time on the autopilot's clock."""
        start_s = self.now_s
        self.until(lambda: self.now_s - start_s >= seconds, "time passes", seconds + 5.0)

    def until(self, condition: Callable[[], bool], what: str, limit_s: float = 10.0) -> float:
        """Wait for a condition; return the waiting time on the autopilot's clock. Raises NeverHappenedError."""
        start_s, wall_end_s = self.now_s, time.monotonic() + limit_s / self.simulator.speed + STALLED_AFTER_S
        while not condition():
            if self.now_s - start_s > limit_s or time.monotonic() > wall_end_s:
                said = [each.text for each in self.said[-3:]]
                raise NeverHappenedError(f"not within {limit_s:g} s: {what} (mode {self.mode}, it says {said})")
            time.sleep(POLL_S)
        return self.now_s - start_s

    def until_mode(self, mode: str, limit_s: float = 10.0) -> str:
        """Wait for a flight mode, and return it."""
        self.until(lambda: self.mode == mode, mode, limit_s)
        return mode

    def until_said(self, words: str, limit_s: float = 10.0, *, since: int = 0) -> float:
        """Wait for a status text with these words; return its time."""

        def found() -> LocalCommand | None:
            return next((each for each in self.said[since:] if words in each.text), None)

        self.until(lambda: found() is not None, f"“{words}”", limit_s)
        said = found()
        assert said is not None
        return said.time_s

    # Commands

    def result(self, function: Callable[..., object], *arguments: object) -> str:
        """Return the name of a call's result: SUCCESS, or the error."""
        try:
            function(*arguments)
        except MavsdkError as error:
            return str(getattr(getattr(error, "result", None), "name", error))
        return "SUCCESS"

    def refusal(self, function: Callable[..., object], *arguments: object) -> tuple[str, str]:
        """Return the result of a call, and the autopilot's status texts, which may arrive a little later."""
        before = len(self.said)
        result = self.result(function, *arguments)
        end_s = time.monotonic() + TEXT_WITHIN_S
        while len(self.said) == before and time.monotonic() < end_s:
            time.sleep(POLL_S)
        return result, " / ".join(each.text for each in self.said[before:])

    def command(self, number: int, *params: float, listen_wall_s: float = 0.4) -> list[int]:
        """Send a COMMAND_LONG; return the results of all its acknowledgements in order."""
        results: list[int] = []

        def take(message: Any, _user_data: object) -> None:
            fields = json.loads(message.fields_json)
            if fields["command"] == number:
                results.append(int(fields["result"]))

        fields = {f"param{index}": value for index, value in enumerate((*params, *[0.0] * 7)[:7], 1)}
        self._send("COMMAND_LONG", fields | {"command": number, "confirmation": 0}, "COMMAND_ACK", take, listen_wall_s)
        return results

    def parameter_answers(self, message: str, name: str, **fields: float) -> int:
        """Send a PARAM_SET or PARAM_REQUEST_READ; return the number of PARAM_VALUE answers."""
        answers: list[str] = []

        def take(told: Any, _user_data: object) -> None:
            if json.loads(told.fields_json)["param_id"] == name:
                answers.append(name)

        self._send(message, fields | {"param_id": name}, "PARAM_VALUE", take, 0.4)
        return len(answers)

    def _send(
        self,
        name: str,
        fields: Mapping[str, float | str],
        answer: str,
        take: Callable[[Any, object], None],
        listen_wall_s: float,
    ) -> None:
        """Send a message to the autopilot, and collect its answers for some time."""
        handle = self._direct.subscribe_message(answer, take)
        whom = {"target_system": self.simulator.system_id, "target_component": AUTOPILOT}
        body = json.dumps({**fields, **whom})
        self._direct.send_message(MavlinkMessage(name, 0, 0, self.simulator.system_id, AUTOPILOT, body))
        time.sleep(listen_wall_s)
        self._direct.unsubscribe_message(handle)

    def rates_hz(self, names: tuple[str, ...], seconds: float) -> Mapping[str, float]:
        """Return the message rate on the autopilot's clock, from the first to the last message."""
        heard_s: dict[str, list[float]] = {name: [] for name in names}

        def take(message: Any, name: object) -> None:
            heard_s[str(name)].append(self.now_s)

        handles = [self._direct.subscribe_message(name, take, name) for name in names]
        self.wait(seconds)
        for handle in handles:
            self._direct.unsubscribe_message(handle)
        return {
            name: (len(times) - 1) / (times[-1] - times[0]) if times and times[-1] > times[0] else 0.0
            for name, times in heard_s.items()
        }

    def send(self, north_m: float, east_m: float, down_m: float) -> None:
        """Send a setpoint, which MAVSDK repeats from now on."""
        self.offboard.set_position_ned(PositionNedYaw(north_m, east_m, down_m, 0.0))

    def stop(self) -> None:
        """Send a velocity of zero, which MAVSDK repeats from now on."""
        self.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))

    def fall_silent(self) -> float:
        """Send the last setpoint once more, then none; return the time."""
        self.offboard.destroy()
        self.offboard = Offboard(self.system)
        return self.now_s

    def restart_simulator(self) -> None:
        """Restart the simulator, and wait until its clock has restarted."""
        resets = self.clock_resets
        self.simulator.stop()
        self.simulator.start()
        end_s = time.monotonic() + STALLED_AFTER_S
        while self.clock_resets == resets:
            if time.monotonic() > end_s:
                raise NeverHappenedError("the restarted autopilot's clock did not begin anew")
            time.sleep(POLL_S)

    # Initial states of exercises

    def be_ready(self) -> None:
        """On the ground, disarmed, in hold, with default parameters."""
        self.fall_silent()
        if self.armed:
            self.action.land()
            self.until(lambda: not self.armed, "landed and disarmed", 120.0)
        if self.mode != "HOLD":
            self.action.hold()
            self.until(lambda: self.mode == "HOLD", "hold")
        self.until(lambda: self.armable, "armable", 60.0)

    def hover(self, height_m: float = 4.0) -> None:
        """Hover in hold."""
        self.fall_silent()
        if not (self.armed and self.telemetry.in_air()):
            self.be_ready()
            self.action.set_takeoff_altitude(height_m)
            self.action.arm()
            self.action.takeoff()
            self.until(lambda: self.mode == "TAKEOFF", "take-off mode")
            self.until(lambda: self.mode == "HOLD", "hold after take-off", 30.0)
        elif self.mode != "HOLD":
            self.action.hold()
            self.until(lambda: self.mode == "HOLD", "hold")

    def fly_offboard(self) -> None:
        """Hover in offboard, 4 m above home, with a stream of setpoints."""
        self.hover()
        north_m, east_m, _ = self.ned_m
        self.send(north_m, east_m, self.down_m(4.0))
        self.offboard.start()
        self.until(lambda: self.mode == "OFFBOARD", "offboard")
