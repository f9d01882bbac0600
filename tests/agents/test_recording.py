"""Recording a core: all that it takes is recorded, once, and what is replayed from it comes out the same."""

import inspect
from collections.abc import Callable
from itertools import pairwise
from typing import Any, get_args

import pytest

from agents.core import VehicleCore
from agents.drops import Drops
from agents.inputs import (
    AutopilotStatus,
    Bus,
    Command,
    Computer,
    CoreInput,
    Ground,
    Killed,
    LateTicks,
    Lying,
    Message,
    Presence,
    Rejoined,
    Start,
    TacticEvent,
    Tick,
    TimeScale,
    VehicleJoins,
)
from agents.outputs import TickOutput
from agents.ports import VehicleStatus
from agents.recording import RecordedCore, replay_input
from agents.settings.config import AgentConfig
from agents.tactics import Event, Tactic
from agents.team.messages import AddedVehicle, OperatorCommand
from estimation.state import Sighting, Telemetry
from gcs.flightlog.records import decision_of

PERIOD_S = 0.1


class ListRecorder:
    def __init__(self) -> None:
        self.items: list[CoreInput | TickOutput] = []

    def write(self, item: CoreInput | TickOutput) -> None:
        self.items.append(item)


def telemetry(now_s: float) -> Telemetry:
    return Telemetry(now_s, (0.2 * now_s, 0.0, 8.0), (0.2, 0.0, 0.0))


def flown(core: VehicleCore) -> list[TickOutput]:
    """Let a core live through something of everything, on a straight line past a target."""
    core.take(TimeScale(2.0))
    core.take(Start(1.0))
    core.take(Presence(1, True))
    core.take(Lying(3, (40.0, 2.0)))
    outputs = []
    for tick in range(200):
        now_s = tick * PERIOD_S
        core.take(telemetry(now_s))
        core.take(AutopilotStatus(VehicleStatus(connected=True, armed=True, battery=1.0 - tick / 400)))
        core.take(LateTicks(3 if tick == 20 else 0))
        core.take(Bus(tick != 30))
        core.take(Drops(too_many=500 if tick >= 50 else 0))
        core.take(Computer("disk" if tick == 50 else ""))
        if tick % 2 == 0:
            core.take(Sighting(now_s, 2, (6.0, -3.0), (0.01, 0.0, 0.01), 0.8, 0.2))
        if tick == 40:
            core.take(Message(now_s, OperatorCommand(now_s, "hold", None, "tower", 7)))
        if tick == 60:
            core.take(Command(now_s, OperatorCommand(now_s, "resume", 2, "here", 8)))
        if tick == 80:
            core.take(Message(now_s, OperatorCommand(now_s, "formation", None, "tower", 9, "wedge")))
        if tick == 90:
            core.take(Presence(1, False))
        if tick == 100:
            core.take(VehicleJoins(4, AddedVehicle((0.0, -8.0), 8.0)))
        if tick == 120:
            core.take(TacticEvent(Event.END))
        outputs.append(core.tick(now_s))
    core.take(Killed(20.0, "refused"))
    outputs.append(core.tick(20.0))
    core.take(AutopilotStatus(VehicleStatus(connected=True)))
    outputs += flown_again(core, 21.0)
    core.take(Ground("no fix"))
    return [*outputs, core.tick(30.0)]


def flown_again(core: VehicleCore, from_s: float) -> list[TickOutput]:
    """Let a core live through another flight, which begins at a time."""
    core.take(Message(from_s, OperatorCommand(from_s, "rejoin", 2, "tower", 10)))
    core.take(Rejoined(from_s, ""))
    core.take(TimeScale(2.0))
    outputs = [core.tick(from_s)]
    core.take(Start(1.0))
    for tick in range(60):
        now_s = from_s + tick * PERIOD_S
        core.take(telemetry(now_s))
        core.take(AutopilotStatus(VehicleStatus(connected=True, armed=True, battery=0.9)))
        core.take(Sighting(now_s, 2, (6.0, -3.0), (0.01, 0.0, 0.01), 0.8, 0.2))
        outputs.append(core.tick(now_s))
    return outputs


def decisions(outputs: list[TickOutput]) -> list[Any]:
    return [decision_of(output) for output in outputs]


Items = list[CoreInput | TickOutput]


@pytest.fixture(scope="module")
def recorded(make_config: Callable[..., AgentConfig]) -> Items:
    """Return the record of a story, whose decisions are those of a core that is not recorded."""
    plain, recorder = flown(VehicleCore(make_config())), ListRecorder()
    kept = flown(RecordedCore(make_config(), recorder))
    assert decisions(kept) == decisions(plain)
    assert {output.status.tactic for output in plain} >= {Tactic.STANDBY, Tactic.ENCIRCLE, Tactic.HOLD}
    return recorder.items


def test_every_input_is_in_the_story_and_what_is_replayed_comes_out_the_same(
    recorded: Items, make_config: Callable[..., AgentConfig]
) -> None:
    assert {type(item) for item in recorded} == {*get_args(CoreInput), TickOutput}
    fresh = VehicleCore(make_config())
    played = [replay_input(fresh, item) for item in recorded if not isinstance(item, TickOutput)]
    outputs = [item for item in recorded if isinstance(item, TickOutput)]
    assert decisions([output for output in played if output is not None]) == decisions(outputs)
    # The story has both kinds of commands in it, each obeyed once: a record that had one twice would tell so.
    notes = [note for output in outputs for note in output.status.notes]
    told = [note.text for note in notes if note.kind == "command" and " by " in note.text]
    assert len(told) == len(set(told)) >= 2


def test_a_core_whose_vehicle_flies_again_decides_as_a_new_one(make_config: Callable[..., AgentConfig]) -> None:
    used, fresh = VehicleCore(make_config()), VehicleCore(make_config())
    flown(used)
    used.take(AutopilotStatus(VehicleStatus(connected=True)))
    again, first = flown_again(used, 40.0), flown_again(fresh, 40.0)
    assert again[-1].status.tactic is Tactic.ENCIRCLE
    assert again[-1].setpoint is not None
    assert [(each.setpoint, each.status.tactic) for each in again] == [(o.setpoint, o.status.tactic) for o in first]


def test_an_output_follows_its_tick_and_nothing_is_recorded_twice(recorded: Items) -> None:
    for before, item in pairwise(recorded):
        assert isinstance(item, TickOutput) == isinstance(before, Tick)
    kinds = [type(item).__name__ for item in recorded]
    # Said in every tick, recorded only when it was news: a link that works, no late ticks but once, the bus away once.
    counts = {kind: kinds.count(kind) for kind in ("LateTicks", "Bus", "Computer", "Command", "Message")}
    assert counts == {"LateTicks": 2, "Bus": 2, "Computer": 2, "Command": 1, "Message": 3}


def test_there_are_two_ways_into_a_core_and_both_are_recorded() -> None:
    ways = {name for name, _ in inspect.getmembers(VehicleCore, inspect.isroutine) if not name.startswith("_")}
    assert ways == {name for name in vars(RecordedCore) if not name.startswith("_")} == {"take", "tick"}
