"""Events as sightings: position, error, height and age; what is none is refused with its reason."""

import msgspec
import pytest

from agents.team.perception import ExternalSighting
from gcs.cot.sightings import EventRefusal, EventRefusedError, EventSightings, TrackedTarget
from gcs.mission.file import load_mission
from tests.support.cot import event_bytes

NOW_S, TEAM_S = 1.75e9, 5000.0
LAT_DEG, LON_DEG = 47.3978, 8.5457


def sightings(geoid_m: float | None = None, uid: str = "BOAT") -> EventSightings:
    return EventSightings(load_mission("case2"), TrackedTarget(uid, 2.0, 0.8, 0.2, geoid_m))


def taken(reader: EventSightings, payload: bytes, now_s: float = NOW_S) -> ExternalSighting:
    sighting = reader.take(payload, TEAM_S, now_s)
    assert sighting is not None
    return msgspec.json.decode(sighting, type=ExternalSighting)


@pytest.mark.parametrize("uid", ["BOAT", "marker-1"])
def test_an_event_is_a_sighting_of_its_place_and_one_sigma_is_its_circular_error(uid: str) -> None:
    sighting = taken(sightings(uid=uid), event_bytes(LAT_DEG, LON_DEG, NOW_S - 0.25, ce_m=3.0))
    assert (sighting.frame, sighting.position) == ("geodetic", (LAT_DEG, LON_DEG))
    assert sighting.covariance_m2 == pytest.approx((9.0, 0.0, 9.0))
    assert sighting.time_s == pytest.approx(TEAM_S - 0.25, abs=1e-3)
    assert (sighting.altitude_m, sighting.importance, sighting.threat) == (None, 0.8, 0.2)


@pytest.mark.parametrize("ce_m", [0.0, 9_999_999.0])
def test_an_unknown_error_is_that_of_the_options(ce_m: float) -> None:
    sighting = taken(sightings(), event_bytes(LAT_DEG, LON_DEG, NOW_S, ce_m=ce_m))
    assert sighting.covariance_m2 == pytest.approx((4.0, 0.0, 4.0))


def test_heights_are_used_with_the_geoid_alone() -> None:
    """case2's origin is 488 m above the sea, here 47.5 m above the ellipsoid: 540.5 m are 5 m above the origin."""
    event = event_bytes(LAT_DEG, LON_DEG, NOW_S, hae_m=540.5)
    assert taken(sightings(), event).altitude_m is None
    assert taken(sightings(geoid_m=47.5), event).altitude_m == pytest.approx(5.0)
    assert taken(sightings(geoid_m=47.5), event_bytes(LAT_DEG, LON_DEG, NOW_S)).altitude_m is None


GOOD = event_bytes(LAT_DEG, LON_DEG, NOW_S)
REFUSED = {
    "not XML": (EventRefusal.MALFORMED, b"\x00\xff<event"),
    "cut": (EventRefusal.MALFORMED, GOOD[:-9]),
    "long": (EventRefusal.MALFORMED, GOOD.replace(b"BOAT", b"B" * 20_000)),
    "entities": (EventRefusal.MALFORMED, GOOD.replace(b"<event", b"<!DOCTYPE event [<!ENTITY a 'b'>]><event", 1)),
    "no point": (EventRefusal.MALFORMED, GOOD.replace(b"<point", b"<place")),
    "no latitude": (EventRefusal.MALFORMED, GOOD.replace(b"lat=", b"late=")),
    "not finite": (EventRefusal.MALFORMED, GOOD.replace(b"lon='8", b"lon='nan' x='8")),
    "nowhere": (EventRefusal.MALFORMED, GOOD.replace(b"lat='47", b"lat='147")),
    "no time": (EventRefusal.MALFORMED, GOOD.replace(b" time='2025", b" time='soon")),
    "no uid": (EventRefusal.MALFORMED, GOOD.replace(b"uid='marker-1'", b"uid=''")),
    "old": (EventRefusal.STALE, event_bytes(LAT_DEG, LON_DEG, NOW_S - 60.0)),
    "ahead": (EventRefusal.FUTURE, event_bytes(LAT_DEG, LON_DEG, NOW_S + 5.0)),
    "far": (EventRefusal.VALUE, event_bytes(-33.0, LON_DEG, NOW_S)),
    "wide": (EventRefusal.VALUE, event_bytes(LAT_DEG, LON_DEG, NOW_S, ce_m=50_000.0)),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_sighting_is_refused_and_counted(what: str) -> None:
    reader, (refusal, payload) = sightings(), REFUSED[what]
    with pytest.raises(EventRefusedError, match=refusal.value[:10]):
        reader.take(payload, TEAM_S, NOW_S)
    assert reader.refused == {refusal: 1}
    assert reader.taken == 0
    taken(reader, GOOD)  # the next good one is


def test_repeated_and_frequent_events_are_refused() -> None:
    reader = sightings()
    taken(reader, event_bytes(LAT_DEG, LON_DEG, NOW_S))
    with pytest.raises(EventRefusedError, match="sent before"):
        reader.take(event_bytes(LAT_DEG, LON_DEG, NOW_S), TEAM_S, NOW_S + 0.1)
    with pytest.raises(EventRefusedError, match="a second"):
        reader.take(event_bytes(LAT_DEG, LON_DEG, NOW_S + 0.01), TEAM_S, NOW_S + 0.01)


def test_events_of_others_are_counted_and_without_a_team_none_is_taken() -> None:
    reader = sightings()
    assert reader.take(event_bytes(LAT_DEG, LON_DEG, NOW_S, uid="x", callsign="CAR"), TEAM_S, NOW_S) is None
    assert (reader.others, reader.taken) == (1, 0)
    with pytest.raises(EventRefusedError, match="no vehicle"):
        reader.take(GOOD, None, NOW_S)
