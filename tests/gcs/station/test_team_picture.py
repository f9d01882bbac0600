"""The pictures of a team that flies, made of messages by hand: what is shown of each, and what of their absence."""

from math import hypot, pi

import msgspec
import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agents.safety.failsafe import Condition
from agents.team.messages import (
    MISSION_RING,
    Aircraft,
    AutopilotReport,
    CommandAnswer,
    CommandedRing,
    MemberState,
    NeighbourAngle,
    NextChange,
    OperatorCommand,
    Outlook,
    RingChoice,
    RingValues,
    StartProposal,
    TargetPackage,
    TargetReport,
    VehicleReport,
)
from gcs.console.vehicle_view import LINK_CUT, SILENT, NextView, VehicleView
from gcs.metrics.ending import UNACCOUNTED, LostFlight
from gcs.mission.mission import Mission
from gcs.station.picture import (
    EventPicture,
    LostPicture,
    OperatorRights,
    TeamPicture,
    mission_picture,
)
from gcs.station.team_picture import TeamPictures
from tests.support.mission_text import content, parsed, put
from tests.support.several_rings import with_rings

UNIX_S, START_S = 1_000_000.0, 1_000_100.0
FENCE = [[-50.0, -50.0], [150.0, -50.0], [150.0, 50.0], [-50.0, 50.0]]


def the_mission() -> Mission:
    return parsed(put(content(), ("safety", "fence_m"), FENCE))


def state(sender: int, time_s: float, place_m: tuple[float, float] = (1.0, -2.0), **fields: object) -> MemberState:
    still = (0.0, 0.0)
    return replace(MemberState(sender, time_s, "formation", place_m, still, place_m, still, 8.0), **fields)


def report(sender: int, time_s: float, **fields: object) -> VehicleReport:
    known = VehicleReport(sender, time_s, "offboard", True, True, 0.05, start_s=START_S, duration_s=600.0)
    return replace(known, **fields)


class Page:
    """The pictures of the team at times on a steady clock, which is `UNIX_S` behind Unix time."""

    def __init__(self, mission: Mission | None = None) -> None:
        self.pictures = TeamPictures(mission or the_mission(), UNIX_S)
        self.events: list[EventPicture] = []

    def hears(self, now_s: float, *messages: MemberState | VehicleReport | StartProposal) -> None:
        for message in messages:
            self.pictures.receive(message, now_s)

    def team(self, now_s: float, link: str = "", stood_s: float = 0.0, *, is_over: bool = False) -> TeamPicture:
        picture = self.pictures.picture(now_s, link, stood_s, is_over=is_over)
        self.events += self.pictures.new_events(now_s)
        return picture

    def vehicle(self, vehicle_id: int, now_s: float, *, is_over: bool = False) -> VehicleView:
        return next(each for each in self.team(now_s, is_over=is_over).vehicles if each.vehicle_id == vehicle_id)


def test_nothing_is_known_of_a_team_that_was_not_heard() -> None:
    picture = Page().team(5.0, "no flight")
    assert picture.vehicles == tuple(VehicleView(each) for each in (1, 2, 3))
    assert (picture.time_s, picture.remaining_s, picture.target, picture.ending) == (None, None, None, "")
    assert (picture.wall_s, picture.link, picture.ring_members) == (UNIX_S + 5.0, "no flight", 0)


def test_a_vehicle_in_reserve_is_marked_until_it_flies() -> None:
    page = Page()
    page.hears(10.0, report(3, START_S, ended="landed: in reserve", in_reserve=True))
    assert (page.vehicle(3, 10.1).in_reserve, page.vehicle(3, 10.1).has_ended) == (True, True)
    page.hears(11.0, report(3, START_S + 1.0))
    assert (page.vehicle(3, 11.1).in_reserve, page.vehicle(3, 11.1).has_ended) == (False, False)


