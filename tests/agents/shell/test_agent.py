"""The agent flies a scripted vehicle: what it sends and how the flight ends, whatever goes wrong in which phase."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from agents.flight_end import FlightEnd
from agents.inputs import ReceivedInput, Start, TacticEvent, Tick, TimeScale
from agents.ports import Connection, FlightMode
from agents.settings.config import AgentConfig
from agents.shell.life import Phase
from agents.shell.outcome import Outcome
from agents.tactics import Event, Tactic
from agents.team.codec import decode
from agents.team.messages import (
    REPORT_TOPIC,
    TOPICS,
    CommandAnswer,
    MemberState,
    OperatorCommand,
    StartProposal,
    VehicleReport,
)
from agents.team.verbs import Verb
from tests.support.fake_flight import ALONE, PAIR, FakeFlight, FakeLink
from tests.support.simulated_loop import run_simulated

P, X = Phase, FlightEnd
LAND = ["stop_offboard", "land"]
FLOWN = ["take_off", "send", "start_offboard", "send", *LAND]
DURATION_S = 15.05
"""Ends between two ticks."""
CONFIGS = {P.COMPARING_CLOCKS: PAIR, P.AGREEING_START: PAIR}
STUCK = {
    P.ENTERING_OFFBOARD: "start_offboard",
    P.TAKING_BACK: "start_offboard",
    P.LEAVING_OFFBOARD: "stop_offboard",
    P.KILLING: "kill",
}


async def reach(phase: Phase) -> FakeFlight:
    """Return a flight that is in a phase, and stays there for a while if it is left alone."""
    flight = FakeFlight(CONFIGS.get(phase, ALONE))
    flight.link.telemetry = phase is not P.HOVERING
    if phase is P.GROUND:
        await flight.agent.connect()
        return flight
    if phase is P.ENTERING_OFFBOARD:
        flight.link.stuck.add("start_offboard")
    await flight.begin(DURATION_S)
    if phase is P.COMPARING_CLOCKS:
        flight.bus.appear(2, True)
    await flight.until(P.TAKE_OFF if phase is P.CHECKING_ARMED else P.FLYING if phase in _LEAD else phase)
    if phase is P.TAKE_OFF:
        await asyncio.sleep(2.0)  # it is armed, and climbs
    if phase in _LEAD:
        flight.link.stuck |= {STUCK[phase]} if phase in STUCK else set()
        await asyncio.sleep(3.0)
        await _LEAD[phase](flight)
        await flight.until(phase)
    if phase in STUCK:
        await asyncio.sleep(0.5)  # the call is under way; one for offboard anew waits until setpoints flow
    if phase is P.RETURNING:
        flight.command("hold")
    if phase is P.CHECKING_ARMED:
        await asyncio.sleep(0.3)
        flight.stop.request()
        await flight.until(phase)
    return flight


async def _take_back(flight: FakeFlight) -> None:
    flight.link.change(mode=FlightMode.HOLD)
    await flight.until(P.PILOT_OVERRIDE)
    flight.command("resume")


def _told(act: Callable[[FakeFlight], object]) -> Callable[[FakeFlight], Coroutine[Any, Any, None]]:
    async def lead(flight: FakeFlight) -> None:
        act(flight)

    return lead


_LEAD: dict[Phase, Callable[[FakeFlight], Coroutine[Any, Any, None]]] = {
    P.STOPPING: _told(lambda flight: flight.stop.request()),
    P.PILOT_OVERRIDE: _told(lambda flight: flight.link.change(mode=FlightMode.HOLD)),
    P.TAKING_BACK: _take_back,
    P.LEAVING_OFFBOARD: _told(lambda flight: flight.command("land")),
    P.LANDING: _told(lambda flight: flight.command("land")),
    P.KILLING: _told(lambda flight: flight.command("kill")),
}

Disturb = Callable[[FakeFlight], object]


def fly_disturbed(phase: Phase, disturb: Disturb) -> tuple[FakeFlight, list[str], Outcome]:
    """Disturb a flight in a phase; return it, what the vehicle was sent afterwards, and the outcome.

    A sequence of setpoints that goes on after the disturbance is not among what was sent.
    """

    async def main() -> tuple[FakeFlight, list[str], Outcome]:
        flight = await reach(phase)
        assert flight.agent.phase is phase
        before = len(flight.link.calls)
        disturb(flight)
        if phase is P.GROUND:
            await asyncio.sleep(1.0)
            await flight.begin(DURATION_S)
        outcome = await flight.outcome()
        await asyncio.sleep(5.0)
        assert flight.agent.phase is P.ENDED
        assert flight.link.overlapping == []
        assert asyncio.all_tasks() == {asyncio.current_task()}
        return flight, flight.link.calls[before:], outcome

    return run_simulated(main())


def steered(calls: list[str]) -> list[str]:
    """Return the calls without setpoints."""
    return [call for call in calls if call != "send"]


def test_a_flight_from_the_ground_to_the_ground() -> None:
    async def main() -> None:
        flight = FakeFlight()
        await flight.begin(DURATION_S)
        outcome = await flight.outcome()
        assert outcome == Outcome(X.LANDED, flew=True)
        assert flight.link.calls == FLOWN
        assert flight.heartbeat.signs == ["rising", "tick", "ended"]
        assert flight.events() == [Event.END, Event.LAND]
        kept = [item for _, item in flight.inputs if isinstance(item, TimeScale | Start | TacticEvent)]
        start_s = flight.agent.start_s
        assert start_s is not None
        assert kept == [TimeScale(1.0), Start(start_s), TacticEvent(Event.END), TacticEvent(Event.LAND)]
        assert isinstance(flight.inputs[0][1], TimeScale)
        assert flight.agent.ended_s == pytest.approx(start_s + DURATION_S + 1e-3, abs=1e-6)  # after a tick at the end
        assert flight.agent.loop.missed == 0
        told_s = {item.event: time_s for time_s, item in flight.inputs if isinstance(item, TacticEvent)}
        ticks_s = [item.now_s for _, item in flight.inputs if isinstance(item, Tick)]
        up_s = 1_000.0 + flight.link.takes_s["take_off"]
        steering = sum(up_s < tick_s < told_s[Event.LAND] for tick_s in ticks_s)
        assert flight.agent.loop.ticks == pytest.approx(steering, abs=2)  # the first and the last lie on the edges

    run_simulated(main())


KILLED_IN = [phase for phase in Phase if phase not in (P.KILLING, P.ENDED)]


@pytest.mark.parametrize("phase", KILLED_IN)
def test_a_kill_cuts_the_motors_and_nothing_is_sent_afterwards(phase: Phase) -> None:
    flight, calls, outcome = fly_disturbed(phase, lambda flight: flight.command("kill"))
    assert calls == ["kill"]
    assert (outcome.how, outcome.flew) == (X.KILLED, True)
    assert not flight.link.status.armed
    assert flight.heartbeat.signs[-1] == "ended"
    answers = [decode(payload) for topic, payload in flight.bus.published if topic == "answer"]
    assert [answer.did for answer in answers if isinstance(answer, CommandAnswer)][-1] == "motors cut"


@pytest.mark.parametrize("phase", [P.GROUND, P.TAKE_OFF, P.FLYING, P.PILOT_OVERRIDE, P.LANDING])
def test_a_vehicle_that_refuses_to_cut_its_motors_is_landed(phase: Phase) -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.link.refused.add("kill")
        flight.link.stuck.clear()
        flight.command("kill")

    _, calls, outcome = fly_disturbed(phase, disturb)
    assert calls == ["kill", *LAND]
    assert (outcome.how, outcome.reason) == (X.REFUSED, "refused to kill")


CALL_STOPPED = {
    P.TAKE_OFF: "take_off",
    P.ENTERING_OFFBOARD: "start_offboard",
    P.TAKING_BACK: "start_offboard",
    P.LEAVING_OFFBOARD: "stop_offboard",
    P.LANDING: "land",
}


@pytest.mark.parametrize("phase", CALL_STOPPED)
def test_a_kill_waits_for_no_call_and_stops_the_one_under_way(phase: Phase) -> None:
    async def main() -> None:
        flight = await reach(phase)
        flight.link.stuck.add("kill")
        flight.command("kill")
        await asyncio.sleep(0.01)
        assert flight.link.calls[-1] == "kill"
        await asyncio.sleep(0.1)
        assert flight.link.cancelled == [CALL_STOPPED[phase]]
        flight.link.release()
        assert (await flight.outcome()).how is X.KILLED

    run_simulated(main())


def test_a_kill_commanded_again_is_one_call_while_it_is_under_way_and_another_one_after_a_refusal() -> None:
    def again(flight: FakeFlight) -> None:
        flight.command("kill")
        flight.link.release()

    _, calls, outcome = fly_disturbed(P.KILLING, again)
    assert (calls, outcome.how) == ([], X.KILLED)

    def refused_once(flight: FakeFlight) -> None:
        flight.link.refused.add("kill")
        flight.command("kill")
        asyncio.get_running_loop().call_later(2.0, flight.link.refused.clear)
        asyncio.get_running_loop().call_later(2.1, flight.command, "kill")

    _, calls, outcome = fly_disturbed(P.FLYING, refused_once)
    assert (calls, outcome.how) == (["kill", *LAND, "kill"], X.KILLED)


def test_a_kill_after_the_end_is_carried_out_and_changes_no_outcome() -> None:
    async def main() -> None:
        flight = await reach(P.FLYING)
        outcome = await flight.outcome()
        flight.link.stuck.add("kill")
        flight.command("kill")
        await asyncio.sleep(0.1)
        flight.hear_peer_clock(0.0)  # with each message the core asks for the kill again, until it is done
        await asyncio.sleep(0.1)
        flight.link.release()
        await asyncio.sleep(1.0)
        assert flight.link.calls == [*FLOWN, "kill"]
        assert flight.link.cancelled == []
        assert outcome.how is X.LANDED

    run_simulated(main())


MODE_CHANGED: dict[Phase, tuple[list[str], FlightEnd]] = {
    # Until offboard is confirmed, and on the way down, the agent is not in offboard anyway.
    P.TAKE_OFF: (["start_offboard", *LAND], X.LANDED),
    P.ENTERING_OFFBOARD: (LAND, X.LANDED),
    P.LANDING: ([], X.OPERATOR),
    # Wherever the core steers, the pilot has the vehicle from the next tick on.
    P.FLYING: (["hand_over"], X.PILOT),
    P.RETURNING: (["hand_over"], X.PILOT),
    P.PILOT_OVERRIDE: ([], X.PILOT),
    # Offboard was asked for anew, and is confirmed.
    P.TAKING_BACK: (LAND, X.LANDED),
}


@pytest.mark.parametrize("phase", MODE_CHANGED)
def test_a_pilot_takes_over(phase: Phase) -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.link.change(mode=FlightMode.OTHER)
        flight.link.telemetry = True
        flight.link.release()

    flight, calls, outcome = fly_disturbed(phase, disturb)
    expected, ending = MODE_CHANGED[phase]
    assert steered(calls) == expected
    assert outcome.how is ending
    assert flight.heartbeat.signs[-1] == "ended"
    if ending is X.PILOT:
        assert "send" not in calls
        assert flight.link.status.armed, "left in the air to the pilot"
        assert flight.statuses[-1].tactic is Tactic.PILOT_OVERRIDE, "the peers keep clear of it"
        mode = "other" if phase is not P.PILOT_OVERRIDE else "hold"
        assert f"'{mode}'" in outcome.reason


def last_report(flight: FakeFlight) -> VehicleReport:
    report = decode(flight.bus.payloads(REPORT_TOPIC)[-1])
    assert isinstance(report, VehicleReport)
    return report


LINK_LOST: dict[Phase, tuple[list[str], FlightEnd]] = {
    P.COMPARING_CLOCKS: (["take_off"], X.LOST),
    P.TAKE_OFF: (LAND, X.LOST),
    P.FLYING: (LAND, X.LOST),
    P.LANDING: ([], X.LOST),
    P.KILLING: (LAND, X.LOST),
    P.PILOT_OVERRIDE: ([], X.PILOT),
    P.TAKING_BACK: (["hand_over"], X.PILOT),
}


@pytest.mark.parametrize("phase", LINK_LOST)
def test_the_link_is_lost(phase: Phase) -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.link.lose()
        flight.link.release()

    flight, calls, outcome = fly_disturbed(phase, disturb)
    expected, ending = LINK_LOST[phase]
    assert steered(calls) == expected
    assert outcome.how is ending
    assert outcome.flew is (phase is not P.COMPARING_CLOCKS)
    assert last_report(flight).unaccounted_m is not None, "a take-off was requested: nobody knows where it is"
    assert flight.heartbeat.signs[-1] == "ended"


def test_where_a_vehicle_was_last_that_is_unaccounted_for_at_the_end() -> None:
    """Of a link that is lost, of motors cut in the air and of a landing that does not come; of no other end."""

    def lose(flight: FakeFlight) -> None:
        flight.link.position_m = (3.0, -4.0, 8.5)
        asyncio.get_running_loop().call_later(1.0, flight.link.lose)

    def kill(flight: FakeFlight) -> None:
        flight.command("kill")
        flight.link.position_m = (3.0, -4.0, 8.5)

    def refuse(flight: FakeFlight) -> None:
        flight.link.refused |= {"land"}
        flight.link.position_m = (3.0, -4.0, 8.5)

    for disturb, older_s in ((lose, 1.0), (kill, 0.0), (refuse, 0.0)):
        flight, _, outcome = fly_disturbed(P.FLYING, disturb)
        report = last_report(flight)
        assert outcome.flew
        assert report.unaccounted_m == (3.0, -4.0, 8.5), disturb
        assert older_s <= (report.link_age_s or 0.0) < older_s + 40.0, disturb

    def pilot(flight: FakeFlight) -> None:
        flight.link.change(mode=FlightMode.OTHER)

    for phase, other in ((P.FLYING, lambda _flight: None), (P.FLYING, pilot), (P.COMPARING_CLOCKS, kill)):
        flight, *_ = fly_disturbed(phase, other)
        assert last_report(flight).unaccounted_m is None, other


def test_a_vehicle_without_telemetry_never_enters_offboard_and_lands_at_the_second_stop() -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.stop.request()
        asyncio.get_running_loop().call_later(5.0, flight.stop.request)

    _, calls, outcome = fly_disturbed(P.HOVERING, disturb)
    assert (calls, outcome.how) == (LAND, X.OPERATOR)


RESTARTED: dict[Phase, tuple[list[str], FlightEnd, bool]] = {
    P.TAKE_OFF: ([], X.REFUSED, False),
    P.ENTERING_OFFBOARD: ([], X.REFUSED, True),
    P.FLYING: (["hand_over"], X.PILOT, True),
    P.PILOT_OVERRIDE: ([], X.PILOT, True),
    P.CHECKING_ARMED: ([], X.OPERATOR, False),
}


@pytest.mark.parametrize("phase", RESTARTED)
def test_the_autopilot_restarts_and_is_disarmed(phase: Phase) -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.link.refused |= {"take_off", "start_offboard"}
        delay_s = 1.5 if phase is P.CHECKING_ARMED else 0.0  # once its arming has shown
        asyncio.get_running_loop().call_later(
            delay_s, lambda: flight.link.change(armed=False, mode=FlightMode.READY, restarts=1)
        )
        flight.link.release()

    _, calls, outcome = fly_disturbed(phase, disturb)
    expected, ending, flew = RESTARTED[phase]
    assert steered(calls) == expected
    assert (outcome.how, outcome.flew) == (ending, flew)
    assert ("restarted" in outcome.reason) is (ending is X.PILOT)


def test_a_refused_arming_ends_the_flight_on_the_ground() -> None:
    async def main() -> None:
        flight = FakeFlight()
        flight.link.refused.add("arm")
        await flight.begin()
        assert await flight.outcome() == Outcome(X.REFUSED, "refused to arm", "look at it", flew=False)
        assert flight.link.calls == ["take_off"]
        assert flight.heartbeat.signs == ["rising", "ended"]
        assert flight.events() == []

    run_simulated(main())


def test_a_take_off_that_is_refused_before_its_arming_is_reported_lands(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        monkeypatch.setitem(FakeLink.takes_s, "take_off", 0.5)
        flight = FakeFlight()
        flight.link.refused.add("take_off")
        await flight.begin()
        outcome = await flight.outcome()
        assert (outcome.how, outcome.reason) == (X.REFUSED, "refused to take_off")
        assert flight.link.calls == ["take_off", *LAND]
        assert not flight.link.status.armed

    run_simulated(main())


def test_a_vehicle_that_lands_takes_part_in_no_start_agreement() -> None:
    async def main() -> None:
        flight = await reach(P.AGREEING_START)
        flight.command("land")
        await flight.until(P.LANDING)
        flight.bus.published.clear()
        await flight.outcome()
        assert flight.bus.published
        sent = [decode(payload) for _, payload in flight.bus.published]
        assert not [each for each in sent if isinstance(each, StartProposal) and (each.ready or each.start_s)]

    run_simulated(main())


@pytest.mark.parametrize("armed", [False, True])
def test_an_arming_that_is_lost_before_take_off_ends_it_there_and_one_that_is_kept_lands(armed: bool) -> None:
    async def main() -> None:
        flight = FakeFlight()
        flight.link.refused.add("take_off")
        await flight.begin()
        await asyncio.sleep(2.0)
        assert flight.link.status.armed
        flight.link.change(armed=armed)
        outcome = await flight.outcome()
        assert (outcome.how, outcome.reason, outcome.flew) == (X.REFUSED, "refused to take_off", armed)
        assert flight.link.calls == ["take_off", *(LAND if armed else [])]

    run_simulated(main())


STOPPED_ONCE: dict[Phase, tuple[list[str], list[Event], FlightEnd]] = {
    P.COMPARING_CLOCKS: ([], [], X.OPERATOR),
    P.TAKE_OFF: (LAND, [Event.LAND], X.OPERATOR),
    P.HOVERING: (["start_offboard", *LAND], [Event.HOLD, Event.END, Event.LAND], X.OPERATOR),
    P.FLYING: (LAND, [Event.HOLD, Event.END, Event.LAND], X.OPERATOR),
    P.PILOT_OVERRIDE: ([], [Event.HOLD, Event.END], X.PILOT),
    P.TAKING_BACK: (LAND, [Event.HOLD, Event.END, Event.LAND], X.OPERATOR),
    P.LANDING: ([], [], X.OPERATOR),
}


@pytest.mark.parametrize("phase", STOPPED_ONCE)
def test_the_operator_stops_the_flight(phase: Phase) -> None:
    began = 0

    def disturb(flight: FakeFlight) -> None:
        nonlocal began
        began = len(flight.events())
        flight.stop.request()
        flight.link.telemetry = True
        flight.link.release()

    flight, calls, outcome = fly_disturbed(phase, disturb)
    expected, events, ending = STOPPED_ONCE[phase]
    assert steered(calls) == expected
    assert flight.events()[began:] == events
    assert outcome.how is ending
    if Event.HOLD in events:
        times_s = {item.event: time_s for time_s, item in flight.inputs if isinstance(item, TacticEvent)}
        assert times_s[Event.END] - times_s[Event.HOLD] == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize(
    ("phase", "expected", "ending"),
    [
        (P.TAKE_OFF, LAND, X.OPERATOR),
        (P.FLYING, LAND, X.OPERATOR),
        (P.TAKING_BACK, ["hand_over"], X.PILOT),
        (P.RETURNING, LAND, X.LANDED),
    ],
)
def test_the_operator_stops_the_flight_twice(phase: Phase, expected: list[str], ending: FlightEnd) -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.stop.request()
        flight.stop.request()

    flight, calls, outcome = fly_disturbed(phase, disturb)
    assert steered(calls) == expected
    assert outcome.how is ending
    assert flight.link.status.armed is (ending is X.PILOT)


@pytest.mark.parametrize("phase", [P.TAKE_OFF, P.ENTERING_OFFBOARD, P.FLYING, P.RETURNING])
def test_the_core_decides_to_land(phase: Phase) -> None:
    flight, calls, outcome = fly_disturbed(phase, lambda flight: flight.command("land"))
    assert steered(calls) == LAND
    assert outcome.how is (X.LANDED if phase is P.RETURNING else X.OPERATOR)
    assert flight.link.cancelled == {P.TAKE_OFF: ["take_off"], P.ENTERING_OFFBOARD: ["start_offboard"]}.get(phase, [])
    assert not flight.link.status.armed


def test_a_take_off_that_is_abandoned_before_it_arms_lands_nothing_but_waits_for_the_arming() -> None:
    async def main() -> None:
        flight = FakeFlight()
        flight.link.refused.add("arm")
        flight.link.stuck.add("take_off")
        await flight.begin()
        await flight.until(P.TAKE_OFF)
        await asyncio.sleep(0.5)
        asked_s = asyncio.get_running_loop().time()
        flight.stop.request()
        outcome = await flight.outcome()
        # Of these are 0.3 s for the last reports.
        assert asyncio.get_running_loop().time() - asked_s == pytest.approx(2.8, abs=0.1)
        assert (outcome.how, outcome.flew) == (X.OPERATOR, False)
        assert flight.link.calls == ["take_off"]

    run_simulated(main())


def test_a_pilot_and_a_decision_to_land_between_two_ticks_leave_the_vehicle_to_the_pilot() -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.link.change(mode=FlightMode.HOLD)
        flight.command("land")

    _, calls, outcome = fly_disturbed(P.FLYING, disturb)
    assert steered(calls) == ["hand_over"]
    assert outcome.how is X.PILOT


def test_offboard_is_requested_again_where_only_setpoints_were_lost() -> None:
    async def main() -> None:
        flight = await reach(P.FLYING)
        flight.link.stuck.add("start_offboard")
        before = len(flight.link.calls)
        flight.link.change(mode=FlightMode.LAND, lost=Connection.SETPOINTS)
        await asyncio.sleep(1.0)
        assert steered(flight.link.calls[before:]) == ["start_offboard"], "one request at a time"
        assert flight.agent.phase is P.FLYING
        flight.link.release()
        await asyncio.sleep(0.5)
        flight.link.change(lost=Connection.NONE)
        assert (await flight.outcome()).how is X.LANDED
        assert "hand_over" not in flight.link.calls

    run_simulated(main())


@pytest.mark.parametrize("changes", [{"lost": Connection.NONE}, {"armed": False}, {"in_air": False}])
def test_a_vehicle_that_left_offboard_otherwise_or_is_down_is_left_alone(changes: dict[str, object]) -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.link.change(**{"mode": FlightMode.LAND, "lost": Connection.SETPOINTS, **changes})

    _, calls, _ = fly_disturbed(P.FLYING, disturb)
    assert steered(calls) == ["hand_over"]


def test_resume_takes_the_vehicle_back_once_setpoints_flow() -> None:
    async def main() -> None:
        flight = await reach(P.PILOT_OVERRIDE)
        await asyncio.sleep(2.0)
        assert flight.link.calls[-1] == "hand_over"
        flight.command("resume")
        await flight.until(P.TAKING_BACK)
        began_s, before = asyncio.get_running_loop().time(), len(flight.link.calls)
        while "start_offboard" not in flight.link.calls[before:]:
            await asyncio.sleep(0.005)
        assert asyncio.get_running_loop().time() - began_s == pytest.approx(0.2, abs=0.02)  # two ticks
        await flight.until(P.FLYING)
        assert (await flight.outcome()).how is X.LANDED
        back = ["hand_over", "take_back", "send", "start_offboard", "send", *LAND]
        assert flight.link.calls == [*FLOWN[:4], *back]

    run_simulated(main())


def test_a_refused_resume_leaves_the_vehicle_to_the_pilot() -> None:
    def disturb(flight: FakeFlight) -> None:
        flight.link.refused.add("start_offboard")
        flight.command("resume")

    _, calls, outcome = fly_disturbed(P.PILOT_OVERRIDE, disturb)
    assert calls == ["take_back", "send", "start_offboard", "send", "hand_over"]
    assert (outcome.how, outcome.reason) == (X.PILOT, "refused to start_offboard")


def test_the_start_is_agreed_on_while_a_pilot_has_the_vehicle() -> None:
    async def main() -> None:
        flight = await reach(P.AGREEING_START)
        flight.link.change(mode=FlightMode.HOLD)
        await flight.until(P.PILOT_OVERRIDE)
        flight.bus.deliver(StartProposal(2, flight.clock.now_s(), flight.clock.now_s() + 2.0))
        await asyncio.sleep(3.0)
        assert [item for _, item in flight.inputs if isinstance(item, Start)] == [Start(flight.agent.start_s or 0.0)]
        assert flight.agent.phase is P.PILOT_OVERRIDE
        flight.command("resume")
        await flight.until(P.FLYING)
        assert (await flight.outcome()).how is X.LANDED

    run_simulated(main())


def test_a_vehicle_that_is_held_on_its_way_up_holds_in_offboard() -> None:
    flight, calls, outcome = fly_disturbed(P.TAKE_OFF, lambda flight: flight.command("hold"))
    assert steered(calls) == ["start_offboard", *LAND]
    assert outcome.how is X.LANDED
    assert {status.tactic for status in flight.statuses} == {
        Tactic.STANDBY,
        Tactic.HOLD,
        Tactic.RETURN_AND_LAND,
        Tactic.LAND,
    }


def test_a_vehicle_held_on_its_way_back_goes_on_when_it_is_sent_to_its_mission() -> None:
    flight, calls, outcome = fly_disturbed(P.RETURNING, lambda flight: flight.command("resume"))
    assert steered(calls) == LAND
    assert outcome.how is X.LANDED
    assert flight.events() == [Event.END, Event.END, Event.LAND]
    assert flight.agent.ended_s == pytest.approx((flight.agent.start_s or 0.0) + DURATION_S + 1e-3, abs=1e-6)


@pytest.mark.parametrize("refused", [{"stop_offboard"}, {"stop_offboard", "land"}])
def test_a_refused_landing(refused: set[str]) -> None:
    flight, calls, outcome = fly_disturbed(P.FLYING, lambda flight: flight.link.refused.update(refused))
    assert steered(calls) == LAND
    assert (outcome.how, outcome.reason, outcome.flew) == (
        X.REFUSED,
        f"refused to {max(refused, key=LAND.index)}",
        True,
    )
    assert flight.heartbeat.signs[-1] == "ended"


def test_other_clocks_are_refused_on_the_ground() -> None:
    _, calls, outcome = fly_disturbed(P.COMPARING_CLOCKS, lambda flight: flight.hear_peer_clock(0.8))
    assert (calls, outcome.how, outcome.flew) == ([], X.REFUSED, False)


def test_a_peer_that_never_comes_ends_the_flight_where_the_vehicle_hovers() -> None:
    flight, calls, outcome = fly_disturbed(P.AGREEING_START, lambda flight: None)
    assert steered(calls) == LAND
    assert (outcome.how, "2" in outcome.reason) == (X.REFUSED, True)
    assert flight.events() == [Event.LAND]
    assert flight.agent.ended_s is None


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("take_off", ["take_off", *LAND]),
        ("stop_offboard", ["take_off", "start_offboard", "stop_offboard"]),
        ("land", ["take_off", "start_offboard", *LAND]),
    ],
)
def test_a_bug_in_a_call_brings_the_vehicle_down_or_leaves_it_to_the_supervisor(call: str, expected: list[str]) -> None:
    async def main() -> None:
        flight = FakeFlight()
        flight.link.broken.add(call)
        await flight.begin(5.0)
        with pytest.raises(ZeroDivisionError):
            await flight.outcome()
        assert steered(flight.link.calls) == expected
        assert ("ended" in flight.heartbeat.signs) is (expected[-1] == "land" != call)

    run_simulated(main())


BUG: dict[Phase, list[str]] = {
    P.TAKE_OFF: LAND,
    P.FLYING: LAND,
    P.PILOT_OVERRIDE: [],
    P.TAKING_BACK: ["hand_over"],
    P.LANDING: [],
}


@pytest.mark.parametrize("phase", BUG)
@pytest.mark.parametrize("how", ["tick", "cancelled"])
def test_a_bug_in_the_core_or_a_cancelled_flight_brings_the_vehicle_down(
    phase: Phase, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        flight = await reach(phase)
        before = len(flight.link.calls)

        def crash(_now_s: float) -> None:
            raise ZeroDivisionError

        assert flight.task is not None
        if how == "tick":
            monkeypatch.setattr(flight.core, "tick", crash)
        else:
            flight.task.cancel()
        with pytest.raises(ZeroDivisionError if how == "tick" else asyncio.CancelledError):
            await flight.outcome()
        assert steered(flight.link.calls[before:]) == BUG[phase]
        # A landing that was broken off is the supervisor's.
        assert (flight.heartbeat.signs[-1] == "ended") is not (phase is P.LANDING and how == "cancelled")

    run_simulated(main())


def test_a_bug_in_the_core_does_not_prevent_the_landing(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        flight = await reach(P.FLYING)
        take = flight.core.take

        def crash(item: ReceivedInput) -> None:
            if item == TacticEvent(Event.LAND):
                raise ZeroDivisionError
            take(item)

        monkeypatch.setattr(flight.core, "take", crash)
        flight.stop.request()
        with pytest.raises(ZeroDivisionError):
            await flight.outcome()
        assert flight.link.calls == FLOWN
        assert flight.heartbeat.signs == ["rising", "tick", "ended"]

    run_simulated(main())


async def _waiting(start_blockers: str) -> FakeFlight:
    flight = FakeFlight(PAIR)
    await flight.agent.connect()
    flight.agent.announce()
    flight.agent.wait_on_ground(start_blockers)
    return flight


def _order(flight: FakeFlight, verb: Verb) -> list[str]:
    """Give an operator's command over the bus; return what is answered before anything else happens."""
    before = len(flight.bus.published)
    flight.bus.deliver(OperatorCommand(flight.clock.now_s(), verb, None, "anna", before))
    sent = (decode(payload) for _, payload in flight.bus.published[before:])
    return [each.did for each in sent if isinstance(each, CommandAnswer)]


