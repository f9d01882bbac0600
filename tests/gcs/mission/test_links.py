"""Connections that several vehicles share: what a mission says of them, and the pace that follows."""

import pytest

from gcs.link.config import link_paces
from gcs.link.rates import LOAD_SHARE, Rates
from gcs.mission.mission import Mission
from tests.support.mission_text import Content, content, drop, faults, parsed, put

URL = "serial:///dev/ttyUSB0:38400"


def shared(**link: object) -> Content:
    """Case 2 with all vehicles on one connection."""
    mission = put(content(), ("links", "mesh"), {"url": URL, **link})
    for index in range(3):
        mission = put(drop(mission, ("vehicles", index, "url")), ("vehicles", index, "link"), "mesh")
    return mission


def pace_of(mission: Mission) -> Rates:
    (pace,) = link_paces(mission).values()
    return pace.rates


def test_vehicles_that_name_a_link_have_its_url_and_one_pace() -> None:
    mission = parsed(shared())
    assert [vehicle.section.url for vehicle in mission.vehicles] == [URL] * 3
    pace = link_paces(mission)[URL]
    assert (pace.vehicles, pace.capacity_bytes_s) == (3, 3840.0)  # ten bits a byte


def test_fixed_rates_are_those_of_the_link_section_and_setpoints_come_once_a_tick_at_most() -> None:
    rate_hz = parsed(content()).mission.rate_hz
    assert pace_of(parsed(shared())) == Rates(20.0, 2.0, rate_hz, 2.0)
    slow = put(put(shared(), ("link", "telemetry_rate_hz"), 8.0), ("link", "setpoint_rate_hz"), 6.0)
    assert pace_of(parsed(slow)) == Rates(8.0, 2.0, 6.0, 2.0)


def test_automatic_rates_fit_the_line_and_a_links_own_keys_stand_for_the_missions() -> None:
    mission = put(put(shared(), ("link", "rates"), "auto"), ("link", "bytes_per_s"), 9e3)
    for own, capacity_bytes_s in (({}, 9e3), ({"bytes_per_s": 3840.0}, 3840.0)):
        (pace,) = link_paces(parsed(put(mission, ("links", "mesh"), {"url": URL, **own}))).values()
        assert pace.capacity_bytes_s == capacity_bytes_s
        assert pace.load.bytes_s <= LOAD_SHARE * capacity_bytes_s
        assert pace.rates.setpoint_hz >= 5.0
    fixed = put(mission, ("links", "mesh"), {"url": URL, "rates": "fixed"})
    assert pace_of(parsed(fixed)).status_hz == 2.0


def test_a_network_has_no_bound_unless_it_is_given() -> None:
    assert {pace.is_bound for pace in link_paces(parsed(content())).values()} == {False}
    given = link_paces(parsed(put(content(), ("link", "bytes_per_s"), 5000.0)))
    assert {pace.capacity_bytes_s for pace in given.values()} == {5000.0}


@pytest.mark.parametrize(
    ("mission", "fault"),
    [
        (put(shared(), ("vehicles", 1, "link"), "mess"), "vehicles[1].link: [links] has no valid 'mess'"),
        (put(shared(), ("vehicles", 1, "url"), URL), "vehicles[1].url: the vehicle's link has a url"),
        (put(content(), ("vehicles", 1, "url"), "udpin://127.0.0.1:14540"), "vehicles[1].url: 14540 is vehicles[0]'s"),
        (shared(speed=3), "links.mesh.speed: unknown key"),
        (shared(url="ttyUSB0"), "links.mesh.url: a vehicle's url is like"),
        (put(content(), ("links",), 3), "links: it must be a table of tables"),
    ],
)
def test_what_is_wrong_is_named(mission: Content, fault: str) -> None:
    assert any(fault in each for each in faults(mission))
