"""What a vehicle answers to each command in each situation, and what it does then: no answer states what is not so."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import pytest

from agents.ports import FlightMode
from agents.settings.shapes import Shape
from agents.shell.life import Phase
from agents.tactics import Tactic
from agents.team.codec import decode
from agents.team.messages import CommandAnswer, OperatorCommand, RingValues
from agents.team.verbs import VERBS, Verb
from tests.agents.shell.test_agent import reach
from tests.support.fake_flight import ALONE, FakeFlight
from tests.support.simulated_loop import run_simulated

MOMENT_S = 0.25
"""Two ticks."""
NUMBER = 1_000
Situation = Callable[[], Coroutine[Any, Any, FakeFlight]]


def reached(phase: Phase, *commands: Verb) -> Situation:
    """Return a flight in a phase, just after commands."""

    async def situation() -> FakeFlight:
        flight = await reach(phase)
        await asyncio.sleep(MOMENT_S)
        for verb in commands:
            flight.command(verb)
        return flight

    return situation


def changed(phase: Phase, **status: Any) -> Situation:
    """Return a flight in a phase, after a change of its autopilot's status."""

    async def situation() -> FakeFlight:
        flight = await reach(phase)
        flight.link.change(**status)
        await asyncio.sleep(MOMENT_S)
        return flight

    return situation


async def waiting() -> FakeFlight:
    flight = await reach(Phase.GROUND)
    flight.agent.wait_on_ground("")
    return flight


async def ended() -> FakeFlight:
    flight = await reach(Phase.LANDING)
    await flight.until(Phase.ENDED)
    return flight


SITUATIONS: Mapping[str, Situation] = {
    "waiting on the ground": waiting,
    "take-off": reached(Phase.TAKE_OFF),
    "take-off, held": reached(Phase.TAKE_OFF, "hold"),
    "flying": reached(Phase.FLYING),
    "held": reached(Phase.FLYING, "hold"),
    "returning": reached(Phase.FLYING, "rtl"),
    "stopped": reached(Phase.STOPPING),
    "mission over, held": reached(Phase.RETURNING),
    "handed over": reached(Phase.PILOT_OVERRIDE),
    "handed over, on the ground": changed(Phase.PILOT_OVERRIDE, mode=FlightMode.LAND, in_air=False),
    "handed over, landed": changed(Phase.PILOT_OVERRIDE, mode=FlightMode.LAND, armed=False, in_air=False),
    "being taken back": reached(Phase.TAKING_BACK),
    "link lost": changed(Phase.FLYING, connected=False),
    "landing": reached(Phase.LANDING),
    "motors being cut": reached(Phase.KILLING),
    "ended": ended,
}


def answered(situation: Situation, *verbs: Verb) -> list[tuple[str, Tactic]]:
    """Return the first answer to each of some commands, and the tactic a moment later."""

    async def main() -> list[tuple[str, Tactic]]:
        flight, found = await situation(), list[tuple[str, Tactic]]()
        for number, verb in enumerate(verbs, NUMBER):
            shape: Shape | None = "wedge" if verb == "formation" else None
            ring = RingValues(radius_m=12.0) if verb == "ring" else None
            vehicle = ALONE.vehicle_id if verb == "rejoin" else None
            flight.bus.deliver(OperatorCommand(flight.clock.now_s(), verb, vehicle, "anna", number, shape, ring=ring))
            await asyncio.sleep(MOMENT_S)
            sent = (decode(payload) for topic, payload in flight.bus.published if topic == "answer")
            answers = [each.did for each in sent if isinstance(each, CommandAnswer) and each.number == number]
            found.append((answers[0] if answers else "", flight.core.tactic))
        flight.link.release()
        if flight.task is not None:
            flight.task.cancel()
            await asyncio.gather(flight.task, return_exceptions=True)
        await flight.agent.close()
        return found

    return run_simulated(main())


