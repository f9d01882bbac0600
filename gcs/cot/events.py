"""Events of Cursor-on-Target, version 2.0: what cordon sends of a team, and what it reads.

Heights of CoT are above the WGS-84 ellipsoid, those of missions above mean sea level: between them is the height of the
geoid. Without it heights are sent as unknown, and received ones are not used.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from math import isfinite
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from estimation.frames import Geodetic

VEHICLE, TARGET, RING = "a-f-A-M-H-Q", "a-u-G", "u-d-c-c"
"""Types: a friendly military rotary-wing drone, something unknown on the ground, a drawn circle."""
ALARM, ALARM_OVER = "b-a-o-tbl", "b-a-o-can"
UNKNOWN: Final = 9_999_999.0
"""The value of a height or an error that is not known."""
STALE_S: Final = 10.0
"""How long an event is shown after it was sent."""
EVENT_MAX_BYTES: Final = 16_384
_TEXT_MAX = 256
_DEGREES = 7
"""Digits behind the point: a centimetre."""


@dataclass(frozen=True, slots=True)
class CotEvent:
    """An event: a place with its circular error and its time [Unix s].

    `height_m` is above the ellipsoid. `ce_m` is one standard deviation, as the schema of events has it. Both, and
    `stale_s`, the Unix time until which it holds, are None if unknown.
    """

    uid: str
    kind: str
    how: str
    time_s: float
    latitude_deg: float
    longitude_deg: float
    height_m: float | None
    ce_m: float | None
    callsign: str
    stale_s: float | None = None


class MalformedEventError(ValueError):
    """Bytes are no event of Cursor-on-Target."""


def read_event(payload: bytes) -> CotEvent:
    """Return the event in bytes; raises MalformedEventError. Declarations of types and entities are refused."""
    if len(payload) > EVENT_MAX_BYTES:
        raise MalformedEventError(f"{len(payload)} bytes, at most {EVENT_MAX_BYTES}")
    if b"<!DOCTYPE" in payload or b"<!ENTITY" in payload:
        raise MalformedEventError("it declares a document type")
    try:
        event = ElementTree.fromstring(payload)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise MalformedEventError(f"no XML: {error}") from error
    point = event.find("point")
    if event.tag != "event" or point is None:
        raise MalformedEventError("no event with a point")
    latitude_deg, longitude_deg = _number(point, "lat"), _number(point, "lon")
    if not (abs(latitude_deg) <= 90.0 and abs(longitude_deg) <= 180.0):
        raise MalformedEventError(f"lat {latitude_deg:g}, lon {longitude_deg:g}")
    contact = event.find("detail/contact")
    return CotEvent(
        _attribute(event, "uid"),
        _attribute(event, "type"),
        event.get("how", "")[:_TEXT_MAX],
        _time_s(event, "time"),
        latitude_deg,
        longitude_deg,
        _known(_number(point, "hae")),
        _known(_number(point, "ce")),
        "" if contact is None else contact.get("callsign", "")[:_TEXT_MAX],
        _time_s(event, "stale"),
    )


def _attribute(event: Element, name: str) -> str:
    value = event.get(name, "")
    if not 0 < len(value) <= _TEXT_MAX:
        raise MalformedEventError(f"{name} {value[:32]!r}")
    return value


def _number(point: Element, name: str) -> float:
    text = point.get(name, "")
    try:
        value = float(text)
    except ValueError as error:
        raise MalformedEventError(f"{name} {text[:32]!r}") from error
    if not isfinite(value):
        raise MalformedEventError(f"{name} {value}")
    return value


def _known(value: float) -> float | None:
    return None if value >= UNKNOWN else value


def _time_s(event: Element, name: str) -> float:
    text = event.get(name, "")
    try:
        time = datetime.fromisoformat(text)
        return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError) as error:
        raise MalformedEventError(f"{name} {text[:40]!r}") from error


def vehicle_event(
    uid: str,
    callsign: str,
    place: Geodetic,
    geoid_m: float | None,
    sigma_m: float,
    motion: tuple[float, float],
    *,
    remarks: str,
    now_s: float,
) -> bytes:
    """Return the event of a vehicle at a place above mean sea level; `motion` is course [deg] and speed [m/s]."""
    course_deg, speed_m_s = motion
    event, detail = _event(uid, VEHICLE, "m-g", place, geoid_m, sigma_m, now_s)
    SubElement(detail, "contact", {"callsign": callsign})
    SubElement(detail, "track", {"course": f"{course_deg:.1f}", "speed": f"{speed_m_s:.2f}"})
    SubElement(detail, "remarks").text = remarks
    return _bytes(event)


def target_event(uid: str, callsign: str, place: Geodetic, sigma_m: float | None, now_s: float) -> bytes:
    """Return the event of a target, whose height is not known; its position is fused from the vehicles' (`m-f`)."""
    event, detail = _event(uid, TARGET, "m-f", place, None, sigma_m, now_s)
    SubElement(detail, "contact", {"callsign": callsign})
    return _bytes(event)


def ring_event(uid: str, callsign: str, place: Geodetic, radius_m: float, now_s: float) -> bytes:
    """Return the event of a ring: a circle about a place, as it is desired."""
    event, detail = _event(uid, RING, "m-p", place, None, None, now_s)
    SubElement(detail, "contact", {"callsign": callsign})
    radius = f"{radius_m:.2f}"
    SubElement(SubElement(detail, "shape"), "ellipse", {"major": radius, "minor": radius, "angle": "360"})
    SubElement(detail, "strokeColor", {"value": "-256"})
    SubElement(detail, "strokeWeight", {"value": "2.0"})
    SubElement(detail, "fillColor", {"value": "0"})
    return _bytes(event)


def alarm_event(
    uid: str, callsign: str, place: Geodetic, geoid_m: float | None, sigma_m: float, alarm: str, now_s: float
) -> bytes:
    """Return the event of a vehicle's alarm; that of an empty one cancels it."""
    event, detail = _event(uid, ALARM if alarm else ALARM_OVER, "m-g", place, geoid_m, sigma_m, now_s)
    SubElement(detail, "contact", {"callsign": f"{callsign}: {alarm}" if alarm else callsign})
    kind = {"type": "911 Alert"} if alarm else {"cancel": "true"}
    SubElement(detail, "emergency", kind).text = callsign
    SubElement(detail, "remarks").text = alarm
    return _bytes(event)


def _event(
    uid: str, kind: str, how: str, place: Geodetic, geoid_m: float | None, sigma_m: float | None, now_s: float
) -> tuple[Element, Element]:
    """Return an event with its point, and its empty detail."""
    times = {"time": _stamp(now_s), "start": _stamp(now_s), "stale": _stamp(now_s + STALE_S)}
    event = Element("event", {"version": "2.0", "uid": uid, "type": kind, **times, "how": how})
    point: Mapping[str, str] = {
        "lat": f"{place.latitude_deg:.{_DEGREES}f}",
        "lon": f"{place.longitude_deg:.{_DEGREES}f}",
        "hae": f"{UNKNOWN if geoid_m is None else place.altitude_m + geoid_m:.2f}",
        "ce": f"{UNKNOWN if sigma_m is None else sigma_m:.2f}",
        "le": f"{UNKNOWN:.1f}",
    }
    SubElement(event, "point", dict(point))
    return event, SubElement(event, "detail")


def _stamp(unix_s: float) -> str:
    return datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _bytes(event: Element) -> bytes:
    return bytes(ElementTree.tostring(event, encoding="UTF-8", xml_declaration=True))