def test_on_the_ground_an_operator_is_answered_at_once_and_starts_what_lacks_nothing() -> None:
    async def story() -> None:
        flight = await _waiting("battery: 12 %")
        assert _order(flight, "start") == ["refused: battery: 12 %"]
        flight.hear_peer_clock(3.0)
        flight.agent.wait_on_ground("")
        (refused,) = _order(flight, "start")
        assert "clock" in refused
        await asyncio.sleep(2.0)
        report = decode(flight.bus.payloads(REPORT_TOPIC)[-1])
        assert isinstance(report, VehicleReport)
        assert "clock" in (report.start_blockers or "")
        assert report.clock_off_s == pytest.approx(3.0, abs=0.1)
        assert not flight.agent.started.is_set()
        assert flight.link.calls == []
        await flight.agent.close()

    run_simulated(story())


def test_what_was_started_flies_and_no_longer_reports_that_it_waits() -> None:
    async def story() -> None:
        flight = await _waiting("")
        assert _order(flight, "start") == ["takes off"]
        assert flight.agent.started.is_set()
        await flight.begin()
        await flight.until(P.TAKE_OFF)
        await asyncio.sleep(1.5)
        report = decode(flight.bus.payloads(REPORT_TOPIC)[-1])
        assert isinstance(report, VehicleReport)
        assert report.start_blockers is None
        flight.stop.request()
        await flight.outcome()

    run_simulated(story())


