"""`cordon start`: the start of a team whose agents wait on the ground."""

import asyncio
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from gcs.cli.options import Changes, ChecklistDone, Json, KeyName, MissionName, bus_mission
from gcs.errors import Exit
from gcs.metrics.json_output import json_output

if TYPE_CHECKING:
    from gcs.console.command_client import StartResult
    from gcs.mission.mission import Mission


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class StartOptions:
    """Options of `cordon start`."""

    mission: MissionName = field(kw_only=False)
    changes: Changes = ()
    key: KeyName = None
    wait: Annotated[
        float,
        Parameter(validator=Number(gte=1, lte=3600), help="Seconds to wait for vehicles that are not ready yet."),
    ] = 10.0
    checklist_done: ChecklistDone = None
    json: Json = False


def start(options: StartOptions) -> Exit:
    """Start a team whose agents wait on the ground (`cordon fly --only ID --wait-for-start`), once all are ready.

    Shows each vehicle as ready, flying, or missing with the reason. If one is missing, none is started.

    Example: cordon start my-mission.toml
    """
    from agents.ports import VehicleRefusedError
    from gcs.checklist import Checklist, done_by
    from gcs.cli.command import granted_operator
    from gcs.cli.output import print_result
    from gcs.console.command_client import start_team
    from gcs.console.terminal import print_problem

    mission = bus_mission(options.mission, options.changes)
    checklist = Checklist(mission.network.team, mission.checklist)
    if options.checklist_done is not None:
        checklist.tick_all(done_by(options.checklist_done))
    if open_items := [item.text for item in checklist.open()]:
        fault = f"the checklist is not done: {'; '.join(open_items)}"
        print_problem(fault, "tick it on the operator's page, or use --checklist-done NAME")
        return Exit.REFUSED
    try:
        operator = granted_operator(mission, "start", options.key)
        result = asyncio.run(start_team(mission, operator, options.wait))
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    if result.started:
        checklist.use()
    _show(mission, result)
    if options.json:
        print_result(_json(mission, result))
    return Exit.HOLDS if result.started else Exit.REFUSED


def _show(mission: "Mission", result: "StartResult") -> None:
    from gcs.console.terminal import print_line, print_problem

    for each in result.states:
        clock = "" if each.clock_off_s is None else f", its clock at most {each.clock_off_s:.3f} s off the others'"
        answer = result.answers.get(each.vehicle)
        did = "no answer" if answer is None else answer.did
        detail = f": {did}" if result.answers else f": {each.reason}" if each.reason else ""
        style = "red" if each.state == "missing" else ""
        print_line(f"vehicle {each.vehicle}: {each.state}{clock}{detail}", style)
    missing = [str(each.vehicle) for each in result.states if each.state == "missing"]
    policy, after_s = mission.failsafe.no_operator, mission.failsafe.no_operator_s
    if missing:
        print_problem(f"no vehicle was started: vehicle {', '.join(missing)} is missing", "see above, then start again")
    elif not result.started:
        print_problem(
            "not every vehicle has started; the others wait for two minutes in the air",
            "start again, or land them: cordon command land",
        )
    elif policy != "go_on":
        does = {"hold": "hold", "return": "return and land"}[policy]
        print_line(
            f"the vehicles {does} {after_s:g} s after the last operator leaves the bus: keep `cordon station` open"
        )


def _json(mission: "Mission", result: "StartResult") -> str:
    vehicles = [
        {**asdict(each), "answer": None if (answer := result.answers.get(each.vehicle)) is None else answer.did}
        for each in result.states
    ]
    return json_output({"mission": mission.mission.name, "started": result.started, "vehicles": vehicles})
