"""Conformance: fly a list of exercises of a MAVLink client on the stub and on PX4, and print both side by side.

Each exercise flies a `Client` and returns its observation: texts and numbers by name. The expectations are those of PX4
(1.17, its built-in simulator), not of the stub. The same list is flown against the stub in every test run and against
PX4 under the marker `px4`. The table marks differences.
"""

import struct
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from math import cos, hypot, radians
from types import MappingProxyType

from agents.shell.clock import WallClock
from estimation.frames import Geodetic, MissionFrame
from estimation.plant.model import Plant, PlantAxis
from sitl.server.process import StubProcess
from sitl.server.server import StubConfig
from tests.experiments.arguments import parser
from tests.support.conformance_client import Client, NeverHappenedError
from tests.support.px4 import Px4Missing, Px4Simulator
from tests.support.wire import free_port

Value = str | float | bool
Observation = Mapping[str, Value]

SYSTEM_ID = 6
STUB_SPEED, PX4_SPEED = 5.0, 3.0
METRES_PER_DEGREE = 111_195.0
DO_SET_MODE, ARM, REQUEST_MESSAGE, SET_INTERVAL, NO_SUCH_COMMAND = 176, 400, 512, 511, 31000
REAL32 = 9
OFFBOARD, POSITION, RETURN = (1, 6, 0), (1, 3, 0), (1, 4, 5)
"""DO_SET_MODE's parameters: custom mode enabled, PX4's main mode, its sub mode."""


@dataclass(frozen=True, slots=True)
class Is:
    """An exact expectation; `why` explains a permitted difference of the stub."""

    value: Value
    why: str = ""

    def holds(self, value: Value) -> bool:
        """Judge one observation."""
        return value == self.value

    def agree(self, one: Value, other: Value) -> bool:
        """Say whether two observations are the same."""
        return one == other

    def __str__(self) -> str:
        return shown(self.value)


@dataclass(frozen=True, slots=True)
class Within:
    """The bounds of a number; two numbers less than half their width apart are the same."""

    low: float
    high: float
    why: str = ""

    def holds(self, value: Value) -> bool:
        """Judge one observation."""
        return not isinstance(value, str) and self.low <= value <= self.high

    def agree(self, one: Value, other: Value) -> bool:
        """Say whether two observations are the same."""
        numbers = not isinstance(one, str) and not isinstance(other, str)
        return numbers and abs(float(one) - float(other)) <= (self.high - self.low) / 2.0

    def __str__(self) -> str:
        return f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True, slots=True)
class Exercise:
    """One exercise, and its expectations."""

    run: Callable[[Client], Observation]
    expected: Mapping[str, Is | Within]

    @property
    def name(self) -> str:
        """Its name in tables and tests."""
        return self.run.__name__.replace("_", " ")

    def faults(self, observation: Observation) -> list[str]:
        """Return what does not conform, as text."""
        wrong = [
            f"{item} is {shown(observation[item])}, expected {expected}"
            for item, expected in self.expected.items()
            if item in observation and not expected.holds(observation[item])
        ]
        missing = [f"{item} was not observed" for item in self.expected if item not in observation]
        return wrong + missing + [f"{item} is not expected" for item in observation if item not in self.expected]