def test_motors_that_are_cut_on_the_ground_end_the_wait() -> None:
    async def story() -> None:
        flight = await _waiting("")
        assert _order(flight, "kill") == ["cuts the motors"]
        assert flight.agent.started.is_set()
        await flight.begin()
        assert (await flight.outcome()).how is X.KILLED
        assert flight.link.calls == ["kill"]

    run_simulated(story())


def aloft(mode: FlightMode, config: AgentConfig = ALONE) -> FakeFlight:
    """Return a vehicle that is in the air, 12 m high, in a flight mode."""
    flight = FakeFlight(config)
    flight.link.position_m = (30.0, 5.0, 12.0)
    flight.link.change(armed=True, in_air=True, mode=mode)
    return flight


async def begin(flight: FakeFlight, life: Coroutine[Any, Any, Outcome]) -> None:
    await flight.agent.connect()
    flight.agent.announce()
    flight.task = asyncio.create_task(life)


def test_a_vehicle_that_is_in_the_air_is_held_where_it_is_and_landed() -> None:
    async def main() -> None:
        flight = aloft(FlightMode.HOLD)
        await begin(flight, flight.agent.recover((1,), 3.0, flight.stop))
        await flight.until(P.FLYING)
        assert {status.tactic for status in flight.statuses[1:]} == {Tactic.HOLD}
        assert await flight.outcome() == Outcome(X.LANDED, flew=True)
        assert flight.link.calls == ["send", "start_offboard", "send", *LAND]
        assert flight.heartbeat.signs == ["rising", "tick", "ended"]
        assert flight.events() == [Event.ADOPT, Event.END, Event.LAND]

    run_simulated(main())


