"""`cordon router`: the router of a team's bus."""

import signal
from dataclasses import dataclass, field

from cyclopts import Parameter

from gcs.cli.options import Changes, KeyName, MissionName, bus_mission
from gcs.errors import Exit, InputError
from gcs.signals import ENDING, hold_back


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class RouterOptions:
    """Options of `cordon router`."""

    mission: MissionName = field(kw_only=False)
    changes: Changes = ()
    key: KeyName = None


def router(options: RouterOptions) -> Exit:
    """Route the messages of a team's vehicles and operators, which all connect to the mission's network.router.

    The router needs its own keys (`cordon keys issue router NAME`). It drops forged messages. Ctrl-C ends it.

    Example: cordon router my-mission.toml
    """
    hold_back()
    from agents.ports import VehicleRefusedError
    from agents.shell.zenoh_session import BusTeam, ZenohSession
    from gcs.console.terminal import print_line, print_problem
    from gcs.keys.team_keys import team_keys

    mission = bus_mission(options.mission, options.changes)
    network = mission.network
    if network.router is None:
        raise InputError(['network.router: the mission has none; next: [network] router = "tcp/ADDRESS:7447"'])
    security = team_keys(mission).identity("router", options.key).security
    session = ZenohSession(BusTeam(network.team, mission.ids, network.router), network.router, (), security)
    try:
        session.open(None, own=False, reports=False)
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    print_line(f"router of team {network.team} at {network.router}; Ctrl-C ends it")
    session.watch(_PresencePrinter())
    signal.sigwait(ENDING)
    session.close()
    return Exit.HOLDS


class _PresencePrinter:
    """Prints which vehicles and operators join and leave the bus, on any thread."""

    def take_presence(self, name: str, present: bool) -> None:
        """Print that a vehicle has joined or left."""
        _print(f"vehicle {name}", present)

    def take_operator(self, name: str, present: bool) -> None:
        """Print that an operator has joined or left."""
        _print(f"operator {name}", present)


def _print(who: str, present: bool) -> None:
    from gcs.console.terminal import print_line

    print_line(f"{who} {'is on' if present else 'left'} the bus")
