"""Fly the drills with px4-trio on three PX4 simulators from the environment variable CORDON_PX4.

A relay between each autopilot and cordon cuts the link, counts setpoints, and acts as a second client that changes the
flight mode. Modes are taken from CURRENT_MODE at 20 Hz; heartbeats, which cordon uses, are recorded separately. At
speed 1.
"""

import asyncio
import sys

from agents.ports import VehicleRefusedError
from agents.safety.failsafe import Condition
from agents.tactics import Tactic
from gcs.console.terminal import STDERR
from gcs.drill.faults import HEARTBEAT_S, Drill, Roles, agents_ended, by_table, cut, the_subject
from gcs.drill.judge import OFFBOARD, Expectation
from gcs.drill.run import DrillProgress, DrillRun, drill_table
from sitl.autopilot.modes import NavMode
from sitl.autopilot.px4 import MODES
from tests.experiments.arguments import parser
from tests.support.firmware_flight import Px4Flight
from tests.support.px4 import Px4Missing
from tests.support.relay import HEARTBEAT, Message

MISSION = "px4-trio"
DO_SET_MODE = 176
RESTARTED_WITHIN_S = 30.0
STOOD_DOWN_MAX_S = 0.5


class Px4DrillFlight(Px4Flight):
    """A flight of PX4 simulators with the faults of the drills."""

    def __init__(self, text: str, speed: float) -> None:
        super().__init__(text, speed)
        self.foreign_s: dict[int, float] = {}
        self._offboard: set[int] = set()

    def take(self, vehicle: int, message: Message) -> None:
        """Take a message, and note when a heartbeat shows that the vehicle has left offboard."""
        super().take(vehicle, message)
        if message.kind == HEARTBEAT:
            if self.mode(message) == OFFBOARD:
                self._offboard.add(vehicle)
            elif vehicle in self._offboard and not self.relays[vehicle].cut:  # cordon sees none over a cut link
                self.foreign_s.setdefault(vehicle, self.now_s())

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


FLIGHTS: list[Px4DrillFlight] = []


def fly(text: str, speed: float) -> Px4DrillFlight:
    """Return a flight, and keep it for later tables."""
    FLIGHTS.append(Px4DrillFlight(text, speed))
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


def stood_down_after_s(flight: Px4DrillFlight) -> dict[int, float]:
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
