"""Who left formation or ring not by order: tracks written here, and flights whose reason to leave is injected."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import tau

import numpy as np
import pytest
from msgspec import structs

from agents.core import VehicleCore
from agents.flight_end import FlightEnd
from agents.inputs import AutopilotStatus, Command, ReceivedInput, TacticEvent
from agents.notes import AlertChange, CommandOutcome, TacticChange
from agents.ports import VehicleStatus
from agents.settings.config import AgentConfig
from agents.tactics import NO_TACTIC, Event
from agents.team.messages import OperatorCommand
from agents.team.verbs import Verb
from gcs.flight import simulated
from gcs.metrics.departures import NO_DATA, Departure, departures, departures_line
from gcs.metrics.ending import VehicleEnding
from gcs.metrics.metrics import evaluate, evaluated
from gcs.metrics.record import FlightEvent, FlightRecord, LoopStatistics, VehicleTrack
from gcs.metrics.references import DesiredRing, FormationReference
from gcs.metrics.result import FlightResult
from gcs.metrics.ring import LOST_AFTER_S
from gcs.mission.file import load_mission
from tests.support.report_evidence import TOLERANCES

TIME_S = np.arange(1001) / 10.0
RADIUS_M, RATE_RAD_S = 10.0, 0.1
STALE = AlertChange("target stale", "for 10 s", "hold")


def track(vehicle_id: int, *tactics: tuple[float, str], count: int = 3) -> VehicleTrack:
    """A vehicle that circles evenly spaced about the origin, with these tactics from these times on."""
    angle = tau * vehicle_id / count + RATE_RAD_S * TIME_S
    position_m = RADIUS_M * np.column_stack((np.cos(angle), np.sin(angle)))
    velocity_m_s = RADIUS_M * RATE_RAD_S * np.column_stack((-np.sin(angle), np.cos(angle)))
    tactic = np.full(TIME_S.size, "encircle", dtype="<U16")
    for from_s, name in tactics:
        tactic[from_s - 1e-9 <= TIME_S] = name
    return VehicleTrack(vehicle_id, position_m, velocity_m_s, tactic)


def record(*tracks: VehicleTrack, events: tuple[FlightEvent, ...] = (), **ended: str) -> FlightRecord:
    still = np.zeros((TIME_S.size, 2))
    endings = tuple(
        VehicleEnding(track.vehicle_id, FlightEnd(how), "why") for track in tracks for how in ended.values()
    )
    loop = LoopStatistics(10.0, 1, 0)
    return FlightRecord(
        "ring", 0, "simulation", "truth", TIME_S, still, still, tracks, loop, 1.0, events=events, endings=endings
    )


def judged(flown: FlightRecord) -> FlightResult:
    return evaluate(flown, DesiredRing(RADIUS_M, RATE_RAD_S), FormationReference(0.0, {}), TOLERANCES)


def alert(vehicle_id: int, at_s: float, change: AlertChange = STALE) -> FlightEvent:
    return FlightEvent(at_s, vehicle_id, "failsafe", change.text, alert=change)


def test_two_that_stay_evenly_spaced_do_not_hide_a_third_that_a_failsafe_took_away() -> None:
    """Vehicle 3 leaves a ring of three at 30 s; at once the others are half a turn apart, as two should be."""
    pair = [track(1, count=2), track(2, count=2)]
    third = track(3, (30.0, "hold"), count=4)
    result = judged(record(*pair, third, events=(alert(3, 30.0),)))
    assert result.departures == (Departure(3, 30.0, "ring", "target stale"),)
    assert (result.verdicts.c1, result.verdicts.c2, result.verdicts.c3) == (True, True, True)
    assert (result.verdicts.kept, result.passes, result.all_hold) == (False, False, False)
    assert result.ring.members_min == 2
    ordered = judged(record(*pair, third))
    assert (ordered.departures, ordered.verdicts.kept, ordered.all_hold) == ((), True, True)


@pytest.mark.parametrize(("silent_s", "back_at_s"), [(9.0, None), (9.0, 70.0), (4.0, None)])
def test_one_that_was_silent_and_is_elsewhere_afterwards_has_left(silent_s: float, back_at_s: float | None) -> None:
    """The process that flew it was killed, and another one brings it home, from where it may join again."""
    then = () if back_at_s is None else ((50.0, "land"), (52.0, NO_TACTIC), (back_at_s, "encircle"))
    third = track(3, (30.0, NO_TACTIC), (30.0 + silent_s, "hold"), (42.0, "return and land"), *then)
    left = Departure(3, 29.9, "ring", NO_DATA, back_at_s)
    assert departures(record(track(1), track(2), third)) == ((left,) if silent_s > LOST_AFTER_S else ())


def test_a_vehicle_that_left_and_came_back_has_left() -> None:
    away = track(1, (30.0, "aside"), (40.0, "formation"), (50.0, "encircle"))
    (found,) = departures(record(away)) or ()
    assert found == Departure(1, 30.0, "ring", "aside", back_at_s=50.0)
    assert judged(record(away)).verdicts.kept is False


def test_in_formation_it_is_the_same() -> None:
    for tactic, cause in (("pilot override", "pilot override"), ("hold", "target stale")):
        left = track(1, (0.0, "formation"), (20.0, tactic))
        flown = record(left, events=(alert(1, 20.0),) if tactic == "hold" else ())
        assert departures(flown) == (Departure(1, 20.0, "formation", cause),)
    assert departures(record(track(1, (0.0, "standby")))) is None
    assert departures(record(track(1, (0.0, "excite"), (20.0, "hold")))) is None


def test_an_alert_takes_away_only_its_own_vehicle_at_its_time_and_by_its_reaction(subtests: pytest.Subtests) -> None:
    others = {
        "another vehicle's": alert(2, 30.0),
        "earlier": alert(1, 29.0),
        "later": alert(1, 31.0),
        "flown on with": alert(1, 30.0, AlertChange("link degraded", "40 %", "fly on and report")),
        "over": alert(1, 30.0, AlertChange("target stale", is_over=True)),
        "of a peer that flies on": alert(1, 30.0, AlertChange("link degraded")),
    }
    flown = record(track(1, (30.0, "hold")))
    for name, event in others.items():
        with subtests.test(name):
            assert departures(replace(flown, events=(event,))) == ()
    for change in (STALE, AlertChange("target stale"), AlertChange("late ticks", "5", "step aside")):
        with subtests.test(change.text):
            (found,) = departures(replace(flown, events=(alert(1, 30.0, change),))) or ()
            assert found.cause == change.condition
    with subtests.test("of a log that holds texts only"):
        text = FlightEvent(30.0, 1, "failsafe", "alert: target stale")
        (found,) = departures(replace(flown, events=(text,))) or ()
        assert found.cause == "alert: target stale"


def silent(flown: VehicleTrack, from_s: float, to_s: float = 101.0) -> VehicleTrack:
    missing = (from_s - 1e-9 <= TIME_S) & (to_s - 1e-9 > TIME_S)
    return replace(flown, tactic=np.where(missing, "unknown", flown.tactic))


def test_a_vehicle_of_which_nothing_more_is_known_has_not_stayed() -> None:
    assert departures(record(track(1), silent(track(2), 60.0))) == (Departure(2, 59.9, "ring", NO_DATA),)
    assert departures(record(track(1), silent(track(2), 97.0))) == ()
    assert departures(record(track(1), silent(track(2), 40.0, 60.0))) == ()
    returns = FlightEvent(60.1, 2, "tactic", "encircle -> return and land: end")
    assert departures(record(track(1), silent(track(2), 60.0), events=(returns,))) == ()


def test_a_flight_that_ended_in_its_place_is_not_kept_unless_by_order(subtests: pytest.Subtests) -> None:
    ordered = {"landed", "simulated", "operator", "aborted", "killed", "unknown", "flies on"}
    for how in FlightEnd:
        with subtests.test(how=how):
            flown = record(track(1), ended=how.value)
            assert bool(departures(flown)) is (how.value not in ordered)
            at_the_end = FlightEvent(100.05, 1, "tactic", "encircle -> return and land: end")
            assert departures(replace(flown, events=(at_the_end,))) == ()
    assert departures(record(track(1), ended="in flight")) == (Departure(1, 100.0, "ring", "why"),)


def fallen_silent(vehicle_id: int, at_s: float) -> VehicleEnding:
    return VehicleEnding(vehicle_id, FlightEnd.LOST, "fell silent", joined=True, heard_s=at_s)


@pytest.mark.parametrize(
    ("tactics", "at_s", "place"),
    [
        ((), 60.0, "ring"),
        (((0.0, "standby"),), 60.0, "flight"),
        (((50.0, "hold"),), 60.0, "flight"),
        ((), 130.0, "flight"),
    ],
)
def test_one_that_joined_and_fell_silent_in_the_air_left_once_wherever_it_was(
    tactics: tuple[tuple[float, str], ...], at_s: float, place: str
) -> None:
    """Also on its way home, after the mission's end, and held by an operator."""
    fourth = silent(track(4, *tactics), at_s) if at_s < 100.0 else track(4, *tactics)
    result = judged(replace(record(track(1), fourth), endings=(fallen_silent(4, at_s),)))
    assert result.departures == (Departure(4, at_s, place, "fell silent"),)
    assert (result.verdicts.kept, result.ended_early) == (False, True)
    line = departures_line(result.departures)
    assert line == f"vehicle 4 left the {place} at {at_s:.1f} s (fell silent)"


