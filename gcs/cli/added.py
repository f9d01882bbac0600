"""Options that describe a vehicle that is not in the mission file, and the mission with it."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from gcs.errors import InputError, KeyFault

if TYPE_CHECKING:
    from gcs.mission.mission import Mission

ADD = Group("With --add")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class AddedVehicleOptions:
    """Keys of a vehicle that is not in the mission file."""

    start: Annotated[
        str | None,
        Parameter(
            group=ADD, help="The added vehicle's place on the ground, X,Y [m], such as 0,-8.", allow_leading_hyphen=True
        ),
    ] = None
    url: Annotated[
        str | None, Parameter(group=ADD, help="The added vehicle's MAVLink connection, as in a mission file.")
    ] = None
    profile: Annotated[
        str | None, Parameter(group=ADD, help="Its bundled profile, or a file beside the mission; default: stub.")
    ] = None
    altitude: Annotated[
        float | None,
        Parameter(group=ADD, help="Its flying height [m], between those of the others; default: that of the last one."),
    ] = None
    slot: Annotated[
        str | None,
        Parameter(
            group=ADD, help="Its position in a free formation, X,Y [m]; others take none.", allow_leading_hyphen=True
        ),
    ] = None
    system_id: Annotated[int | None, Parameter(group=ADD, help="Its MAVLink system id; default: its id.")] = None
    endpoint: Annotated[
        str | None,
        Parameter(
            group=ADD, help="Zenoh endpoint of the added vehicle's agent; default: tcp/127.0.0.1 with port 7460+id."
        ),
    ] = None


NOT_DESCRIBED = AddedVehicleOptions()


def given_options(options: object) -> list[str]:
    """Return which of a class of options were given, by their names on the command line."""
    default = type(options)()
    names = [each.name for each in fields(options) if getattr(options, each.name) != getattr(default, each.name)]  # type: ignore[arg-type]  # a dataclass
    return [_SPELT.get(name, f"--{name.replace('_', '-')}") for name in names]


_SPELT = {"recorded": "--no-log"}
"""What is typed for a field of another name."""


def enlarged(
    mission: "Mission", vehicle: int, options: AddedVehicleOptions, faults: list[str], *, named: str
) -> "Mission":
    """Return a mission with the vehicle of the options, whose id was given by the option or the argument `named`.

    Raises InputError, whose faults name options, also with those `faults` that the verb has found.
    """
    from gcs.mission.added_vehicle import OPTIONS
    from gcs.mission.file import enlarged_mission

    if options.start is None:
        faults.append("--start: with --add the vehicle needs its place on the ground, X,Y")
    table: dict[str, object] = {"id": vehicle, "altitude_m": mission.vehicles[-1].section.altitude_m}
    for key, option in OPTIONS.items():
        given = getattr(options, option.removeprefix("--").replace("-", "_"))
        if given is not None:
            table[key] = _place(option, given, faults) if key in ("start_m", "slot_m") else given
    if faults:
        raise InputError(faults)
    try:
        return enlarged_mission(mission, table)
    except InputError as error:
        options_of = {"id": named, **OPTIONS}
        raise InputError([_named(fault, len(mission.vehicles), options_of) for fault in error.placed]) from error


def _place(option: str, given: str, faults: list[str]) -> tuple[float, float]:
    try:
        x, y = map(float, given.split(","))
    except ValueError:
        faults.append(f"{option}: {given!r} is not a place X,Y in metres, such as 0,-8")
        return 0.0, 0.0
    return x, y


def _named(fault: KeyFault, number: int, options: Mapping[str, str]) -> KeyFault:
    """Return a fault of the enlarged mission with the option in place of the key of the added vehicle."""
    vehicle, _, key = fault.place.partition(".")
    if vehicle == f"vehicles[{number}]" and key in options:
        return KeyFault(options[key], fault.reason)
    return KeyFault("--add", f"with one more vehicle: {fault}")
