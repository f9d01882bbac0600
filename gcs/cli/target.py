"""`cordon target`: an operator reports where the target is."""

import asyncio
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.options import Changes, KeyName, RunningMission, Share, running_mission
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from agents.team.perception import ExternalSighting
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class TargetOptions:
    """Options of `cordon target`, without a position in the mission frame."""

    lat: Annotated[float | None, Parameter(help="Latitude in degrees, with --lon instead of X Y.")] = None
    lon: Annotated[float | None, Parameter(help="Longitude in degrees.")] = None
    sigma: Annotated[
        float, Parameter(help="Standard deviation of the position in metres.", validator=Number(gt=0.0, lte=1000.0))
    ] = 2.0
    altitude: Annotated[
        float | None,
        Parameter(
            help="Altitude in metres above the mission's origin, with the same standard deviation.",
            validator=Number(gte=-1e4, lte=1e5),
        ),
    ] = None
    target: Annotated[str | None, Parameter(help="Name of the target, if the mission has several.")] = None
    importance: Annotated[Share, Parameter(help="Importance of the target, 0 to 1.")] = 0.8
    threat: Annotated[Share, Parameter(help="Threat of the target, 0 to 1.")] = 0.2
    lasting: Annotated[
        float,
        Parameter(help="Repeat it twice a second for this many seconds.", validator=Number(gte=0.0, lte=3600.0)),
    ] = 0.0
    mission: RunningMission = "case2"
    changes: Changes = ()
    key: KeyName = None

    @property
    def is_geodetic(self) -> bool:
        """Whether the position is given as latitude and longitude."""
        return self.lat is not None and self.lon is not None


_DEFAULTS = TargetOptions()


def target(
    x: Annotated[
        float | None, Parameter(help="Metres along the mission frame's x axis.", allow_leading_hyphen=True)
    ] = None,
    y: Annotated[float | None, Parameter(help="Metres along its y axis.", allow_leading_hyphen=True)] = None,
    /,
    *,
    options: TargetOptions = _DEFAULTS,
) -> Exit:
    """Send a sighting of the target to a running team. The target filters weight it by its standard deviation.

    The target's estimate stays valid for `target_filter.stale_after_s` after the last sighting.

    Example: cordon target 35 -5 --sigma 1 --lasting 30 --mission my-mission.toml
    """
    position = tuple(value for value in (x, y, options.lat, options.lon) if value is not None)
    if len(position) != 2 or not (options.is_geodetic or (x is not None and y is not None)):
        raise InputError(["target: give the position as X Y in metres, or as --lat and --lon in degrees"])
    mission = running_mission(options.mission, options.changes)
    if faults := list(_position_faults(position, mission, geodetic=options.is_geodetic)):
        raise InputError(faults)
    return _publish(_sighting(position, options), mission, options)


def _position_faults(position: tuple[float, ...], mission: "Mission", *, geodetic: bool) -> Iterator[str]:
    first, second = position
    if not (isfinite(first) and isfinite(second)):
        yield f"target: {first}, {second} is not a position"
        return
    if geodetic and mission.mission_frame().is_local:
        yield "--lat: the mission's frame has no position on Earth: give X Y in metres instead"
    if geodetic and not (abs(first) <= 90.0 and abs(second) <= 180.0):
        yield f"--lat: {first}, {second} is not a position on Earth"


def _sighting(position: tuple[float, ...], options: TargetOptions) -> "ExternalSighting":
    from agents.team.perception import ExternalSighting

    first, second = position
    return ExternalSighting(
        "geodetic" if options.is_geodetic else "mission",
        (first, second),
        (options.sigma**2, 0.0, options.sigma**2),
        options.importance,
        options.threat,
        altitude_m=options.altitude,
        altitude_sigma_m=options.sigma,
        target=options.target,
    )


def _publish(sighting: "ExternalSighting", mission: "Mission", options: TargetOptions) -> Exit:
    """Publish a sighting for some seconds; raises InputError for one that the vehicles would reject."""
    from agents.ports import VehicleRefusedError
    from agents.team.perception import Perception, SightingRefusedError, encode_sighting
    from gcs.console.command_client import CommandClient
    from gcs.console.terminal import STDERR, print_problem
    from gcs.keys.team_keys import team_keys

    try:
        perception = Perception(mission.mission_frame(), lambda _: None, [each.name for each in mission.targets])
        perception.read(encode_sighting(sighting), now_s=0.0, time_scale=1.0)
    except SightingRefusedError as refused:
        raise InputError([f"target: {refused}"]) from refused
    try:
        sensor = team_keys(mission).identity("sensor", options.key)
        reached = asyncio.run(CommandClient(mission, sensor).send_sighting(sighting, options.lasting))
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    STDERR.print(f"sent to vehicles {', '.join(map(str, sorted(reached)))}", highlight=False)
    return Exit.HOLDS