def test_every_field_is_that_of_the_messages() -> None:
    page = Page()
    place = NeighbourAngle(1, START_S + 20.0, 1.0, 0.05, 10.5)
    flies = state(
        1, START_S + 20.0, (3.0, 4.0), tactic="encircle", velocity_m_s=(0.5, -0.6), aim_m=(3.5, 4.5),
        altitude_m=9.0, angle=place,
    )  # fmt: skip
    says = report(
        1,
        START_S + 19.9,
        yaw_rad=1.5,
        autopilot=AutopilotReport(0.7, 900.0, 3, 14),
        estimator="good",
    )
    ahead = state(3, START_S + 20.0, (0.0, 0.0), angle=NeighbourAngle(3, START_S + 20.0, 1.5, 0.05, 10.0))
    behind = state(2, START_S + 20.0, (3.0, 8.0), angle=NeighbourAngle(2, START_S + 20.0, 0.5, 0.05, 10.0))
    page.hears(10.0, says, report(2, START_S + 20.0), report(3, START_S + 20.0), flies, behind, ahead)
    assert page.vehicle(1, 10.25) == VehicleView(
        1,
        age_s=0.25,
        is_stale=False,
        tactic="encircle",
        mode="offboard",
        position_m=(3.0, 4.0, 9.0),
        yaw_rad=1.5,
        velocity_m_s=(0.5, -0.6),
        aim_m=(3.5, 4.5),
        autopilot=AutopilotReport(0.7, 900.0, 3, 14),
        estimator="good",
        link_age_s=0.05,
        nearest_id=2,
        nearest_m=4.0,
        fence_margin_m=46.0,
        radius_m=10.5,
        angular_rate_rad_s=0.05,
        lead_rad=0.5,
    )
    team = page.team(10.25)
    assert (team.time_s, team.remaining_s, team.ring_members) == (20.0, 580.0, 3)
    leads_rad = [each.lead_rad for each in team.vehicles]
    assert leads_rad == pytest.approx([0.5, 0.5, 2.0 * pi - 1.0])


def test_a_ring_commanded_in_flight_is_shown_until_the_next_flight() -> None:
    page = Page()
    page.hears(10.0, report(1, START_S), state(1, START_S, (0.0, 0.0)))
    assert page.team(10.1).ring is None
    page.hears(11.0, state(1, START_S + 1.0, (0.0, 0.0), ring=CommandedRing(15.0, START_S)))
    page.hears(11.0, state(2, START_S + 1.0, (9.0, 0.0), ring=CommandedRing(12.0, START_S - 1.0, tilt_deg=9.0)))
    team = page.team(11.1)
    assert team.ring == RingValues(15.0, None, None, 9.0)
    page.hears(12.0, report(1, START_S + 2.0, ended="landed"), report(2, START_S + 2.0, ended="landed"))
    assert page.team(12.1).ring is None
    page.hears(200.0, state(1, START_S + 190.0, (0.0, 0.0)), state(2, START_S + 190.0, (9.0, 0.0)))
    assert page.team(200.1).ring is None


def on_ring(sender: int, time_s: float, ring: int | None, **fields: object) -> MemberState:
    angle = NeighbourAngle(sender, time_s, 0.5 * sender, 0.05, 10.0)
    on_it = state(sender, time_s, tactic="encircle", angle=angle, choice=RingChoice(ring))
    return replace(on_it, **fields)


def sees(sender: int, time_s: float, x_m: float, age_s: float = 0.5) -> VehicleReport:
    return report(sender, time_s, target=TargetReport((x_m, 0.0), (0.0, 0.0), (0.1, 0.0, 0.1), age_s))


def places_m(page: Page, now_s: float) -> list[float | None]:
    targets = page.team(now_s).targets
    assert isinstance(targets, tuple)
    return [None if each is None else each.position_m[0] for each in targets]


def test_each_target_is_where_the_vehicles_of_its_rings_have_it() -> None:
    """North is about the first target, south and high about the second."""
    page = Page(with_rings(the_mission()))
    page.hears(10.0, sees(1, START_S, 30.0), sees(2, START_S, 110.0), sees(3, START_S, 111.0, age_s=0.1))
    assert places_m(page, 10.0) == [None, None], "no state says yet which target they are about"
    page.hears(10.0, on_ring(1, START_S + 0.1, 0), on_ring(2, START_S, 1), on_ring(3, START_S, 2))
    team = page.team(10.0)
    assert places_m(page, 10.0) == [30.0, 111.0], "of two, that with the newest sighting"
    assert [each.ring for each in team.vehicles] == ["north", "south", "high"]
    assert (team.target, team.ring, team.rings) == (None, None, (None, None, None))
    assert [each.lead_rad for each in team.vehicles] == [None] * 3, "each is alone on its ring"


