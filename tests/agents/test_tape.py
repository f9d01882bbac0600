"""The tape: all that goes into a core is on it, once, and what is played from it comes out the same."""

import inspect
from collections.abc import Callable
from typing import Any, get_args

from agents.core import VehicleCore
from agents.drops import Drops
from agents.outputs import TickOutput
from agents.ports import VehicleStatus
from agents.settings.config import AgentConfig
from agents.tactics import Event, Tactic
from agents.tape import CoreInput, TapedCore, Tick, play
from agents.team.messages import OperatorCommand
from estimation.state import Sighting, Telemetry
from gcs.flightlog.records import decision_of

PERIOD_S = 0.1


class ListTape:
    def __init__(self) -> None:
        self.items: list[CoreInput | TickOutput] = []

    def write(self, item: CoreInput | TickOutput) -> None:
        self.items.append(item)


def telemetry(now_s: float) -> Telemetry:
    return Telemetry(now_s, (0.2 * now_s, 0.0, 8.0), (0.2, 0.0, 0.0))


def flown(core: VehicleCore) -> list[TickOutput]:
    """Let a core live through something of everything, on a straight line past a target."""
    core.set_time_scale(2.0)
    core.start(1.0)
    core.on_presence(1, True)
    outputs = []
    for tick in range(200):
        now_s = tick * PERIOD_S
        core.on_telemetry(telemetry(now_s))
        core.on_vehicle(VehicleStatus(connected=True, armed=True, battery=1.0 - tick / 400))
        core.on_loop(3 if tick == 20 else 0)
        core.on_bus(tick != 30)
        core.on_drops(Drops(too_many=500 if tick >= 50 else 0))
        core.on_computer("disk" if tick == 50 else "")
        if tick % 2 == 0:
            core.on_sighting(Sighting(now_s, 2, (6.0, -3.0), (0.01, 0.0, 0.01), 0.8, 0.2))
        if tick == 40:
            core.on_message(OperatorCommand(now_s, "hold", None, "tower", 7), now_s)
        if tick == 60:
            core.on_command(OperatorCommand(now_s, "resume", 2, "here", 8), now_s)
        if tick == 80:
            core.on_message(OperatorCommand(now_s, "formation", None, "tower", 9, "wedge"), now_s)
        if tick == 90:
            core.on_presence(1, False)
        if tick == 120:
            core.on_event(Event.END)
        outputs.append(core.tick(now_s))
    core.on_killed("refused", 20.0)
    core.on_ground("no fix")
    outputs.append(core.tick(20.0))
    return outputs


def decisions(outputs: list[TickOutput]) -> list[Any]:
    return [decision_of(output) for output in outputs]


def test_a_taped_core_decides_as_any_other(make_config: Callable[..., AgentConfig]) -> None:
    plain, tape = flown(VehicleCore(make_config())), ListTape()
    taped = flown(TapedCore(make_config(), tape))
    assert decisions(taped) == decisions(plain)
    assert {output.status.tactic for output in plain} >= {Tactic.STANDBY, Tactic.ENCIRCLE, Tactic.HOLD}


def test_what_is_played_from_the_tape_comes_out_the_same(make_config: Callable[..., AgentConfig]) -> None:
    tape = ListTape()
    flown(TapedCore(make_config(), tape))
    fresh = VehicleCore(make_config())
    played = [play(fresh, item) for item in tape.items if not isinstance(item, TickOutput)]
    on_tape = [item for item in tape.items if isinstance(item, TickOutput)]
    assert decisions([output for output in played if output is not None]) == decisions(on_tape)
    # The story has both kinds of commands in it, each obeyed once: a tape that had one twice would tell so.
    told = [note.text for output in on_tape for note in output.status.notes if note.kind == "command"]
    assert len(told) == len(set(told)) >= 2


def test_an_output_follows_its_tick_and_nothing_is_recorded_twice(make_config: Callable[..., AgentConfig]) -> None:
    tape = ListTape()
    flown(TapedCore(make_config(), tape))
    for before, item in zip(tape.items, tape.items[1:], strict=False):
        assert isinstance(item, TickOutput) == isinstance(before, Tick)
    kinds = [type(item).__name__ for item in tape.items]
    # Said in every tick, on tape only when it was news: a link that works, no late ticks but once, the bus away once.
    assert kinds.count("LateTicks") == 2
    assert kinds.count("Bus") == 2
    assert kinds.count("Computer") == 2
    assert kinds.count("Command") == 1
    assert kinds.count("Message") == 2


def test_every_way_into_a_core_is_on_tape_and_back() -> None:
    ways = {name for name, _ in inspect.getmembers(VehicleCore, inspect.isroutine) if not name.startswith("_")}
    assert ways == {name for name in vars(TapedCore) if not name.startswith("_")}
    assert len(get_args(CoreInput)) == len(ways)
