"""Cameras pointed at places in a simulated flight: the directions that are sent, by the vehicles' true motion."""

from collections.abc import Iterator
from dataclasses import replace
from math import atan2, degrees, hypot
from pathlib import Path

import pytest

import cordon
from agents.team.messages import CameraView
from cordon import Commanded
from estimation.frames import Triple
from gcs.flightlog.reader import FlightLog, read_log
from gcs.flightlog.records import Decision, Truth
from gcs.link.gimbal import between_rad
from gcs.metrics.pointing import pointing_error_rms_deg
from gcs.metrics.record import CameraTrack
from gcs.replay.cores import replay

pytestmark = pytest.mark.slow

TARGET_M, PLACE_M = (14.0, 0.0), (30.0, -12.0)
LOOKS_S, BACK_S, SINGLE_S, END_S = 40.0, 46.0, 52.0, 58.0
LOOK = f"look x={PLACE_M[0]} y={PLACE_M[1]}"


@pytest.fixture(scope="module")
def mission() -> cordon.Mission:
    target = {"start_m": list(TARGET_M), "velocity_m_s": [0.0, 0.0]}
    vehicles = {1: {"gimbal": True}, 2: {"gimbal": True}}
    return cordon.load("case2-field").replace(target=target, decision={"distance_max_m": 60.0}, vehicles=vehicles)


def directions(log: FlightLog, vehicle: int) -> Iterator[tuple[float, Triple, tuple[float, ...]]]:
    """Yield the time and the true place (x, y, z) whenever a direction was sent, and this."""
    records = log.vehicles[vehicle]
    truths = [each.read(Truth) for each in records if each.kind is Truth]
    places_m = {round(each.time_s, 3): each.position_m for each in truths}
    for decision in (each.read(Decision) for each in records if each.kind is Decision):
        sent_rad = () if decision.setpoint is None else tuple(decision.setpoint.camera_rad)
        if (place_m := places_m.get(round(decision.time_s, 3))) is not None and sent_rad:
            yield decision.time_s, place_m, sent_rad


def off_deg(log: FlightLog, vehicle: int, at_m: tuple[float, float], from_s: float, until_s: float) -> float:
    """Return the largest angle between the directions sent in a time and that to a place on the ground."""
    found = []
    for time_s, (x, y, z), sent_rad in directions(log, vehicle):
        if from_s < time_s < until_s:
            away_x, away_y = at_m[0] - x, at_m[1] - y
            true_rad = atan2(-z, hypot(away_x, away_y)), atan2(away_y, away_x)
            found.append(degrees(between_rad(true_rad, sent_rad)))
    assert len(found) > 10
    return max(found)


def test_cameras_look_at_a_place_and_at_the_target_again(
    mission: cordon.Mission, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    log = tmp_path / "flight.mcap"
    told = [Commanded(LOOKS_S, LOOK), Commanded(BACK_S, "look target"), Commanded(SINGLE_S, LOOK, 2)]
    flown = cordon.simulate(mission, seed=3, duration_s=END_S, log=log, events=told)
    read = read_log(log)
    with subtests.test("directions"):
        for vehicle in (1, 2):
            assert off_deg(read, vehicle, TARGET_M, LOOKS_S - 6.0, LOOKS_S) < 3.0
            assert off_deg(read, vehicle, PLACE_M, LOOKS_S + 0.2, BACK_S) < 1.5
            assert off_deg(read, vehicle, TARGET_M, BACK_S + 0.2, SINGLE_S) < 3.0
        assert off_deg(read, 1, TARGET_M, SINGLE_S + 0.2, END_S) < 3.0
        assert off_deg(read, 2, PLACE_M, SINGLE_S + 0.2, END_S) < 1.5
    with subtests.test("answers"):
        said = [(each.vehicle, each.command.did) for each in flown.record.events if each.command is not None]
        at_place, at_target = f"looks at x {PLACE_M[0]} m, y {PLACE_M[1]} m", "looks at the target"
        assert [did for vehicle, did in said if vehicle == 2] == [at_place, at_target, at_place]
        assert all(did.startswith("has no gimbal") for vehicle, did in said if vehicle == 3)
    with subtests.test("the way that it flies"):
        assert {*flown.vehicles[2].tactic[int(10 * LOOKS_S) :]} == {"encircle"}
    with subtests.test("replay"):
        assert all(each.identical == each.ticks > 0 for each in replay(read).vehicles)
    with subtests.test("the metric leaves these views out"):
        seen = directions(read, 2)
        views = [CameraView(time_s, at_m, rad[0], rad[1], 1.0) for time_s, at_m, rad in seen if time_s > 30.0]
        record = replace(flown.record, cameras={2: CameraTrack.of(views, 0.0, 0.0)})
        track = next(each for each in record.vehicles if each.vehicle_id == 2)
        error_deg = pointing_error_rms_deg(record, track, record.time_s > LOOKS_S)
        assert error_deg is not None
        assert error_deg < 3.0


def test_what_cannot_look_is_bad_input(mission: cordon.Mission, subtests: pytest.Subtests) -> None:
    for text, vehicle, expected in (
        ("look", None, "look: give x=METRES y=METRES"),
        ("look x=1", None, "look: give x=METRES y=METRES"),
        ("look x=1 y=nan", None, "look: give x=METRES y=METRES"),
        ("look target x=1", None, "look: give x=METRES y=METRES"),
        (LOOK, 3, "look: vehicle 3 has no gimbal (vehicles with one: 1, 2"),
    ):
        with subtests.test(text), pytest.raises(cordon.InputError) as refused:
            cordon.simulate(mission, duration_s=5.0, events=[Commanded(1.0, text, vehicle)])
        assert expected in str(refused.value)
    with subtests.test("no gimbals"), pytest.raises(cordon.InputError) as refused:
        cordon.simulate(cordon.load("case2-field"), duration_s=5.0, events=[Commanded(1.0, LOOK)])
    assert "no vehicle has one" in str(refused.value)
