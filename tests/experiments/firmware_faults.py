"""Provoke faults on the firmware of PX4 and ArduCopter in mid-ring, and print what cordon tells and does.

Three simulators from the environment variables CORDON_PX4 and CORDON_ARDUCOPTER fly px4-trio and ardupilot-trio at
speed 1. Each fault hits the last vehicle that still flies its mission. It is watched, ended, and `resume` is sent as
long as the vehicle is in doubt. Distances are by the simulators' truth. Exit code 1 if vehicles came too close.
"""

import asyncio
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import dist, inf
from pathlib import Path

from agents.ports import VehicleRefusedError
from agents.tactics import Tactic
from estimation.frames import Triple
from gcs.drill.judge import NEAR_TOLERANCE_M, SAME_HEIGHT_M
from gcs.drill.run import drill_mission
from tests.experiments.arguments import parser
from tests.support.arducopter import ArduCopterMissing
from tests.support.firmware_flight import CopterFlight, FirmwareFlight, Px4Flight
from tests.support.px4 import Px4Missing

MISSIONS = {"px4": "px4-trio", "arducopter": "ardupilot-trio"}
RETURNS_WITHIN_S, RESUMES_EVERY_S = 40.0, 3.0
ENDED_S, LOOKS_S = 3.0, 0.05
BESIDE_M, SEPARATION_M = 10.0, 2.0
METRES_PER_DEGREE = 111_195.0
BATTERY_RESET, SET_MESSAGE_INTERVAL, LOCAL_POSITION = 42651, 511, 32
NEVER = -1.0
PASCAL_PER_M = 11.4
"""At the height of the missions."""

Act = Callable[[FirmwareFlight, int], None]


@dataclass(frozen=True)
class Fault:
    """A fault of a vehicle's firmware: how it begins, how it ends (None: it lasts), and how long it is watched."""

    name: str
    begin: Act
    end: Act | None = None
    watched_s: float = 20.0


def _copter(**parameters: float) -> Act:
    def act(flight: FirmwareFlight, vehicle: int) -> None:
        for name, value in parameters.items():
            flight.relays[vehicle].set_parameter(name, value)

    return act


def _px4(**parameters: float) -> Act:
    def act(flight: FirmwareFlight, vehicle: int) -> None:
        assert isinstance(flight, Px4Flight)
        for name, value in parameters.items():
            flight.simulators[vehicle].run("param", "set", name, f"{value:g}")

    return act


def _battery(number: int, percent: float) -> Act:
    return lambda flight, vehicle: flight.relays[vehicle].command(BATTERY_RESET, float(1 << number), percent)


def _motion(period_us: float) -> Act:
    return lambda flight, vehicle: flight.relays[vehicle].command(SET_MESSAGE_INTERVAL, LOCAL_POSITION, period_us)


def _link(*, cut: bool) -> Act:
    def act(flight: FirmwareFlight, vehicle: int) -> None:
        flight.relays[vehicle].cut = cut

    return act


def _origin(flight: FirmwareFlight) -> Triple:
    """Return a place beside the mission's origin [deg, deg, m]."""
    frame = flight.mission.frame
    assert frame.latitude_deg is not None
    assert frame.longitude_deg is not None
    assert frame.altitude_m is not None
    return frame.latitude_deg + BESIDE_M / METRES_PER_DEGREE, frame.longitude_deg, frame.altitude_m


def _copter_origin(flight: FirmwareFlight, vehicle: int) -> None:
    flight.relays[vehicle].set_origin(*_origin(flight))


def _px4_origin(flight: FirmwareFlight, vehicle: int) -> None:
    assert isinstance(flight, Px4Flight)
    latitude, longitude, altitude = _origin(flight)
    flight.simulators[vehicle].run(
        "commander", "set_ekf_origin", f"{latitude:.8f}", f"{longitude:.8f}", f"{altitude:g}"
    )


def _runs(command: str, *words: str) -> Act:
    def act(flight: FirmwareFlight, vehicle: int) -> None:
        assert isinstance(flight, Px4Flight)
        flight.simulators[vehicle].run(command, *words)

    return act


