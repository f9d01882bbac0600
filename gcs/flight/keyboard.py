"""The keyboard of a flight: its commands for the vehicles of this process, and for those of others."""

from collections.abc import Callable
from contextlib import AsyncExitStack

from rich.text import Text

from agents.ports import PeerBus
from agents.tactics import Tactic
from agents.team.participant import Participant
from gcs.console.keyboard.bindings import KeyBindings
from gcs.console.keyboard.commands import KeyCommands
from gcs.console.keyboard.keyboard import Keyboard
from gcs.console.team_bus import guest_bus
from gcs.errors import InputError
from gcs.flight.team import FlightTeam
from gcs.keys.identity import Identity, user_name

_HERE_ONLY = "the keyboard commands the vehicles of this process only: there is no operator key for the others"


async def command_by_keyboard(team: FlightTeam, stack: AsyncExitStack) -> Callable[[], Text]:
    """Let the keyboard command the team until the stack ends; return the text below the table about it.

    Without a terminal no key is read. Raises VehicleRefusedError when the bus to other vehicles cannot be opened.
    """
    if not team.view.is_live:
        return Text
    identity, bus = Identity(Participant("operator", user_name())), None
    if len(team.members) < len(team.plan.mission.vehicles):
        try:
            identity = team.keys.identity("operator")
        except InputError as error:
            team.view.print_line(f"{_HERE_ONLY}: {error}")
        else:
            bus = await _opened(team, identity, stack)
    here = [member.vehicle.id for member in team.members]
    bindings = KeyBindings(here if bus is None else team.plan.mission.ids)
    commands = KeyCommands(team.agents, team.clock, identity.participant.name, bus, bindings, lambda: _piloted(team))
    keyboard = stack.enter_context(Keyboard(commands.press, commands.ignore_paste))
    return (lambda: commands.hint) if keyboard.active else Text


def _piloted(team: FlightTeam) -> set[int]:
    """Return the vehicles that pilots fly, of this process and of others."""
    newest, pilot = team.newest.values(), Tactic.PILOT_OVERRIDE
    here = {status.vehicle_id for status in newest if status.tactic is pilot}
    return here | {peer.sender for status in newest for peer in status.peers if peer.tactic == pilot.value}


async def _opened(team: FlightTeam, identity: Identity, stack: AsyncExitStack) -> PeerBus:
    """Return the bus to vehicles of other processes, which accept no commands from a vehicle's own bus."""
    bus = guest_bus(team.plan.mission, identity)
    stack.push_async_callback(bus.close)
    await bus.open(lambda _message: None, lambda *_: None, lambda _vehicle, _present: None)
    return bus