def test_a_vehicle_that_changes_to_a_ring_about_another_target_moves_none() -> None:
    page = Page(with_rings(the_mission()))
    page.hears(10.0, sees(1, START_S, 30.0), on_ring(1, START_S, 0), sees(2, START_S, 110.0), on_ring(2, START_S, 1))
    page.hears(10.2, sees(1, START_S + 0.2, 110.0), on_ring(2, START_S + 0.2, 1))
    assert places_m(page, 10.2) == [30.0, 110.0], "its report is about the other target, which its state says later"
    page.hears(10.3, on_ring(1, START_S + 0.3, 1))
    page.hears(10.3, sees(2, START_S + 0.3, 112.0, age_s=5.0), on_ring(2, START_S + 0.3, 1))
    assert places_m(page, 10.3) == [30.0, 112.0], "until it reports the other target, its estimate is of the first"
    page.hears(10.4, sees(1, START_S + 0.35, 110.5, age_s=0.0), on_ring(1, START_S + 0.4, None))
    assert places_m(page, 10.4) == [30.0, 110.5], "the first is where it was seen last"
    lost = page.team(10.4).targets
    assert isinstance(lost, tuple)
    assert lost[0] is not None
    assert lost[0].lost_speed_m_s is not None


def test_sightings_of_another_target_do_not_renew_an_estimate() -> None:
    page = Page(with_rings(the_mission()))
    package = TargetPackage(1, START_S + 1.0, (0.0, 0.0), (1.0, 0.0, 1.0), 0.8, 0.2, ())
    page.hears(10.0, sees(1, START_S, 30.0), on_ring(1, START_S, 0))
    for target, age_s in ((1, 1.5), (0, 0.0)):
        page.hears(11.0, on_ring(1, START_S + 1.0, 0, sightings=(replace(package, target=target),)))
        targets = page.team(11.0).targets
        assert isinstance(targets, tuple)
        assert targets[0] is not None
        assert targets[0].sighting_age_s == pytest.approx(age_s)


def test_a_mission_of_several_rings_names_them_with_their_bounds_and_what_was_commanded_of_each() -> None:
    mission = with_rings(the_mission())
    planned = mission_picture(mission, "sitl", 600.0)
    assert planned.targets == ("boat", "buoy")
    assert isinstance(planned.rings, tuple)
    assert [(each.name, each.target, each.places) for each in planned.rings] == [
        ("north", 0, 2), ("south", 1, 2), ("high", 1, 2)
    ]  # fmt: skip
    assert [each.ring for each in planned.rings] == [
        RingValues(10.0, 0.05, 8.0, 0.0), RingValues(14.0, 0.06, 7.0, 0.0), RingValues(8.0, -0.1, 12.0, 0.0)
    ]  # fmt: skip
    assert [each.ring_bounds.speed_max_m_s for each in planned.rings] == pytest.approx([2.3, 2.4, 2.4])
    assert len({each.colour for each in planned.rings} - {each.colour for each in planned.vehicles}) == 3
    only = msgspec.to_builtins(mission_picture(the_mission(), "sitl", 600.0))
    assert not only.keys() & {"targets", "rings"}
    page = Page(mission)
    old, new = CommandedRing(12.0, START_S - 1.0), CommandedRing(13.0, START_S)
    for vehicle_id, rings in ((1, (MISSION_RING, old, MISSION_RING)), (2, (MISSION_RING, new, MISSION_RING)), (3, ())):
        page.hears(10.0, state(vehicle_id, START_S, choice=RingChoice(None, b"", rings)))
    assert page.team(10.0).rings == (None, RingValues(13.0), None)
    assert not msgspec.to_builtins(Page().team(1.0)).keys() & {"targets", "rings"}


def test_what_is_not_known_is_null_and_never_zero() -> None:
    page = Page(parsed(content()))
    page.hears(1.0, StartProposal(1, START_S, None, ready=False))
    shown = msgspec.to_builtins(page.vehicle(1, 1.0))
    shown |= shown.pop("autopilot")
    assert {name for name, value in shown.items() if value not in (None, "", False, ())} == {
        "vehicle_id",
        "severity",
    } | ({"age_s"} if shown["age_s"] else set())
    page.hears(1.5, state(1, START_S))
    assert page.vehicle(1, 1.5).fence_margin_m is None, "this mission has no fence"
    assert page.vehicle(1, 1.5).nearest_m is None, "no other was heard"