def shown(value: Value) -> str:
    """Return a value as in the table."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else f"{value:.4g}"


def observed(**values: Value) -> Observation:
    """Return an immutable observation."""
    return MappingProxyType(values)


EXERCISES: list[Exercise] = []


def exercise(**expected: Is | Within) -> Callable[[Callable[[Client], Observation]], Callable[[Client], Observation]]:
    """Add a function to the list, with its expectations."""

    def add(run: Callable[[Client], Observation]) -> Callable[[Client], Observation]:
        EXERCISES.append(Exercise(run, MappingProxyType(expected)))
        return run

    return add


# On the ground


@exercise(system_id=Is(SYSTEM_ID), autopilot=Is("PX4"), vehicle=Is("MULTICOPTER"), version=Is("1.17"))
def connect(client: Client) -> Observation:
    """Identify the vehicle."""
    version = client.info.get_version()
    return observed(
        system_id=client.system.get_system_id(),
        autopilot=client.system.autopilot_type().name,
        vehicle=client.system.vehicle_type().name,
        version=f"{version.flight_sw_major}.{version.flight_sw_minor}",
    )


@exercise(
    HEARTBEAT=Within(0.8, 1.2),
    SYS_STATUS=Within(4.0, 5.6, "its stream skips when the machine is busy"),
    LOCAL_POSITION_NED=Within(28.0, 32.0),
    GLOBAL_POSITION_INT=Within(45.0, 55.0),
    ATTITUDE=Within(45.0, 105.0, "the stub computes fifty times a second"),
    GPS_RAW_INT=Within(6.8, 9.2),
    HOME_POSITION=Within(0.3, 0.7),
    BATTERY_STATUS=Within(0.3, 0.7),
    EXTENDED_SYS_STATE=Within(0.8, 1.2),
)
def telemetry_unasked(client: Client) -> Observation:
    """Measure the default message rates [Hz]; MAVSDK has lowered EXTENDED_SYS_STATE."""
    client.be_ready()
    client.wait(3.0)  # MAVSDK's own requests are sent by now
    slow = ("HEARTBEAT", "SYS_STATUS", "GPS_RAW_INT", "HOME_POSITION", "BATTERY_STATUS", "EXTENDED_SYS_STATE")
    rates = dict(client.rates_hz(slow, 10.0))
    for name in ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE"):
        rates |= client.rates_hz((name,), 3.0)
    return observed(**rates)


@exercise(twenty=Within(19.0, 21.0), five=Within(4.5, 5.5), unasked_again=Within(28.0, 32.0), unknown=Is("FAILED"))
def telemetry_at_rates_asked_for(client: Client) -> Observation:
    """Set the rate of LOCAL_POSITION_NED [Hz], restore it, and request an unknown message."""
    rates: list[float] = []
    for rate_hz in (20.0, 5.0):
        client.telemetry.set_rate_position_velocity_ned(rate_hz)
        rates.append(client.rates_hz(("LOCAL_POSITION_NED",), 4.0)["LOCAL_POSITION_NED"])
    client.command(SET_INTERVAL, 32.0, 0.0)
    rates.append(client.rates_hz(("LOCAL_POSITION_NED",), 4.0)["LOCAL_POSITION_NED"])
    unknown = acknowledged(client.command(SET_INTERVAL, 9999.0, 50_000.0))
    return observed(twenty=rates[0], five=rates[1], unasked_again=rates[2], unknown=unknown)


@exercise(
    calibrated=Is(True), local_position=Is(True), global_position=Is(True), home=Is(True), armable=Is(True),
    fix=Is("FIX_3D"), satellites=Within(8, 20), battery_percent=Within(90.0, 100.0), mode=Is("HOLD"),
)  # fmt: skip
def health(client: Client) -> Observation:
    """Read the inputs of preflight checks."""
    client.be_ready()
    said, gps = client.telemetry.health(), client.telemetry.gps_info()
    calibrations = (said.is_gyrometer_calibration_ok, said.is_accelerometer_calibration_ok)
    return observed(
        calibrated=all(calibrations) and bool(said.is_magnetometer_calibration_ok),
        local_position=bool(said.is_local_position_ok),
        global_position=bool(said.is_global_position_ok),
        home=bool(said.is_home_position_ok),
        armable=bool(said.is_armable),
        fix=gps.fix_type.name,
        satellites=gps.num_satellites,
        battery_percent=client.telemetry.battery().remaining_percent,
        mode=client.mode,
    )


@exercise(
    home_from_start_m=Within(0.0, 1.0),
    origin_from_home_m=Within(0.0, 1.5),
    origin_above_home_m=Within(-1.5, 1.5),
    down_at_rest_m=Within(-1.5, 1.5),
    height_at_rest_m=Within(-1.0, 1.0),
    frames_agree_within_m=Within(0.0, 0.1),
)
def origin_and_home(client: Client) -> Observation:
    """Compare start, home, the estimator's origin, and the two position messages."""
    client.be_ready()
    home, origin = client.telemetry.home(), client.telemetry.get_gps_global_origin()
    start = (client.simulator.place[0], client.simulator.place[1])
    north_m, east_m, down_m = client.ned_m
    here = client.telemetry.position()
    by_globe = offset_m((origin.latitude_deg, origin.longitude_deg), (here.latitude_deg, here.longitude_deg))
    return observed(
        home_from_start_m=hypot(*offset_m(start, (home.latitude_deg, home.longitude_deg))),
        origin_from_home_m=hypot(
            *offset_m((home.latitude_deg, home.longitude_deg), (origin.latitude_deg, origin.longitude_deg))
        ),
        origin_above_home_m=origin.altitude_m - home.absolute_altitude_m,
        down_at_rest_m=down_m,
        height_at_rest_m=client.height_m,
        frames_agree_within_m=hypot(by_globe[0] - north_m, by_globe[1] - east_m),
    )