NORTH_10_M = 10.0 / METRES_PER_DEGREE
COPTER_FAULTS: Sequence[Fault] = (
    Fault("origin set", _copter_origin),
    Fault("barometer jumps 6 m", _copter(SIM_BARO_GLITCH=6.0), _copter(SIM_BARO_GLITCH=0.0)),
    Fault("barometer drifts 0.3 m/s", _copter(SIM_BARO_DRIFT=0.3), _copter(SIM_BARO_DRIFT=0.0)),
    Fault("GPS jumps 10 m", _copter(SIM_GPS1_GLTCH_X=NORTH_10_M), _copter(SIM_GPS1_GLTCH_X=0.0)),
    Fault("GPS height jumps 10 m", _copter(SIM_GPS1_GLTCH_Z=10.0), _copter(SIM_GPS1_GLTCH_Z=0.0)),
    Fault("GPS off", _copter(SIM_GPS1_ENABLE=0.0), _copter(SIM_GPS1_ENABLE=1.0)),
    Fault("telemetry frozen", _motion(NEVER), _motion(2e4)),
    Fault("link cut", _link(cut=True), _link(cut=False)),
    Fault("battery charge unknown", _copter(BATT_MONITOR=3.0)),
    Fault("battery voltage low", _copter(SIM_BATT_VOLTAGE=9.5)),
    Fault("battery 2 at 5 %", _battery(1, 5.0)),
    Fault("battery 1 at 5 %", _battery(0, 5.0)),
)
PX4_FAULTS: Sequence[Fault] = (
    Fault("origin set", _px4_origin),
    Fault("barometer jumps 6 m", _px4(SIM_BARO_OFF_P=-6.0 * PASCAL_PER_M), _px4(SIM_BARO_OFF_P=0.0)),
    Fault("GPS height jumps 6 m", _px4(EKF2_GPS_POS_Z=6.0), _px4(EKF2_GPS_POS_Z=0.0)),
    Fault("GPS jumps 10 m", _px4(EKF2_GPS_POS_X=10.0), _px4(EKF2_GPS_POS_X=0.0)),
    Fault("GPS off", _px4(SIM_GPS_USED=0), _px4(SIM_GPS_USED=10)),
    Fault("GPS stuck", _runs("sensor_gps_sim", "stop"), _runs("sensor_gps_sim", "start")),
    Fault("telemetry frozen", _motion(NEVER), _motion(2e4)),
    Fault("link cut", _link(cut=True), _link(cut=False)),
    Fault("battery stops reporting", _runs("battery_simulator", "stop"), _runs("battery_simulator", "start"), 40.0),
    Fault("battery empties", _px4(SIM_BAT_MIN_PCT=5.0, SIM_BAT_DRAIN=10.0)),
)
FAULTS = {"px4": PX4_FAULTS, "arducopter": COPTER_FAULTS}


class _CopterFaults(CopterFlight):
    """Three ArduCopter simulators with two batteries each."""

    def parameters(self, vehicle: int) -> Mapping[str, float]:
        """Return a vehicle's own default parameters."""
        return {**super().parameters(vehicle), "BATT2_MONITOR": 4.0, "BATT2_CAPACITY": 33000.0}


@dataclass
class Row:
    """What was seen of one fault: what its vehicle and the others told, with times after it [s], and distances [m].

    `untrue_m` is the largest distance of the told position from the true one, `drift_m` that of the vehicle from where
    it began to hold; both horizontal and vertical. `nearest_m` is the smallest distance of two vehicles at one height.
    """

    fault: str
    vehicle: int
    told: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    untrue_m: tuple[float, float] = (0.0, 0.0)
    drift_m: tuple[float, float] = (0.0, 0.0)
    nearest_m: float = inf
    ended: str = ""

    def text(self, autopilot: str) -> str:
        """Return the row of the table."""
        pairs = (f"{across:.1f}, {up:.1f}" for across, up in (self.untrue_m, self.drift_m))
        told, others = "; ".join(self.told) or "nothing", "; ".join(self.others) or "-"
        cells = (self.fault, autopilot, str(self.vehicle), told, others, *pairs, f"{self.nearest_m:.1f}", self.ended)
        return f"| {' | '.join(cells)} |"