def test_before_the_start_there_is_no_mission_time() -> None:
    page = Page()
    page.hears(1.0, state(1, START_S - 5.0), report(1, START_S - 5.0, start_s=None))
    assert (page.team(1.0).time_s, page.team(1.0).remaining_s) == (None, None)
    page.hears(1.5, report(1, START_S - 2.0))
    assert (page.team(1.5).time_s, page.team(1.5).remaining_s) == (None, 600.0)


def test_one_clock_that_is_wrong_does_not_move_the_missions_time() -> None:
    page = Page()
    for vehicle_id, off_s in ((1, 0.0), (2, 900.0), (3, 0.1)):
        page.hears(1.0, report(vehicle_id, START_S + 30.0 + off_s))
    assert page.team(1.0).time_s == pytest.approx(30.1)


def test_a_vehicle_whose_messages_stop_is_stale_after_a_second() -> None:
    page = Page()
    page.hears(1.0, report(1, START_S + 1.0), state(1, START_S + 1.0))
    assert not page.vehicle(1, 2.0).is_stale
    shown = page.vehicle(1, 2.1)
    assert (shown.is_stale, shown.alert, shown.severity, shown.has_ended) == (True, SILENT, "alarm", False)
    assert shown.advice
    assert shown.position_m == (1.0, -2.0, 8.0)
    assert page.team(4.0).link == "no message from any vehicle for 3 s"
    page.hears(5.0, StartProposal(1, START_S + 4.9, START_S), report(1, START_S + 4.9))
    assert page.vehicle(1, 5.0).is_stale, "that its process lives does not show where it flies"
    page.hears(5.0, state(1, START_S + 5.0))
    shown = page.vehicle(1, 5.05)
    assert (shown.is_stale, shown.alert, shown.severity) == (False, "", "information")
    assert [each.text for each in page.events] == [
        "connected, tactic formation",
        "no messages, last tactic formation",
        "messages restored",
    ]


def test_a_vehicle_in_take_off_is_where_its_report_says_until_it_sends_states() -> None:
    page = Page()
    for now_s, height_m in ((1.0, 0.0), (2.0, 0.6), (3.0, 1.2)):
        page.hears(now_s, report(1, START_S + now_s, mode="takeoff", start_s=None, position_m=(1.0, 2.0, height_m)))
        assert page.vehicle(1, now_s).position_m == (1.0, 2.0, height_m)
        assert not page.vehicle(1, now_s).is_stale
    page.hears(4.0, report(1, START_S + 4.0), state(1, START_S + 4.0))
    assert page.vehicle(1, 4.0).position_m == (1.0, -2.0, 8.0)


def test_a_vehicle_on_the_ground_is_not_stale_between_its_reports() -> None:
    page = Page()
    page.hears(1.0, report(1, START_S, start_s=None, armed=False, in_air=False))
    page.hears(1.9, StartProposal(1, START_S + 0.9, None, ready=False))
    assert not page.vehicle(1, 2.5).is_stale
    assert page.vehicle(1, 3.0).is_stale


def test_a_vehicle_whose_link_is_cut_is_stale_at_once_though_its_agent_speaks() -> None:
    page = Page()
    page.hears(1.0, state(1, START_S), report(1, START_S))
    page.hears(2.0, state(1, START_S + 1.0), report(1, START_S + 1.0, link_age_s=0.9))
    page.hears(2.5, state(1, START_S + 1.5))
    shown = page.vehicle(1, 2.5)
    assert (shown.is_stale, shown.alert, shown.severity) == (True, LINK_CUT, "alarm")
    assert shown.link_age_s == pytest.approx(1.4)
    page.hears(2.6, state(1, START_S + 1.6, alert=Condition.TELEMETRY_STALE.value))
    assert page.vehicle(1, 2.6).alert == "telemetry stale"
    page.hears(2.7, state(1, START_S + 1.7, alert=Condition.BUS_FLOODED.value))
    assert page.vehicle(1, 2.7).severity == "alarm", "whatever else it warns of"
    page.hears(3.0, state(1, START_S + 2.0), report(1, START_S + 2.0))
    assert not page.vehicle(1, 3.0).is_stale
    link = [(each.text, each.severity) for each in page.events if "link" in each.text]
    assert link == [("link to its autopilot cut", "alarm"), ("link restored", "information")]


