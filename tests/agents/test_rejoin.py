"""What a vehicle that has landed answers to a command to rejoin, by what it knows of itself and of its peers."""

from collections.abc import Callable

import pytest

from agents.core import VehicleCore
from agents.inputs import AutopilotStatus, Command, Killed, Message, TacticEvent
from agents.ports import VehicleStatus
from agents.settings.config import AgentConfig
from agents.tactics import Event, Tactic
from agents.team.messages import Goal, MemberState, OperatorCommand
from estimation.state import Telemetry

FLYING = VehicleStatus(connected=True, armed=True, in_air=True)
DOWN = VehicleStatus(connected=True)
NOW_S = 20.0


def landed(core: VehicleCore, height_m: float = 0.1, status: VehicleStatus = DOWN) -> VehicleCore:
    """Let a vehicle fly at a height until it is as a status says."""
    core.take(AutopilotStatus(FLYING))
    core.take(Telemetry(1.0, (0.0, 0.0, height_m), (0.0, 0.0, 0.0)))
    core.tick(1.0)
    core.take(AutopilotStatus(status))
    return core


def answer(core: VehicleCore, vehicle: int | None = 2) -> str:
    command = OperatorCommand(NOW_S, "rejoin", vehicle, "anna", 1)
    core.take(Command(NOW_S, command))
    told = core.commands.answer(command.key, NOW_S)
    assert told is not None
    return told.did


def state(sender: int, tactic: Tactic, time_s: float = NOW_S - 0.1) -> Message:
    here, rest = (9.0, 9.0 * sender), (0.0, 0.0)
    peer = MemberState(sender, time_s, tactic.value, here, rest, here, rest)
    return Message(time_s, peer)


@pytest.mark.parametrize(
    ("height_m", "status", "expected"),
    [
        (0.1, DOWN, "is checked"),
        (8.0, VehicleStatus(connected=True, in_air=True), "refused: it fell"),
        (0.1, VehicleStatus(connected=True, in_air=True), "refused: it has not landed"),
        (8.0, FLYING, "refused: it has not landed"),
        (0.1, VehicleStatus(), "refused: its link is lost"),
    ],
)
def test_only_a_vehicle_that_landed_takes_off_again(
    make_config: Callable[..., AgentConfig], height_m: float, status: VehicleStatus, expected: str
) -> None:
    core = landed(VehicleCore(make_config()), height_m, status)
    assert answer(core).startswith(expected)
    assert core.commands.rejoins is (expected == "is checked")


def test_one_whose_motors_were_cut_in_the_air_does_not(make_config: Callable[..., AgentConfig]) -> None:
    core = landed(VehicleCore(make_config()), 8.0, FLYING)
    core.take(Command(2.0, OperatorCommand(2.0, "kill", 2, "anna", 9)))
    core.take(Killed(3.0, ""))
    core.take(AutopilotStatus(DOWN))
    assert answer(core).startswith("refused: it fell")


@pytest.mark.parametrize(
    ("tactics", "expected"),
    [
        ((Tactic.ENCIRCLE, Tactic.ENCIRCLE), "is checked"),
        ((Tactic.ENCIRCLE, Tactic.RETURN_AND_LAND), "is checked"),
        ((Tactic.LAND, Tactic.RETURN_AND_LAND), "refused: the others return and land"),
    ],
)
def test_none_takes_off_while_the_team_returns(
    make_config: Callable[..., AgentConfig], tactics: tuple[Tactic, Tactic], expected: str
) -> None:
    core = landed(VehicleCore(make_config()))
    for sender, tactic in zip((1, 3), tactics, strict=True):
        core.take(state(sender, tactic))
    assert answer(core) == expected


@pytest.mark.parametrize(
    ("place_m", "goal_m", "expected"),
    [
        ((0.0, 2.0), None, "refused: vehicle 1 holds 2.0 m from its take-off place: send it elsewhere first"),
        ((0.0, 9.0), (1.0, 0.0), "refused: vehicle 1 goes to a place 1.0 m from its take-off place"),
        ((0.0, 2.0), (0.0, 9.0), "is checked"),
        ((0.0, 9.0), None, "is checked"),
    ],
)
def test_none_takes_off_where_another_vehicle_holds_or_goes_to(
    make_config: Callable[..., AgentConfig],
    place_m: tuple[float, float],
    goal_m: tuple[float, float] | None,
    expected: str,
) -> None:
    core = landed(VehicleCore(make_config(home_m=(0.0, 0.0), safety={"separation_m": 3.0})))
    rest, goal = (0.0, 0.0), None if goal_m is None else Goal(*goal_m)
    peer = MemberState(1, NOW_S - 0.1, Tactic.HOLD.value, place_m, rest, place_m, rest, goal=goal)
    core.take(Message(NOW_S - 0.1, peer))
    assert answer(core).startswith(expected)


def test_nor_once_its_mission_is_over_nor_without_a_name(make_config: Callable[..., AgentConfig]) -> None:
    assert answer(landed(VehicleCore(make_config())), None).startswith("refused: the command names no vehicle")
    core = landed(VehicleCore(make_config()))
    core.take(TacticEvent(Event.END))
    assert answer(core) == "refused: its mission is over"
