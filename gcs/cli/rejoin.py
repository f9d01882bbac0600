"""`cordon rejoin`: a vehicle that has landed comes back into the flight of its team, or one that is not in its mission
file joins it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.added import ADD, NOT_DESCRIBED, AddedVehicleOptions, enlarged, given_options
from gcs.cli.command import send
from gcs.cli.options import (
    Changes,
    ChecklistDone,
    KeyName,
    Log,
    Recorded,
    RunningMission,
    bus_mission,
    chosen_vehicle,
    running_mission,
)
from gcs.errors import Exit, InputError
from gcs.signals import hold_back

if TYPE_CHECKING:
    from gcs.metrics.record import FlightRecord
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class AddOptions:
    """Options of `cordon rejoin --add` about the flight of the vehicle."""

    sitl: Annotated[bool, Parameter(negative="", group=ADD, help="Fly a bundled stub vehicle.")] = False
    off_bus: Annotated[
        tuple[int, ...],
        Parameter(
            negative="",
            show_default=False,
            group=ADD,
            help="Do not wait for the answer of this vehicle, which is down and off the bus; may be repeated.",
        ),
    ] = ()
    wait: Annotated[
        float | None,
        Parameter(
            validator=Number(gte=0, lte=3600),
            group=ADD,
            help="Seconds to wait on the ground until it is ready; 0: refuse at once; default: 60.",
        ),
    ] = None
    checklist_done: ChecklistDone = None
    log: Log = None
    recorded: Recorded = True


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RejoinOptions:
    """Options of `cordon rejoin`."""

    vehicle: Annotated[int, Parameter(help="The vehicle that has landed, or with --add the id of a new one.")] = field(
        kw_only=False
    )
    mission: RunningMission = "case2"
    changes: Changes = ()
    key: KeyName = None
    add: Annotated[
        bool,
        Parameter(
            negative="",
            help="Fly a vehicle that is not in the mission file with the others, in this process, until it is down.",
        ),
    ] = False
    described: AddedVehicleOptions = NOT_DESCRIBED
    added: AddOptions = AddOptions()


def rejoin(options: RejoinOptions) -> int:
    """Let a vehicle that has landed take off again and join the others, while their `cordon fly` still flies.

    For a swapped battery or a mended fault, also after its autopilot has restarted. The vehicle is checked as before a
    flight. Then it takes off where it stands, and returns to its slot or to a ring. One in reserve (`reserve = true` in
    the mission) takes off for the first time.

    With --add a vehicle that is not in the mission file joins, one for each flight. This process flies it, as
    `cordon fly --only` does, until the mission's end; Ctrl-C brings it down earlier, and it comes home once all the
    others do. It takes off once every vehicle of the mission has answered that it knows it. It is the last in line and
    the last to land.

    Example: cordon rejoin 2 --mission px4-trio

    Example: cordon rejoin 4 --add --mission px4-trio --start 0,-9 --url udpin://127.0.0.1:14543 --profile px4
    """
    from gcs.console.verb_arguments import GivenCommand

    if options.add:
        return _add(options)
    if given := [*given_options(options.described), *given_options(options.added)]:
        raise InputError([f"{option}: it needs --add" for option in given])
    mission = running_mission(options.mission, options.changes)
    if options.vehicle not in mission.ids:
        chosen = f"VEHICLE: the mission has no vehicle {options.vehicle} (it has {', '.join(map(str, mission.ids))})"
        raise InputError([f"{chosen}; one that is not in its file joins by --add"])
    return send(mission, "rejoin", GivenCommand(vehicle=options.vehicle), options.key)


def _add(options: RejoinOptions) -> int:
    from gcs.flight.supervisor import is_supervised, supervise
    from gcs.mission.added_vehicle import recovery_command

    hold_back()
    if not is_supervised():
        mission = _enlarged(options)  # what is wrong with the options is reported by this process
        return supervise(recovery=recovery_command(mission, options.mission, options.changes))
    return _fly(options)


def _enlarged(options: RejoinOptions) -> "Mission":
    """Return the mission with the vehicle of the options; raises InputError, whose faults name options."""
    mission, added = bus_mission(options.mission, options.changes), options.added
    for each in added.off_bus:
        chosen_vehicle(mission, each, "--off-bus")
    faults = [f"{option}: {reason}" for option, reason, is_so in _slips(options, mission) if is_so]
    return enlarged(mission, options.vehicle, options.described, faults, named="VEHICLE")


def _slips(options: RejoinOptions, mission: "Mission") -> Iterator[tuple[str, str, bool]]:
    """Yield options of --add, what is wrong with them, and whether it is."""
    vehicle, added = options.vehicle, options.added
    yield "--add", f"vehicle {vehicle} is in the mission: rejoin it without --add", vehicle in mission.ids
    yield "--key", "not with --add, which uses the keys of the vehicle", options.key is not None
    yield "--url", "with --add the vehicle needs its connection, or --sitl", not (options.described.url or added.sitl)
    yield "--off-bus", "no vehicle is left that the new one could join", {*added.off_bus} == {*mission.ids}


def _fly(options: RejoinOptions) -> Exit:
    from gcs.cli.output import present
    from gcs.console.terminal import print_line
    from gcs.flight.recording import RecordingOptions
    from gcs.flight.request import FlightRequest
    from gcs.flight.run import run_flight

    mission, added = _enlarged(options), options.added
    print_line(f"vehicle {options.vehicle} is looked for, and checked as before a flight")
    request = FlightRequest(
        mission=mission,
        stubs=(options.vehicle,) if added.sitl else (),
        wait_s=60.0 if added.wait is None else added.wait,
        checklist_done=added.checklist_done,
        off_bus=added.off_bus,
    )

    def judge(flown: "Mission", record: "FlightRecord") -> Exit:
        present(flown, record, json=False, plot=None)
        return Exit.HOLDS  # the mission's verdicts are on a team that begins it together

    return run_flight(request.plan(), RecordingOptions(added.log, added.recorded, options.vehicle), judge)
