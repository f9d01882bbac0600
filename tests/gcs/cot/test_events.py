"""Events of a team: allowed by the schema, and where its vehicles, targets and rings are."""

from math import cos, radians, sin, sqrt
from xml.etree.ElementTree import Element

import pytest

from agents.team.messages import CommandedRing, MemberState, NeighbourAngle, TargetPackage
from gcs.cot.bridge import TeamEvents
from gcs.mission.file import load_mission
from tests.support.cot import checked, unix_s

NOW_S = 1.75e9
LAT_DEG, LON_DEG, ALTITUDE_M = 47.397742, 8.545594, 488.0


def state(vehicle: int, position_m: tuple[float, float], **fields: object) -> MemberState:
    known: dict[str, object] = {"velocity_m_s": (1.0, 0.0), "aim_m": position_m, "aim_rate_m_s": (0.0, 0.0)}
    return MemberState(vehicle, 100.0, "encircle", position_m, **{**known, **fields})  # type: ignore[arg-type]


def events_of(*states: MemberState, geoid_m: float | None = None) -> dict[str, Element]:
    team = TeamEvents(load_mission("case2"), geoid_m)
    for each in states:
        team.take(each, 0.0)
    return by_uid(team)


def by_uid(team: TeamEvents, now_s: float = 0.5) -> dict[str, Element]:
    checked_events = [checked(each) for each in team.events(now_s, NOW_S)]
    return {each.get("uid", "").removeprefix("cordon-cordon-"): each for each in checked_events}


def degrees_of(x_m: float, y_m: float) -> tuple[float, float]:
    """Return latitude and longitude in case2, whose x points east and y north, by the ellipsoid's radii there."""
    lat, flattening = radians(LAT_DEG), 1.0 / 298.257223563
    e2 = flattening * (2.0 - flattening)
    across_m = 6378137.0 / sqrt(1.0 - e2 * sin(lat) ** 2)
    along_m = across_m * (1.0 - e2) / (1.0 - e2 * sin(lat) ** 2)
    north_rad, east_rad = y_m / (along_m + ALTITUDE_M), x_m / ((across_m + ALTITUDE_M) * cos(lat))
    return LAT_DEG + north_rad * 180.0 / 3.141592653589793, LON_DEG + east_rad * 180.0 / 3.141592653589793


def assert_at(event: Element, x_m: float, y_m: float) -> None:
    point = event.find("point")
    assert point is not None
    place_deg = float(point.get("lat", "")), float(point.get("lon", ""))
    assert place_deg == pytest.approx(degrees_of(x_m, y_m), abs=2e-7)


def test_a_vehicle_is_where_it_flies() -> None:
    (event,) = events_of(state(2, (12.0, 5.0), altitude_m=9.0, position_sigma_m=0.4, velocity_m_s=(0.0, 2.0))).values()
    assert (event.get("type"), event.get("uid")) == ("a-f-A-M-H-Q", "cordon-cordon-vehicle-2")
    assert_at(event, 12.0, 5.0)
    point = event.find("point")
    assert point is not None
    assert (point.get("hae"), point.get("ce")) == ("9999999.00", "0.40"), "the geoid's height is not known"
    track, contact = event.find("detail/track"), event.find("detail/contact")
    assert track is not None
    assert contact is not None
    assert float(track.get("course", "")) % 360.0 == pytest.approx(0.0, abs=0.1), "y is north in case2"
    assert float(track.get("speed", "")) == pytest.approx(2.0)
    assert contact.get("callsign") == "case2 2"
    assert unix_s(event, "time") == pytest.approx(NOW_S)
    assert unix_s(event, "stale") == pytest.approx(NOW_S + 10.0)


def test_with_the_geoid_heights_are_above_the_ellipsoid() -> None:
    (event,) = events_of(state(1, (0.0, 0.0), altitude_m=9.0), geoid_m=47.5).values()
    point = event.find("point")
    assert point is not None
    assert float(point.get("hae", "")) == pytest.approx(ALTITUDE_M + 9.0 + 47.5, abs=0.01)


def test_target_and_ring_are_in_the_middle_of_the_vehicles() -> None:
    """Each states bearing and radius; the ring has the radius that operators commanded last."""
    found = events_of(
        state(1, (30.0, 0.0), angle=NeighbourAngle(1, 100.0, 0.0, 0.05, 10.0), ring=CommandedRing(12.0, 5.0)),
        state(2, (20.0, 11.0), angle=NeighbourAngle(2, 100.0, radians(90.0), 0.05, 10.0)),
    )
    assert found["target"].get("type") == "a-u-G"
    assert found["ring"].get("type") == "u-d-c-c"
    for name in ("target", "ring"):
        assert_at(found[name], 20.0, 0.5)
    ellipse = found["ring"].find("detail/shape/ellipse")
    assert ellipse is not None
    assert (float(ellipse.get("major", "")), float(ellipse.get("minor", ""))) == (12.0, 12.0)


def test_before_the_ring_a_target_is_where_it_was_seen() -> None:
    package = TargetPackage(1, 100.0, (40.0, -6.0), (0.16, 0.0, 0.16), 0.8, 0.2, (2, 3))
    found = events_of(state(1, (0.0, 0.0), sightings=(package,)))
    assert "ring" not in found
    assert_at(found["target"], 40.0, -6.0)
    point = found["target"].find("point")
    assert point is not None
    assert float(point.get("ce", "")) == pytest.approx(0.4), "one sigma"


def test_an_alarm_is_sent_until_it_is_over_and_then_cancelled_once() -> None:
    team = TeamEvents(load_mission("case2"), None)
    team.take(state(1, (0.0, 0.0), alert="battery critical"), 0.0)
    for _ in range(2):
        alarm = by_uid(team)["vehicle-1-alarm"]
        assert alarm.get("type") == "b-a-o-tbl"
        emergency = alarm.find("detail/emergency")
        assert emergency is not None
        assert emergency.get("type") == "911 Alert"
        assert alarm.findtext("detail/remarks") == "battery critical"
    team.take(state(1, (0.0, 0.0)), 0.2)
    over = by_uid(team)["vehicle-1-alarm"]
    assert over.get("type") == "b-a-o-can"
    emergency = over.find("detail/emergency")
    assert emergency is not None
    assert emergency.get("cancel") == "true"
    assert "vehicle-1-alarm" not in by_uid(team)


def test_the_silent_and_those_of_other_teams_are_not_shown() -> None:
    team = TeamEvents(load_mission("case2"), None)
    team.take(state(1, (0.0, 0.0)), 0.0)
    team.take(state(99, (0.0, 0.0)), 0.0)
    assert set(by_uid(team, 1.0)) == {"vehicle-1"}
    assert by_uid(team, 3.0) == {}
