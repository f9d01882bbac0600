"""What a vehicle knows of its peers, and for how long."""

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from agents.team.messages import MemberState, NeighbourAngle
from agents.team.team import Team
from tests.support.team import a_team


def member(sender: int, time_s: float, tactic: str = "formation", x: float = 0.0) -> MemberState:
    return MemberState(sender, time_s, tactic, (x, 0.0), (0.0, 0.0), (x, 0.0), (0.0, 0.0))


def angle(sender: int, time_s: float, bearing: float = 0.5) -> NeighbourAngle:
    return NeighbourAngle(sender, time_s, bearing, 0.3, 10.0)


def test_the_newest_message_counts_whatever_the_order() -> None:
    team = a_team()
    for time_s in (2.0, 3.0, 1.0):
        team.receive(member(1, time_s, "encircle", x=time_s))
        team.ring.receive(angle(1, time_s, bearing=time_s / 10.0).numbers)
    assert team.member(1).position_m == (3.0, 0.0)
    assert team.members() == (team.member(1),)
    assert team.ring.bearings_rad(3.0, team.ring.ids) == [0.3]


def test_what_was_said_too_long_ago_is_dropped() -> None:
    team = a_team()
    team.receive(member(1, 10.0))
    team.receive(member(3, 10.2))
    team.ring.receive(angle(1, 10.0).numbers)
    team.ring.receive(angle(3, 10.2).numbers)
    team.expire(12.0)
    assert [peer.sender for peer in team.members()] == [1, 3]
    team.expire(12.1)
    assert [peer.sender for peer in team.members()] == [3]
    assert team.ring.ids == ()  # vehicle 3 flies in formation, whatever angle it once sent
    team.expire(12.3)
    assert team.members() == ()


@pytest.mark.parametrize(("tactic", "counted"), [("encircle", 1), ("formation", 0), ("hold", 0), ("land", 0)])
def test_only_engaged_peers_are_on_the_ring(tactic: str, counted: int) -> None:
    team = a_team()
    team.ring.receive(angle(1, 10.0).numbers)
    assert team.ring.ids == (1,)
    team.receive(member(1, 10.0, tactic))
    assert len(team.ring.ids) == counted


def test_only_vehicles_about_as_far_out_are_abreast() -> None:
    team = a_team()
    for sender, radius_m in ((1, 10.5), (3, 12.6), (4, 8.4)):
        team.ring.receive(replace(angle(sender, 1.0, bearing=0.1 * sender), radius_m=radius_m).numbers)
    assert team.ring.abreast(2.0, 10.5, 2.0, team.ring.ids) == [pytest.approx((0.4, 0.3, 0.0))]
    # Where the radial part of the distance is nearly all of it, the vehicles may be at almost the same bearing.
    assert [spare_rad for _, _, spare_rad in team.ring.abreast(2.0, 10.5, 2.1001, team.ring.ids)] == [
        pytest.approx(spare_m / 10.5, abs=0.003) for spare_m in (0.0, 2.1, 2.1)
    ]


def test_vehicles_know_whether_they_all_take_the_same_references_into_account() -> None:
    """A chain of radios: 1 and 3 hear 2 only."""
    chain = {1: (2,), 2: (1, 3), 3: (2,)}

    def known(hears: dict[int, tuple[int, ...]]) -> list[bool]:
        teams = {each: a_team() for each in hears}
        for time_s in (1.0, 2.0):  # what is sent first is computed before anything is received
            digests = {each: team.ring.references(each) for each, team in teams.items()}
            for own, others in hears.items():
                for other in others:
                    place = replace(angle(other, time_s), reference_rad=0.5, references=digests[other])
                    teams[own].ring.receive(place.numbers)
        return [teams[each].ring.is_known_to_all(each) for each in hears]

    assert known(chain) == [False, False, False]
    assert known(chain | {1: (2, 3), 3: (1, 2)}) == [True, True, True]


def test_references_are_extrapolated_at_their_own_rates_and_come_with_id_and_radius() -> None:
    team = a_team()
    published = replace(angle(3, 10.0), reference_rad=1.0, reference_rate_rad_s=-0.2, radius_m=14.0)
    for place in (angle(1, 10.0), published, replace(published, sender=4)):
        team.ring.receive(place.numbers)
    team.receive(member(4, 10.0, "hold"))
    ids, references_rad, radii_m = team.ring.others(10.5)
    assert (ids, radii_m) == ([3], [14.0])
    assert references_rad == pytest.approx([0.9])


def test_who_flies_in_formation_and_who_is_near() -> None:
    team = a_team()
    for sender, tactic, x in ((1, "formation", 3.0), (3, "encircle", 5.0), (4, "formation", 5.01)):
        team.receive(member(sender, 1.0, tactic, x))
    assert sorted(team.in_formation()) == [1, 4]
    assert sorted(team.within(np.zeros(2), 5.0)) == [1, 3]


