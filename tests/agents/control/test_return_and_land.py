"""The way up and down, flown by three cores and their plants: layers, who waits for whom, and where they land."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import combinations
from math import dist, hypot
from typing import Any

import numpy as np
import pytest

from agents.control.return_and_land import ASIDE_AFTER_S, WAY_EXTRA_S, assembled
from agents.core import VehicleCore
from agents.inputs import Command, Lying, Message, Start, TacticEvent
from agents.notes import Note
from agents.safety.endurance import return_duration_s
from agents.settings.config import AgentConfig
from agents.settings.sections import ChoreographySettings
from agents.tactics import Event, Tactic
from agents.team.messages import BusMessage, Goal, MemberState, OperatorCommand
from estimation.plant.model import exact_step
from estimation.state import Telemetry, Vector

DT_S = 0.1
CLIMB_M_S = 1.0
SINK_M_S = 0.5
LAYER_M = 3.0
HOMES = {1: (0.0, 4.0), 2: (0.0, 0.0), 3: (0.0, -4.0)}
RETURN: dict[str, Any] = {"layer_m": LAYER_M, "landing": "return"}
MakeConfig = Callable[..., AgentConfig]


@dataclass
class Flyer:
    """One vehicle: its core, its true motion and height, and until when it has been up."""

    config: AgentConfig
    motion: Vector
    height_m: float
    core: VehicleCore = field(init=False)
    down_s: float | None = None

    def __post_init__(self) -> None:
        self.core = VehicleCore(self.config)

    def fly(self, setpoint: tuple[float, float, float]) -> None:
        self.motion = exact_step(self.config.plant, DT_S).advance(self.motion, np.array(setpoint[:2]), np.zeros(2))
        self._climb(setpoint[2], CLIMB_M_S)

    def sink(self) -> None:
        self._climb(0.0, SINK_M_S)

    def _climb(self, to_m: float, rate_m_s: float) -> None:
        self.height_m += min(max(to_m - self.height_m, -rate_m_s * DT_S), rate_m_s * DT_S)

    @property
    def place(self) -> tuple[float, float]:
        return float(self.motion[0]), float(self.motion[1])


class Sky:
    """Three vehicles in the air that hear each other at once."""

    def __init__(
        self,
        make: MakeConfig,
        places: dict[int, tuple[float, float]],
        rally: tuple[tuple[float, float], ...] = (),
        fence_m: tuple[tuple[float, float], ...] = (),
        **choreography: Any,
    ) -> None:
        settings = ChoreographySettings(**choreography)
        self.now_s = 100.0
        self.flyers = {
            i: Flyer(
                make(
                    vehicle_id=i,
                    choreography=settings,
                    home_m=HOMES[i],
                    rally_m=tuple((x, y + HOMES[i][1]) for x, y in rally),
                    layers_from_m=8.0,
                    starts_m=tuple(HOMES.values()),
                    safety={"separation_m": 2.0, "fence_m": fence_m},
                ),
                np.array([*place, 0.0, 0.0]),
                8.0,
            )
            for i, place in places.items()
        }
        for each in self.flyers.values():
            each.height_m = each.config.take_off_altitude_m

    def up(self) -> Iterator[Flyer]:
        return (each for each in self.flyers.values() if each.down_s is None)

    def step(self) -> dict[int, tuple[Note, ...]]:
        self.now_s += DT_S
        self.notes: dict[int, tuple[Note, ...]] = {}
        sent = {i: self._tick(each) for i, each in self.flyers.items() if each.down_s is None}
        for sender, messages in sent.items():
            for i, each in self.flyers.items():
                for message in messages if i != sender else ():
                    each.core.take(Message(self.now_s, message))
        return self.notes

    def _tick(self, flyer: Flyer) -> list[BusMessage]:
        x, y, x_rate, y_rate = flyer.motion.tolist()
        flyer.core.take(Telemetry(self.now_s, (x, y, flyer.height_m), (x_rate, y_rate, 0.0)))
        output = flyer.core.tick(self.now_s)
        self.notes[flyer.config.vehicle_id] = output.status.notes
        if flyer.core.tactic is Tactic.LAND:
            flyer.sink()
            flyer.down_s = self.now_s if flyer.height_m <= 0.0 else None
        elif flyer.core.tactic is not Tactic.PILOT_OVERRIDE:  # its pilot holds it where it is
            assert output.setpoint is not None
            flyer.fly(output.setpoint.position_m)
        return [message.received() for message in output.messages]

    def end(self, *vehicles: int) -> None:
        for i in vehicles or tuple(self.flyers):
            self.flyers[i].core.take(TacticEvent(Event.END))

    def clearances_m(self) -> float:
        """The smallest distance in space between two that are up."""
        return min(
            (dist((*a.place, a.height_m), (*b.place, b.height_m)) for a, b in combinations(self.up(), 2)), default=99.0
        )


def settled(sky: Sky, steps: int = 30) -> Sky:
    for _ in range(steps):
        sky.step()
    return sky


def test_vehicles_that_return_rise_cross_in_layers_and_land_in_order_at_their_starts(make_config: MakeConfig) -> None:
    crossed = {1: (20.0, -8.0), 2: (24.0, 0.0), 3: (20.0, 8.0)}  # their ways home cross
    sky = settled(Sky(make_config, crossed, **RETURN, landing_order=(3, 1, 2)))
    began = {i: each.place for i, each in sky.flyers.items()}
    sky.end()
    nearest_m = 99.0
    while any(sky.up()):
        sky.step()
        assert sky.now_s < 500.0, "they never came down"
        nearest_m = min(nearest_m, sky.clearances_m())
        for i, each in sky.flyers.items():
            if each.core.tactic is Tactic.RETURN_AND_LAND and dist(each.place, began[i]) > 1.0:
                assert each.height_m > each.config.return_altitude_m - 1.1, "it rises before it moves across"
    assert sorted(sky.flyers, key=lambda i: sky.flyers[i].down_s or 0.0) == [3, 1, 2]
    assert nearest_m > 0.9 * LAYER_M
    for i, each in sky.flyers.items():
        assert dist(each.place, HOMES[i]) < 1.0


def test_each_lands_at_the_nearest_of_its_places_where_nobody_else_does(make_config: MakeConfig) -> None:
    """Rally points at 40 and 80 m: the first two are nearer to one each, the third to its start."""
    sky = settled(
        Sky(make_config, {1: (45.0, 0.0), 2: (70.0, -8.0), 3: (12.0, 6.0)}, ((40.0, 0.0), (80.0, 0.0)), **RETURN)
    )
    began_s = sky.now_s
    sky.end()
    nearest_m = 99.0
    while any(sky.up()):
        sky.step()
        assert sky.now_s < began_s + 300.0, "they never came down"
        nearest_m = min(nearest_m, sky.clearances_m())
    assert nearest_m > 2.0
    for i, spot in {1: (40.0, 4.0), 2: (80.0, 0.0), 3: (0.0, -4.0)}.items():
        assert dist(sky.flyers[i].place, spot) < 1.0, i
    config = sky.flyers[1].config
    way_s = [return_duration_s(config, (), (x, 4.0), 8.0, (0.0, 0.0)) for x in (40.0, 60.0, 20.0, 0.0)]
    assert way_s[0] == way_s[3] < way_s[1] == way_s[2]


def test_vehicles_well_apart_land_together_and_near_ones_one_by_one(make_config: MakeConfig) -> None:
    sky = settled(Sky(make_config, {1: (0.0, 2.8), 2: (0.0, 0.0), 3: (0.0, -30.0)}))
    sky.end()
    while any(sky.up()):
        sky.step()
        assert sky.now_s < 500.0, "they never came down"
    down_s = {i: each.down_s or 0.0 for i, each in sky.flyers.items()}
    assert down_s[1] == pytest.approx(down_s[3], abs=3.0)
    assert down_s[2] - down_s[1] > 8.0 / SINK_M_S, "it began to sink once the other was down"


def test_one_that_comes_down_alone_does_not_wait_for_those_that_fly_on(make_config: MakeConfig) -> None:
    sky = settled(Sky(make_config, {1: (0.0, 2.8), 2: (0.0, 0.0), 3: (0.0, -2.8)}))
    sky.end(2)
    for _ in range(int(25.0 / DT_S)):
        sky.step()
    assert [i for i, each in sky.flyers.items() if each.down_s is not None] == [2]


def above_a_pilot(make: MakeConfig, pilot: tuple[float, float] = (0.0, 1.0), **settings: Any) -> Sky:
    """Vehicle 2 returns to (0, 0), and a pilot holds vehicle 1 below that."""
    sky = settled(Sky(make, {1: pilot, 2: (20.0, 0.0)}, **{**RETURN, **settings}))
    sky.flyers[1].core.take(TacticEvent(Event.HANDED_OVER))
    sky.flyers[1].height_m = 6.0
    sky.end(2)
    return sky


def pilot_goes(sky: Sky, i: int, to: tuple[float, float]) -> None:
    """Let a pilot fly a vehicle to a place at 2 m/s."""
    flyer = sky.flyers[i]
    while (away_m := dist(flyer.place, to)) > 0.2:
        velocity = 2.0 * (np.array(to) - flyer.motion[:2]) / away_m
        flyer.motion[:] = *(flyer.motion[:2] + DT_S * velocity), *velocity
        sky.step()
    flyer.motion[2:] = 0.0


def landed(sky: Sky, i: int = 2, within_s: float = 400.0) -> float:
    """Fly until a vehicle is down, and return its least distance across to another that is at or below its height."""
    least_m, until_s, flyer = 99.0, sky.now_s + within_s, sky.flyers[i]
    while flyer.down_s is None and sky.now_s < until_s:
        sky.step()
        others = [each for each in sky.flyers.values() if each is not flyer and each.height_m < flyer.height_m + 1.0]
        if flyer.core.tactic is Tactic.LAND:
            least_m = min([least_m, *(dist(each.place, flyer.place) for each in others)])
    return least_m


def places_about(wanted_m: tuple[float, float], taken_m: list[tuple[float, float]], keep_m: float) -> float:
    """The distance to the nearest place that is as far from all that are taken, on a grid of 5 cm."""
    x, y = np.meshgrid(np.arange(-12.0, 12.0, 0.05), np.arange(-12.0, 12.0, 0.05))
    away_m = np.min([np.hypot(x - a, y - b) for a, b in taken_m], axis=0)
    return float(np.hypot(x - wanted_m[0], y - wanted_m[1])[away_m >= keep_m].min())


def test_none_lands_past_one_that_a_pilot_flies_but_beside_it(make_config: MakeConfig) -> None:
    sky = above_a_pilot(make_config)
    returning, arrived_s = sky.flyers[2], 0.0
    while not (arrived_s and dist(returning.place, HOMES[2]) > 1.5):
        sky.step()
        if dist(returning.place, HOMES[2]) < 1.0:
            arrived_s = arrived_s or sky.now_s
        assert returning.core.tactic is Tactic.RETURN_AND_LAND
        assert sky.now_s < 300.0
    assert sky.now_s - arrived_s == pytest.approx(ASIDE_AFTER_S, abs=5.0), "it waits above its start at first"
    assert returning.height_m == pytest.approx(returning.config.return_altitude_m, abs=0.2)
    assert landed(sky) > 2.9, "1.5 separations of 2 m, and it does not drift"
    taken = [sky.flyers[1].place, HOMES[1], HOMES[3]]
    nearest_m = places_about(HOMES[2], taken, 3.0)
    assert nearest_m - 0.1 < dist(returning.place, HOMES[2]) < nearest_m + 0.6
    assert min(dist(returning.place, each) for each in taken) > 2.9


def test_it_lands_at_its_start_if_the_pilot_leaves_in_time(make_config: MakeConfig) -> None:
    sky = settled(above_a_pilot(make_config), 400)
    assert sky.flyers[2].core.tactic is Tactic.RETURN_AND_LAND
    pilot_goes(sky, 1, (8.0, 1.0))
    landed(sky)
    assert dist(sky.flyers[2].place, HOMES[2]) < 1.0


def test_it_chooses_anew_when_the_pilot_follows_it(make_config: MakeConfig) -> None:
    sky = above_a_pilot(make_config)
    returning = sky.flyers[2]
    goals, first_s = set[tuple[float, float]](), 0.0
    for _ in range(4000):
        sky.step()
        if (goal := returning.core._planner.goal) is not None and len(goals) < 3:
            first_s = first_s if goals else sky.now_s
            goals.add((goal.x_m, goal.y_m))
            if len(goals) < 3:  # until its third choice the pilot goes where it goes
                pilot_goes(sky, 1, (goal.x_m, goal.y_m))
        if returning.core.tactic is Tactic.LAND:
            break
    assert len(goals) == 3
    assert sky.now_s - first_s < WAY_EXTRA_S, "it chooses at once, not when its way takes too long"
    assert landed(sky) > 2.5


@pytest.mark.parametrize("earlier", [True, False])
def test_of_two_that_choose_one_place_the_later_in_the_landing_order_chooses_anew(
    make_config: MakeConfig, earlier: bool
) -> None:
    sky = above_a_pilot(make_config, landing_order=(3, 2, 1) if earlier else (2, 3, 1))
    core = sky.flyers[2].core
    while (chosen := core._planner.goal) is None:
        sky.step()
        assert sky.now_s < 300.0
    for _ in range(15):
        far, still = (30.0, 30.0), (0.0, 0.0)
        state = MemberState(3, sky.now_s, "return and land", far, still, far, still, 17.0, goal=chosen)
        core.take(Message(sky.now_s, state))
        sky.step()
    anew = core._planner.goal
    assert anew is not None
    assert (dist((anew.x_m, anew.y_m), (chosen.x_m, chosen.y_m)) > 2.9) is earlier


def test_without_a_free_place_it_waits(make_config: MakeConfig) -> None:
    narrow_m = ((-2.5, -5.5), (2.5, -5.5), (2.5, 5.5), (-2.5, 5.5))
    sky = Sky(make_config, {1: (0.0, 1.0), 2: (0.0, -1.5)}, fence_m=narrow_m, **RETURN)
    sky = settled(sky)
    sky.flyers[1].core.take(TacticEvent(Event.HANDED_OVER))
    sky.flyers[1].height_m = 6.0
    sky.end(2)
    landed(sky, within_s=500.0)
    assert sky.flyers[2].core.tactic is Tactic.RETURN_AND_LAND
    pilot_goes(sky, 1, (20.0, 1.0))
    landed(sky, within_s=100.0)
    assert dist(sky.flyers[2].place, HOMES[2]) < 1.0


def test_one_that_lands_in_place_does_not_land_past_a_pilot(make_config: MakeConfig) -> None:
    sky = settled(Sky(make_config, {1: (0.0, 1.0), 2: (0.0, 0.0)}, layer_m=LAYER_M))
    sky.flyers[1].core.take(TacticEvent(Event.HANDED_OVER))
    sky.flyers[1].height_m = 6.0
    began = sky.flyers[2].height_m
    sky.end(2)
    sky.step()
    assert sky.flyers[2].core.tactic is Tactic.RETURN_AND_LAND
    settled(sky, 250)
    assert dist(sky.flyers[2].place, (0.0, 0.0)) < 0.5
    assert landed(sky) > 2.9
    assert began == sky.flyers[2].config.take_off_altitude_m


def test_none_lands_on_one_that_lies_below_or_was_last_received_there(make_config: MakeConfig) -> None:
    for lies in (True, False):
        sky = settled(Sky(make_config, {1: (0.5, 0.5), 2: (20.0, 0.0)}, **RETURN))
        other = sky.flyers.pop(1)  # it is silent from now on
        if lies:
            sky = settled(Sky(make_config, {2: (20.0, 0.0)}, **RETURN))
            sky.flyers[2].core.take(Lying(1, other.place))
        settled(sky, 100)
        sky.end(2)
        landed(sky)
        assert 2.9 < dist(sky.flyers[2].place, other.place) < 6.0, lies


def test_one_that_says_it_lands_and_never_does_is_not_landed_on(make_config: MakeConfig) -> None:
    sky = settled(Sky(make_config, {1: (0.0, 1.0), 2: (0.0, 0.0)}, layer_m=LAYER_M))
    sky.flyers[1].sink = lambda: None  # type: ignore[method-assign]
    sky.end()
    began_s = sky.now_s
    assert landed(sky) > 2.9
    assert sky.now_s - began_s > 120.0, "it waits for it as long as for one that lands"


def test_two_above_one_pilot_land_at_different_places(make_config: MakeConfig) -> None:
    sky = settled(Sky(make_config, {1: (20.0, 5.0), 2: (20.0, 0.0), 3: (0.0, -2.0)}, **RETURN))
    sky.flyers[3].core.take(TacticEvent(Event.HANDED_OVER))
    sky.flyers[3].height_m = 6.0
    sky.flyers[3].motion[:2] = 0.0, 2.0  # between both starts
    sky.end(1, 2)
    for i in (1, 2):
        assert landed(sky, i) > 2.9
    assert dist(sky.flyers[1].place, sky.flyers[2].place) > 2.9


def test_a_goto_does_not_land_past_a_pilot(make_config: MakeConfig) -> None:
    sky = settled(Sky(make_config, {1: (20.0, 5.0), 2: (20.0, 0.0)}, layer_m=LAYER_M))
    hold = OperatorCommand(sky.now_s, "hold", 2, "ground", 1)
    goto = OperatorCommand(sky.now_s, "goto", 2, "ground", 2, place=Goal(10.0, 0.0, lands=True))
    for command in (hold, goto):
        sky.flyers[2].core.take(Command(sky.now_s, command))
    sky.flyers[1].core.take(TacticEvent(Event.HANDED_OVER))
    sky.flyers[1].height_m, sky.flyers[1].motion[0], sky.flyers[1].motion[1] = 6.0, 10.0, 1.0
    notes = [note for _ in range(300) for note in sky.step().get(2, ())]
    assert sky.flyers[2].core.tactic is Tactic.HOLD
    assert dist(sky.flyers[2].place, (10.0, 0.0)) < 1.0
    refused = [note.command.did for note in notes if note.command is not None and note.command.is_refused]
    assert len(refused) == 1
    assert "vehicle 1" in refused[0]


def test_every_wait_is_bounded(make_config: MakeConfig) -> None:
    sky = settled(Sky(make_config, {1: (0.0, 2.8), 2: (0.0, 0.0)}))
    sky.flyers[1].sink = lambda: None  # type: ignore[method-assign]  # it says that it lands, and never does
    sky.end()
    while sky.flyers[2].down_s is None:
        sky.step()
        assert sky.now_s < 400.0
    assert sky.now_s > 160.0


def test_layers_are_left_once_all_are_in_their_places(make_config: MakeConfig) -> None:
    sky = Sky(make_config, {1: (0.0, 12.0), 2: (0.0, 0.0), 3: (0.0, -2.6)}, layer_m=LAYER_M)
    for each in sky.flyers.values():
        each.core.take(Start(sky.now_s))
    assert [each.height_m for each in sky.flyers.values()] == [8.0, 8.0 + LAYER_M, 8.0 + 2.0 * LAYER_M]
    for _ in range(300):
        sky.step()
        if any(abs(each.height_m - each.config.take_off_altitude_m) > 0.2 for each in sky.flyers.values()):
            gaps = [abs(a.place[1] - b.place[1]) for a, b in combinations(sky.flyers.values(), 2)]
            assert min(gaps) > 4.0, "it sank before all were in their places"
    assert [each.height_m for each in sky.flyers.values()] == pytest.approx([8.0] * 3)


def peer(vehicle_id: int, place: tuple[float, float], tactic: Tactic) -> MemberState:
    return MemberState(vehicle_id, 1.0, tactic.value, place, (0.0, 0.0), place, (0.0, 0.0))


@pytest.mark.parametrize(
    ("tactic", "place", "peers_tactic", "expected"),
    [
        (Tactic.FORMATION, (0.9, 5.0), Tactic.FORMATION, True),
        (Tactic.FORMATION, (1.1, 5.0), Tactic.FORMATION, False),
        (Tactic.FORMATION, (30.0, 5.0), Tactic.ENCIRCLE, True),
        (Tactic.ENCIRCLE, (0.0, 1.4), Tactic.FORMATION, False),
        (Tactic.ENCIRCLE, (0.0, 1.6), Tactic.ENCIRCLE, True),
    ],
)
def test_who_is_in_the_way(
    tactic: Tactic, place: tuple[float, float], peers_tactic: Tactic, expected: bool, make_config: MakeConfig
) -> None:
    config = make_config(safety={"separation_m": 1.0})
    heard = [peer(1, place, peers_tactic), peer(3, (0.0, -5.0), tactic)]
    assert assembled(config, tactic, np.zeros(2), heard, 0.0) is expected
    assert hypot(*place) > 0.0


def test_who_is_not_heard_of_is_waited_for_but_not_for_ever(make_config: MakeConfig) -> None:
    config, here = make_config(), np.zeros(2)
    heard = [peer(1, (0.0, 5.0), Tactic.FORMATION)]
    assert not assembled(config, Tactic.FORMATION, here, heard, 9.0)
    assert assembled(config, Tactic.FORMATION, here, heard, 11.0)