HEAD = (
    "| fault | autopilot | vehicle | told | the others | told from true | drift in hold | nearest | ended |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


def _apart(here_m: Triple, there_m: Triple) -> tuple[float, float]:
    return dist(here_m[:2], there_m[:2]), abs(here_m[2] - there_m[2])


class Watch:
    """Watches a flight from a fault on."""

    def __init__(self, flight: FirmwareFlight, fault: Fault, vehicle: int) -> None:
        self._flight, self._vehicle, self._began_s = flight, vehicle, flight.now_s()
        self._held_m: Triple | None = None
        self.row = Row(fault.name, vehicle)

    async def look(self, duration_s: float, until: Callable[[], bool] = lambda: False) -> None:
        """Measure for a time, or until something is so."""
        end_s = self._flight.now_s() + duration_s
        while self._flight.now_s() < end_s and not until():
            self._measure()
            await asyncio.sleep(LOOKS_S)

    def _measure(self) -> None:
        flight, row = self._flight, self.row
        now_m = {i: places[-1][1] for i, places in flight.true_m.items() if flight.is_armed(i)}
        if (true_m := now_m.get(self._vehicle)) is None:
            return
        row.untrue_m = _largest(row.untrue_m, _apart(flight.positions_m[self._vehicle], true_m))
        if flight.log.tactic(self._vehicle) == Tactic.HOLD.value:
            self._held_m = self._held_m or true_m
            row.drift_m = _largest(row.drift_m, _apart(self._held_m, true_m))
        near = (_apart(one, other) for one, other in combinations(now_m.values(), 2))
        row.nearest_m = min([row.nearest_m, *(across for across, up in near if up < SAME_HEIGHT_M)])

    def finished(self, ended: str) -> Row:
        """Return the row, with what was told since the fault."""
        log, row = self._flight.log, self.row
        for i in sorted(log.reported):
            changes = [
                (each.time_s, f"{each.tactic}{f' ({each.alert})' if each.alert else ''}") for each in log.reported[i]
            ]
            changes += [(at_s, f"mode {mode}") for at_s, mode in log.modes[i]]
            texts = [f"{at_s - self._began_s:.1f} s: {text}" for at_s, text in sorted(changes) if at_s >= self._began_s]
            (row.told if i == self._vehicle else row.others).extend(
                texts if i == self._vehicle else [f"{i} at {each}" for each in texts]
            )
        row.ended = ended
        return row


def _largest(one: tuple[float, float], other: tuple[float, float]) -> tuple[float, float]:
    return max(one[0], other[0]), max(one[1], other[1])


async def _provoke(flight: FirmwareFlight, fault: Fault, vehicle: int) -> Row:
    """Return what was seen of a fault, ended by the vehicle's return to its mission or without it."""
    watch, log = Watch(flight, fault, vehicle), flight.log

    def is_back() -> bool:
        return log.tactic(vehicle) == Tactic.ENCIRCLE.value and not log.alert(vehicle)

    fault.begin(flight, vehicle)
    await watch.look(fault.watched_s)
    if fault.end is not None:
        fault.end(flight, vehicle)
        await watch.look(ENDED_S)
    end_s = flight.now_s() + RETURNS_WITHIN_S
    while flight.now_s() < end_s and not is_back():
        resuming = asyncio.create_task(flight.resume(vehicle))
        await watch.look(RESUMES_EVERY_S, is_back)
        await resuming
    return watch.finished("flies on" if is_back() else log.state(vehicle))


async def _fly(autopilot: str, faults: list[Fault], logs: Path | None) -> list[Row]:
    """Provoke faults in one flight, as long as a vehicle flies its mission; those provoked are removed."""
    rows = []
    make = Px4Flight if autopilot == "px4" else _CopterFaults
    async with make(drill_mission(MISSIONS[autopilot]), 1.0, logs) as flight:
        await flight.reach_mission(flight.mission.ids, lambda _: Tactic.ENCIRCLE.value)
        while faults:
            able = [
                i
                for i in flight.mission.ids
                if flight.log.tactic(i) == Tactic.ENCIRCLE.value and not flight.log.alert(i)
            ]
            if not able:
                break
            rows.append(await _provoke(flight, faults.pop(0), able[-1]))
            print(rows[-1].text(autopilot), flush=True)
    return rows


async def main(autopilots: Sequence[str], names: Sequence[str], logs: Path | None) -> int:
    """Provoke the faults of these names, or all; return whether vehicles came too close."""
    print(HEAD, flush=True)
    rows: list[Row] = []
    for autopilot in autopilots:
        faults = [each for each in FAULTS[autopilot] if not names or each.name.replace(" ", "-") in names]
        while faults:
            rows += await _fly(autopilot, faults, logs)
    return 1 if min((row.nearest_m for row in rows), default=inf) < SEPARATION_M - NEAR_TOLERANCE_M else 0


if __name__ == "__main__":
    reader = parser("firmware_faults", __doc__)
    reader.add_argument("faults", nargs="*", metavar="fault", help="names such as GPS-off (default: all)")
    reader.add_argument("--autopilot", choices=list(MISSIONS), action="append", help="one of them (default: both)")
    reader.add_argument("--logs", type=Path, help="folder for the flights' logs")
    given = reader.parse_args()
    try:
        sys.exit(asyncio.run(main(given.autopilot or list(MISSIONS), given.faults, given.logs)))
    except (Px4Missing, ArduCopterMissing, VehicleRefusedError) as reason:
        sys.exit(str(reason))