def test_alerts_have_advice_and_severity_and_disappear() -> None:
    page = Page()
    page.hears(1.0, state(1, START_S, alert=Condition.BATTERY_CRITICAL.value), state(2, START_S, alert="bus flooded"))
    one, two, three = page.team(1.0).vehicles
    assert [each.severity for each in (one, two, three)] == ["alarm", "warning", "information"]
    assert one.advice
    assert two.advice
    assert one.advice != two.advice
    page.hears(1.2, state(1, START_S + 0.2))
    assert (page.vehicle(1, 1.2).alert, page.vehicle(1, 1.2).advice) == ("", "")


def test_what_comes_next_is_counted_down_by_the_newest_message_and_the_age_of_it() -> None:
    page, lands = Page(), Outlook(NextChange("land", START_S + 20.0, "not following"), "not following")
    page.hears(1.0, report(1, START_S + 1.0, outlook=lands), state(1, START_S + 1.0, alert="not following"))
    shown = page.vehicle(1, 1.25)
    assert (shown.next, shown.blocks) == (NextView("lands", 18.75, "not following"), "not following")
    page.hears(1.5, state(1, START_S + 1.5, alert="not following"))
    assert page.vehicle(1, 1.5).next == NextView("lands", 18.5, "not following")
    page.hears(2.0, report(1, START_S + 2.0, ended="landed"))
    assert page.vehicle(1, 2.0).next is None


def test_how_flights_end_and_how_the_next_one_begins() -> None:
    page = Page()
    for vehicle_id, x_m in ((1, 4.0), (2, 8.0), (3, 9.0)):
        page.hears(1.0, state(vehicle_id, START_S, (x_m, 0.0)), report(vehicle_id, START_S))
    page.hears(1.5, report(3, START_S + 0.5, ended="killed: on the ground"))
    team = page.team(1.6)
    assert [each.has_ended for each in team.vehicles] == [False, False, True]
    assert (team.ending, team.ring_members) == ("", 0)
    assert team.vehicles[2].ending == "killed: on the ground"
    assert team.vehicles[1].nearest_id == 1, "one that lies on the ground is no neighbour"
    assert team.vehicles[2].alert == ""
    page.hears(
        2.0,
        report(1, START_S + 1.0, ended="landed", is_completed=True),
        report(2, START_S + 1.0, ended="landed", is_completed=True),
    )
    assert page.team(2.1).ending == "1, 2 landed; 3 killed: on the ground"
    assert page.team(60.0).time_s == page.team(2.1).time_s, "the mission's time stands still"
    assert not any("no messages" in each.text for each in page.events), "what has ended may fall silent"
    assert page.team(60.0).link == ""
    ended = [(each.vehicle_id, each.severity) for each in page.events if each.text.startswith("flight ended")]
    assert ended == [(3, "warning"), (1, "information"), (2, "information")]
    known = len(page.events)
    page.hears(60.1, state(1, START_S + 1.0, tactic="land"))
    page.team(60.1)
    assert page.events[known:] == [], "a state that was sent before the end connects no vehicle"

    page.hears(70.0, report(1, START_S + 69.0, start_s=None), StartProposal(1, START_S + 69.0, None, ready=False))
    team = page.team(70.0)
    assert (team.ending, team.time_s, team.vehicles[0].has_ended) == ("", None, False)
    assert (team.vehicles[0].position_m, team.vehicles[0].tactic) == (None, ""), "where the last flight ended is past"


def shown(team: TeamPicture) -> list[tuple[str, str, bool, bool, bool]]:
    return [(each.alert, each.severity, each.has_ended, each.is_stale, each.is_unaccounted) for each in team.vehicles]


LOST = (UNACCOUNTED, "alarm", False, True, True)
ENDED = ("", "information", True, True, False)