def test_one_that_joined_and_landed_or_still_flies_fails_nothing() -> None:
    for how, at_s in ((FlightEnd.LANDED, 60.0), (FlightEnd.FLIES_ON, 99.0)):
        home = silent(track(4, (50.0, "return and land"), (55.0, "land")), at_s)
        flown = replace(record(track(1), home), endings=(VehicleEnding(4, how, "", joined=True, heard_s=at_s),))
        assert departures(flown) == ()
        assert not judged(flown).ended_early


def test_a_vehicle_that_its_dead_supervisor_or_an_error_landed_did_not_leave_by_order(
    subtests: pytest.Subtests,
) -> None:
    """The shell lands it, so no alert says why; the same is by order where an operator or the mission says so."""
    held = CommandOutcome("hold", "pat", "holds")
    orders = {
        "nothing": None,
        "a command": FlightEvent(50.0, 1, "command", held.text, command=held),
        "the mission's end": FlightEvent(50.0, 1, "tactic", "", tactic=TacticChange("encircle", "land", "end")),
    }
    for how in ("watchdog", "operator"):
        for name, event in orders.items():
            with subtests.test(how=how, because=name):
                flown = record(track(1, (50.0, "land")), events=(event,) if event else (), ended=how)
                by_order = how == "operator" or event is not None
                assert departures(flown) == (() if by_order else (Departure(1, 50.0, "ring", "why"),))
    refused = structs.replace(held, is_refused=True)
    flown = record(
        track(1, (50.0, "land")), events=(FlightEvent(50.0, 1, "command", "", command=refused),), ended="error"
    )
    assert departures(flown)