@pytest.mark.parametrize("how", ["expires", "is forgotten"])
@pytest.mark.parametrize(("tactic", "missed"), [("formation", True), ("return and land", True), ("land", False)])
def test_who_falls_silent_is_missed_unless_it_said_that_it_leaves(how: str, tactic: str, missed: bool) -> None:
    team = a_team()
    team.receive(member(1, 10.0, "formation"))
    team.receive(member(1, 10.5, tactic))
    team.receive(member(3, 12.6))
    assert team.gone_s == {}
    if how == "expires":
        team.expire(12.6)
    else:
        team.forget(1)
    assert team.gone_s == ({1: 10.5} if missed else {})
    assert team.count_received == 2
    team.receive(member(1, 12.7))
    assert team.gone_s == {}


def far_and_near() -> Team:
    """Return a team of which vehicle 1 is near and vehicle 3 is far away, both of them known since 10 s."""
    team = a_team()
    for sender in (1, 3):
        team.receive(replace(member(sender, 10.0, "encircle"), angle=angle(sender, 10.0)))
    team.watch([team.member(1)], 11.0)
    return team


def receive(team: Team, state: MemberState) -> None:
    if not team.waits(state):
        team.receive(state)


def test_the_state_of_one_far_away_waits_for_its_turn() -> None:
    team = far_and_near()
    for tenth in range(1, 11):
        time_s = 10.0 + tenth / 10.0
        for sender in (1, 3):
            receive(
                team, replace(member(sender, time_s, "encircle", tenth / 10.0), angle=angle(sender, time_s, time_s))
            )
        assert team.member(1).time_s == time_s
        assert time_s - team.member(3).time_s < 0.75
    assert team.member(3).time_s == pytest.approx(10.8)
    assert sorted(team.ring.bearings_rad(11.0, team.ring.ids)) == pytest.approx([10.86, 11.0])


def test_one_far_away_whose_reference_does_not_go_on_as_published_does_not_wait() -> None:
    team = far_and_near()
    place = replace(angle(3, 10.0), reference_rad=3.1, reference_rate_rad_s=0.5)
    team.receive(replace(member(3, 10.01, "encircle"), angle=replace(place, time_s=10.01)))
    for time_s, reference_rad, waits in ((10.11, 3.15, True), (10.31, 3.25 - 2.0 * np.pi, True), (10.41, 3.305, False)):
        state = replace(member(3, time_s, "encircle"), angle=replace(place, time_s=time_s, reference_rad=reference_rad))
        assert team.waits(state) is waits, time_s


@pytest.mark.parametrize(
    "changed", [{"tactic": "hold"}, {"alert": "battery low"}, {"shape": "wedge", "shaped_s": 10.05}]
)
def test_what_is_new_about_one_far_away_counts_at_once(changed: dict[str, Any]) -> None:
    team = far_and_near()
    receive(team, replace(member(3, 10.1, "encircle"), **changed))
    assert team.member(3).time_s == 10.1


def test_each_vehicle_compares_a_state_with_the_one_that_it_knows() -> None:
    """All vehicles of a process share a received state, but not all have received the same ones before."""
    informed, other, state = far_and_near(), far_and_near(), replace(member(3, 10.2, "encircle"), angle=angle(3, 10.2))
    receive(informed, replace(state, time_s=10.1, alert="battery low"))
    for team, waits in ((other, True), (informed, False), (other, True)):
        assert team.waits(state) is waits


def test_one_far_away_is_as_fresh_as_its_last_state() -> None:
    team = far_and_near()
    receive(team, member(1, 10.2, "encircle"))
    receive(team, replace(member(3, 10.2, "encircle"), angle=angle(3, 10.2)))
    assert team.member(3).time_s == 10.0
    team.expire(11.1)
    assert [peer.time_s for peer in team.members()] == [10.2, 10.2]
    assert team.lost(11.1, 60.0) == ()
    team.expire(12.3)
    assert team.members() == ()
    assert team.gone_s == {1: 10.2, 3: 10.2}


def test_a_peer_that_is_new_is_near_until_the_next_choice() -> None:
    team = far_and_near()
    receive(team, member(4, 10.1))
    assert [each.sender for each in team.near()] == [1, 4]
    team.watch([team.member(1)], 11.0)
    assert [each.sender for each in team.near()] == [1]
    assert [team.watch_due(now_s) for now_s in (10.5, 10.99, 11.0, 3.0)] == [False, False, True, True]


def test_a_peer_that_leaves_without_a_place_on_the_ring_changes_who_comes_to_it() -> None:
    team = a_team()
    team.receive(member(3, 10.0, "encircle"))
    before = team.ring.revision
    team.forget(3)
    assert team.ring.revision != before