PARAMETERS: Mapping[str, int | float] = {
    "COM_OBL_RC_ACT": 0, "NAV_DLL_ACT": 0, "NAV_RCL_ACT": 2, "GF_ACTION": 2, "GF_MAX_HOR_DIST": 0.0,
    "GF_MAX_VER_DIST": 0.0, "MPC_XY_VEL_MAX": 12.0, "MPC_ACC_HOR": 3.0, "MPC_XY_CRUISE": 5.0, "MPC_LAND_SPEED": 0.7,
    "MPC_TKO_SPEED": 1.5, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_MAX_DN": 1.5, "MIS_TAKEOFF_ALT": 2.5,
    "COM_DISARM_LAND": 2.0, "COM_DISARM_PRFLT": 10.0, "RTL_RETURN_ALT": 30.0, "COM_RC_IN_MODE": 1, "MAV_TYPE": 2,
    "MAV_SYS_ID": SYSTEM_ID,
}  # fmt: skip
"""Parameters that clients read, with PX4's values; PX4's simulator sets COM_OF_LOSS_T (1.0) to the speed factor."""


@exercise(different=Is("none"), asked=Is(len(PARAMETERS)))
def parameters_by_default(client: Client) -> Observation:
    """Read parameters with their types."""
    different = [
        f"{name} = {value:g}"
        for name, expected in PARAMETERS.items()
        if (value := client.parameter(name, type(expected))) != wire_value(expected)
    ]
    return observed(different=", ".join(different) or "none", asked=len(PARAMETERS))


@exercise(
    known_read=Is(1), unknown_read=Is(0), right_type_set=Within(1, 2), wrong_type_set=Is(0), kept=Is(0),
    wrong_type_read=Is("WRONG_TYPE"), integer=Is(4), real=Is(7.5), out_of_any_sense=Is(99),
)  # fmt: skip
def parameters_set(client: Client) -> Observation:
    """Read and set, count the answers to an unknown name and to a wrong type, and set an invalid value."""
    param, by_name = client.param, {"param_index": -1}
    answers = {
        "known_read": client.parameter_answers("PARAM_REQUEST_READ", "NAV_DLL_ACT", **by_name),
        "unknown_read": client.parameter_answers("PARAM_REQUEST_READ", "NO_SUCH_PARAM", **by_name),
        "right_type_set": client.parameter_answers("PARAM_SET", "MPC_XY_CRUISE", param_value=5.0, param_type=REAL32),
        "wrong_type_set": client.parameter_answers("PARAM_SET", "NAV_DLL_ACT", param_value=1.0, param_type=REAL32),
    }
    param.set_param_int("COM_OBL_RC_ACT", 4)
    integer = param.get_param_int("COM_OBL_RC_ACT")
    param.set_param_float("MPC_XY_CRUISE", 7.5)
    real = param.get_param_float("MPC_XY_CRUISE")
    param.set_param_float("MPC_XY_CRUISE", 5.0)
    param.set_param_int("COM_OBL_RC_ACT", 99)
    out_of_any_sense = param.get_param_int("COM_OBL_RC_ACT")
    param.set_param_int("COM_OBL_RC_ACT", 0)
    return observed(
        **answers,
        kept=param.get_param_int("NAV_DLL_ACT"),
        wrong_type_read=client.result(param.get_param_float, "COM_OBL_RC_ACT"),
        integer=integer,
        real=real,
        out_of_any_sense=out_of_any_sense,
    )


