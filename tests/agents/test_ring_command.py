"""A ring that operators command in flight, in closed loop and as vehicles pass it on.

`python -m tests.experiments.ring_commands 100` flies many random commands.
"""

from collections.abc import Callable
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.core import VehicleCore
from agents.inputs import Message
from agents.settings.config import AgentConfig
from agents.situation.task import Task
from agents.team.codec import decode, encode
from agents.team.messages import MISSION_RING, CommandAnswer, CommandedRing, MemberState, OperatorCommand, RingValues
from estimation.state import POSITION, Vector
from sitl.simulation.simulation import Absence
from tests.experiments.membership_scenes import Scene, flown
from tests.experiments.ring_commands import measured
from tests.support.mission_text import CASE2, content, parsed

Maker = Callable[..., AgentConfig]


class ReturnsNone:
    """A plug-in planner that leaves every plan to cordon."""

    def plan(self, task: Task) -> None:
        return None


TIMES_S = st.sampled_from([0.0, 10.0, 20.0])
COMMANDED = st.builds(
    CommandedRing,
    radius_m=st.none() | st.sampled_from([8.0, 12.5]),
    radius_s=TIMES_S,
    angular_rate_rad_s=st.none() | st.sampled_from([-0.1, 0.1]),
    rate_s=TIMES_S,
    altitude_m=st.none() | st.sampled_from([6.0, 11.0]),
    altitude_s=TIMES_S,
    tilt_deg=st.none() | st.sampled_from([-12.0, 5.0]),
    tilt_s=TIMES_S,
)


def polar(scene: Scene) -> tuple[Vector, Vector, Vector]:
    """Fly a scene about a target at rest; return the times (T,), the radii and the bearings (T, N) by truth."""
    flight = flown(scene, 0)
    about_m = flight.motion[..., POSITION] - np.array(scene.mission.target.start_m)
    bearing_rad = np.unwrap(np.arctan2(about_m[..., 1], about_m[..., 0]), axis=0)
    return flight.time_s, np.hypot(about_m[..., 0], about_m[..., 1]), bearing_rad


def commanded(*told: OperatorCommand, absences: tuple[Absence, ...] = (), until_s: float) -> Scene:
    mission = content(CASE2)
    mission["formation"]["speed_m_s"] = 0.5
    mission["target"] |= {"start_m": [20.0, 0.0], "velocity_m_s": [0.0, 0.0]}
    mission["target"]["sensor"]["range_m"] = 40.0
    mission["decision"]["distance_max_m"] = 18.0
    mission["encirclement"] |= {"radius_m": 10.0, "angular_rate_rad_s": 0.1}
    mission["mission"]["duration_s"] = until_s
    for vehicle, scale in zip(mission["vehicles"], ((0.92, 1.06), (1.08, 0.95), (0.95, 0.92)), strict=True):
        vehicle["true_scale"] = dict(zip(("a0", "a1"), scale, strict=True))
    return Scene(parsed(mission), absences, until_s, until_s, told=told)


def peer(time_s: float, ring: CommandedRing) -> MemberState:
    zero = (0.0, 0.0)
    return MemberState(1, time_s, "encircle", zero, zero, zero, zero, ring=ring)


def ring(time_s: float, number: int, radius_m: float | None, rate_rad_s: float | None) -> OperatorCommand:
    return OperatorCommand(time_s, "ring", None, "tower", number, ring=RingValues(radius_m, rate_rad_s))


def test_one_vehicle_receives_a_ring_and_all_fly_it_also_one_that_was_away() -> None:
    """The vehicle that is away during both commands comes back to the ring of its peers."""
    away = Absence(3, 75.0, 110.0, (20.0, -19.0))
    scene = commanded(ring(80.0, 1, 15.0, None), ring(90.0, 2, None, -0.08), absences=(away,), until_s=190.0)
    time_s, radius_m, bearing_rad = polar(scene)
    last = time_s > 170.0
    assert radius_m[last] == pytest.approx(15.0, abs=0.1)
    rates_rad_s = np.diff(bearing_rad[last], axis=0) / np.diff(time_s[last])[:, None]
    assert rates_rad_s == pytest.approx(-0.08, abs=2e-3)
    gaps_deg = np.degrees(np.diff(np.sort(bearing_rad[-1] % (2.0 * np.pi))))
    assert gaps_deg == pytest.approx(120.0, abs=1.0)


