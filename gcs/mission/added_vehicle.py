"""A vehicle that is not in the mission file and joins its flight: what it must not change for the others, how it
announces itself, and the command that reaches it once its own program is gone.
"""

from collections.abc import Iterator, Sequence
from shlex import join

from agents.team.messages import AddedVehicle
from estimation.input_file import toml_content
from gcs.errors import KeyFault
from gcs.mission.mission import CORDONS_PLANNER, Mission, MissionVehicle, lowest_between_m

OPTIONS = {
    "start_m": "--start",
    "url": "--url",
    "profile": "--profile",
    "altitude_m": "--altitude",
    "slot_m": "--slot",
    "system_id": "--system-id",
    "endpoint": "--endpoint",
}
"""The options of the command line that describe it, by the keys of its table."""


def announcement(vehicle: MissionVehicle) -> AddedVehicle:
    """Return what it announces to the others."""
    section = vehicle.section
    return AddedVehicle(section.start_m, section.altitude_m, section.slot_m or ())


def recovery_command(mission: Mission, file: str, changes: Sequence[str] = ()) -> str:
    """Return the command that brings home the vehicle that a mission adds, also beside a flight of the others.

    `file` is the mission's name on the command line, `changes` are the values of `--set`.
    """
    table = toml_content(mission.text)["vehicles"][-1]
    number = str(mission.added)
    words = ["cordon", "recover", file, *[word for each in changes for word in ("--set", each)]]
    words += ["--add", number, "--only", number]
    for key, option in OPTIONS.items():
        if key in table:
            words += [option, _text(table[key])]
    return join(words)


def _text(value: object) -> str:
    """Return a value of its table as it is given on the command line."""
    if isinstance(value, list):
        return ",".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def unable_faults(mission: Mission) -> Iterator[KeyFault]:
    """Yield why no vehicle can join the flight of a mission."""
    impossible = {
        "rings": ("of several rings", bool(mission.rings)),
        "safety.rally": ("with rally points", bool(mission.safety.rally)),
        "mission.planner": ("with a planner of its own", mission.mission.planner != CORDONS_PLANNER),
    }
    for key, (what, found) in impossible.items():
        if found:
            yield KeyFault(key, f"a mission {what} takes no vehicle that is not in its file")


def added_faults(mission: Mission, vehicle: MissionVehicle) -> Iterator[KeyFault]:
    """Yield what a vehicle that joins the flight of a mission would change for the others; both are valid."""
    place, others = f"vehicles[{len(mission.vehicles)}]", [each.section for each in mission.vehicles]
    low_m, high_m = (pick(each.altitude_m for each in others) for pick in (min, max))
    if not low_m <= vehicle.section.altitude_m <= high_m:
        yield KeyFault(
            f"{place}.altitude_m",
            f"{vehicle.section.altitude_m:g} m would change the layers of the others: {low_m:g} to {high_m:g} m is "
            "possible",
        )
    elif lowest_between_m([*others, vehicle.section], mission.safety) != lowest_between_m(others, mission.safety):
        yield KeyFault(f"{place}.altitude_m", "its altitude limits would change the heights of the others on the ring")
    config, section = mission.agent_config(mission.vehicles[0]), vehicle.section
    enlarged = config.with_added(vehicle.id, section.start_m, section.slot_m or ())
    if lost := sorted({*config.shapes} - {*enlarged.shapes}):
        yield KeyFault("formation.spacing_m", f"with one more vehicle a {lost[0]} is not possible any more")