@exercise(uploaded=Is("SUCCESS"), corners=Is(4), armable_inside=Is(True), cleared=Is("SUCCESS"), left=Is(0))
def geofence_on_the_ground(client: Client) -> Observation:
    """Upload an inclusion fence around home, read it back, and clear it."""
    client.be_ready()
    uploaded = client.result(client.geofence.upload_geofence, client.fence_around_home(30.0))
    corners = len(client.geofence.download_geofence().polygons[0].points)
    client.wait(1.0)
    armable = client.armable
    cleared = client.result(client.geofence.clear_geofence)
    left = len(client.geofence.download_geofence().polygons)
    return observed(uploaded=uploaded, corners=corners, armable_inside=armable, cleared=cleared, left=left)


DENIED_TEXT = "Arming denied: Resolve system health failures first"


@exercise(
    mode_return=Is("ACCEPTED, ACCEPTED"), armable_in_return=Is(False), arm_in_return=Is("TEMPORARILY_REJECTED"),
    mode_offboard=Is("ACCEPTED, ACCEPTED"), armable_in_offboard=Is(False), arm_in_offboard=Is("COMMAND_DENIED"),
    mode_position=Is("ACCEPTED, ACCEPTED"), armable_in_position=Is(False), arm_in_position=Is("COMMAND_DENIED"),
    says=Is(DENIED_TEXT), armable_in_hold=Is(True), unknown_command=Is("UNSUPPORTED"), unknown_message=Is("DENIED"),
)  # fmt: skip
def refused_on_the_ground(client: Client) -> Observation:
    """Arm in modes that no flight starts from; disarmed, every mode may be selected. MAVSDK leaves return by itself."""
    client.be_ready()
    found: dict[str, Value] = {}
    for name, mode, told in (("return", RETURN, "RETURN_TO_LAUNCH"), ("offboard", OFFBOARD, "OFFBOARD")):
        found[f"mode_{name}"] = acknowledged(client.command(DO_SET_MODE, *mode))
        client.until(lambda told=told: client.mode == told, told)  # type: ignore[misc]
        client.wait(0.5)
        found[f"armable_in_{name}"] = client.armable
        found[f"arm_in_{name}"] = (
            acknowledged(client.command(ARM, 1.0)) if name == "return" else client.result(client.action.arm)
        )
    found["mode_position"] = acknowledged(client.command(DO_SET_MODE, *POSITION))
    client.until(lambda: client.mode == "POSCTL", "position mode")
    client.wait(0.5)
    found["armable_in_position"] = client.armable
    found["arm_in_position"], found["says"] = client.refusal(client.action.arm)
    client.be_ready()
    found["armable_in_hold"] = client.armable
    found["unknown_command"] = acknowledged(client.command(NO_SUCH_COMMAND))
    found["unknown_message"] = acknowledged(client.command(REQUEST_MESSAGE, 9999.0))
    return observed(**found)


@exercise(arm=Is("SUCCESS"), says=Is("Armed by external command"), disarms_after_s=Within(10.5, 12.0))
def arm_and_wait(client: Client) -> Observation:
    """Arm and do nothing: it disarms by itself."""
    client.be_ready()
    said_before = len(client.said)
    result, says = client.refusal(client.action.arm)
    armed_s = client.until_said("Armed by", since=said_before)
    disarmed_s = client.until_said("Disarmed by", 20.0, since=said_before)
    return observed(arm=result, says=says, disarms_after_s=disarmed_s - armed_s)


# In the air


