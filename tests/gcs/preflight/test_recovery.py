"""What is done with each vehicle of a team in the air, from facts built by hand."""

from dataclasses import replace

import pytest
from msgspec import structs

from agents.ports import FlightMode, VehicleStatus
from gcs.autopilots import ardupilot, px4, registry
from gcs.errors import InputError
from gcs.flight.plan import FlightPlan, TeamRecovery
from gcs.flight.recovery import HOLDS_S, homeward
from gcs.mission.file import load_mission
from gcs.preflight.findings import Grade, VehicleFacts
from gcs.preflight.recovery import FAR_M, Standing, Treatment, standings

CASE2 = load_mission("case2")
FENCE_M = ((-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0))
ALOFT = VehicleFacts(
    vehicle_id=2,
    autopilot=px4.AUTOPILOT,
    multicopter=True,
    status=VehicleStatus(connected=True, armed=True, in_air=True, mode=FlightMode.HOLD, battery=0.8),
    origin_m=(0.0, 0.0, 0.0),
    position_m=(20.0, 5.0, 8.0),
)


def with_status(**changes: object) -> VehicleFacts:
    return replace(ALOFT, status=structs.replace(ALOFT.status, **changes))


def judged(facts: VehicleFacts, *, taken: bool = False) -> Standing:
    (standing,) = standings(CASE2, [facts], (2,) if taken else ())
    assert standing.vehicle_id == standing.finding.about == 2
    return standing


@pytest.mark.parametrize(
    "mode", [FlightMode.HOLD, FlightMode.OFFBOARD, FlightMode.LAND, FlightMode.RETURN, FlightMode.TAKE_OFF]
)
def test_one_that_its_autopilot_holds_lands_or_returns_is_taken(mode: FlightMode) -> None:
    standing = judged(with_status(mode=mode))
    assert (standing.treatment, standing.finding.grade) == (Treatment.TAKE, Grade.PASS)
    assert all(each in standing.finding.found for each in (mode.value, "20.6 m", "height 8.0 m", "80%"))


@pytest.mark.parametrize("mode", [FlightMode.OTHER, FlightMode.UNKNOWN, FlightMode.READY])
def test_one_that_a_pilot_may_fly_is_taken_only_at_the_word(mode: FlightMode) -> None:
    kept, taken = judged(with_status(mode=mode)), judged(with_status(mode=mode), taken=True)
    assert (kept.treatment, taken.treatment) == (Treatment.ACCOMPANY, Treatment.TAKE)
    assert kept.finding.grade is taken.finding.grade is Grade.WARNING
    assert "--take-from-pilot 2" in kept.finding.next_step
    silent = replace(ALOFT, mode_received=False)
    assert judged(silent).treatment is Treatment.ACCOMPANY, "its mode is not known"


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        (with_status(in_air=False), "armed on the ground"),
        (replace(ALOFT, autopilot=ardupilot.AUTOPILOT), ardupilot.AUTOPILOT.label),
        (replace(ALOFT, autopilot=registry.UNKNOWN), "unknown autopilot"),
        (replace(ALOFT, multicopter=False), "no multicopter"),
        (replace(ALOFT, position_m=None), "no position"),
        (replace(ALOFT, position_m=None, lost=("it has no GPS", "wait")), "no GPS"),
        (replace(ALOFT, position_m=(0.0, FAR_M + 1.0, 8.0)), "1001.0 m from its start"),
        (VehicleFacts(vehicle_id=2, unreachable=("carries system id 7, not 2", "correct it")), "system id 7"),
    ],
)
def test_refused_are_those_that_may_be_another_vehicle_or_cannot_be_flown(facts: VehicleFacts, words: str) -> None:
    standing = judged(facts, taken=True)
    assert (standing.treatment, standing.finding.grade) == (Treatment.LEAVE, Grade.REFUSE)
    assert words in standing.finding.found
    assert "--leave 2" in standing.finding.next_step


def test_those_that_are_missing_on_the_ground_or_fell_are_left() -> None:
    missing = judged(VehicleFacts(vehicle_id=2, unreachable=("no heartbeat", "look"), silent=True))
    assert (missing.treatment, missing.finding.grade) == (Treatment.LEAVE, Grade.WARNING)
    down = structs.replace(ALOFT.status, armed=False, in_air=False)
    home = judged(replace(ALOFT, status=down, position_m=(0.5, 0.5, 0.0)))
    assert (home.treatment, home.finding.grade) == (Treatment.LEAVE, Grade.PASS)
    fell = judged(replace(ALOFT, status=down))
    assert (fell.treatment, fell.finding.grade) == (Treatment.LEAVE, Grade.WARNING)
    place = CASE2.mission_frame().geodetic_from_mission((20.0, 5.0, 8.0))
    assert f"20.6 m from its start, at {place.latitude_deg:.6f}, {place.longitude_deg:.6f}" in fell.finding.found
    falling = judged(replace(ALOFT, status=structs.replace(down, in_air=True), position_m=(0.0, 0.0, 5.0)))
    assert (falling.treatment, falling.finding.grade) == (Treatment.LEAVE, Grade.WARNING)


def test_low_batteries_and_places_outside_the_fence_are_warnings() -> None:
    assert judged(with_status(battery=0.3)).finding.grade is Grade.WARNING
    assert judged(with_status(battery=None)).finding.grade is Grade.WARNING
    fenced = replace(CASE2, safety=CASE2.safety.model_copy(update={"fence_m": FENCE_M}))
    far = replace(ALOFT, position_m=(60.0, 0.0, 8.0))
    (standing,) = standings(fenced, [far], ())
    assert (standing.treatment, standing.finding.check, standing.finding.grade) == (
        Treatment.TAKE,
        "fence",
        Grade.WARNING,
    )
    assert judged(far).finding.grade is Grade.PASS


def test_the_way_home_has_layers_where_they_fit_and_the_teams_identity() -> None:
    home, told = homeward(CASE2, land=False)
    assert (home.choreography.landing, told) == ("return", "")
    assert home.choreography.layer_m > CASE2.safety.vertical_separation_m
    assert home.identity == CASE2.identity
    layered = CASE2.replace(choreography={"layer_m": 4.0})
    assert homeward(layered, land=False)[0].choreography.layer_m == 4.0
    landed, told = homeward(layered, land=True)
    assert (landed.choreography.landing, told) == ("in_place", "")
    low, told = homeward(CASE2.replace(safety={"altitude_max_m": 10.0}), land=False)
    assert low.choreography.landing == "in_place"
    assert "altitude_max_m" in told


def test_a_team_with_a_planner_of_its_own_is_brought_home_without_it() -> None:
    mission, _ = homeward(CASE2.replace(mission={"planner": "somewhere:Planner"}), land=False)
    assert mission.mission.planner == "somewhere:Planner"
    plan = FlightPlan(mission, HOLDS_S, mission.vehicles, None, recovery=TeamRecovery())
    assert plan.planner is None
    with pytest.raises(InputError):
        replace(plan, recovery=None)
