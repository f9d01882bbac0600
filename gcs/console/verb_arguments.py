"""The arguments of the operators' verbs, read from text: `ring left radius=15 rate=-0.1`."""

from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite, nan

from agents.settings.shapes import SHAPES, Shape
from agents.team.messages import Goal, OperatorCommand, RingValues
from agents.team.verbs import AUTO, TARGET, VERBS, Verb
from estimation.vectors import Pair
from gcs.errors import InputError
from gcs.mission.mission import Mission

_FAR_M = 1e5


@dataclass(frozen=True, slots=True)
class GivenCommand:
    """The arguments of a verb: a shape, a place or the values of a ring, the number of a ring, the only vehicle (None:
    all).
    """

    argument: Shape | RingValues | Goal | None = None
    ring_number: int | None = None
    vehicle: int | None = None

    def command(self, time_s: float, verb: Verb, origin: str, number: int) -> OperatorCommand:
        """Return the command with these arguments, from an operator at a time, by its number."""
        given = self.argument
        return OperatorCommand(
            time_s,
            verb,
            self.vehicle,
            origin,
            number,
            shape=None if isinstance(given, RingValues | Goal) else given,
            ring=given if isinstance(given, RingValues) else None,
            ring_number=self.ring_number,
            place=given if isinstance(given, Goal) else None,
        )


def given_command(mission: Mission, verb: Verb, arguments: Sequence[str], vehicle: int | None) -> GivenCommand:
    """Return the arguments of a verb and the vehicle of `--vehicle`; raises InputError."""
    takes = VERBS[verb].takes
    if takes not in ("", "view") and vehicle is not None:
        whom = "names its vehicle itself" if takes in ("assign", "place") else "commands the whole team"
        raise InputError([f"--vehicle: {verb} {whom}: leave this option out (given: {vehicle})"])
    match takes:
        case "shape":
            return GivenCommand(_shape(mission, arguments))
        case "ring":
            number, values = _named_ring(mission, arguments)
            return GivenCommand(_ring_values(values, is_only=number is None), number)
        case "assign":
            return _assignment(mission, arguments)
        case "place":
            return _journey(mission, arguments)
        case "view":
            return GivenCommand(_looked_at(mission, arguments, vehicle), vehicle=vehicle)
    if arguments:
        raise InputError([f"{' '.join(arguments)}: {verb} has no argument"])
    return GivenCommand(vehicle=vehicle)


def _shape(mission: Mission, given: Sequence[str]) -> Shape:
    shapes = mission.agent_config(mission.vehicles[0]).shapes
    if len(given) != 1:
        raise InputError([f"give one shape (shapes: {', '.join(shapes)}; given: {' '.join(given) or 'nothing'})"])
    if (shape := next((each for each in shapes if each == given[0]), None)) is not None:
        return shape
    if given[0] not in SHAPES:
        raise InputError([f"shape: there is no '{given[0]}' (shapes: {', '.join(shapes)})"])
    near = mission.formation.spacing_m < mission.safety.separation_m
    why = "formation.spacing_m is less than safety.separation_m" if near else "neighbours exceed network.range_m"
    why = "its vehicles have no slot_m" if given[0] == "free" else why
    raise InputError([f"shape: no '{given[0]}' in {mission.mission.name}: {why} (shapes: {', '.join(shapes)})"])


_RING_KEYS = {"radius": "radius_m", "rate": "angular_rate_rad_s", "altitude": "altitude_m", "tilt": "tilt_deg"}
_RING_FORM = "radius=METRES, rate=RAD_S, altitude=METRES, tilt=DEGREES, or some of them, as in radius=15 rate=-0.1"


def _named_ring(mission: Mission, given: Sequence[str]) -> tuple[int | None, Sequence[str]]:
    """Return the number of the ring that is named first, and the rest; None with one ring, which has no name."""
    if not mission.rings:
        return None, given
    if not given or "=" in given[0]:
        raise InputError(
            [f"ring: name the ring first, as in ring {mission.rings[0].name} radius=15 ({_rings(mission)})"]
        )
    return _ring_number(mission, given[0]), given[1:]


