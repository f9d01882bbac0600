"""`cordon command`: an operator's command to a running team."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, get_args

from cyclopts import Parameter

from agents.team.verbs import VERBS, CommandVerb, Verb, VerbRow
from gcs.cli.options import Changes, KeyName, RunningMission, chosen_vehicle, running_mission
from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from gcs.console.command_client import CommandClient, CommandResult, RingFaults
    from gcs.console.verb_arguments import GivenCommand
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
            "assign: the vehicle, and its ring's name or auto; goto: the vehicle, x=METRES y=METRES, and land to land "
            "there; look: x=METRES y=METRES, or target."
        ),
    ],
    options: CommandOptions = _DEFAULTS,
) -> Exit:
    """Command a running team: {labels}. Shows each vehicle's answer.

    {helps}

    Example: cordon command ring radius=15 rate=-0.1
    """
    from gcs.cli.output import confirmed
    from gcs.console.terminal import print_problem
    from gcs.console.verb_arguments import given_command

    mission = running_mission(options.mission, options.changes)
    if options.vehicle is not None:
        chosen_vehicle(mission, options.vehicle, "--vehicle")
    given = given_command(mission, verb, arguments, options.vehicle)
    row, vehicles = VERBS[verb], _receivers(mission, given)
    if row.confirmation == "word" and not options.yes and not confirmed(_question(row, vehicles, mission)):
        print_problem("not confirmed: no command was sent")
        return Exit.REFUSED
    return send(mission, verb, given, options.key)


def _receivers(mission: "Mission", given: "GivenCommand") -> Sequence[int]:
    return mission.ids if given.vehicle is None else (given.vehicle,)


def send(mission: "Mission", verb: Verb, given: "GivenCommand", key: str | None) -> Exit:
    """Send a command to a running team with the keys of a name, and show each vehicle's answer; raises InputError."""
    from agents.ports import VehicleRefusedError
    from gcs.console.command_client import CommandClient
    from gcs.console.terminal import print_problem

    vehicles, ring_faults = _receivers(mission, given), _ring_faults(mission, given)
    try:
        operator = CommandClient(mission, granted_operator(mission, verb, key))
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
        if vehicle_id in operator.in_reserve:
            result = "no answer: it is in reserve, and stays on the ground until `cordon rejoin`"
        if answer is not None:
            result = f"{answer.did} (answered after {answer.after_s * 1000:.0f} ms)"
        elif VERBS[verb].is_for_landed:
            result += f"; if a process of its own flew it, start that again: cordon fly MISSION --only {vehicle_id}"
        print_line(f"vehicle {vehicle_id}: {verb}: {result}")
    STDERR.print(
        f"joining the team's bus took {operator.joined_after_s * 1000:.0f} ms, before the command was sent",
        highlight=False,
    )


def _ring_faults(mission: "Mission", given: "GivenCommand") -> "RingFaults":
    """Return what checks a command of the ring; no other command waits for its import."""
    from agents.team.messages import RingValues

    if not isinstance(given.argument, RingValues):
        return lambda _flown: ()
    from gcs.preflight.mission import ring_change_faults

    return partial(ring_change_faults, mission, given.argument, ring=given.ring_number or 0)


def _question(row: VerbRow, vehicles: Sequence[int], mission: "Mission") -> str:
    named = f"vehicle {vehicles[0]}" if len(vehicles) == 1 else f"vehicles {', '.join(map(str, vehicles))}"
    return f"{row.does.capitalize()} {named} of {mission.mission.name}? In flight they fall."