def test_a_vehicle_that_held_on_a_larger_ring_goes_on_there() -> None:
    """It engages within 18 m of the target in the mission, whose ring has 10 m: on a ring of 22 m within 30 m."""
    hold, resume = OperatorCommand(100.0, "hold", 2, "tower", 1), OperatorCommand(115.0, "resume", 2, "tower", 2)
    scene = commanded(ring(70.0, 9, 22.0, 0.04), hold, resume, until_s=145.0)
    time_s, radius_m, _ = polar(scene)
    assert radius_m[time_s > 100.0] == pytest.approx(22.0, abs=0.5)


@pytest.mark.parametrize("seed", [3, 9])
def test_random_rings_are_flown_gently_and_soon(seed: int) -> None:
    flight = measured(seed)
    assert flight.commands > 1
    assert flight.reasons == []


@given(st.lists(COMMANDED, min_size=1, max_size=4))
def test_all_vehicles_agree_in_whatever_order_they_hear_of_the_commands(heard: list[CommandedRing]) -> None:
    found = set()
    for order in permutations(heard):
        newest = MISSION_RING
        for each in (*order, order[0]):
            newest = newest.with_(each)
        found.add(tuple(value for value, _ in newest.dated))
    assert len(found) == 1


VALUES = st.builds(
    RingValues,
    *(st.none() | st.floats(*each) for each in ((5.0, 40.0), (-0.3, 0.3), (1.0, 90.0), (-60.0, 60.0))),
)


@given(VALUES, st.floats(0.0, 1e9), VALUES, st.floats(0.0, 1e9))
def test_a_vehicle_that_hears_of_a_command_flies_the_same_numbers(
    values: RingValues, time_s: float, later: RingValues, later_s: float
) -> None:
    given_to_one = MISSION_RING.commanded(values, time_s).commanded(later, later_s)
    received = decode(encode(peer(5.0, given_to_one)))
    assert isinstance(received, MemberState)
    assert received.ring == given_to_one


def test_a_tilt_that_no_mission_may_have_is_not_received() -> None:
    """A ring at rest needs no climb rate: without this bound it could be as steep as its altitude limits allow."""
    steep = CommandedRing(tilt_deg=61.0, tilt_s=3.0)
    with pytest.raises(ValueError, match="6000"):
        decode(encode(peer(5.0, steep)))


@pytest.mark.parametrize(("radius_m", "rate_rad_s"), [(1000.0, None), (0.5, None), (None, 5.0), (None, -5.0)])
def test_a_peer_with_a_ring_that_cannot_be_flown_is_not_followed(
    make_config: Maker, radius_m: float | None, rate_rad_s: float | None
) -> None:
    core = VehicleCore(make_config(vehicle_id=2))
    for number, values in enumerate((RingValues(12.0), RingValues(radius_m, rate_rad_s))):
        told = MISSION_RING.commanded(values, 10.0 + number)
        core.take(Message(20.0 + number, peer(20.0 + number, told)))
    notes = core.tick(21.1).status.notes
    assert [(each.ring.radius_m, each.ring.angular_rate_rad_s) for each in notes if each.ring] == [(12.0, 0.05)]
    assert notes[-1].text.startswith("refused the ring in vehicle 1's state: no ring of ")


def test_a_peer_cannot_date_a_ring_ahead_of_its_message(make_config: Maker) -> None:
    """It would be newer than every later command."""
    core = VehicleCore(make_config(vehicle_id=2))
    core.take(Message(20.0, peer(20.0, MISSION_RING.commanded(RingValues(14.0), 22.0))))
    core.take(Message(20.1, ring(20.1, 1, 12.0, None)))
    notes = [note.ring for note in core.tick(20.2).status.notes if note.ring is not None]
    assert [each.radius_m for each in notes] == [12.0]


