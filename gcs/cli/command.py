"""`cordon command`: an operator's command to a running team."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import isfinite, nan
from typing import TYPE_CHECKING, Annotated, get_args

from cyclopts import Parameter

from agents.settings.shapes import SHAPES
from agents.team.verbs import AUTO, VERBS, CommandVerb, Verb, VerbRow
from gcs.cli.options import Changes, KeyName, RunningMission, bus_mission, chosen_vehicle
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from agents.settings.shapes import Shape
    from agents.team.messages import RingValues
    from gcs.console.command_client import CommandClient, CommandResult, RingFaults
    from gcs.keys.identity import Identity
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class CommandOptions:
    """Options of `cordon command`, without the verb and its arguments."""

    vehicle: Annotated[int | None, Parameter(help="Send the command to this vehicle only, not to all.")] = None
    mission: RunningMission = "case2"
    changes: Changes = ()
    key: KeyName = None
    yes: Annotated[bool, Parameter(negative="", help="Kill without asking for confirmation.")] = False


_DEFAULTS = CommandOptions()


def command(
    verb: CommandVerb,
    /,
    *arguments: Annotated[
        str,
        Parameter(
            help="formation: the shape; ring: the values to change, with several rings after its name; "
            "assign: the vehicle, and its ring's name or auto."
        ),
    ],
    options: CommandOptions = _DEFAULTS,
) -> Exit:
    """Command a running team: {labels}. Shows each vehicle's answer.

    {helps}

    Example: cordon command ring radius=15 rate=-0.1
    """
    from agents.ports import VehicleRefusedError
    from gcs.cli.output import confirmed
    from gcs.console.command_client import CommandClient
    from gcs.console.terminal import print_problem

    mission = bus_mission(options.mission, options.changes)
    if options.vehicle is not None:
        chosen_vehicle(mission, options.vehicle, "--vehicle")
    given = _given(mission, verb, arguments, options.vehicle)
    vehicles = mission.ids if given.vehicle is None else (given.vehicle,)
    ring_faults = _ring_faults(mission, given)
    row = VERBS[verb]
    if row.confirmation == "word" and not options.yes and not confirmed(_question(row, vehicles, mission)):
        print_problem("not confirmed: no command was sent")
        return Exit.REFUSED
    try:
        operator = CommandClient(mission, granted_operator(mission, verb, options.key))
        sent = operator.command(
            verb, vehicles, given.vehicle, given.argument, ring_faults=ring_faults, ring_number=given.ring_number
        )
        answers = asyncio.run(sent)
    except VehicleRefusedError as refusal:
        if faults := ring_faults(()):  # no team has sent the rings that it flies
            raise InputError(faults) from refusal
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    if operator.difference:
        print_problem(f"{operator.difference}; {verb} was sent")
    _show(verb, vehicles, answers, operator)
    obeyed = [answer is not None and answer.obeyed for answer in answers.values()]
    return Exit.HOLDS if obeyed and all(obeyed) else Exit.REFUSED


_ROWS = [VERBS[verb] for verb in get_args(CommandVerb)]
command.__doc__ = (command.__doc__ or "").format(
    labels=f"{', '.join(row.label for row in _ROWS[:-1])} or {_ROWS[-1].label}",
    helps=" ".join(f"{row.name}: {row.help}." for row in _ROWS if row.help),
)


def granted_operator(mission: "Mission", verb: Verb, name: str | None) -> "Identity":
    """Return the operator whose keys are on this computer; raises VehicleRefusedError if they do not grant the verb."""
    from agents.ports import VehicleRefusedError
    from gcs.keys.team_keys import team_keys

    operator = team_keys(mission).identity("operator", name)
    if verb not in operator.may:
        approval = "an approved kill key in its folder, and its approval in the roster (`cordon keys admit`)"
        raise VehicleRefusedError(
            f"operator {operator.participant.name} may not command {verb} (granted: {', '.join(operator.may)})",
            "use the keys of an operator who may; `cordon keys issue operator NAME --may` grants verbs"
            + (f"; kill also needs {approval}" if VERBS[verb].is_dangerous else ""),
        )
    return operator


def _show(
    verb: Verb, vehicles: Sequence[int], answers: "Mapping[int, CommandResult | None]", operator: "CommandClient"
) -> None:
    from gcs.console.terminal import STDERR, print_line

    for vehicle_id in vehicles:
        answer, ended = answers.get(vehicle_id), operator.ended.get(vehicle_id)
        result = "no answer" if ended is None else f"no answer: its flight has ended ({ended})"
        if answer is not None:
            result = f"{answer.did} (answered after {answer.after_s * 1000:.0f} ms)"
        print_line(f"vehicle {vehicle_id}: {verb}: {result}")
    STDERR.print(
        f"joining the team's bus took {operator.joined_after_s * 1000:.0f} ms, before the command was sent",
        highlight=False,
    )


@dataclass(frozen=True, slots=True)
class _Given:
    """The arguments of a verb: a shape or the values of a ring, the number of a ring, the only vehicle (None: all)."""

    argument: "Shape | RingValues | None" = None
    ring_number: int | None = None
    vehicle: int | None = None


def _given(mission: "Mission", verb: Verb, arguments: Sequence[str], vehicle: int | None) -> _Given:
    """Return the arguments of a verb and the vehicle of `--vehicle`; raises InputError."""
    takes = VERBS[verb].takes
    if takes and vehicle is not None:
        whom = "names its vehicle itself" if takes == "assign" else "commands the whole team"
        raise InputError([f"--vehicle: {verb} {whom}: leave this option out (given: {vehicle})"])
    match takes:
        case "shape":
            return _Given(_shape(mission, arguments))
        case "ring":
            number, values = _named_ring(mission, arguments)
            return _Given(_ring_values(values, is_only=number is None), number)
        case "assign":
            return _assignment(mission, arguments)
    if arguments:
        raise InputError([f"{' '.join(arguments)}: {verb} has no argument"])
    return _Given(vehicle=vehicle)


def _shape(mission: "Mission", given: Sequence[str]) -> "Shape":
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


def _named_ring(mission: "Mission", given: Sequence[str]) -> tuple[int | None, Sequence[str]]:
    """Return the number of the ring that is named first, and the rest; None with one ring, which has no name."""
    if not mission.rings:
        return None, given
    if not given or "=" in given[0]:
        raise InputError(
            [f"ring: name the ring first, as in ring {mission.rings[0].name} radius=15 ({_rings(mission)})"]
        )
    return _ring_number(mission, given[0]), given[1:]


def _ring_number(mission: "Mission", name: str) -> int:
    """Return the number of the ring of a name; raises InputError."""
    from difflib import get_close_matches

    names = [each.name for each in mission.rings]
    if name in names:
        return names.index(name)
    near = get_close_matches(name, names, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    raise InputError([f"{name}: the mission has no ring of this name ({hint}{_rings(mission)})"])


def _rings(mission: "Mission") -> str:
    return f"rings: {', '.join(each.name for each in mission.rings)}"


def _assignment(mission: "Mission", given: Sequence[str]) -> _Given:
    if not mission.rings:
        raise InputError([f"assign: {mission.mission.name} has one ring, and every vehicle flies it"])
    if len(given) != 2 or not given[0].isdecimal():
        form = f"assign VEHICLE RING, as in assign {mission.ids[0]} {mission.rings[0].name}, or assign VEHICLE {AUTO}"
        raise InputError([f"assign: give {form} (given: {' '.join(given) or 'nothing'}; {_rings(mission)})"])
    vehicle = chosen_vehicle(mission, int(given[0]), "assign").id
    return _Given(ring_number=None if given[1] == AUTO else _ring_number(mission, given[1]), vehicle=vehicle)


def _ring_values(given: Sequence[str], *, is_only: bool) -> "RingValues":
    from agents.team.messages import RingValues

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


def _ring_faults(mission: "Mission", given: _Given) -> "RingFaults":
    """Return what checks a command of the ring; no other command waits for its import."""
    from agents.team.messages import RingValues

    if not isinstance(given.argument, RingValues):
        return lambda _flown: ()
    from gcs.preflight.mission import ring_change_faults

    return partial(ring_change_faults, mission, given.argument, ring=given.ring_number or 0)


def _question(row: VerbRow, vehicles: Sequence[int], mission: "Mission") -> str:
    named = f"vehicle {vehicles[0]}" if len(vehicles) == 1 else f"vehicles {', '.join(map(str, vehicles))}"
    return f"{row.does.capitalize()} {named} of {mission.mission.name}? In flight they fall."