def test_a_vehicle_that_is_unaccounted_for_is_never_ended_until_an_operator_confirms_its_recovery() -> None:
    """Its place is the last that its autopilot sent, with the age of that, however long its agent still speaks."""
    page, place_m = Page(), (5.0, -6.0, 8.5)
    page.hears(1.0, *(state(each, START_S, (each, 0.0)) for each in (1, 2, 3)))
    page.hears(1.0, *(report(each, START_S) for each in (1, 2, 3)))
    page.team(1.0)
    lost = report(3, START_S + 40.0, ended="lost: its link was lost", link_age_s=35.0, unaccounted_m=place_m)
    page.hears(40.0, lost, *(state(each, START_S + 39.0, (each, 0.0)) for each in (1, 2)))
    page.hears(40.0, *(report(each, START_S + 39.0) for each in (1, 2)))
    team = page.team(40.5)
    assert shown(team) == [("", "information", False, False, False)] * 2 + [LOST]
    assert (team.vehicles[2].position_m, team.vehicles[2].link_age_s) == (place_m, 35.5)
    assert team.vehicles[1].nearest_id == 1
    told = [each.severity for each in page.events if each.vehicle_id == 3 and each.text.startswith(UNACCOUNTED)]
    assert told == ["alarm"]

    page.hears(41.0, *(report(each, START_S + 40.0, ended="landed", is_completed=True) for each in (1, 2)))
    for at_s, is_over in ((42.0, False), (43.0, True), (500.0, True)):
        team = page.team(at_s, is_over=is_over)
        assert shown(team)[2] == LOST
        assert [each.has_ended for each in team.vehicles] == [True, True, False]
        assert team.ending == f"1, 2 landed; 3 {UNACCOUNTED}"
        assert max(team.vehicles[2].age_s or 0.0, team.vehicles[2].link_age_s or 0.0) == pytest.approx(at_s - 5.0)

    page.pictures.recover(1)
    page.pictures.recover(3)
    team = page.team(501.0, is_over=True)
    assert [each.has_ended for each in team.vehicles] == [True] * 3
    assert (team.vehicles[2].alert, team.vehicles[2].ending) == ("", "recovered")
    assert team.ending == "1, 2 landed; 3 recovered"
    confirmed = [(each.vehicle_id, each.severity) for each in page.events if "recovered" in each.text]
    assert confirmed == [(3, "information")], "one that has landed needs no recovery"
    page.hears(510.0, report(3, START_S + 500.0, start_s=None))
    page.hears(511.0, replace(lost, time_s=START_S + 520.0))
    assert shown(page.team(511.0))[2] == LOST, "a confirmation holds for one flight"


def test_a_flight_whose_process_is_gone_is_over() -> None:
    page = Page()
    page.hears(1.0, state(1, START_S), report(1, START_S))
    page.hears(1.0, report(2, START_S, ended="landed", is_completed=True))
    new = page.team(1.9, "waiting for team", is_over=True)
    assert not any(each.is_unaccounted for each in new.vehicles), "messages arrive before it is noticed who sends them"
    team = page.team(9.0, "waiting for team", is_over=True)
    assert shown(team) == [LOST, ENDED, ("", "information", False, True, False)]
    assert UNACCOUNTED in team.ending
    assert team.lost is None
    page.hears(20.0, report(1, START_S + 19.0, start_s=None))
    assert page.vehicle(1, 20.0).position_m is None, "another start: another flight"
    assert Page().team(1.0, is_over=True).ending == ""


def test_a_team_that_vanishes_in_flight_is_kept_as_it_was_and_the_time_counts_up() -> None:
    """Whoever looks after a while sees where the vehicles were, that nobody flies them, and since when."""
    page = Page()
    page.hears(1.0, *(state(each, START_S, (each, 0.0)) for each in (1, 2, 3)))
    for at_s, stood_s, is_over in ((1.9, 0.0, True), (3.9, 0.0, False), (4.1, 0.2, False), (30.0, 26.1, False)):
        assert page.team(at_s, stood_s=stood_s, is_over=is_over).lost is None
    for at_s, is_over in ((2.1, True), (4.1, False), (99.0, True), (99.0, False)):
        team = page.team(at_s, is_over=is_over)
        assert team.lost is not None
        assert (team.lost.since_wall_s, team.lost.vehicles) == (UNIX_S + 1.0, (1, 2, 3))
        assert "COM_OBL_RC_ACT" in team.lost.autopilots
        assert ("network is cut" in team.lost.reason) is not is_over
        assert team.lost.processes_ended is is_over
        assert shown(team) == [LOST] * 3
        assert team.link == f"no message from any vehicle for {at_s - 1.0:.0f} s"
        assert [each.position_m for each in team.vehicles] == [(1.0, 0.0, 8.0), (2.0, 0.0, 8.0), (3.0, 0.0, 8.0)]
        assert team.ending == ""
    page.hears(100.0, state(2, START_S + 99.0))
    assert page.team(100.0).lost is None, "it flies again"


