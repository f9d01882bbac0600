"""`cordon check`: preflight without arming."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import date
from time import time
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from gcs.cli.options import Changes, Json, MissionName, bus_mission
from gcs.errors import Exit

if TYPE_CHECKING:
    from gcs.mission.mission import Mission
    from gcs.preflight.computer import ComputerFacts
    from gcs.preflight.findings import VehicleFacts


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class CheckOptions:
    """Options of `cordon check`."""

    mission: MissionName = field(kw_only=False)
    changes: Changes = ()
    all: Annotated[bool, Parameter(negative="", help="List passed checks too, not only their number.")] = False
    bench: Annotated[
        bool, Parameter(negative="", help="Check boards in hardware-in-the-loop simulation: for `cordon fly --bench`.")
    ] = False
    json: Json = False


def check(options: CheckOptions) -> Exit:
    """Run the preflight checks of a mission, its vehicles and this computer, without arming.

    Parameters are read, never written. Refusals are listed last, above the totals.

    Example: cordon check px4-trio --all
    """
    from agents.shell.computer import computer_clock
    from gcs.cli.output import print_result
    from gcs.console.terminal import STDERR
    from gcs.keys.team_keys import leaves_this_computer, read_only_folders, team_keys
    from gcs.preflight.keys import KeyFacts
    from gcs.preflight.preflight import exit_code, findings_json, findings_view, preflight

    mission = bus_mission(options.mission, options.changes)
    clock = computer_clock() if leaves_this_computer(mission) else None
    holders = team_keys(mission).holders()
    ends_s = time() + mission.mission.duration_s
    key_facts = None if holders is None else KeyFacts(holders, ends_s, read_only_folders(mission))
    facts, computer = asyncio.run(_facts(mission))
    findings = preflight(
        mission, facts, date.today(), bench=options.bench, clock=clock, computer=computer, key_facts=key_facts
    )
    STDERR.print(findings_view(mission.mission.name, findings, passes=options.all))
    if options.json:
        print_result(findings_json(mission.mission.name, findings))
    return exit_code(findings)


async def _facts(mission: "Mission") -> "tuple[Sequence[VehicleFacts], ComputerFacts]":
    """Return the facts about the vehicles, and about this computer while their telemetry streams, as in flight."""
    from gcs.preflight.computer import computer_facts
    from gcs.preflight.link_facts import gather_facts
    from gcs.preflight.priority import RaisedPriority

    measured: list[ComputerFacts] = []

    async def measure() -> None:
        measured.append(await computer_facts(mission, mission.vehicles, priority.privileges))

    with RaisedPriority() as priority:
        facts = await gather_facts(mission, beside=measure)
    return facts, measured[0]