def test_those_that_left_alike_are_named_together() -> None:
    found = [Departure(i, at_s, "ring", "target stale") for i, at_s in ((1, 30.0), (3, 31.5))]
    assert departures_line(found) == "vehicles 1 and 3 left the ring from 30.0 to 31.5 s (target stale)"
    back = [Departure(2, 50.0, "formation", "too close", 55.0)]
    assert departures_line(back) == "vehicle 2 left the formation at 50.0 s (too close), back at 55.0 s"
    assert (departures_line(()), departures_line(None)) == ("no vehicle left its place", "")


# Real agents, with the reason to leave injected


LEAVES_S = 12.0
HEALTHY = VehicleStatus(connected=True, armed=True, in_air=True, battery=0.9, local_position_ok=True, armable=True)


def received(item: ReceivedInput, _now_s: float) -> ReceivedInput:
    return item


def command(verb: Verb) -> Callable[[float], ReceivedInput]:
    return lambda now_s: Command(now_s, OperatorCommand(now_s, verb, 2, "pat", 7))


@pytest.fixture
def flown(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[float], ReceivedInput]], FlightResult]:
    """Return a function that flies three vehicles onto a ring, and gives an input to vehicle 2 at 12 s."""
    cores: list[VehicleCore] = []

    def new_core(config: AgentConfig, planner: None) -> VehicleCore:
        cores.append(VehicleCore(config, planner))
        return cores[-1]

    def fly(given: Callable[[float], ReceivedInput]) -> FlightResult:
        mission = load_mission("case2", {"target.start_m": [8.0, 0.0]})
        cores.clear()
        monkeypatch.setattr(simulated, "VehicleCore", new_core)

        def on_tick(tick: int, vehicle: int, _output: object) -> None:
            if vehicle == 1 and tick == round(LEAVES_S * mission.mission.rate_hz):
                cores[1].take(given(LEAVES_S))

        return evaluated(mission, simulated.fly_simulated(mission, 0, 2.0 * LEAVES_S, lambda _: None, on_tick=on_tick))

    return fly


@pytest.mark.slow
def test_what_an_operator_or_the_mission_orders_is_kept(
    flown: Callable[[Callable[[float], ReceivedInput]], FlightResult], subtests: pytest.Subtests
) -> None:
    verbs: tuple[Verb, ...] = ("hold", "kill")
    orders = {verb: command(verb) for verb in verbs} | {"the mission's end": partial(received, TacticEvent(Event.END))}
    for name, given in orders.items():
        with subtests.test(name):
            result = flown(given)
            assert result.vehicles[1].engaged_at_s is not None
            assert result.vehicles[1].tactic != "encircle"
            assert (result.departures, result.verdicts.kept) == ((), True)
            assert result.ring.members_min == 2


@pytest.mark.slow
def test_what_a_failsafe_or_a_pilot_takes_away_is_not(
    flown: Callable[[Callable[[float], ReceivedInput]], FlightResult], subtests: pytest.Subtests
) -> None:
    reported = {
        "tilt too large": structs.replace(HEALTHY, tilt_deg=50),
        "battery low": structs.replace(HEALTHY, battery=0.15),
    }
    for condition, status in reported.items():
        with subtests.test(condition):
            result = flown(partial(received, AutopilotStatus(status)))
            (found,) = result.departures or ()
            assert (found.vehicle, found.place, found.cause) == (2, "ring", condition)
            assert LEAVES_S < found.at_s < LEAVES_S + 10.0
            assert result.verdicts.kept is False
    with subtests.test("pilot"):
        result = flown(partial(received, TacticEvent(Event.HANDED_OVER)))
        (found,) = result.departures or ()
        assert (found.vehicle, found.cause, result.verdicts.kept) == (2, "mode changed", False)