def test_on_the_ground_and_after_landing_no_flight_is_lost() -> None:
    page = Page()
    page.hears(1.0, *(report(each, START_S, armed=False, in_air=False, start_s=None) for each in (1, 2)))
    assert page.team(9.0).lost is None, "they wait for their start"
    page.hears(10.0, state(1, START_S + 9.0), report(1, START_S + 9.0, ended="landed", is_completed=True))
    assert page.team(19.0, is_over=True).lost is None


def test_what_the_supervisor_says_of_a_lost_flight_is_shown_until_the_next_messages() -> None:
    page = Page()
    page.hears(1.0, *(state(each, START_S) for each in (1, 2)))
    flight = LostFlight("no tick of vehicle 2 for 0.6 s", (1, 2), UNIX_S + 2.0, "autopilots fly", "watch them")
    page.pictures.lose(flight, 2.0)
    page.hears(2.5, state(1, START_S + 0.5))  # was in transit
    lost = page.team(2.6).lost
    assert lost == LostPicture("no tick of vehicle 2 for 0.6 s", (1, 2), UNIX_S + 2.0, "autopilots fly", "watch them")
    assert [(each.text, each.severity, each.vehicle_id) for each in page.events if each.vehicle_id is None] == [
        (f"vehicles 1 and 2 {UNACCOUNTED}: no tick of vehicle 2 for 0.6 s", "alarm", None)
    ]
    assert page.team(500.0, is_over=True).lost == replace(lost, processes_ended=True)
    assert shown(page.team(500.0, is_over=True))[:2] == [LOST] * 2
    page.pictures.recover(1)
    left = page.team(500.0, is_over=True)
    assert left.lost is not None
    assert left.lost.vehicles == (2,)
    assert shown(left)[:2] == [ENDED, LOST]
    page.pictures.recover(2)
    assert page.team(500.0, is_over=True).lost is None, "both were found"
    page.hears(501.0, state(1, START_S + 500.0))
    assert page.team(501.0).lost is None


def test_a_flight_ends_on_the_page_without_the_last_report_of_a_vehicle_that_is_unaccounted_for() -> None:
    """The bus may lose that report; the supervisor names the vehicle."""
    page = Page()
    page.hears(1.0, *(state(each, START_S) for each in (1, 2, 3)))
    page.hears(9.0, *(report(each, START_S + 8.0, ended="landed", is_completed=True) for each in (1, 2)))
    page.pictures.lose(LostFlight("the flight is over", (3,), UNIX_S + 9.0, "autopilots fly", "search"), 9.1)
    team = page.team(20.0, is_over=True)
    assert team.lost is not None
    assert team.ending == f"1, 2 landed; 3 {UNACCOUNTED}"
    page.pictures.recover(3)
    assert page.team(21.0, is_over=True).lost is None


def test_a_team_that_vanishes_in_take_off_is_unaccounted_for_where_it_was_last() -> None:
    """It sends no states before it has taken off; one that still waits on the ground is not missed."""
    page, place_m = Page(), (1.0, -2.0, 3.5)
    page.hears(1.0, report(1, START_S, mode="take-off", start_s=None, position_m=place_m))
    page.hears(1.0, report(2, START_S, mode="ready", armed=False, in_air=False, start_s=None, position_m=(0.0,) * 3))
    assert page.team(2.5).lost is None
    team = page.team(9.0)
    assert team.lost is not None
    assert team.lost.vehicles == (1,)
    assert (team.vehicles[0].is_unaccounted, team.vehicles[0].position_m) == (True, place_m)
    assert [each.is_unaccounted for each in team.vehicles] == [True, False, False]