NOT_WAITING = "did not wait for its start"
GROUND, LANDS, RETURNS = "refused: it waits on the ground for its start", "refused: it is landing", "returns and lands"
DOWN = "refused: it is on the ground, disarmed: it takes off by rejoin"
STANDS = "refused: it has flown and is on the ground: it takes off again by rejoin"
HANDED_OVER = "refused: cordon has handed it over: resume takes it back, kill cuts its motors"
CUT = "refused: its motors are being cut"
RETURNING = "refused: it is on its way to land"
LATER = ", once it is in offboard"
IN_5_S = ", lands in 5 s unless resumed"
WEDGE = "in the shape 'wedge'"
PLACE, LATER_PLACE = f"takes its place {WEDGE}", f"will take its place, once in formation, {WEDGE}"
RING = "will fly, once it encircles, a ring of 12 m"
OVER = "refused: its mission is over"
ONE_RING = "refused: the mission has one ring, which every vehicle flies"
LOST = "; its link is lost"
ANSWERS: Mapping[str, tuple[str, ...]] = {
    # hold, resume, land, rtl, abort, formation, ring
    "waiting on the ground": (GROUND,) * 7,
    "take-off": (
        f"holds{LATER}", "was waiting for the start already", "lands", RETURNS + LATER, f"holds{LATER}{IN_5_S}",
        LATER_PLACE, RING,
    ),
    "take-off, held": (
        f"holds{LATER}", f"resumes its mission{LATER}", "lands", RETURNS + LATER, f"holds{LATER}{IN_5_S}", LATER_PLACE,
        RING,
    ),
    "flying": ("holds", "was on its mission already", "lands", RETURNS, f"holds{IN_5_S}", PLACE, RING),
    "held": (
        "was holding already", "resumes its mission", "lands", RETURNS, f"was holding already{IN_5_S}", LATER_PLACE,
        RING,
    ),
    "returning": ("holds", RETURNING, "lands", "was returning to land already", f"holds{IN_5_S}", RETURNING, RETURNING),
    "stopped": (
        "was holding already", "refused: the operator ends the flight: rtl brings it home", "lands", RETURNS,
        "was holding already, lands in 5 s", OVER, OVER,
    ),
    "mission over, held": (
        "was holding already", "continues its return", "lands", RETURNS, f"was holding already{IN_5_S}", OVER, OVER,
    ),
    "handed over": (HANDED_OVER, f"resumes its mission{LATER}", *(HANDED_OVER,) * 3, LATER_PLACE, RING),
    "handed over, on the ground": (HANDED_OVER, STANDS, *(HANDED_OVER,) * 3, LATER_PLACE, RING),
    "handed over, landed": (DOWN,) * 7,
    "being taken back": (
        f"holds{LATER}", f"resumes its mission{LATER}", "lands", RETURNS + LATER, f"holds{LATER}{IN_5_S}", LATER_PLACE,
        RING,
    ),
    "link lost": (
        f"holds{LOST}", f"was on its mission already{LOST}", f"lands{LOST}", RETURNS + LOST, f"holds{IN_5_S}{LOST}",
        PLACE + LOST, RING + LOST,
    ),
    "landing": (LANDS, LANDS, "was landing already", LANDS, "was landing already", LANDS, LANDS),
    "motors being cut": (CUT,) * 7,
    "ended": (DOWN,) * 7,
}  # fmt: skip
FLIES, PILOTED = "refused: it has not landed", "refused: it is in a pilot's hands: let its pilot land and disarm it"
REJOINS: Mapping[str, str] = {
    "waiting on the ground": GROUND,
    "handed over": PILOTED,
    "handed over, on the ground": PILOTED,
    "handed over, landed": "is checked",
    "link lost": "refused: its link is lost: rejoin once it is received again",
    "ended": "is checked",
}
"""The answers to rejoin; in other situations FLIES."""
STEERING: tuple[Verb, ...] = ("hold", "resume", "land", "rtl", "abort", "formation", "ring", "assign")
BECOMES = {
    "holds": {Tactic.HOLD},
    "resumes": {Tactic.FORMATION},
    "lands": {Tactic.LAND},
    "returns": {Tactic.RETURN_AND_LAND, Tactic.LAND},
    "continues": {Tactic.RETURN_AND_LAND, Tactic.LAND},
}
"""The tactics after an answer that begins with these words."""


@pytest.mark.parametrize("name", SITUATIONS)
def test_every_answer_is_true(name: str) -> None:
    assert set(STEERING) | {"start", "kill", "rejoin", "goto", "look"} == set(VERBS)
    refuses = all(expected.startswith("refused: ") for expected in ANSWERS[name])
    # What is refused changes nothing.
    flights: list[tuple[Verb, ...]] = [STEERING] if refuses else [(verb,) for verb in STEERING]
    found = [each for verbs in flights for each in answered(SITUATIONS[name], *verbs)]
    *expected, of_ring = ANSWERS[name]
    assigned = of_ring if of_ring in (GROUND, DOWN, CUT) else ONE_RING
    assert [did for did, _ in found] == [*expected, of_ring, assigned]
    for did, tactic in found:
        if (after := BECOMES.get(did.split(" ")[0].strip(",;"))) is not None:
            assert tactic in after, did
    waits = name == "waiting on the ground"
    assert answered(SITUATIONS[name], "rejoin")[0][0] == REJOINS.get(name, FLIES)
    (started, _), (killed, _) = answered(SITUATIONS[name], "start", "kill")
    assert started.startswith("takes off" if waits else NOT_WAITING)
    assert killed == "cuts the motors"
