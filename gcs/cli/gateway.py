"""What the verbs share that carry a running team to another system: `cordon ros2` and `cordon cot`."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from gcs.errors import Exit, InputError

if TYPE_CHECKING:
    from gcs.mission.mission import Mission


class Gateway(Protocol):
    """A gateway between the team's bus and another network."""

    @property
    def summary(self) -> str:
        """What it has carried, and what it refused."""

    async def run(self, stop: asyncio.Event) -> None:
        """Carry until `stop`; raises VehicleRefusedError if a network cannot be joined."""


def require_target(mission: "Mission", name: str | None) -> None:
    """Raise InputError for the name of a target that the mission has not."""
    names = [each.name for each in mission.targets]
    if name is not None and name not in names:
        known = f"it has {', '.join(names)}" if names else "it has one: leave the option out"
        raise InputError([f"--target: {name!r} is no target of the mission ({known})"])


def run_gateway(make: Callable[[], Gateway], title: str) -> Exit:
    """Run a gateway, made on the event loop, until Ctrl-C, and print what it has carried."""
    from agents.ports import VehicleRefusedError
    from gcs.console.terminal import print_line, print_problem
    from gcs.signals import relay

    async def run() -> None:
        stop, loop = asyncio.Event(), asyncio.get_running_loop()
        relay(lambda: loop.call_soon_threadsafe(stop.set))
        gateway = make()
        print_line(f"{title}: Ctrl-C ends it")
        try:
            await gateway.run(stop)
        finally:
            print_line(gateway.summary)

    try:
        asyncio.run(run())
    except VehicleRefusedError as refusal:
        print_problem(refusal.reason, refusal.next_step)
        return Exit.REFUSED
    return Exit.HOLDS
