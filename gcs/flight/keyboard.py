"""The keyboard of a flight: its commands for the vehicles of this process, and for those of others."""

from collections.abc import Callable
from contextlib import AsyncExitStack

from agents.ports import PeerBus
from agents.team.participant import Participant
from gcs.console.key_commands import KeyCommands
from gcs.console.keyboard import Keyboard
from gcs.console.team_bus import guest_bus
from gcs.errors import InputError
from gcs.flight.team import Team
from gcs.keys.identity import Identity, user_name

_HERE_ONLY = "keys command the vehicles of this process only: it has no operator's keys for the others"


async def command_by_keyboard(team: Team, stack: AsyncExitStack) -> Callable[[], str]:
    """Let keys command the team until the stack ends; return what is shown about it below the table.

    Without a terminal nothing is read. Raises VehicleRefusedError when the bus to other vehicles cannot be opened.
    """
    if not team.view.is_live:
        return str
    identity, bus = Identity(Participant("operator", user_name())), None
    if len(team.members) < len(team.plan.mission.vehicles):
        try:
            identity = team.keys.identity("operator")
        except InputError as error:
            team.view.print_line(f"{_HERE_ONLY}: {error}")
        else:
            bus = await _opened(team, identity, stack)
    commands = KeyCommands(team.agents, team.clock, identity.participant.name, bus)
    keyboard = stack.enter_context(Keyboard(commands.press))
    return (lambda: commands.hint) if keyboard.active else str


async def _opened(team: Team, identity: Identity, stack: AsyncExitStack) -> PeerBus:
    """Return the bus to vehicles of other processes: from a vehicle's own bus they take no commands."""
    bus = guest_bus(team.plan.mission, identity)
    stack.push_async_callback(bus.close)
    await bus.open(lambda _message: None, lambda _sighting: None, lambda _vehicle, _present: None)
    return bus
