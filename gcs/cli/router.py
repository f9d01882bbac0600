"""`cordon router`: the router of a team's bus."""

import signal
from dataclasses import dataclass, field

from cyclopts import Parameter

from agents.drops import DropCounter
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
    from gcs.keys.team_keys import read_only_folders, team_keys
    from gcs.preflight.keys import MAKE_WRITABLE, NOT_KEPT

    mission = bus_mission(options.mission, options.changes)
    network = mission.network
    if network.router is None:
        raise InputError(['network.router: the mission has none; next: [network] router = "tcp/ADDRESS:7447"'])
    for folder in read_only_folders(mission):
        print_problem(f"{folder} cannot be written to: {NOT_KEPT}", MAKE_WRITABLE)
    security = team_keys(mission).identity("router", options.key).security
    team, refuse = BusTeam(network.team, mission.ids, network.router), _RefusalPrinter()
    session = ZenohSession(team, network.router, (), security, refuse)
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


class _RefusalPrinter:
    """Prints which callers are refused when they begin, and at each tenfold, on the thread of the gate."""

    def __init__(self) -> None:
        self._counter = DropCounter()

    def __call__(self, sender: str, why: str) -> None:
        """Count a caller that was refused."""
        from gcs.console.terminal import print_line

        sender, count = self._counter.refuse(sender, why)
        if count == 10 ** (len(f"{count}") - 1):
            print_line(f"bus: {sender} is refused: {why}; {count} times so far", "yellow")


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