@exercise(
    altitude_kept=Is(4.0), lift_off_s=Within(1.0, 3.0), hold_s=Within(5.5, 10.0), modes=Is("TAKEOFF, HOLD"),
    height_m=Within(2.5, 6.0, "its estimator wanders"), in_air=Is(True),
    says=Is("Using default takeoff altitude: 4.0 m"),
)  # fmt: skip
def take_off(client: Client) -> Observation:
    """Take off to 4 m; modes are reported with heartbeats, up to one second late."""
    client.be_ready()
    client.action.set_takeoff_altitude(4.0)
    client.action.arm()
    start_s, said_before = client.now_s, len(client.said)
    client.action.takeoff()
    client.until_said("Using default", since=said_before)
    says = client.said[-1].text
    lifted_s = client.until_said("Takeoff detected", since=said_before)
    modes = [client.until_mode("TAKEOFF"), client.until_mode("HOLD", 30.0)]
    hold_s = client.now_s - start_s
    client.wait(5.0)
    return observed(
        altitude_kept=client.action.get_takeoff_altitude(),
        lift_off_s=lifted_s - start_s,
        hold_s=hold_s,
        modes=", ".join(modes),
        height_m=client.height_m,
        in_air=bool(client.telemetry.in_air()),
        says=says,
    )


@exercise(
    disarm=Is("COMMAND_DENIED"), disarm_says=Is("Disarming denied: not landed"), armed=Is(True),
    offboard=Is("ACCEPTED, TEMPORARILY_REJECTED"), offboard_mode=Is("HOLD"),
    says=Is("Switching to Offboard is currently not available"),
    position=Is("ACCEPTED, TEMPORARILY_REJECTED"), position_mode=Is("HOLD"),
)  # fmt: skip
def refused_in_the_air(client: Client) -> Observation:
    """Disarm in the air, start offboard without setpoints, select a mode that needs sticks: acknowledged at first."""
    client.hover()
    disarm, disarm_says = client.refusal(client.action.disarm)
    before = len(client.said)
    offboard = acknowledged(client.command(DO_SET_MODE, *OFFBOARD))
    client.until_said("Switching to", since=before)
    client.wait(1.2)
    offboard_mode, says = client.mode, client.said[-1].text
    position = acknowledged(client.command(DO_SET_MODE, *POSITION))
    client.wait(1.2)
    return observed(
        disarm=disarm, disarm_says=disarm_says, armed=client.armed, offboard=offboard, offboard_mode=offboard_mode,
        says=says, position=position, position_mode=client.mode,
    )  # fmt: skip


@exercise(start=Is("SUCCESS"), mode_after_s=Within(0.0, 2.0), step_90_s=Within(1.5, 4.5), stop=Is("SUCCESS"))
def offboard_step(client: Client) -> Observation:
    """Start offboard with a stream of setpoints, fly 3 m north, and leave it for hold."""
    client.hover()
    north_m, east_m, _ = client.ned_m
    client.send(north_m, east_m, client.down_m(4.0))
    start_s = client.now_s
    start = client.result(client.offboard.start)
    client.until_mode("OFFBOARD")
    mode_after_s = client.now_s - start_s
    client.wait(3.0)
    client.send(north_m + 3.0, east_m, client.down_m(4.0))
    step_s = client.until(lambda: client.ned_m[0] > north_m + 2.7, "nine tenths of the step")
    stop = client.result(client.offboard.stop)
    client.until_mode("HOLD")
    return observed(start=start, mode_after_s=mode_after_s, step_90_s=step_s, stop=stop)


def stream_lost(client: Client, action: int) -> dict[str, Value]:
    """Stop sending in offboard, then send again: the time of the failsafe, its mode, and what ends it."""
    client.param.set_param_float("COM_OF_LOSS_T", 1.0)
    client.param.set_param_int("COM_OBL_RC_ACT", action)
    client.fly_offboard()
    client.wait(2.0)
    north_m, east_m, _ = client.ned_m
    client.send(north_m, east_m, client.down_m(4.0))
    said_before = len(client.said)
    silent_s = client.fall_silent()
    failsafe_s = client.until_said("Failsafe activated", since=said_before)
    client.until(lambda: client.mode != "OFFBOARD", "the failsafe's mode")
    mode = client.mode
    client.wait(2.0)
    client.send(north_m, east_m, client.down_m(4.0))
    back_s = client.until(lambda: client.mode == "OFFBOARD", "offboard again, unasked", 4.0)
    client.param.set_param_int("COM_OBL_RC_ACT", 0)
    return {"failsafe_s": failsafe_s - silent_s, "mode": mode, "resumes_unasked_s": back_s}


LOSS_S, RESUME_S = Within(0.7, 1.6), Within(0.0, 2.5)