def test_the_target_is_that_of_the_newest_sighting_and_goes_on() -> None:
    page = Page()
    old = TargetReport((30.0, 0.0), (1.0, 0.0), (1.0, 0.0, 1.0), 8.0)
    new = TargetReport((35.0, -5.0), (0.5, -0.25), (0.4, 0.1, 0.6), 1.0)
    page.hears(1.0, report(1, START_S, target=old), report(2, START_S, target=new), report(3, START_S))
    page.hears(1.8, *(state(each, START_S + 0.8) for each in (1, 2, 3)))
    target = page.team(1.8).target
    assert target is not None
    assert target.position_m == pytest.approx((35.4, -5.2))
    assert (target.velocity_m_s, target.covariance_m2) == ((0.5, -0.25), (0.4, 0.1, 0.6))
    assert target.sighting_age_s == pytest.approx(1.8)
    seen = TargetPackage(1, START_S + 0.9, (35.0, -5.0), (1.0, 0.0, 1.0), 0.8, 0.2, (2,))
    page.hears(2.0, state(2, START_S + 1.0, sightings=(seen,)))
    target = page.team(2.0).target
    assert target is not None
    assert target.sighting_age_s == pytest.approx(0.1), "it goes on seeing it between its reports"
    lost = page.team(9.0).target
    assert lost is not None, "who is not heard tells nothing of the target any more: it is lost"
    assert lost.position_m == pytest.approx((35.5, -5.25)), "at its last place"
    assert lost.sighting_age_s == pytest.approx(9.0 - 1.9), "it was seen last 0.1 s before 2.0 s"
    assert lost.lost_speed_m_s == pytest.approx(max(hypot(0.5, 0.25), 0.1) + 1.5), "as it was, or faster"


def test_events_are_numbered_and_dated() -> None:
    page = Page()
    page.hears(1.0, state(1, START_S + 3.0), report(1, START_S + 3.0))
    page.team(1.0)
    page.pictures.receive(OperatorCommand(START_S + 4.0, "hold", None, "anna", 1), 2.0)
    page.hears(2.0, report(1, START_S + 4.0, mode="hold"))
    page.pictures.receive(CommandAnswer(1, START_S + 4.0, 1, "refused: a pilot has it", outcome="refused"), 2.0)
    page.team(2.0)
    assert [each.number for each in page.events] == [1, 2, 3, 4]
    told = [(each.text, each.vehicle_id, each.severity, each.time_s, each.wall_s) for each in page.events[1:]]
    assert told == [
        ("command from anna to all vehicles: hold", None, "information", 4.0, UNIX_S + 2.0),
        ("answers: refused: a pilot has it", 1, "warning", 4.0, UNIX_S + 2.0),
        ("mode offboard -> hold", 1, "information", 4.0, UNIX_S + 2.0),
    ]


def test_a_mission_as_it_is_planned() -> None:
    mission = the_mission()
    shown = mission_picture(mission, "sitl", 90.0, OperatorRights("anna", ("hold",)))
    assert (shown.mission, shown.source, shown.duration_s, shown.rate_hz) == ("case2", "sitl", 90.0, 10.0)
    assert (shown.origin_deg, shown.x_bearing_deg) == ((47.397742, 8.545594), 90.0)
    assert (shown.ring, shown.separation_m) == (RingValues(10.0, 0.05, 8.0, 0.0), 3.0)
    assert [(each.vehicle_id, each.start_m) for each in shown.vehicles] == [
        (1, (0.0, 4.0, 0.0)),
        (2, (0.0, 0.0, 0.0)),
        (3, (0.0, -4.0, 0.0)),
    ]
    assert len({each.colour for each in shown.vehicles}) == 3
    assert {len(each.fence_m) for each in shown.vehicles} == {4}
    assert shown.operator.may == ("hold",)
    local = parsed({**content(), "frame": {"local": True}})
    assert mission_picture(local, "flight", 90.0).origin_deg is None
    assert hypot(*shown.vehicles[0].start_m) == 4.0


def test_traffic_is_that_of_the_newest_report_whoever_received_it_until_it_is_old() -> None:
    def plane(time_s: float, x: float, label: str = "HB-XYZ") -> Aircraft:
        return Aircraft(label, START_S + time_s, (x, 0.0), (50.0, 0.0), 120.0)

    page = Page()
    page.hears(1.0, state(1, START_S + 1.0, traffic=(plane(0.5, 100.0), plane(0.9, -50.0, "DRONE"))))
    page.hears(1.1, state(2, START_S + 1.1, traffic=(plane(0.2, 85.0),)))
    seen = page.team(1.5).traffic or ()
    assert [(each.label, each.position_m, each.altitude_m) for each in seen] == [
        ("DRONE", (-50.0, 0.0), 120.0),
        ("HB-XYZ", (100.0, 0.0), 120.0),
    ]
    assert [each.age_s for each in seen] == pytest.approx([0.6, 1.0])
    page.hears(6.0, state(2, START_S + 6.0, traffic=(plane(5.9, 370.0),)))
    assert [(each.label, each.position_m) for each in page.team(11.0).traffic or ()] == [("HB-XYZ", (370.0, 0.0))]
    assert page.team(17.0).traffic is UNSET
