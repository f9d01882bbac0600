"""`cordon target`: an operator tells the team where the target is."""

import asyncio
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from agents.team.perception import Seen
    from gcs.mission.mission import Mission

Share = Annotated[float, Parameter(validator=Number(gte=0.0, lte=1.0))]


def target(
    x: Annotated[
        float | None, Parameter(help="Metres along the mission frame's x axis.", allow_leading_hyphen=True)
    ] = None,
    y: Annotated[float | None, Parameter(help="Metres along its y axis.", allow_leading_hyphen=True)] = None,
    /,
    *,
    lat: Annotated[float | None, Parameter(help="Degrees of latitude, with --lon in place of X Y.")] = None,
    lon: Annotated[float | None, Parameter(help="Degrees of longitude.")] = None,
    sigma: Annotated[
        float, Parameter(help="How sure that is: standard deviation in metres.", validator=Number(gt=0.0, lte=1000.0))
    ] = 2.0,
    altitude: Annotated[
        float | None,
        Parameter(help="Metres above the mission's origin, as sure as the place.", validator=Number(gte=-1e4, lte=1e5)),
    ] = None,
    importance: Annotated[Share, Parameter(help="How important the target is held to be, 0 to 1.")] = 0.8,
    threat: Annotated[Share, Parameter(help="How dangerous it is held to be, 0 to 1.")] = 0.2,
    lasting: Annotated[
        float,
        Parameter(help="Say it for this many seconds, twice a second.", validator=Number(gte=0.0, lte=3600.0)),
    ] = 0.0,
    mission: Annotated[str, Parameter(help="The mission that is being flown: it says where the team is.")] = "case2",
) -> Exit:
    """Tell a running team where the target is, as a sighting like any other: it counts as much as it is sure.

    A team believes that it knows its target for `target_filter.stale_after_s` after the last sighting.

    Example: cordon target 35 -5 --sigma 1 --lasting 30 --mission case2
    """
    from math import isfinite  # noqa: PLC0415

    from agents.team.perception import Seen  # noqa: PLC0415
    from gcs.mission.file import load_mission  # noqa: PLC0415

    place = [value for value in (x, y, lat, lon) if value is not None]
    geodetic = lat is not None and lon is not None
    if len(place) != 2 or not (geodetic or (x is not None and y is not None)):
        raise InputError(["target: give its place as X Y in metres, or as --lat and --lon in degrees"])
    if not all(map(isfinite, place)):
        raise InputError([f"target: {place[0]}, {place[1]} is no place"])
    flown = load_mission(mission)
    if geodetic and flown.mission_frame().is_local:
        raise InputError(["--lat: the mission's frame lies nowhere on Earth: give X Y in metres instead"])
    if geodetic and not (abs(place[0]) <= 90.0 and abs(place[1]) <= 180.0):
        raise InputError([f"--lat: {place[0]}, {place[1]} is not a place on Earth"])
    frame = "geodetic" if geodetic else "mission"
    position, covariance_m2 = (place[0], place[1]), (sigma**2, 0.0, sigma**2)
    seen = Seen(frame, position, covariance_m2, importance, threat, altitude_m=altitude, altitude_sigma_m=sigma)
    return _tell(seen, flown, lasting)


def _tell(seen: "Seen", flown: "Mission", lasting_s: float) -> Exit:
    """Tell the team a sighting for some seconds; what the vehicles would refuse is refused here, where it is read."""
    from agents.ports import VehicleRefusedError  # noqa: PLC0415
    from agents.team.perception import Perception, SightingRefusedError, encode_seen  # noqa: PLC0415
    from gcs.cli.output import STDERR  # noqa: PLC0415
    from gcs.console.operator import Operator  # noqa: PLC0415

    try:
        Perception(flown.mission_frame(), lambda _: None).read(encode_seen(seen), now_s=0.0, time_scale=1.0)
    except SightingRefusedError as refused:
        raise InputError([f"target: {refused}"]) from refused
    try:
        heard = asyncio.run(Operator(flown).point_out(seen, lasting_s))
    except VehicleRefusedError as refusal:
        STDERR.print(f"{refusal.reason}\nnext: {refusal.next_step}", markup=False, highlight=False, soft_wrap=True)
        return Exit.REFUSED
    STDERR.print(f"said to vehicles {', '.join(map(str, sorted(heard)))}", highlight=False)
    return Exit.HOLDS
