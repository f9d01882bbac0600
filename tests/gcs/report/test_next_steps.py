"""What to do after a flight follows from its end, its verdicts, its alerts, its plants and its late ticks."""

from dataclasses import replace

import pytest

from agents.flight_end import FlightEnd
from agents.notes import AlertChange
from gcs.console.advice import advice
from gcs.metrics.catalogue import Verdicts
from gcs.metrics.departures import Departure
from gcs.metrics.ending import TeamEnding
from gcs.metrics.record import FlightEvent
from gcs.metrics.references import EngagementResult
from gcs.metrics.result import FlightResult, PlantResult
from gcs.report.evidence.flight import FlightEvidence
from gcs.report.flight_page import alert_table, next_steps
from tests.support.report_evidence import flown

HELD = Verdicts(True, True, True, True, True, True, True)


@pytest.fixture(scope="module")
def flight() -> tuple[FlightEvidence, FlightResult]:
    """A flight of which nothing is to be corrected."""
    evidence, result, _ = flown(3, duration_s=120.0, rate_hz=5.0)
    return replace(evidence, logs=("flight one.mcap",)), replace(result, verdicts=HELD)


def test_a_flight_in_which_all_held_needs_no_step(flight: tuple[FlightEvidence, FlightResult]) -> None:
    evidence, result = flight
    assert next_steps(result, evidence) == ()


def test_every_early_end_has_a_step_and_names_its_vehicles(
    flight: tuple[FlightEvidence, FlightResult], subtests: pytest.Subtests
) -> None:
    evidence, result = flight
    for how in FlightEnd:
        with subtests.test(how=how):
            ending = TeamEnding(how, "Why.", (2, 3))
            steps = next_steps(replace(result, ended=ending), evidence)
            assert len(steps) == (1 if ending.is_early else 0)
            assert all(step.text.startswith("Vehicles 2 and 3: ") for step in steps)


def test_a_verdict_that_fails_leads_to_the_decisions_of_the_vehicle_that_was_worst(
    flight: tuple[FlightEvidence, FlightResult],
) -> None:
    evidence, result = flight
    vehicles = [replace(each, radius_error_rms_m=0.1 * each.id) for each in result.vehicles]
    vehicles[1] = replace(vehicles[1], radius_error_rms_m=5.0)
    failed = replace(result, vehicles=tuple(vehicles), verdicts=replace(HELD, c1=False, c3=False))
    (step,) = next_steps(failed, evidence)
    assert "C1 and C3 fail" in step.text
    assert step.command == "cordon replay 'flight one.mcap' --explain 2"
    moved = replace(failed, ring=replace(failed.ring, unsettled_at_s=81.25))
    assert "81.2 s" in next_steps(moved, evidence)[0].text


def test_vehicles_that_did_not_engage_or_came_too_close_come_first(flight: tuple[FlightEvidence, FlightResult]) -> None:
    evidence, result = flight
    failed = replace(
        result,
        verdicts=replace(HELD, c2=False, separation=False, engaged=False),
        engagement=EngagementResult((1, 2, 3), (1, 2)),
    )
    close, missing, settled = next_steps(failed, evidence)
    assert "too close" in close.text
    assert "Vehicle 3 did not engage" in missing.text
    assert missing.command.endswith("--explain 3")
    assert settled.text.startswith("C2 fails")


def test_vehicles_that_left_alike_are_one_step_and_what_was_not_judged_is_flown_for_longer(
    flight: tuple[FlightEvidence, FlightResult],
) -> None:
    evidence, result = flight
    left = tuple(Departure(vehicle, 50.0, "ring", "target stale") for vehicle in (3, 1))
    failed = replace(result, departures=left, verdicts=replace(HELD, c1=None, kept=False), not_judged=("C1",))
    (step,) = next_steps(failed, evidence)
    assert "Vehicles 1 and 3 left formation or ring (target stale)" in step.text
    assert step.command.endswith("--explain 3"), "the first to leave"
    (step,) = next_steps(replace(result, verdicts=replace(HELD, c1=None), not_judged=("C1",)), evidence)
    assert step.text == "C1 could not be judged: fly for longer."


def test_a_plant_that_is_invalid_is_to_be_identified_again(flight: tuple[FlightEvidence, FlightResult]) -> None:
    evidence, result = flight
    plants = tuple(
        PlantResult(each, "px4", "valid" if each == 2 else "stiffer", "residual", "latency") for each in (1, 2, 3)
    )
    (step,) = next_steps(replace(result, mission="my team.toml"), replace(evidence, plants=plants))
    assert "vehicles 1 and 3" in step.text
    assert step.command == "cordon excite 'my team.toml'"


@pytest.mark.parametrize(("speed", "advised"), [(1.0, "fewer vehicles"), (10.0, "--speed below 10")])
def test_late_ticks_are_reported_with_what_helps_at_that_speed(
    flight: tuple[FlightEvidence, FlightResult], speed: float, advised: str
) -> None:
    evidence, result = flight
    late = replace(result, loop=replace(result.loop, ticks=900, missed=100))
    (step,) = next_steps(late, replace(evidence, speed=speed))
    assert "100 of 1000 ticks" in step.text
    assert advised in step.text
    few = replace(result, loop=replace(result.loop, ticks=900, missed=9))
    assert next_steps(few, evidence) == ()


def test_the_alerts_of_a_flight_stand_with_what_to_do_about_each(flight: tuple[FlightEvidence, FlightResult]) -> None:
    _, result = flight
    stale = AlertChange("telemetry stale", "", "hold")
    events = tuple(
        FlightEvent(time_s, vehicle_id, "failsafe", change.text, alert=change)
        for time_s, vehicle_id, change in (
            (10.0, 3, stale),
            (12.0, 1, stale),
            (15.0, 3, AlertChange("telemetry stale", is_over=True)),
            (20.0, 2, AlertChange("battery low", "18 %", "return and land")),
        )
    )
    assert alert_table(replace(result, events=events)).rows == (
        ("telemetry stale", "1, 3", advice("telemetry stale"), "10.0"),
        ("battery low", "2", advice("battery low"), "20.0"),
    )
