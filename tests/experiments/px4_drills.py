"""Fly the drills with px4-trio on three PX4 simulators from the environment variable CORDON_PX4.

A relay between each autopilot and cordon cuts the link, counts setpoints, and acts as a second client that changes the
flight mode. Modes are taken from CURRENT_MODE at 20 Hz; heartbeats, which cordon uses, are recorded separately. At
speed 1.
"""

import asyncio
import sys
from contextlib import AsyncExitStack

from agents.ports import VehicleRefusedError
from agents.safety.failsafe import Condition
from agents.tactics import Tactic
from gcs.console.terminal import STDERR
from gcs.drill.faults import HEARTBEAT_S, Drill, Roles, agents_ended, by_table, cut, the_subject
from gcs.drill.flight import DrillFlight
from gcs.drill.judge import OFFBOARD, Expectation
from gcs.drill.run import DrillProgress, DrillRun, drill_table
from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import MODES, custom_mode
from tests.experiments.arguments import parser
from tests.support.px4 import FIRST_PORT, Px4Missing, Px4Simulator
from tests.support.relay import CURRENT_MODE, GLOBAL_POSITION, HEARTBEAT, Message, Relay, flight_mode, is_armed

MISSION = "px4-trio"
SET_MESSAGE_INTERVAL, DO_SET_MODE = 511, 176
MODE_PERIOD_US = 50_000.0
ASKED_AGAIN_S = 1.0
READY_WITHIN_S, SETTLES_S = 60.0, 15.0
RESTARTED_WITHIN_S = 30.0
STOOD_DOWN_MAX_S = 0.5
METRES_PER_DEGREE = 111_195.0
_MODES = {custom_mode(mode): mode.name.lower() for mode in NavMode}


class Px4Flight(DrillFlight):
    """A flight of PX4 simulators behind relays."""

    def __init__(self, text: str, speed: float) -> None:
        super().__init__(text, speed)
        self.relays: dict[int, Relay] = {}
        self.simulators: dict[int, Px4Simulator] = {}
        self.foreign_s: dict[int, float] = {}
        self._offboard: set[int] = set()
        self._asked_s = 0.0
        self._located: set[int] = set()
        self._armed: dict[int, bool] = {}

    async def serve(self, stack: AsyncExitStack) -> None:
        """Start relays and simulators, and wait until their estimators have settled."""
        frame = self.mission.frame
        for instance, vehicle in enumerate(self.mission.vehicles):
            east_m, north_m = vehicle.section.start_m
            assert frame.x_bearing_deg == 90.0
            assert frame.latitude_deg is not None
            assert frame.longitude_deg is not None
            assert frame.altitude_m is not None
            place = (frame.latitude_deg + north_m / METRES_PER_DEGREE, frame.longitude_deg, frame.altitude_m)
            assert east_m == 0.0
            simulator = Px4Simulator(instance, speed=self.speed, place=place, parameters={"COM_OBL_RC_ACT": 4.0})
            stack.callback(simulator.close)
            self.simulators[vehicle.id] = simulator
            await self._relay(stack, vehicle.id, simulator.system_id, FIRST_PORT + instance, vehicle.section.url)
        for simulator in self.simulators.values():
            simulator.start()
        if not await self.until(lambda: len(self._located) == len(self.simulators), READY_WITHIN_S):
            raise VehicleRefusedError(f"PX4 {sorted(self._located)} alone know where they are", "see their px4.log")
        await asyncio.sleep(SETTLES_S)

    async def _relay(self, stack: AsyncExitStack, vehicle: int, system_id: int, port: int, url: str) -> None:
        def take(message: Message) -> None:
            self._take(vehicle, message)

        def count() -> None:
            self.log.setpoint_s[vehicle] = self.now_s()

        back_port = int(url.rpartition(":")[2])
        relay = Relay(system_id, port, back_port, on_message=take, on_setpoint=count)
        await relay.open()
        stack.push_async_callback(relay.close)
        self.relays[vehicle] = relay

    def _take(self, vehicle: int, message: Message) -> None:
        now_s = self.now_s()
        if message.kind == GLOBAL_POSITION:
            self._located.add(vehicle)
        mode = _MODES.get(flight_mode(message) or 0, "other")
        if message.kind == HEARTBEAT:
            self._armed[vehicle] = is_armed(message)
            if mode == OFFBOARD:
                self._offboard.add(vehicle)
            elif vehicle in self._offboard:
                self.foreign_s.setdefault(vehicle, now_s)
        if message.kind == CURRENT_MODE:
            self.log.note_mode(now_s, vehicle, mode)

    def observe(self, now_s: float) -> None:
        """Record their position estimates, and request CURRENT_MODE, also after a restart."""
        flying = {i: position_m for i, position_m in self.positions_m.items() if self._armed.get(i)}
        self.log.note_places(now_s, flying)
        if now_s - self._asked_s > ASKED_AGAIN_S:
            self._asked_s = now_s
            for relay in self.relays.values():
                relay.command(SET_MESSAGE_INTERVAL, CURRENT_MODE, MODE_PERIOD_US)

    def fail(self, fault: str, roles: Roles) -> None:
        """Inject a fault through the subject's relay, or its simulator."""
        if fault == "foreign mode":
            main, sub = MODES[NavMode.HOLD]
            self.relays[roles.subject].command(DO_SET_MODE, 1.0, float(main), float(sub))
        elif fault == "link cut":
            self.relays[roles.subject].cut = True
        elif fault == "autopilot restarted":
            self.simulators[roles.subject].stop()
            self.simulators[roles.subject].start()
        else:
            super().fail(fault, roles)

    def clear_faults(self) -> None:
        """Restore the links."""
        super().clear_faults()
        for relay in self.relays.values():
            relay.cut = False


