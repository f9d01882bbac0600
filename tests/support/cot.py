"""Events of Cursor-on-Target by hand: a check by the schema Event.xsd, version 2.0, and events to send."""

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

_DATE_TIME = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:\d\d)"
_DECIMAL = r"[+-]?(\d+(\.\d*)?|\.\d+)"
_REQUIRED: Mapping[str, str] = {
    "version": r"2(\.0)?",
    "type": r"\w+(-\w+)*(;[^;]*)?",
    "uid": r".+",
    "time": _DATE_TIME,
    "start": _DATE_TIME,
    "stale": _DATE_TIME,
    "how": r"\w(-\w+)*",
}
_OPTIONAL: Mapping[str, str] = {"access": r".*", "qos": r"\d-\w-\w", "opex": r".*"}
_POINT: Mapping[str, str] = dict.fromkeys(("lat", "lon", "hae", "ce", "le"), _DECIMAL)


def checked(payload: bytes) -> Element:
    """Return an event that the schema allows: its attributes, one point, at most one detail; fails for any other."""
    event = ElementTree.fromstring(payload)
    assert event.tag == "event"
    assert _REQUIRED.keys() <= event.attrib.keys() <= _REQUIRED.keys() | _OPTIONAL.keys()
    for name, value in event.items():
        assert re.fullmatch({**_REQUIRED, **_OPTIONAL}[name], value), f"{name}={value!r}"
    assert [each.tag for each in event] in (["point"], ["point", "detail"], ["detail", "point"])
    point = event.find("point")
    assert point is not None
    assert point.attrib.keys() == _POINT.keys()
    assert len(point) == 0
    for name, value in point.items():
        assert re.fullmatch(_POINT[name], value), f"{name}={value!r}"
    assert -90.0 <= float(point.get("lat", "")) <= 90.0
    assert -180.0 <= float(point.get("lon", "")) <= 180.0
    assert unix_s(event, "start") <= unix_s(event, "stale")
    return event


def unix_s(event: Element, name: str) -> float:
    return datetime.fromisoformat(event.get(name, "")).timestamp()


def event_bytes(
    lat_deg: float,
    lon_deg: float,
    time_s: float,
    *,
    uid: str = "marker-1",
    callsign: str = "BOAT",
    ce_m: float = 0.3,
    hae_m: float = 9_999_999.0,
    lasts_s: float = 60.0,
) -> bytes:
    """Return an event as a hand-held would send it: a hostile on the ground."""
    time, stale = (datetime.fromtimestamp(each, UTC).isoformat() for each in (time_s, time_s + lasts_s))
    return (
        f"<?xml version='1.0' encoding='UTF-8' standalone='yes'?>"
        f"<event version='2.0' uid='{uid}' type='a-h-G' time='{time}' start='{time}' stale='{stale}' how='h-g-i-g-o'>"
        f"<point lat='{lat_deg:.9f}' lon='{lon_deg:.9f}' hae='{hae_m}' ce='{ce_m}' le='9999999.0'/>"
        f"<detail><contact callsign='{callsign}'/></detail></event>"
    ).encode()
