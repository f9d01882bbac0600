"""A core that records its inputs and outputs: it writes each input, then takes it."""

from typing import Protocol

from agents.control.plan import PlannerFactory
from agents.core import VehicleCore
from agents.drops import NO_DROPS
from agents.inputs import Bus, Computer, CoreInput, LateTicks, ReceivedInput, Rejoined, Tick
from agents.outputs import TickOutput
from agents.settings.config import AgentConfig

_AT_FIRST: tuple[ReceivedInput, ...] = (LateTicks(0), Bus(alive=True), NO_DROPS, Computer(""))
"""What a core assumes before its first inputs."""


class InputRecorder(Protocol):
    """Records a core's inputs and outputs in order; never blocks, never raises."""

    def write(self, item: CoreInput | TickOutput) -> None:
        """Take the next item; a tick's output follows the tick."""


class RecordedCore(VehicleCore):
    """A core whose every input and output is written to a recorder. An input that lasts is written when it changes."""

    def __init__(self, config: AgentConfig, recorder: InputRecorder, planner: PlannerFactory | None = None) -> None:
        super().__init__(config, planner)
        self._write = recorder.write
        self._lasting = _lasting_at_first()

    def take(self, item: ReceivedInput) -> None:
        """See VehicleCore."""
        kind = type(item)
        if not item.lasts:
            self._write(item)
        elif self._lasting.get(kind) != item:
            self._lasting[kind] = item
            self._write(item)
        super().take(item)
        if type(item) is Rejoined and not item.refusal:  # the core has begun anew
            self._lasting = _lasting_at_first()

    def tick(self, now_s: float) -> TickOutput:
        """See VehicleCore."""
        self._write(Tick(now_s))
        output = super().tick(now_s)
        self._write(output)
        return output


def _lasting_at_first() -> dict[type, ReceivedInput]:
    return {type(each): each for each in _AT_FIRST}


def replay_input(core: VehicleCore, item: CoreInput) -> TickOutput | None:
    """Let a core take a recorded input; return the output of a tick, None for other inputs."""
    if isinstance(item, Tick):
        return core.tick(item.now_s)
    core.take(item)
    return None