@exercise(failsafe_s=LOSS_S, mode=Is("HOLD"), resumes_unasked_s=RESUME_S)
def stream_lost_hold(client: Client) -> Observation:
    """Lose the stream with COM_OBL_RC_ACT = 5."""
    return observed(**stream_lost(client, 5))


@exercise(failsafe_s=LOSS_S, mode=Is("LAND"), resumes_unasked_s=RESUME_S)
def stream_lost_land(client: Client) -> Observation:
    """Lose the stream with COM_OBL_RC_ACT = 4."""
    return observed(**stream_lost(client, 4))


@exercise(failsafe_s=LOSS_S, mode=Is("RETURN_TO_LAUNCH"), resumes_unasked_s=RESUME_S)
def stream_lost_default(client: Client) -> Observation:
    """Lose the stream with COM_OBL_RC_ACT = 0: without sticks, the mode of NAV_RCL_ACT."""
    return observed(**stream_lost(client, 0))


@exercise(mode=Is("OFFBOARD"), drift_m=Within(0.0, 1.5, "its estimator wanders"))
def stop_by_velocity(client: Client) -> Observation:
    """Send a velocity of zero in offboard at rest, instead of positions."""
    client.fly_offboard()
    client.wait(3.0)
    before = client.ned_m
    client.stop()
    client.wait(5.0)
    after = client.ned_m
    return observed(mode=client.mode, drift_m=hypot(after[0] - before[0], after[1] - before[1]))


@exercise(
    hold=Is("SUCCESS"), drift_m=Within(0.0, 1.5, "its estimator wanders"),
    speed_m_s=Within(0.0, 1.0, "its estimator wanders"),
)  # fmt: skip
def hold(client: Client) -> Observation:
    """Change from offboard to hold at rest, and stay."""
    client.fly_offboard()
    client.wait(3.0)
    before = client.ned_m
    result = client.result(client.action.hold)
    client.until_mode("HOLD")
    client.wait(5.0)
    velocity = client.telemetry.position_velocity_ned().velocity
    after = client.ned_m
    return observed(
        hold=result,
        drift_m=hypot(after[0] - before[0], after[1] - before[1]),
        speed_m_s=hypot(velocity.north_m_s, velocity.east_m_s),
    )


@exercise(
    stopped_m=Within(7.5, 12.5), mode=Is("HOLD"),
    says=Is("Geofence: approaching or outside geofence"),
)  # fmt: skip
def geofence_crossed(client: Client) -> Observation:
    """Fly out of an inclusion fence of 8 m around home, which puts it into hold; a lost stream would do the same."""
    client.param.set_param_int("COM_OBL_RC_ACT", 5)
    client.hover()
    client.geofence.upload_geofence(client.fence_around_home(8.0))
    client.fly_offboard()
    home = client.telemetry.home()
    before = len(client.said)
    client.send(home.local_north_m + 14.0, home.local_east_m, client.down_m(4.0))
    try:
        client.until_said("eofence", 15.0, since=before)
        stopped_m = client.ned_m[0] - home.local_north_m
        client.until(lambda: client.mode != "OFFBOARD", "the fence's mode")
        mode, says = client.mode, next(each.text for each in client.said[before:] if "eofence" in each.text)
    finally:
        client.geofence.clear_geofence()
        client.param.set_param_int("COM_OBL_RC_ACT", 0)
        client.fall_silent()
    return observed(stopped_m=stopped_m, mode=mode, says=says)