def test_those_that_are_recovered_together_wait_for_each_other_and_for_nobody_else() -> None:
    async def main() -> None:
        waits, alone = aloft(FlightMode.HOLD, PAIR), aloft(FlightMode.HOLD, PAIR)
        for flight, together in ((waits, (1, 2)), (alone, (1,))):
            await begin(flight, flight.agent.recover(together, 3.0, flight.stop))
        await alone.outcome()
        assert waits.agent.phase is P.AGREEING_START
        waits.stop.request()
        assert (await waits.outcome()).how is X.OPERATOR

    run_simulated(main())


def test_a_vehicle_in_the_air_that_refuses_offboard_lands_where_it_is() -> None:
    async def main() -> None:
        flight = aloft(FlightMode.RETURN)
        flight.link.refused.add("start_offboard")
        await begin(flight, flight.agent.recover((1,), 3.0, flight.stop))
        outcome = await flight.outcome()
        assert (outcome.how, outcome.flew) == (X.REFUSED, True)
        assert flight.link.calls == ["send", "start_offboard", "send", *LAND]

    run_simulated(main())


def test_a_vehicle_that_its_pilot_flies_is_sent_nothing_and_its_state_goes_to_the_peers() -> None:
    async def main() -> None:
        flight = aloft(FlightMode.OTHER, PAIR)
        await begin(flight, flight.agent.accompany(flight.stop))
        await flight.until(P.PILOT_OVERRIDE)
        flight.command("resume")
        await asyncio.sleep(20.0)
        assert flight.agent.phase is P.PILOT_OVERRIDE
        states = [decode(each) for each in flight.bus.payloads(TOPICS[MemberState].name)]
        assert len(states) > 20
        assert all(isinstance(each, MemberState) and each.tactic == "pilot override" for each in states)
        flight.stop.request()
        flight.stop.request()
        assert (await flight.outcome()).how is X.PILOT
        assert flight.link.calls == ["hand_over"]
        assert flight.heartbeat.signs == ["rising", "tick", "ended"]

    run_simulated(main())