FLIGHTS: list[Px4Flight] = []


def fly(text: str, speed: float) -> Px4Flight:
    """Return a flight, and keep it for later tables."""
    FLIGHTS.append(Px4Flight(text, speed))
    return FLIGHTS[-1]


def _restarted(roles: Roles) -> Expectation:
    return Expectation(
        (roles.subject,),
        roles.others,
        RESTARTED_WITHIN_S,
        tactic=Tactic.PILOT_OVERRIDE.value,
        stands_back=True,
        leaves_offboard=True,
        respacing=tuple(i for i in roles.others if i in roles.on_ring),
        separation_m=roles.mission.safety.separation_m,
    )


def _foreign(roles: Roles) -> Expectation:
    return by_table(Condition.MODE_CHANGED, the_subject, found_within_s=HEARTBEAT_S)(roles)


DRILLS: tuple[Drill, ...] = (
    Drill("foreign mode", "stand down, nothing sent; back by resume", _foreign),
    Drill(
        "link cut",
        "out of offboard, and not back after 5 s; the others close the gap",
        cut,
        undo_after_s=5.0,
        lands_subject=True,
    ),
    Drill("killed agent", "all out of offboard", agents_ended, ends_flight=True),
    Drill(
        "autopilot restarted",
        "stand down, nothing sent; the others close the gap",
        _restarted,
        lands_subject=True,
    ),
    Drill("frozen agent", "all out of offboard", agents_ended, ends_flight=True),
)


def stood_down_after_s(flight: Px4Flight) -> dict[int, float]:
    """Return, by vehicle, the time from the heartbeat with a mode that was not requested to its pilot override."""
    return {
        i: said[0].time_s - shown_s
        for i, shown_s in flight.foreign_s.items()
        if (said := [each for each in flight.log.reported[i] if each.tactic == Tactic.PILOT_OVERRIDE.value])
    }


async def main(names: list[str]) -> int:
    """Fly the drills of these names, or all, and print the table."""
    drills = [drill for drill in DRILLS if not names or drill.fault.replace(" ", "-") in names]
    progress = DrillProgress(STDERR, len(drills))
    rows = await DrillRun(MISSION, fly, drills, progress, speed=1.0).run()
    STDERR.print(drill_table(MISSION, rows))
    for number, flight in enumerate(FLIGHTS, start=1):
        for i, after_s in stood_down_after_s(flight).items():
            STDERR.print(
                f"flight {number}, vehicle {i}: pilot override {after_s:.2f} s after the heartbeat that shows it"
            )
            assert after_s <= STOOD_DOWN_MAX_S
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    reader = parser("px4_drills", __doc__)
    reader.add_argument("faults", nargs="*", metavar="fault", help="names such as battery-low (default: all)")
    given = reader.parse_args()
    try:
        sys.exit(asyncio.run(main(given.faults)))
    except (Px4Missing, VehicleRefusedError) as reason:
        sys.exit(str(reason))
