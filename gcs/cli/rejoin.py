"""`cordon rejoin`: a vehicle that has landed comes back into the flight of its team."""

from dataclasses import dataclass, field
from typing import Annotated

from cyclopts import Parameter

from gcs.cli.command import send
from gcs.cli.options import Changes, KeyName, RunningMission, bus_mission, chosen_vehicle
from gcs.errors import Exit


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RejoinOptions:
    """Options of `cordon rejoin`."""

    vehicle: Annotated[int, Parameter(help="The vehicle that has landed.")] = field(kw_only=False)
    mission: RunningMission = "case2"
    changes: Changes = ()
    key: KeyName = None


def rejoin(options: RejoinOptions) -> Exit:
    """Let a vehicle that has landed take off again and join the others, while their `cordon fly` still flies.

    For a swapped battery or a mended fault, also after its autopilot has restarted. The vehicle is checked as before a
    flight. Then it takes off where it stands, and returns to its slot or to a ring. One in reserve (`reserve = true` in
    the mission) takes off for the first time. A vehicle that is not in the mission file cannot join.

    Example: cordon rejoin 2 --mission px4-trio
    """
    from gcs.console.verb_arguments import GivenCommand

    mission = bus_mission(options.mission, options.changes)
    chosen_vehicle(mission, options.vehicle, "VEHICLE")
    return send(mission, "rejoin", GivenCommand(vehicle=options.vehicle), options.key)