def test_values_of_two_operators_that_do_not_go_together_leave_one_ring(make_config: Maker) -> None:
    """25 m at 0.18 rad/s would be 4.5 m/s: all fly the earlier value, whichever they receive first."""
    earlier, later = ring(80.0, 1, 25.0, None), ring(80.1, 2, None, 0.18)
    cores = {i: VehicleCore(make_config(vehicle_id=i, slots=(1, 2, 3))) for i in (1, 2)}
    for i, orders in ((1, (earlier, later)), (2, (later, earlier))):
        for order in orders:
            cores[i].take(Message(80.2, order))
    held = {i: core._broadcast.commanded_rings[0] for i, core in cores.items()}
    for i, other in ((1, 2), (2, 1)):
        told = held[other]
        zero = (0.0, 0.0)
        cores[i].take(Message(80.4, MemberState(other, 80.4, "encircle", zero, zero, zero, zero, ring=told)))
    rings = {
        i: [note.ring for note in core.tick(80.5).status.notes if note.ring is not None][-1]
        for i, core in cores.items()
    }
    assert {(each.radius_m, each.angular_rate_rad_s) for each in rings.values()} == {(25.0, 0.05)}


def test_a_plug_in_planner_keeps_its_own_ring(make_config: Maker) -> None:
    core = VehicleCore(make_config(vehicle_id=2), lambda _config: ReturnsNone())
    core.take(Message(10.0, ring(10.0, 1, 12.0, None)))
    (answer,) = (decode(each.payload) for each in core.tick(10.1).messages)
    assert isinstance(answer, CommandAnswer)
    assert answer.did == "refused: its plug-in planner flies a ring of its own"


def test_an_operator_whose_command_is_older_than_anothers_learns_that(make_config: Maker) -> None:
    core = VehicleCore(make_config(vehicle_id=2))
    core.take(Message(100.5, ring(100.4, 1, 15.0, None)))
    core.take(Message(101.0, ring(100.3, 2, 20.0, None)))
    answers = [decode(each.payload) for each in core.tick(101.1).messages]
    assert [each.did for each in answers if isinstance(each, CommandAnswer)] == [
        "will fly, once it encircles, a ring of 15 m",
        "refused: a newer command of the ring applies",
    ]


def test_a_command_that_a_peer_has_passed_on_before_is_obeyed(make_config: Maker) -> None:
    core, order = VehicleCore(make_config(vehicle_id=2)), ring(20.0, 1, 12.0, -0.05)
    assert order.ring is not None
    core.take(Message(20.2, peer(20.2, MISSION_RING.commanded(order.ring, 20.0))))
    core.take(Message(20.4, order))
    (answer,) = (decode(each.payload) for each in core.tick(20.5).messages)
    assert isinstance(answer, CommandAnswer)
    assert (answer.outcome, answer.did) == ("obeyed", "will fly, once it encircles, a ring of 12 m, -0.05 rad/s")


def test_a_command_without_a_value_or_of_a_ring_that_cannot_be_flown_is_refused(make_config: Maker) -> None:
    core = VehicleCore(make_config(vehicle_id=2))
    for number, values in enumerate((None, RingValues(), RingValues(radius_m=1000.0))):
        core.take(Message(10.0, OperatorCommand(10.0, "ring", None, "anna", number, ring=values)))
    answers = [decode(each.payload) for each in core.tick(10.1).messages]
    assert [(each.outcome, each.did) for each in answers] == [  # type: ignore[union-attr]
        ("refused", "refused: the command names no value of the ring"),
        ("refused", "refused: the command names no value of the ring"),
        ("refused", "refused: a ring of 1000 m is beyond its law's reach: less than 60 m is possible"),
    ]