@exercise(
    land=Is("SUCCESS"), says=Is("Landing at current position"), landed_s=Within(8.0, 25.0),
    disarms_later_s=Within(1.8, 2.5), disarmed_says=Is("Disarmed by landing"), rests_in=Is("OFFBOARD"),
    armable=Is(False), arm=Is("COMMAND_DENIED"), armable_after_hold=Is(True),
)  # fmt: skip
def land_out_of_offboard(client: Client) -> Observation:
    """Land from 4 m without leaving offboard: it stays in offboard, and cannot be armed before hold is selected."""
    client.fly_offboard()
    client.wait(4.0)
    start_s, before = client.now_s, len(client.said)
    land, says = client.refusal(client.action.land)
    client.fall_silent()
    landed_s = client.until_said("Landing detected", 60.0, since=before)
    disarmed_s = client.until_said("Disarmed by", since=before)
    client.until_mode("OFFBOARD")
    client.wait(2.0)
    mode, armable, arm = client.mode, client.armable, client.result(client.action.arm)
    disarmed_says = next(each.text for each in client.said[before:] if "Disarmed" in each.text)
    client.be_ready()
    return observed(
        land=land, says=says, landed_s=landed_s - start_s, disarms_later_s=disarmed_s - landed_s,
        disarmed_says=disarmed_says, rests_in=mode, armable=armable, arm=arm, armable_after_hold=client.armable,
    )  # fmt: skip


@exercise(
    arm=Is("SUCCESS"), hovers=Is(True), returns=Is("SUCCESS"), mode=Is("RETURN_TO_LAUNCH"),
    home_m=Within(0.0, 2.5, "its estimator wanders"), rests_in=Is("HOLD"),
)  # fmt: skip
def second_flight_and_return(client: Client) -> Observation:
    """Fly again right after landing, and return: it lands at home, disarms, and stays in hold."""
    client.be_ready()
    client.action.set_takeoff_altitude(4.0)
    arm = client.result(client.action.arm)
    client.action.takeoff()
    client.until_mode("TAKEOFF")
    client.until_mode("HOLD", 30.0)
    client.wait(2.0)
    hovers = client.height_m > 3.0
    before = client.ned_m
    returns = client.result(client.action.return_to_launch)
    mode = client.until_mode("RETURN_TO_LAUNCH")
    client.until(lambda: not client.armed, "home and disarmed", 120.0)
    client.until_mode("HOLD")
    after = client.ned_m
    home_m = hypot(after[0] - before[0], after[1] - before[1])
    return observed(arm=arm, hovers=hovers, returns=returns, mode=mode, home_m=home_m, rests_in=client.mode)


@exercise(kill=Is("SUCCESS"), says=Is("Disarmed by external command"), on_ground_s=Within(0.5, 4.0), armable=Is(True))
def kill_in_the_air(client: Client) -> Observation:
    """Kill at 4 m: in contrast to disarming it is accepted; the vehicle falls, and can be armed again."""
    client.hover()
    kill, says = client.refusal(client.action.kill)
    start_s = client.now_s
    client.until(lambda: not client.telemetry.in_air(), "on the ground")
    on_ground_s = client.now_s - start_s
    client.wait(3.0)
    return observed(kill=kill, says=says, on_ground_s=on_ground_s, armable=client.armable)


@exercise(
    rate_asked_for=Within(9.0, 11.0), clock_runs_back=Is(True), system_id=Is(SYSTEM_ID), systems=Is(1),
    rate_afterwards=Within(28.0, 32.0), mode=Is("HOLD"), flies_again=Is("SUCCESS"),
)  # fmt: skip
def restart(client: Client) -> Observation:
    """Restart the autopilot: its clock and the message rates are reset, the system id is the same."""
    client.be_ready()
    client.telemetry.set_rate_position_velocity_ned(10.0)
    asked = client.rates_hz(("LOCAL_POSITION_NED",), 4.0)["LOCAL_POSITION_NED"]
    client.restart_simulator()
    client.be_ready()
    return observed(
        rate_asked_for=asked,
        clock_runs_back=client.clock_resets > 0,
        system_id=client.system.get_system_id(),
        systems=client.systems,
        rate_afterwards=client.rates_hz(("LOCAL_POSITION_NED",), 4.0)["LOCAL_POSITION_NED"],
        mode=client.mode,
        flies_again=client.result(client.action.arm),
    )


RESULTS = ("ACCEPTED", "TEMPORARILY_REJECTED", "DENIED", "UNSUPPORTED", "FAILED")


def acknowledged(results: Sequence[int]) -> str:
    """Return acknowledgements as text."""
    return ", ".join(RESULTS[result] for result in results) or "silence"