def _ring_number(mission: Mission, name: str) -> int:
    """Return the number of the ring of a name; raises InputError."""
    names = [each.name for each in mission.rings]
    if name in names:
        return names.index(name)
    near = get_close_matches(name, names, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    raise InputError([f"{name}: the mission has no ring of this name ({hint}{_rings(mission)})"])


def _rings(mission: Mission) -> str:
    return f"rings: {', '.join(each.name for each in mission.rings)}"


def _assignment(mission: Mission, given: Sequence[str]) -> GivenCommand:
    if not mission.rings:
        raise InputError([f"assign: {mission.mission.name} has one ring, and every vehicle flies it"])
    if len(given) != 2 or not given[0].isdecimal():
        form = f"assign VEHICLE RING, as in assign {mission.ids[0]} {mission.rings[0].name}, or assign VEHICLE {AUTO}"
        raise InputError([f"assign: give {form} (given: {' '.join(given) or 'nothing'}; {_rings(mission)})"])
    vehicle = int(given[0])
    if vehicle not in mission.ids:
        raise InputError([f"assign: the mission has no vehicle {vehicle} (it has {', '.join(map(str, mission.ids))})"])
    return GivenCommand(ring_number=None if given[1] == AUTO else _ring_number(mission, given[1]), vehicle=vehicle)


def _journey(mission: Mission, given: Sequence[str]) -> GivenCommand:
    form = f"goto VEHICLE x=METRES y=METRES, and land to land there, as in goto {mission.ids[0]} x=30 y=-5"
    place, lands = _place([each for each in given[1:] if each != "land"]), "land" in given
    if place is None or not given[0].isdecimal():
        raise InputError([f"goto: give {form} (given: {' '.join(given) or 'nothing'})"])
    vehicle = int(given[0])
    if vehicle not in mission.ids:
        raise InputError([f"goto: the mission has no vehicle {vehicle} (it has {', '.join(map(str, mission.ids))})"])
    return GivenCommand(Goal(*place, lands), vehicle=vehicle)


def _looked_at(mission: Mission, given: Sequence[str], vehicle: int | None) -> Goal | None:
    """Return the place of the verb look, None for the target; raises InputError, also if no gimbal is there."""
    with_gimbal = [each.id for each in mission.vehicles if each.section.gimbal is not None]
    if not with_gimbal or vehicle not in (None, *with_gimbal):
        whose = mission.mission.name if vehicle is None else f"vehicle {vehicle}"
        have = f"vehicles with one: {', '.join(map(str, with_gimbal))}" if with_gimbal else "no vehicle has one"
        raise InputError([f"look: {whose} has no gimbal ({have}; gimbal = true in [[vehicles]])"])
    if tuple(given) == (TARGET,):
        return None
    if (place := _place(given)) is None:
        form = f"x=METRES y=METRES, as in look x=30 y=-5, or {TARGET}"
        raise InputError([f"look: give {form} (given: {' '.join(given) or 'nothing'})"])
    return Goal(*place)


def _place(given: Sequence[str]) -> Pair | None:
    """Return the place that is given by its x and y, None if it is anything else."""
    words = dict(each.partition("=")[::2] for each in given)
    try:
        x_m, y_m = float(words["x"]), float(words["y"])
    except (KeyError, ValueError):
        return None
    is_place = len(given) == 2 and all(isfinite(each) and abs(each) <= _FAR_M for each in (x_m, y_m))
    return (x_m, y_m) if is_place else None


def _ring_values(given: Sequence[str], *, is_only: bool) -> RingValues:
    values = dict[str, float]()
    for each in given:
        name, equals, text = each.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = nan
        if name not in _RING_KEYS or not isfinite(value) or _RING_KEYS[name] in values:
            unnamed = "; the mission has one ring, without a name" if is_only and not equals else ""
            raise InputError([f"{each}: give {_RING_FORM}{unnamed}"])
        values[_RING_KEYS[name]] = value
    if not values:
        raise InputError([f"ring: give {_RING_FORM}"])
    return RingValues(**values)