def offset_m(start: tuple[float, float], end: tuple[float, float]) -> tuple[float, float]:
    """Return the distances north and east between two positions [degrees], on a sphere."""
    north_deg, east_deg = end[0] - start[0], end[1] - start[1]
    return north_deg * METRES_PER_DEGREE, east_deg * METRES_PER_DEGREE * cos(radians(start[0]))


def wire_value(value: int | float) -> int | float:
    """Return a parameter as a client reads it: floats have 32 bits."""
    return value if isinstance(value, int) else float(struct.unpack("<f", struct.pack("<f", value))[0])


# The two simulators


PLACE = (47.397742, 8.545594, 488.0)


class StubSimulator:
    """The stub as a simulator that can be restarted."""

    def __init__(self, port: int, *, speed: float = STUB_SPEED) -> None:
        """Prepare a stub for a client on `port`."""
        self.url = f"udpin://127.0.0.1:{port}"
        self.system_id = SYSTEM_ID
        self.speed = speed
        self.place = PLACE
        plant = Plant(PlantAxis(1.51, 1.90), PlantAxis(1.87, 2.40), delay_s=0.2)
        frame = MissionFrame(Geodetic(*PLACE), x_bearing_rad=0.0)
        self._config = StubConfig(SYSTEM_ID, port, plant, frame, origin_offset_m=(0.3, -0.2, -0.5))
        self._process: StubProcess | None = None

    def start(self) -> None:
        """Start the process."""
        self._process = StubProcess([self._config], partial(WallClock, self.speed))
        self._process.start()

    def stop(self) -> None:
        """Stop the process, if it runs."""
        process, self._process = self._process, None
        if process is not None:
            process.stop()

    close = stop


@contextmanager
def client_of(simulator: StubSimulator | Px4Simulator) -> Iterator[Client]:
    """Start a simulator and connect to it; both end with the context."""
    simulator.start()
    try:
        client = Client(simulator)
        try:
            yield client
        finally:
            client.close()
    finally:
        simulator.close()


def flown(simulator: StubSimulator | Px4Simulator) -> dict[str, Observation]:
    """Fly the whole list; the observation of an unfinished exercise is the reason."""
    observations: dict[str, Observation] = {}
    with client_of(simulator) as client:
        for each in EXERCISES:
            try:
                observations[each.name] = each.run(client)
            except (NeverHappenedError, RuntimeError) as error:
                observations[each.name] = observed(failure=str(error))
    return observations


def table(stub: Mapping[str, Observation], px4: Mapping[str, Observation]) -> Iterator[str]:
    """Yield the table's lines: expectation, both observations, and every difference, marked and explained."""
    yield f"{'exercise':30}  {'item':24}  {'expected':34}  {'stub':34}  {'PX4':34}"
    for each in EXERCISES:
        ours, theirs = stub.get(each.name, {}), px4.get(each.name, {})
        for item in [*each.expected, *({*ours, *theirs} - {*each.expected})]:
            expected = each.expected.get(item, Is("never"))
            cells = [shown(side[item]) if item in side else "" for side in (ours, theirs)]
            yield f"{each.name:30}  {item:24}  {expected!s:34.34}  {cells[0]:34.34}  {cells[1]:34.34}  " + " ".join(
                remarks(expected, ours.get(item), theirs.get(item))
            )


def remarks(expected: Is | Within, stub: Value | None, px4: Value | None) -> Iterator[str]:
    """Yield the remarks on a line: what does not conform, and where stub and PX4 differ."""
    for name, value in (("stub", stub), ("PX4", px4)):
        if value is not None and not expected.holds(value):
            yield f"FAILS ({name})"
    if stub is not None and px4 is not None and not expected.agree(stub, px4):
        yield f"DIFFERS: {expected.why or 'unexplained'}"


def main() -> None:
    """Print the table; the column of PX4 is empty where there is none."""
    stub = flown(StubSimulator(free_port()))
    try:
        px4 = flown(Px4Simulator(SYSTEM_ID - 1, speed=PX4_SPEED, place=PLACE))
    except Px4Missing as missing:
        print(f"no PX4: {missing}", file=sys.stderr)
        px4 = {}
    for line in table(stub, px4):
        print(line.rstrip())


if __name__ == "__main__":
    parser("conformance", __doc__).parse_args()
    main()
